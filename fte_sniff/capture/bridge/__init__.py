"""Between a host program and the controller: a pseudo-terminal that is opened instead of the port.

It must not know of frames: it carries bytes both ways, and yields them as any source does.

    host program <-> pseudo-terminal <-> HostEnd <-> Exchange <-> port <-> controller

    line_speed   the baud of a terminal as a number, read and set
    host_end     the pseudo-terminal: who is there, what they ask for, bytes both ways
    outlet       bytes onto an open port, whatever kind of port it is
    wires        what is told of the two wires, and its times
    exchange     two threads that pass every byte on at once
    source       exchanges as a source, also after a loss
    wiring       a bridge as a capture is started on it

Bytes are passed on by the threads that read them, before anything else is done with them. Passed
on are the bytes, the baud that the host program asks for, and a hang-up (0 baud). A pseudo-terminal
has no modem lines and tells of no break: DTR and RTS stay as the bridge was asked to set them.
"""
