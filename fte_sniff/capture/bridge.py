"""The bridge: forward bytes between a host program and a port, and capture both directions.

    feedback reader:  port read -> stamp -> host program
    control reader:   host read -> port write -> stamp

The host program opens a pseudo-terminal instead of the port. When the port is lost, it is hung up,
like the device of an adapter that was unplugged. The port has one baud, and is the bridge's alone.
"""

from __future__ import annotations

import fcntl
import os
import select
import struct
import termios
import threading
import time
import tty
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

import serial

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.discovery import is_pseudo_terminal
from fte_sniff.capture.lasting_name import LastingPort
from fte_sniff.capture.serial_port import (
    READ_TIMEOUT_S,
    max_latency_ns,
    reader_of,
    request_low_latency,
    writer_of,
)
from fte_sniff.capture.source import HOST, Connection, Received
from fte_sniff.errors import FileError, TranslatableText, printable
from fte_sniff.protocol.items import Chunk, PortEvent, PortEventKind
from fte_sniff.protocol.spec import byte_time_ns

DRIVER_BUFFER_BYTES: Final = 4096
"""Approximate size of a driver's write buffer: no byte is stamped later than a full one drains."""

REPORT_NS: Final = 1_000_000_000
"""Least time between two reports of bytes that were not delivered."""


def connect_bridge(lasting: LastingPort, link: str | None, clock: Clock) -> Connection:
    """Open a port exclusively, and make the pseudo-terminal of the host program, and its link.

    Raises PortError for the port, FileError if the link exists already or cannot be made.
    """
    port = lasting.open()
    try:
        host = HostEnd(None if link is None else Path(link))
    except BaseException:
        port.close()
        raise
    request_low_latency(port)
    _set_exclusive(port, termios.TIOCEXCL)
    forwarder = Forwarder(lasting, port, host, clock)

    def close() -> Iterable[Received]:
        rest = list(forwarder.rest())
        host.close()
        _set_exclusive(port, termios.TIOCNXCL)
        port.close()
        return rest

    return Connection(
        names=(lasting.name, HOST),
        detail=TranslatableText(
            "a host program can open {name}; {settings}",
            name=host.name,
            settings=str(lasting.settings),
        ),
        readers=(forwarder.feedback, forwarder.control),
        close=close,
        device=host.name,
        comes_back=lasting.comes_back,
        uncertainty_ns={lasting.name: max_latency_ns(port), HOST: 0},
    )


def _set_exclusive(port: serial.Serial, request: int) -> None:
    """Refuse or allow other programs: one that opens the port by mistake would steal bytes."""
    with suppress(OSError):  # no terminal, or closed already
        fcntl.ioctl(port.fileno(), request)


class Forwarder:
    """The readers of a bridge; each is called by a thread of its own."""

    def __init__(
        self, lasting: LastingPort, port: serial.Serial, host: HostEnd, clock: Clock
    ) -> None:
        self._port, self._host, self._clock = lasting.name, host, clock
        self._read, self._write = reader_of(port), writer_of(port)
        self._byte_ns = byte_time_ns(lasting.settings.baud)
        self._pending = b""
        """Bytes of the host program that the port has not accepted yet."""
        self._free_ns = 0
        """When the last byte that was written leaves the line."""
        self._not_delivered = 0
        self._reported_ns = -REPORT_NS

    def feedback(self) -> Iterator[Received]:
        """Forward what the port has received."""
        data, now_ns = self._read(), self._clock.now_ns()
        self._not_delivered += self._host.write(data)
        yield Chunk(self._port, now_ns, data)
        if now_ns - self._reported_ns >= REPORT_NS:
            self._reported_ns = now_ns
            yield from self._undelivered()

    def control(self) -> Iterator[Received]:
        """Forward what the host program has written; without room, it has to wait."""
        was_in_use = self._host.in_use
        self._pending = self._pending or self._host.read()
        sent = self._write(self._pending) if self._pending else 0
        data, self._pending = self._pending[:sent], self._pending[sent:]
        if self._host.in_use != was_in_use:
            detail = TranslatableText("a host program closed {name}", name=self._host.name)
            kind = PortEventKind.CLOSED
            if self._host.in_use:
                detail = TranslatableText("a host program opened {name}", name=self._host.name)
                kind = PortEventKind.OPENED
            yield self._event(kind, detail)
        yield Chunk(HOST, self._leaves_ns(len(data)), data)

    def rest(self) -> Iterator[Received]:
        """Report what was not forwarded, and that the bridge hangs up."""
        yield from self._undelivered()
        if count := len(self._pending):
            detail = TranslatableText(
                "{count} bytes from the host program were not sent: the port did not accept them",
                count=count,
            )
            yield self._event(PortEventKind.NOT_PASSED_ON, detail, count)
        if self._host.in_use:
            yield self._event(PortEventKind.CLOSED, TranslatableText("the bridge hangs up"))

    def _undelivered(self) -> Iterator[PortEvent]:
        count, self._not_delivered = self._not_delivered, 0
        if count:
            detail = TranslatableText(
                "the host program does not read: {count} bytes were recorded, but not delivered",
                count=count,
            )
            yield self._event(PortEventKind.NOT_PASSED_ON, detail, count)

    def _event(self, kind: PortEventKind, detail: str, count: int = 0) -> PortEvent:
        return PortEvent(self._clock.now_ns(), HOST, kind, detail, count)

    def _leaves_ns(self, count: int) -> int:
        """When the last of `count` bytes that are written now leaves the line.

        So the times of rows are computed like those of bytes that are received.
        """
        now_ns, took_ns = self._clock.now_ns(), count * self._byte_ns
        latest_ns = now_ns + max(took_ns, DRIVER_BUFFER_BYTES * self._byte_ns)
        self._free_ns = min(max(self._free_ns, now_ns) + took_ns, latest_ns)
        return self._free_ns


