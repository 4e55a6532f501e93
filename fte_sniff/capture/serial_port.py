"""Open, configure, read and write one serial port; latency of its driver.

Opening writes nothing to the line. On a real serial port Linux raises DTR and RTS at the moment of
opening; within about a millisecond they are lowered again (`off`, the default), kept raised (`on`),
or kept as the system raised or found them (`leave`). On closing, the system lowers both. In that
first millisecond Linux may echo bytes, if the port was last used as a terminal; a port without a
connected TX wire cannot. Bytes that came before the port was opened are discarded. The port is
locked against other programs that also request the lock.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import selectors
import socket
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Final, TypeAlias, cast

import serial
from serial.urlhandler import protocol_socket

from fte_sniff.capture.port_errors import check_name, port_error
from fte_sniff.capture.uart_errors import LineWatch, line_watch_of
from fte_sniff.capture.url_handlers import scheme_of, url_scheme
from fte_sniff.errors import PortError, TranslatableText, ValueRangeError
from fte_sniff.platform import POSIX, TerminalError
from fte_sniff.protocol import DEFAULT_BAUD, byte_time_ns

if POSIX:
    import fcntl
    import termios

READ_TIMEOUT_S = 0.01

BAUD_RANGE = (50, 12_000_000)
"""Lowest and highest baud that is passed to a driver."""


class ControlLine(StrEnum):
    """What to do with DTR or RTS on opening."""

    ON = "on"
    OFF = "off"
    LEAVE = "leave"


@dataclass(frozen=True, slots=True)
class PortSettings:
    """How a port is opened; always 8 data bits, no parity, 1 stop bit, no flow control."""

    baud: int = DEFAULT_BAUD
    """Bits per second; ValueRangeError outside BAUD_RANGE."""
    dtr: ControlLine = ControlLine.OFF
    rts: ControlLine = ControlLine.OFF

    def __post_init__(self) -> None:
        low, high = BAUD_RANGE
        if not low <= self.baud <= high:
            raise ValueRangeError(f"baud {self.baud} is out of range: {low}..{high}")

    def __str__(self) -> str:
        return TranslatableText(
            "{baud} baud 8N1, DTR {dtr}, RTS {rts}",
            baud=self.baud,
            dtr=TranslatableText(self.dtr),
            rts=TranslatableText(self.rts),
        )


DEFAULT_SETTINGS = PortSettings()


def open_port(name: str, settings: PortSettings = DEFAULT_SETTINGS) -> serial.Serial:
    """Open a device (`/dev/ttyUSB0`), or a URL of `url_handlers` or pyserial, ready to be read.

    Raises PortError, with the fix: the port is absent, busy, forbidden or no serial port.
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
        with _control_lines(port, settings):
            port.open()
        if POSIX and device is not None:
            _keep_breaks(port.fileno())
    except (OSError, ValueError, LookupError, OverflowError, TerminalError, re.error) as error:
        raise port_error(name, device, error) from error
    return port


def device_of(port: serial.Serial) -> str | None:
    """The device file of a port; None for `sim://` and the like."""
    # The type stubs call every port a Serial; in truth only those on a device file are.
    return port.port if isinstance(port, serial.Serial) else None


@contextlib.contextmanager
def _control_lines(port: serial.Serial, settings: PortSettings) -> Iterator[None]:
    port.dtr = settings.dtr is ControlLine.ON
    port.rts = settings.rts is ControlLine.ON
    if ControlLine.LEAVE not in (settings.dtr, settings.rts):
        yield
        return
    device = device_of(port)
    if device is None:
        if url_scheme(url := port.port or "").sets_lines:
            raise PortError(
                f"{scheme_of(url)}:// cannot leave DTR and RTS as they are: use on or off"
            )
        yield
        return
    if not POSIX:
        raise PortError("Windows cannot leave DTR and RTS as they are: use on or off")
    # pyserial always sets both lines, so let it set the values that opening the device gives. Keep
    # the device open meanwhile, because closing it lowers the lines.
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
    """The bits of the modem lines; 0 if the terminal has none, like a pseudo-terminal."""
    assert POSIX
    try:
        (lines,) = struct.unpack("I", fcntl.ioctl(descriptor, termios.TIOCMGET, b"\0\0\0\0"))
    except OSError:
        return 0
    return int(lines)


