"""Owns opening a port: the settings, and what is done to the line.

It must not read or write a byte of it.

What opening does to the line: nothing is written. On a real serial port Linux itself raises DTR and
RTS at the moment of opening, before any program can have a say; they are lowered again within a
millisecond or so (`off`, the default), kept raised (`on`), or kept as the system raised or found
them (`leave`). On closing, the system lowers both. Until the port is set up, in that same
millisecond, Linux may echo what arrives, if the port was last used as a terminal: a tap that has no
TX wire cannot. Bytes that came before the port was opened are thrown away. The port is locked
against other programs that ask for the lock too.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import struct
import termios
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from urllib.parse import urlsplit

import serial

from fte_sniff.capture.ports.refusal import check_name, refusal
from fte_sniff.errors import PortError, ValueRangeError
from fte_sniff.protocol import DEFAULT_BAUD

READ_TIMEOUT_S = 0.01
"""How long a read of an open port waits for bytes, seconds."""

BAUD_RANGE = (50, 12_000_000)
"""The least and the greatest baud that is passed on to a driver."""


class ControlLine(StrEnum):
    """What is done with DTR or RTS on opening."""

    ON = "on"
    OFF = "off"
    LEAVE = "leave"


@dataclass(frozen=True, slots=True)
class PortSettings:
    """How a port is opened; always 8 data bits, no parity, 1 stop bit, no flow control."""

    baud: int = DEFAULT_BAUD
    """Bits per second; outside BAUD_RANGE raises ValueRangeError."""
    dtr: ControlLine = ControlLine.OFF
    rts: ControlLine = ControlLine.OFF

    def __post_init__(self) -> None:
        low, high = BAUD_RANGE
        if not low <= self.baud <= high:
            raise ValueRangeError(f"baud {self.baud} is out of range: {low}..{high}")

    def __str__(self) -> str:
        return f"{self.baud} baud 8N1, DTR {self.dtr}, RTS {self.rts}"


DEFAULT_SETTINGS = PortSettings()
"""The controller's own line; DTR and RTS lowered."""


def open_port(name: str, settings: PortSettings = DEFAULT_SETTINGS) -> serial.Serial:
    """Open a device or a URL that pyserial knows, ready to be read.

    Args:
        name: a device (`/dev/ttyUSB0`), or `sim://`, `socket://host:port`, `rfc2217://host:port`,
            `loop://`, `hwgrep://regexp`.
        settings: baud, DTR and RTS.

    Raises:
        PortError: the port is absent, busy, forbidden or no serial port; the way out is in it.
    """
    check_name(name)
    device = None
    try:
        port = serial.serial_for_url(
            name,
            do_not_open=True,
            baudrate=settings.baud,
            timeout=READ_TIMEOUT_S,
            exclusive=True,
        )
        device = device_of(port)
        with _lines_as_asked(port, settings):
            port.open()
        if device is not None:
            _make_breaks_harmless(port.fileno())
    except (OSError, ValueError, LookupError, OverflowError, termios.error, re.error) as error:
        raise refusal(name, device, error) from error
    return port


def device_of(port: serial.Serial) -> str | None:
    """The device file behind a port; None where there is none (`sim://` and the like)."""
    # The type stubs call every port a Serial; in truth only those on a device file are.
    return port.port if isinstance(port, serial.Serial) else None


@contextlib.contextmanager
def _lines_as_asked(port: serial.Serial, settings: PortSettings) -> Iterator[None]:
    """What is opened in this context has its DTR and RTS as the settings say."""
    port.dtr = settings.dtr is ControlLine.ON
    port.rts = settings.rts is ControlLine.ON
    if ControlLine.LEAVE not in (settings.dtr, settings.rts):
        yield
        return
    device = device_of(port)
    if device is None:
        if urlsplit(port.port or "").scheme == "rfc2217":
            raise PortError("rfc2217:// cannot leave DTR and RTS as they are: ask for on or off")
        yield
        return
    # pyserial cannot but set both lines, so it is told to set what opening the device gave. The
    # device stays open meanwhile, as closing it would lower the lines.
    descriptor = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        found = _modem_lines(descriptor)
        if settings.dtr is ControlLine.LEAVE:
            port.dtr = bool(found & termios.TIOCM_DTR)
        if settings.rts is ControlLine.LEAVE:
            port.rts = bool(found & termios.TIOCM_RTS)
        yield
    finally:
        os.close(descriptor)


def _modem_lines(descriptor: int) -> int:
    """The modem lines' bits; none where the terminal has no such lines, as a pty."""
    try:
        (lines,) = struct.unpack("I", fcntl.ioctl(descriptor, termios.TIOCMGET, b"\0\0\0\0"))
    except OSError:
        return 0
    return int(lines)


def _make_breaks_harmless(descriptor: int) -> None:
    """Make a break an ordinary 00 byte: with BRKINT, which pyserial leaves, it discards bytes."""
    attributes = termios.tcgetattr(descriptor)
    attributes[0] &= ~(termios.BRKINT | termios.IGNPAR)
    termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
