"""Open, configure, read and write one serial port; latency of its driver.

Opening writes nothing to the line. Linux raises DTR and RTS at the moment of opening; within about
a millisecond they are set as requested, by default off. On closing, the system lowers both. Bytes
that came before the port was opened are discarded. A port that another program holds is refused:
two programs that read one port take bytes from each other. The port is locked against other
programs that also request the lock.

A shared port is opened beside the other program, and nothing about it is changed: no baud, no
modem line, no lock, and no byte is discarded. (Linux itself raises DTR and RTS for every open.)
"""

from __future__ import annotations

import errno
import os
import re
import select
import socket
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

import serial
from serial.urlhandler import protocol_socket

from fte_sniff.capture.discovery import holders_of, is_terminal
from fte_sniff.capture.port_errors import check_name, port_error
from fte_sniff.capture.url_handlers import NETWORK_LATENCY_NS, is_network
from fte_sniff.errors import TranslatableText, UsageError, ValueRangeError, printable
from fte_sniff.platform import POSIX, TerminalError
from fte_sniff.protocol.spec import DEFAULT_BAUD, byte_time_ns

if POSIX:
    import termios

READ_TIMEOUT_S: Final = 0.01

BAUD_RANGE: Final = (50, 12_000_000)
"""Lowest and highest baud that is passed to a driver."""


_LINE_STATES: Final = {True: TranslatableText("on"), False: TranslatableText("off")}


@dataclass(frozen=True, slots=True)
class PortSettings:
    """How a port is opened; always 8 data bits, no parity, 1 stop bit, no flow control."""

    baud: int = DEFAULT_BAUD
    """Bits per second; ValueRangeError outside BAUD_RANGE."""
    dtr: bool = False
    """Whether DTR is set on opening, rather than cleared."""
    rts: bool = False
    share: bool = False
    """True to read a port that another program holds, and to leave its settings as they are."""

    def __post_init__(self) -> None:
        low, high = BAUD_RANGE
        if not low <= self.baud <= high:
            raise ValueRangeError(f"baud {self.baud} is out of range: {low}..{high}")

    def __str__(self) -> str:
        if self.share:
            return TranslatableText("shared, with the settings of the other program")
        return TranslatableText(
            "{baud} baud 8N1, DTR {dtr}, RTS {rts}",
            baud=self.baud,
            dtr=_LINE_STATES[self.dtr],
            rts=_LINE_STATES[self.rts],
        )


DEFAULT_SETTINGS: Final = PortSettings()


class SharedSerial(serial.Serial):
    """A port beside another program, whose settings and bytes that wait are left alone."""

    def _reconfigure_port(self, force_update: bool = False) -> None: ...

    def _update_dtr_state(self) -> None: ...

    def _update_rts_state(self) -> None: ...

    def _reset_input_buffer(self) -> None: ...


def open_port(name: str, settings: PortSettings = DEFAULT_SETTINGS) -> serial.Serial:
    """Open a device (`/dev/ttyUSB0`), or a URL of `url_handlers` or pyserial, ready to be read.

    Raises PortError, with the fix: the port is absent, busy, forbidden or no serial port.
    """
    check_name(name)
    device = None
    try:
        port = _unopened(name, settings)
        device = device_of(port)
        if device is not None and not settings.share and is_terminal(device) and holders_of(device):
            raise OSError(errno.EBUSY, "")
        port.open()
        if is_network(name):
            _keep_alive(port)
        if POSIX and device is not None and not settings.share:
            _keep_breaks(port.fileno())
    except (OSError, ValueError, LookupError, OverflowError, TerminalError, re.error) as error:
        raise port_error(name, device, error) from error
    return port


def _unopened(name: str, settings: PortSettings) -> serial.Serial:
    if settings.share:
        if "://" in name or not POSIX:
            raise UsageError(f"{printable(name)} cannot be shared: URLs and Windows ports cannot")
        port: serial.Serial = SharedSerial()
        port.port, port.timeout = name, READ_TIMEOUT_S
        return port
    port = serial.serial_for_url(
        name,
        do_not_open=True,
        baudrate=settings.baud,
        timeout=READ_TIMEOUT_S,
        exclusive=True,
    )
    port.dtr, port.rts = settings.dtr, settings.rts
    return port


def device_of(port: serial.Serial) -> str | None:
    """The device file of a port; None for `sim://` and the like."""
    # The type stubs call every port a Serial; in truth only those on a device file are.
    return port.port if isinstance(port, serial.Serial) else None