def _keep_breaks(descriptor: int) -> None:
    """Read a break as a 00 byte: with BRKINT, which pyserial leaves on, it discards bytes."""
    assert POSIX
    attributes = termios.tcgetattr(descriptor)
    attributes[0] &= ~(termios.BRKINT | termios.IGNPAR)
    termios.tcsetattr(descriptor, termios.TCSANOW, attributes)


# Reading and writing

Read: TypeAlias = Callable[[], bytes]
"""Returns what has arrived; `b""` after READ_TIMEOUT_S. Raises OSError when the port is lost."""

Write: TypeAlias = Callable[[bytes], int]
"""Writes the first of these bytes and returns their number: 0 if the driver has no room within
READ_TIMEOUT_S. Raises OSError when the port is lost."""

_MAX_READ = 65_536
_HUNG_UP = TranslatableText("the other end has hung up")


def reader_of(port: serial.Serial) -> Read:
    """The fastest safe way to read `port`."""
    read: Any = type(port).read
    if read is protocol_socket.Serial.read:
        return _SocketReader(cast(Any, port)._socket).read
    if POSIX and read is serial.Serial.read:
        return _DescriptorReader(port.fileno()).read
    return _PortReader(port).read


class _SocketReader:
    """Reads everything that has arrived with two system calls."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._selector = selectors.DefaultSelector()
        self._selector.register(connection, selectors.EVENT_READ)

    def read(self) -> bytes:
        if not self._selector.select(READ_TIMEOUT_S):
            return b""
        try:
            data = self._connection.recv(_MAX_READ)
        except BlockingIOError:
            return b""
        if not data:
            raise OSError(_HUNG_UP)
        return data


class _DescriptorReader:
    """Reads everything that has arrived with two system calls.

    pyserial needs one call for each byte: it reads until it has the requested count, and loses the
    bytes already read if the port is lost before that.
    """

    def __init__(self, descriptor: int) -> None:
        assert POSIX
        self._descriptor = descriptor
        self._gone = select.POLLHUP | select.POLLERR | select.POLLNVAL
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLIN)

    def read(self) -> bytes:
        ready = self._poll.poll(READ_TIMEOUT_S * 1000)
        if not ready:
            return b""
        try:
            data = os.read(self._descriptor, _MAX_READ)
        except BlockingIOError:
            return b""
        # A terminal without bytes is also readable if another program has just read them.
        if not data and ready[0][1] & self._gone:
            raise OSError(_HUNG_UP)
        return data


class _PortReader:
    """Reads through pyserial's interface; for ports without a file descriptor."""

    def __init__(self, port: serial.Serial) -> None:
        self._port = port

    def read(self) -> bytes:
        data = self._port.read(self._port.in_waiting or 1)
        if not data:
            return data
        try:
            # The rest of what came with the first byte; otherwise each frame takes two reads.
            return data + self._port.read(self._port.in_waiting)
        except OSError:
            # The next read raises it again; the bytes read so far are not lost.
            return data


def writer_of(port: serial.Serial) -> Write:
    """The fastest way to write to `port`."""
    if type(port).write in (serial.Serial.write, protocol_socket.Serial.write):
        return _DescriptorWriter(port.fileno()).write
    return lambda data: port.write(data) or 0


class _DescriptorWriter:
    """Writes as much as the system accepts; pyserial does not return that number."""

    def __init__(self, descriptor: int) -> None:
        assert POSIX
        self._descriptor = descriptor
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLOUT)

    def write(self, data: bytes) -> int:
        try:
            return os.write(self._descriptor, data)
        except BlockingIOError:
            self._poll.poll(READ_TIMEOUT_S * 1000)
            return 0


# Latency of the driver

USB_SERIAL: Final = Path("/sys/bus/usb-serial/devices")
"""Where Linux publishes the settings of USB adapters."""

SHORT_TIMER_MS: Final = 2
"""A latency timer up to this is not noticeable, milliseconds."""

_TIOCGSERIAL = 0x541E
_TIOCSSERIAL = 0x541F
_SERIAL_STRUCT = struct.Struct("=32i")
"""`struct serial_struct`, and spare bytes after it."""
_FLAGS = 4
_LOW_LATENCY = 1 << 13


class LowLatency(StrEnum):
    """The driver's answer to a request for low latency."""

    GRANTED = "low latency granted"
    REFUSED = "low latency refused"
    ABSENT = "no low latency setting"


