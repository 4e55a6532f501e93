"""Speeds of terminals. `struct termios2` takes any baud, where termios knows a fixed list."""

import fcntl
import struct
import termios

_TCGETS2, _TCSETS2 = 0x802C542A, 0x402C542B
_TERMIOS2 = struct.Struct("IIIIB19sII")
_BOTHER = 0o010000
_CONTROL_FLAGS = 2


def speed_of(descriptor: int) -> int:
    """The output speed of a terminal, bits per second."""
    return int(_TERMIOS2.unpack(fcntl.ioctl(descriptor, _TCGETS2, bytes(_TERMIOS2.size)))[-1])


def set_speed(descriptor: int, baud: int) -> None:
    """Set both directions of a terminal to `baud` bits per second."""
    fields = list(_TERMIOS2.unpack(fcntl.ioctl(descriptor, _TCGETS2, bytes(_TERMIOS2.size))))
    flags = fields[_CONTROL_FLAGS] & ~(termios.CBAUD | termios.CIBAUD)
    fields[_CONTROL_FLAGS] = flags | _BOTHER
    fields[-2:] = baud, baud
    fcntl.ioctl(descriptor, _TCSETS2, _TERMIOS2.pack(*fields))
