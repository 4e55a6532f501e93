"""Open, configure and read one serial port; driver latency.

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
import select
import struct
import termios
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final, TypeAlias
from urllib.parse import urlsplit

import serial
from serial.urlhandler import protocol_socket

from fte_sniff.capture.port_errors import check_name, refusal
from fte_sniff.capture.uart_errors import LineWatch, line_watch_of
from fte_sniff.errors import PortError, TranslatableText, ValueRangeError
from fte_sniff.protocol import DEFAULT_BAUD, byte_time_ns

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


Read: TypeAlias = Callable[[], bytes]

_MOST_AT_ONCE = 65_536
_GONE = select.POLLHUP | select.POLLERR | select.POLLNVAL


def reader_of(port: serial.Serial) -> Read:
    """The quickest safe way to read `port`."""
    if isinstance(port, protocol_socket.Serial):
        return _DescriptorReader(port.fileno(), empty_is_end=_GONE | select.POLLIN).read
    if type(port).read is serial.Serial.read:
        return _DescriptorReader(port.fileno(), empty_is_end=_GONE).read
    return _PortReader(port).read


class _DescriptorReader:
    """Reads what the system has: two calls a read, however few or many bytes there are.

    pyserial would need a call a byte here: it reads until it has the count it was asked for, and
    when the port is lost before that, the bytes it already took are lost with it.
    """

    def __init__(self, descriptor: int, empty_is_end: int) -> None:
        self._descriptor = descriptor
        self._empty_is_end = empty_is_end
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLIN)

    def read(self) -> bytes:
        ready = self._poll.poll(READ_TIMEOUT_S * 1000)
        if not ready:
            return b""
        try:
            data = os.read(self._descriptor, _MOST_AT_ONCE)
        except BlockingIOError:
            return b""
        # A terminal is also readable without bytes where another program was quicker.
        if not data and ready[0][1] & self._empty_is_end:
            raise OSError(TranslatableText("the other end has hung up"))
        return data


class _PortReader:
    """Reads through pyserial's interface; for ports that have no descriptor of their own."""

    def __init__(self, port: serial.Serial) -> None:
        self._port = port

    def read(self) -> bytes:
        data = self._port.read(self._port.in_waiting or 1)
        if not data:
            return data
        try:
            # The rest of what the first byte came with, or each frame would be two reads.
            return data + self._port.read(self._port.in_waiting)
        except OSError:
            # The next read meets it again; what has been read is not lost with the port.
            return data


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


@dataclass(frozen=True, slots=True)
class PortCapabilities:
    """What a port's driver granted."""

    line: LineWatch
    """What knows of the line's errors."""
    low_latency: LowLatency
    timer_ms: int | None
    """The adapter's latency timer, milliseconds; None where it has none."""
    usb: bool

    def __str__(self) -> str:
        low, line = TranslatableText(self.low_latency.value), self.line.words
        if self.timer_ms is None:
            return TranslatableText("{low_latency}; {line}", low_latency=low, line=line)
        return TranslatableText(
            "{low_latency}, latency timer {ms} ms; {line}",
            low_latency=low,
            ms=self.timer_ms,
            line=line,
        )


def ask(port: serial.Serial) -> PortCapabilities:
    """Ask for low latency, and for line errors; before anything is read of an open port."""
    low_latency = ask_low_latency(port)
    device = device_of(port)
    return PortCapabilities(
        line_watch_of(port),
        low_latency,
        latency_timer_ms(device) if device else None,
        is_usb(device) if device else False,
    )


_SYS_TTY = Path("/sys/class/tty")

HOST_NS = 1_000_000
"""Until this program runs once bytes have arrived, on a machine that is not overloaded."""

USB_FRAME_NS = 1_000_000
"""Between two questions of a full-speed USB host to an adapter."""

USB_UNKNOWN_NS = 16_000_000
"""For an adapter that does not tell its latency timer: the usual one."""

NETWORK_NS = 20_000_000
"""For a port server, on a local network that is well."""

FIFO_BYTES = 16
"""Byte times that a UART of the board holds bytes: until its FIFO is full, or four pass unused."""

_NETWORK_SCHEMES = ("socket", "rfc2217")


def max_latency_ns(port: serial.Serial, sys_tty: Path = _SYS_TTY) -> int:
    """How late bytes of an open port can be, nanoseconds; a machine that stalls adds to it.

    Args:
        port: as `open_port` gives it.
        sys_tty: where the system tells of terminals.
    """
    device = device_of(port)
    if device is None:
        network = (port.port or "").partition("://")[0].lower() in _NETWORK_SCHEMES
        return HOST_NS + NETWORK_NS * network
    return HOST_NS + _device_ns(sys_tty / Path(device).resolve().name / "device", port.baudrate)


def _device_ns(facts: Path, baud: int) -> int:
    if not facts.exists():
        return 0  # a pseudo-terminal
    subsystem = (facts / "subsystem").resolve().name
    if not subsystem.startswith("usb"):
        return FIFO_BYTES * byte_time_ns(baud)
    try:
        timer_ms = int((facts / "latency_timer").read_text())
    except (OSError, ValueError):
        return USB_FRAME_NS + USB_UNKNOWN_NS
    return USB_FRAME_NS + timer_ms * 1_000_000