def request_low_latency(port: serial.Serial) -> LowLatency:
    """Request low latency (ASYNC_LOW_LATENCY): the driver delivers bytes as they arrive."""
    if not POSIX:
        return LowLatency.ABSENT
    try:
        descriptor = port.fileno()
        settings = fcntl.ioctl(descriptor, _TIOCGSERIAL, bytes(_SERIAL_STRUCT.size))
    except (AttributeError, OSError):
        return LowLatency.ABSENT
    try:
        fcntl.ioctl(descriptor, _TIOCSSERIAL, with_low_latency(settings))
        settings = fcntl.ioctl(descriptor, _TIOCGSERIAL, bytes(_SERIAL_STRUCT.size))
    except PermissionError:
        return LowLatency.REFUSED
    except OSError:
        return LowLatency.ABSENT
    return LowLatency.GRANTED if has_low_latency(settings) else LowLatency.REFUSED


def has_low_latency(serial_struct: bytes) -> bool:
    """True if the low latency flag is set in a `struct serial_struct`."""
    return bool(_SERIAL_STRUCT.unpack(serial_struct)[_FLAGS] & _LOW_LATENCY)


def with_low_latency(serial_struct: bytes) -> bytes:
    """This `struct serial_struct` with the low latency flag set."""
    numbers = list(_SERIAL_STRUCT.unpack(serial_struct))
    numbers[_FLAGS] |= _LOW_LATENCY
    return _SERIAL_STRUCT.pack(*numbers)


def latency_timer_ms(device: str, devices: Path = USB_SERIAL) -> int | None:
    """The latency timer of a USB adapter, milliseconds; None if it has none."""
    return _timer_ms(devices / Path(device).resolve().name)


def _timer_ms(folder: Path) -> int | None:
    try:
        return int((folder / "latency_timer").read_text())
    except (OSError, ValueError):
        return None


@dataclass(frozen=True, slots=True)
class PortCapabilities:
    """What the driver of an open port supports."""

    line: LineWatch
    low_latency: LowLatency
    timer_ms: int | None
    """The adapter's latency timer, milliseconds; None if it has none."""
    usb: bool

    def __str__(self) -> str:
        low, line = TranslatableText(self.low_latency.value), self.line.description
        if self.timer_ms is None:
            return TranslatableText("{low_latency}; {line}", low_latency=low, line=line)
        return TranslatableText(
            "{low_latency}, latency timer {ms} ms; {line}",
            low_latency=low,
            ms=self.timer_ms,
            line=line,
        )


def request_capabilities(port: serial.Serial) -> PortCapabilities:
    """Request low latency and line errors of an open port; call it before the first read."""
    low_latency = request_low_latency(port)
    device = device_of(port)
    return PortCapabilities(
        line_watch_of(port),
        low_latency,
        timer_ms=latency_timer_ms(device) if device else None,
        usb=device is not None and (USB_SERIAL / Path(device).resolve().name).exists(),
    )


# Parts of the largest latency:
HOST_NS = 1_000_000  # until this program runs after bytes have arrived
USB_FRAME_NS = 1_000_000  # polling interval of a full-speed USB host
USB_UNKNOWN_NS = 16_000_000  # usual latency timer, for an adapter where it cannot be read
FIFO_BYTES = 16  # byte times that an on-board UART holds bytes: FIFO full, or four unused

_SYS_TTY = Path("/sys/class/tty")


def max_latency_ns(port: serial.Serial, sys_tty: Path = _SYS_TTY) -> int:
    """Largest delay from the wire to the read, nanoseconds, on a machine that is not overloaded."""
    device = device_of(port)
    if device is None:
        return HOST_NS + url_scheme(port.port or "").latency_ns
    return HOST_NS + _driver_ns(sys_tty / Path(device).resolve().name / "device", port.baudrate)


def _driver_ns(folder: Path, baud: int) -> int:
    if not POSIX:
        return USB_FRAME_NS + USB_UNKNOWN_NS
    if not folder.exists():
        return 0  # a pseudo-terminal
    if not (folder / "subsystem").resolve().name.startswith("usb"):
        return FIFO_BYTES * byte_time_ns(baud)
    timer_ms = _timer_ms(folder)
    return USB_FRAME_NS + (USB_UNKNOWN_NS if timer_ms is None else timer_ms * 1_000_000)
