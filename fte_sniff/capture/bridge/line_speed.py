"""Owns the speed of a terminal as a number of bits per second, also where it is no usual one.

It must not know whose terminal it is. On a pseudo-terminal either end shows and sets the same.

Linux keeps the number in `struct termios2`, which Python's termios does not show:

    4 flags (u32 each), line discipline (u8), 19 control characters, ispeed (u32), ospeed (u32)
"""

from __future__ import annotations

import fcntl
import struct
import termios

_TCGETS2, _TCSETS2 = 0x802C542A, 0x402C542B
_TERMIOS2 = struct.Struct("IIIIB19sII")
_BOTHER = 0o010000
_CONTROL_FLAGS = 2

_NUMBER_OF_CODE: dict[int, int] = {
    getattr(termios, name): int(name[1:])
    for name in dir(termios)
    if name[0] == "B" and name[1:].isdecimal()
}
_CODE_OF_NUMBER = {number: code for code, number in _NUMBER_OF_CODE.items()}


def speed_of(descriptor: int) -> int:
    """Bits per second that bytes are written with; 0 means hung up."""
    try:
        reply = fcntl.ioctl(descriptor, _TCGETS2, bytes(_TERMIOS2.size))
    except OSError:
        code: int = termios.tcgetattr(descriptor)[5]
        return _NUMBER_OF_CODE.get(code, int(code))
    return int(_TERMIOS2.unpack(reply)[-1])


def set_speed(descriptor: int, baud: int) -> None:
    """Set both directions to `baud` bits per second."""
    try:
        reply = fcntl.ioctl(descriptor, _TCGETS2, bytes(_TERMIOS2.size))
    except OSError:
        attributes = termios.tcgetattr(descriptor)
        attributes[4] = attributes[5] = _CODE_OF_NUMBER.get(baud, baud)
        termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
        return
    fields = list(_TERMIOS2.unpack(reply))
    flags = fields[_CONTROL_FLAGS] & ~(termios.CBAUD | termios.CIBAUD)
    fields[_CONTROL_FLAGS] = flags | _BOTHER
    fields[-2:] = baud, baud
    fcntl.ioctl(descriptor, _TCSETS2, _TERMIOS2.pack(*fields))