_KEEP_ALIVE: Final = {"TCP_KEEPIDLE": 5, "TCP_KEEPINTVL": 2, "TCP_KEEPCNT": 3}
"""A server that does not answer for about 11 s is lost: seconds, seconds, attempts."""


def _keep_alive(port: serial.Serial) -> None:
    """Have the system notice a server that is gone without a word, such as a cable pulled out."""
    connection: socket.socket = vars(port)["_socket"]
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for option, value in _KEEP_ALIVE.items():
        if (number := getattr(socket, option, None)) is not None:
            connection.setsockopt(socket.IPPROTO_TCP, number, value)


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

_MAX_READ: Final = 65_536


def reader_of(port: serial.Serial) -> Read:
    """The fastest way to read `port` that loses no byte."""
    read: Any = type(port).read
    if POSIX and read in (serial.Serial.read, protocol_socket.Serial.read):
        return _descriptor_reader(port.fileno())
    return lambda: port.read(port.in_waiting or 1)


def _descriptor_reader(descriptor: int) -> Read:
    """Read all that has arrived; pyserial reads until it has a count, and loses it on an error."""
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    gone = select.POLLHUP | select.POLLERR | select.POLLNVAL
    is_terminal = os.isatty(descriptor)

    def read() -> bytes:
        ready = poll.poll(READ_TIMEOUT_S * 1000)
        if not ready:
            return b""
        try:
            data = os.read(descriptor, _MAX_READ)
        except BlockingIOError:
            return b""
        except OSError:
            data, ready = b"", poll.poll(0)  # it may have gone since
            if not ready or not ready[0][1] & gone:
                raise
        # A terminal without bytes is also readable if another program has just read them.
        if not data and (ready[0][1] & gone or not is_terminal):
            raise OSError(TranslatableText("the other end has hung up"))
        return data

    return read


def writer_of(port: serial.Serial) -> Write:
    """The way to write to `port` that returns how much was written."""
    write: Any = type(port).write
    if POSIX and write in (serial.Serial.write, protocol_socket.Serial.write):
        return _descriptor_writer(port.fileno())
    return lambda data: port.write(data) or 0


def _descriptor_writer(descriptor: int) -> Write:
    poll = select.poll()
    poll.register(descriptor, select.POLLOUT)

    def write(data: bytes) -> int:
        try:
            return os.write(descriptor, data)
        except BlockingIOError:
            poll.poll(READ_TIMEOUT_S * 1000)
            return 0

    return write


# Latency of the driver

_SYS_TTY: Final = Path("/sys/class/tty")


def request_low_latency(port: serial.Serial) -> None:
    """Request that the driver delivers bytes as they arrive, where there is such a setting."""
    request = getattr(port, "set_low_latency_mode", None)
    if request is not None:  # the ports of URLs, and of Windows, do not have it
        # In this order: another system, a lost device, a driver without it. Bytes come later then,
        # by as much as `max_latency_ns` reads.
        with suppress(NotImplementedError, OSError, ValueError):
            request(True)


# Parts of the largest latency:
HOST_NS: Final = 1_000_000  # until this program runs after bytes have arrived
USB_FRAME_NS: Final = 1_000_000  # polling interval of a full-speed USB host
USB_UNKNOWN_NS: Final = 16_000_000  # usual latency timer, for an adapter where it cannot be read
FIFO_BYTES: Final = 16  # byte times that an on-board UART holds bytes: FIFO full, or four unused


def max_latency_ns(port: serial.Serial, sys_tty: Path = _SYS_TTY) -> int:
    """Largest delay from the wire to the read, nanoseconds, on a machine that is not overloaded."""
    device = device_of(port)
    if device is None:
        return HOST_NS + NETWORK_LATENCY_NS * is_network(port.port or "")
    folder = sys_tty / Path(device).resolve().name / "device"
    if POSIX and not folder.exists():
        return HOST_NS  # a pseudo-terminal
    if POSIX and not (folder / "subsystem").resolve().name.startswith("usb"):
        return HOST_NS + FIFO_BYTES * byte_time_ns(port.baudrate)
    timer_ns = USB_UNKNOWN_NS
    with suppress(OSError, ValueError):
        timer_ns = int((folder / "latency_timer").read_text()) * 1_000_000
    return HOST_NS + USB_FRAME_NS + timer_ns
