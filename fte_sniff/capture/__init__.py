"""Bytes in: ports, the clock they are stamped with, and the simulated line.

It must not know of frames, files or screens: it hands on chunks and port events. Importing it makes
`sim://` known to pyserial, so that whatever opens ports through `serial.serial_for_url` can open
simulated ones.

    ports          opening a port, and what can go wrong with it
    items          what a source is, whatever it reads; how a line is got at
    threaded       the life of a source that reads in a thread of its own
    source         an open port as an iterable of chunks and port events
    merged         several sources as one, on one time line
    tap            listening: one port, or one for each of two wires
    identity, returning   what a lost port is known by, and how it is waited for
    clock          the time that chunks are stamped with
    lateness       how much earlier than they are stamped bytes may have come
    simulator/     a host, a controller and a wire as a pure model
    url_handlers/  sim:// and socket://, as pyserial finds them
    reading        taking what has arrived from any kind of port
    line_errors    what a UART reports of bytes in error, counted and marked
    latency        how soon a driver hands on what it has
    granted        what an open port is asked for before it is read
    refusal, permission, holders   why a port cannot be had, and the way out
    checks/        what can be wrong with the machine and a port that is not open
    listening      listening to a port for a while, to judge its line by
    adapters       USB adapters that have become no port
    listing        the ports that are plugged in
    bridge/        a pseudo-terminal in front of a port; every byte passed on both ways
    backlog        the bounded way from reading threads to the consumer
    pseudo_terminal   a device that other programs open, and the link to it
    controller_pty a simulated controller as a device for other programs
"""

import serial

_HANDLERS = f"{__name__}.url_handlers"

if _HANDLERS not in serial.protocol_handler_packages:
    # Before pyserial's own: one of them is mended here.
    serial.protocol_handler_packages.insert(0, _HANDLERS)
