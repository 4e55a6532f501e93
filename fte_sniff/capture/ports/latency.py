"""Owns how soon a driver hands on what it has received: asking for it, and reading what was set.

It must not read or write a byte of the line.

Two things hold bytes back. A driver may collect them for a while before it wakes the reader, unless
low latency is asked for (ASYNC_LOW_LATENCY); and an FTDI adapter itself waits until its latency
timer has run off or 62 bytes are there. The ftdi_sio driver sets the timer to 1 ms as long as low
latency is asked for. It stays asked for until the adapter is unplugged, as with `setserial`.
"""

from __future__ import annotations

import fcntl
import struct
from enum import StrEnum
from pathlib import Path
from typing import Final

import serial

USB_SERIAL: Final = Path("/sys/bus/usb-serial/devices")
"""Where the system tells of USB adapters' own settings."""

SHORT_TIMER_MS: Final = 2
"""A latency timer up to this delays no row noticeably, milliseconds."""

_TIOCGSERIAL = 0x541E
_TIOCSSERIAL = 0x541F
_SERIAL_STRUCT = struct.Struct("=32i")
"""`struct serial_struct`, with room behind it."""
_FLAGS_PLACE = 4
_LOW_LATENCY = 1 << 13


class LowLatency(StrEnum):
    """What became of asking a driver to hand on at once."""

    GRANTED = "low latency granted"
    REFUSED = "low latency refused"
    ABSENT = "no low latency setting"


def ask_low_latency(port: serial.Serial) -> LowLatency:
    """Ask the driver behind an open port to hand on at once what it receives."""
    try:
        descriptor = port.fileno()
        told = fcntl.ioctl(descriptor, _TIOCGSERIAL, bytes(_SERIAL_STRUCT.size))
    except (AttributeError, OSError):
        return LowLatency.ABSENT
    try:
        fcntl.ioctl(descriptor, _TIOCSSERIAL, with_low_latency(told))
        told = fcntl.ioctl(descriptor, _TIOCGSERIAL, bytes(_SERIAL_STRUCT.size))
    except PermissionError:
        return LowLatency.REFUSED
    except OSError:
        return LowLatency.ABSENT
    return LowLatency.GRANTED if has_low_latency(told) else LowLatency.REFUSED


def has_low_latency(serial_struct: bytes) -> bool:
    """Whether low latency is asked for in a `struct serial_struct`."""
    return bool(_SERIAL_STRUCT.unpack(serial_struct)[_FLAGS_PLACE] & _LOW_LATENCY)


def with_low_latency(serial_struct: bytes) -> bytes:
    """The same `struct serial_struct`, with low latency asked for and nothing else changed."""
    numbers = list(_SERIAL_STRUCT.unpack(serial_struct))
    numbers[_FLAGS_PLACE] |= _LOW_LATENCY
    return _SERIAL_STRUCT.pack(*numbers)


def latency_timer_ms(device: str, devices: Path = USB_SERIAL) -> int | None:
    """The latency timer of the adapter behind a device file; None where it has none."""
    try:
        return int((devices / Path(device).resolve().name / "latency_timer").read_text())
    except (OSError, ValueError):
        return None


def is_usb(device: str, devices: Path = USB_SERIAL) -> bool:
    """Whether a device file is that of a USB adapter."""
    return (devices / Path(device).resolve().name).exists()
