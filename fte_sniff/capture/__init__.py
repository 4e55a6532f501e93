"""Bytes in: ports, the clock they are stamped with, and the simulated line.

It must not know of frames, files or screens: it hands on chunks and port events. Importing it makes
`sim://` known to pyserial, so that whatever opens ports through `serial.serial_for_url` can open
simulated ones.

    clock            the time that chunks are stamped with
    ports/           one port: found, opened, had or not, and its driver's habits
    sources/         ports as iterables of chunks and port events; one or two wires
    bridge/          a pseudo-terminal in front of a port; every byte passed on both ways
    simulator/       a host, a controller and a wire as a pure model
    url_handlers/    sim:// and socket://, as pyserial finds them
    pseudo_terminal  a device that other programs open, and the link to it
    controller_pty   a simulated controller as a device for other programs
    checks/          what can be wrong with the machine and a port that is not open
"""

import serial

_HANDLERS = f"{__name__}.url_handlers"

if _HANDLERS not in serial.protocol_handler_packages:
    # Before pyserial's own: one of them is mended here.
    serial.protocol_handler_packages.insert(0, _HANDLERS)