# The end of the host program: a pseudo-terminal

_MAX_READ: Final = 65_536


class HostEnd:
    """The pseudo-terminal that a host program opens instead of the port.

    While no program uses it, written bytes are dropped, as on a real line without a listener. The
    next program starts with an empty buffer and a raw terminal.
    """

    in_use = False
    """True if a host program had it open at the latest read."""

    def __init__(self, link: Path | None = None) -> None:
        """Create the device, then a link to it; raises FileError if that cannot be created."""
        self._descriptor, theirs = os.openpty()
        os.set_blocking(self._descriptor, False)
        tty.setraw(theirs)
        self._device = os.ttyname(theirs)
        # Closed, so that POLLHUP shows whether a program uses it.
        os.close(theirs)
        self._link = link
        self.name = self._device if link is None else str(link)
        """The path that users open: the link, or else the device."""
        self._poll, self._hang_up = select.poll(), select.poll()
        self._poll.register(self._descriptor, select.POLLIN)
        self._hang_up.register(self._descriptor, 0)
        self._lock = threading.Lock()
        """Of writes and resets: what is written for a program is not reset."""
        if link is not None:
            try:
                _make_link(link, self._device)
            except FileError:
                os.close(self._descriptor)
                raise

    def read(self, timeout_s: float = READ_TIMEOUT_S) -> bytes:
        """Read what the host program has written; `b""` after `timeout_s` at most."""
        ready = self._poll.poll(timeout_s * 1000)
        events = ready[0][1] if ready else 0
        if events & select.POLLHUP and not events & select.POLLIN:
            with self._lock:
                if self.in_use and self._has_no_program:
                    self._reset()
            time.sleep(timeout_s / 2)
            return b""
        self.in_use = True
        # If the program just hung up, the next read sees POLLHUP.
        with suppress(OSError):
            return os.read(self._descriptor, _MAX_READ) if events else b""
        return b""

    def write(self, data: bytes) -> int:
        """Write what the device accepts; returns the number of bytes that it does not."""
        with self._lock:
            if not data or self._has_no_program:
                return 0
            try:
                return len(data) - os.write(self._descriptor, data)
            except BlockingIOError:
                return len(data)

    @property
    def _has_no_program(self) -> bool:
        """Whether no host program has it open now."""
        return any(events & select.POLLHUP for _, events in self._hang_up.poll(0))

    @property
    def unread(self) -> int:
        """Number of bytes that the host program has not read yet."""
        theirs = os.open(self._device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            (count,) = struct.unpack("i", fcntl.ioctl(theirs, termios.FIONREAD, bytes(4)))
        finally:
            os.close(theirs)
        return int(count)

    def close(self) -> None:
        """Hang up like an unplugged port: the host program reads end of file."""
        self.in_use = False
        if self._link is not None:
            with suppress(OSError):
                if str(self._link.readlink()) == self._device:
                    self._link.unlink()
        os.close(self._descriptor)

    def _reset(self) -> None:
        self.in_use = False
        with suppress(OSError, termios.error):
            theirs = os.open(self._device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            tty.setraw(theirs, termios.TCSAFLUSH)
            os.close(theirs)


def _make_link(link: Path, device: str) -> None:
    """Make a link to a device in place of one that a killed run left; raises FileError."""
    named = printable(str(link))
    try:
        # A new device often has the number of the one to which that link leads.
        is_left = not link.exists() or os.path.realpath(link) == device
        if is_pseudo_terminal(str(link)) and is_left:
            link.unlink(missing_ok=True)
        link.symlink_to(device)
    except FileExistsError as error:
        raise FileError(f"{named} exists already: remove it, or name another") from error
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise FileError(f"{named} cannot be made: {reason}") from error
