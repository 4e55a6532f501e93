"""The bridge: forward bytes between a host program and a port, and capture both directions.

feedback thread:  port read -> stamp -> host program -> queue
control thread:   host read -> port write -> queue

opened -> forward -> stopped: closed
                  -> lost:    hang up the pseudo-terminal; wait for the port, then begin again
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
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self
from urllib.parse import urlencode

import serial

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.discovery import sharing_note
from fte_sniff.capture.port_errors import one_line
from fte_sniff.capture.reconnect import PTY_FOLDER, OpenedPort, Reopen, reopener
from fte_sniff.capture.serial_port import (
    BAUD_RANGE,
    DEFAULT_SETTINGS,
    READ_TIMEOUT_S,
    PortSettings,
    device_of,
    max_latency_ns,
    open_port,
    reader_of,
    request_low_latency,
    writer_of,
)
from fte_sniff.capture.source import CAPACITY, ChunkQueue, Item, ThreadedSource
from fte_sniff.errors import FileError, TranslatableText, printable
from fte_sniff.protocol import Chunk, PortEvent, PortEventKind, byte_time_ns

if TYPE_CHECKING:
    from fte_sniff.capture.simulation import SimulationParameters

HOST = "host"
"""Name of the wire from the host program; the other wire has the port's name."""

DRIVER_BUFFER_BYTES = 4096
"""Approximate size of a driver's write buffer: no byte is stamped later than a full one drains."""


@dataclass(frozen=True, slots=True)
class Bridge:
    """A port, and a pseudo-terminal that a host program opens instead of it."""

    port: str
    settings: PortSettings = DEFAULT_SETTINGS
    """How it is opened; the host program can change the baud."""
    link: Path | None = None
    reconnect: bool = True
    """True to wait for a lost port, if it can come back and there is a link."""

    @property
    def names(self) -> tuple[str, ...]:
        """The wire from the controller, and the wire from the host program."""
        return (self.port, HOST)

    def open(self, clock: Clock) -> BridgeSource:
        """Open the port exclusively, and create the pseudo-terminal.

        Raises PortError for the port, FileError if `link` exists already or cannot be created.
        """
        port = open_port(self.port, self.settings)
        try:
            host = HostEnd(self.settings.baud, self.link)
        except BaseException:
            port.close()
            raise
        detail = TranslatableText(
            "a host program can open {name}; {settings}{shared}",
            name=host.name,
            settings=str(self.settings),
            shared=sharing_note(device_of(port)),
        )
        # Without a link, the next pseudo-terminal would have another name.
        again = self.reconnect and self.link is not None
        reopen = reopener(self.port, self.settings, port) if again else None
        wires = WireEvents(self.port, self.settings.baud, clock)
        return BridgeSource(port, host, wires, detail=detail, reopen=reopen)


def open_simulated(
    parameters: SimulationParameters, baud: int, link: Path | None = None
) -> BridgeSource:
    """A bridge to a simulated controller; raises PortError if the line cannot carry the rate."""
    url = f"sim://?{urlencode(asdict(parameters))}"
    return Bridge(url, PortSettings(baud), link, reconnect=False).open(Clock.tied())


class BridgeSource(ThreadedSource):
    """The chunks and events of both directions, each in order; iterate once.

    Forwarding starts when the source is entered as a context, or iterated, so that a recorder can
    be ready first. The host's wire has an event `opened` whenever a host program opens the
    pseudo-terminal. When the port is closed or lost, the pseudo-terminal is hung up, like the
    device of an adapter that was unplugged.
    """

    _port: serial.Serial

    def __init__(
        self,
        port: serial.Serial,
        host: HostEnd,
        wires: WireEvents,
        *,
        detail: str = "",
        reopen: Reopen | None = None,
    ) -> None:
        """Take over an open port and a host's end, exclusively; both are closed at the end.

        `detail` is the text of the port's event `opened`; without `reopen` a lost port is the end.
        """
        super().__init__(port, wires.port, wires.queue, wires.clock, reopen)
        self.device: str = host.name
        self._host = host
        self._wires = wires
        # Line errors are not requested: a host program that sets its baud switches off the marks.
        self.capabilities = {self.name: str(request_low_latency(port)), HOST: "a pseudo-terminal"}
        self.uncertainty_ns = {self.name: max_latency_ns(port), HOST: 0}
        _set_exclusive(port, termios.TIOCEXCL)
        self._forwarder = Forwarder(port, host, wires, self._end_due)
        self._detail = detail
        self._started = False

    def __enter__(self) -> Self:
        if not self._started:
            self._started = True
            self._start("port to host", self._detail)
        return self

    def __iter__(self) -> Iterator[Item]:
        return super(BridgeSource, self.__enter__()).__iter__()

    def _read_until_lost(self) -> OSError | None:
        error = self._forwarder.run()
        self._host.close()
        return error

    def _resume(self, opened: OpenedPort, away_s: float) -> None:
        self._port = opened.port
        request_low_latency(self._port)
        _set_exclusive(self._port, termios.TIOCEXCL)
        self._host = self._host.reopen(self._port.baudrate)
        self._put_found_again(opened, away_s)
        self._wires.port_reopened(self._port.baudrate)
        self._forwarder = Forwarder(self._port, self._host, self._wires, self._end_due)

    def _put_silence(self) -> None:
        self._wires.put_feedback(self._clock.now_ns(), b"")
        self._wires.put_control(b"")

    def _close_port(self) -> None:
        _set_exclusive(self._port, termios.TIOCNXCL)
        super()._close_port()


def _set_exclusive(port: serial.Serial, request: int) -> None:
    """Refuse or allow other programs: one that opens the port by mistake would steal bytes."""
    with suppress(OSError):  # no terminal, or closed already
        fcntl.ioctl(port.fileno(), request)


class WireTimes:
    """When bytes that are written to a line leave it, one after the other at its baud."""

    free_ns = 0
    """When the last of them leaves."""

    def __init__(self, baud: int) -> None:
        self.set_baud(baud)

    def set_baud(self, baud: int) -> None:
        """Use this speed from now on, bits per second."""
        self._byte_ns = byte_time_ns(baud)

    def write(self, count: int, now_ns: int) -> int:
        """Add `count` bytes that are written now; return when the last one has left the line."""
        duration_ns = count * self._byte_ns
        latest_ns = now_ns + max(duration_ns, DRIVER_BUFFER_BYTES * self._byte_ns)
        self.free_ns = min(max(self.free_ns, now_ns) + duration_ns, latest_ns)
        return self.free_ns


class WireEvents:
    """The items of both wires; put from two threads, iterated by one.

    The chunks of the host's wire hold what was written to the port. Their time stamp is when their
    last byte leaves the line, so that row times are computed like those of received bytes.
    """

    def __init__(self, port: str, baud: int, clock: Clock, capacity: int = CAPACITY) -> None:
        self.port = port
        self.clock = clock
        self._baud = baud
        self._times = WireTimes(baud)
        self.queue = ChunkQueue(port, HOST, capacity=capacity)

    def put_feedback(self, t_ns: int, data: bytes) -> None:
        """Append bytes that were read from the port at `t_ns`; empty for silence."""
        self.queue.put(Chunk(self.port, t_ns, data))

    def put_control(self, data: bytes) -> None:
        """Append bytes that the host program has just written to the port; empty for silence."""
        t_ns = self._times.write(len(data), self.clock.now_ns())
        self.queue.put(Chunk(HOST, t_ns, data))

    def put_event(self, wire: str, kind: PortEventKind, detail: str, count: int = 0) -> None:
        """Append an event of a wire, stamped with the time now."""
        t_ns = self.clock.now_ns()
        if wire == HOST:
            t_ns = max(t_ns, self._times.free_ns)
        self.queue.put_event(PortEvent(t_ns, wire, kind, detail, count))

    def baud_requested(self, baud: int) -> None:
        """The host program set the speed of both wires, bits per second."""
        self._set_baud(baud)
        kind = PortEventKind.BAUD_CHANGED
        requested = TranslatableText("the host program asks for {baud} baud", baud=baud)
        self.put_event(HOST, kind, requested, baud)
        changed = TranslatableText("it has {baud} baud now", baud=baud)
        self.put_event(self.port, kind, changed, baud)

    def port_reopened(self, baud: int) -> None:
        """The port was opened again, with this speed."""
        if baud != self._baud:
            self._set_baud(baud)
            detail = TranslatableText("it begins again with {baud} baud", baud=baud)
            for wire in (self.port, HOST):
                self.put_event(wire, PortEventKind.BAUD_CHANGED, detail, baud)

    def _set_baud(self, baud: int) -> None:
        self._baud = baud
        self._times.set_baud(baud)


class Forwarder:
    """Forwards bytes both ways, from an open port to its loss or to the end."""

    def __init__(
        self,
        port: serial.Serial,
        host: HostEnd,
        wires: WireEvents,
        end_due: Callable[[], bool],
    ) -> None:
        """Take the ports; once `end_due`, `run` forwards the received bytes and returns."""
        self._port = port
        self._host = host
        self._wires = wires
        self._read = reader_of(port)
        self._write = writer_of(port)
        self._baud = port.baudrate
        self._modem_lines = port.dtr, port.rts
        self._end_due = end_due
        self._stopping = False
        self._lost: OSError | None = None
        self._not_delivered = 0
        self._not_written = 0

    def run(self) -> OSError | None:
        """Forward in two threads until the end is due (None) or the port is lost (the error)."""
        control = threading.Thread(target=self._carry_control, name="host to port", daemon=True)
        control.start()
        try:
            self._carry_feedback()
        except OSError as error:
            self._lost = self._lost or error
        self._stopping = True
        control.join()
        self._report_not_delivered()
        if self._not_written:
            detail = TranslatableText(
                "{count} bytes from the host program were not sent: the port did not accept them",
                count=self._not_written,
            )
            self._wires.put_event(HOST, PortEventKind.NOT_PASSED_ON, detail, self._not_written)
        if self._host.in_use:
            detail = TranslatableText("the bridge hangs up")
            self._wires.put_event(HOST, PortEventKind.CLOSED, detail)
        return self._lost

    # From the port to the host program

    def _carry_feedback(self) -> None:
        while True:
            # Checked before the read, so that bytes that arrived before the end are still read.
            last = self._stopping or self._end_due()
            data = self._read()
            t_ns = self._wires.clock.now_ns()
            dropped = self._host.write(data)
            self._wires.put_feedback(t_ns, data)
            if dropped:
                self._count_not_delivered(dropped)
            elif not self._host.buffered:
                self._report_not_delivered()
            if last:
                return

    def _count_not_delivered(self, count: int) -> None:
        if not self._not_delivered:
            detail = TranslatableText(
                "the host program does not read: its bytes are recorded, but not delivered"
            )
            self._wires.put_event(HOST, PortEventKind.NOT_PASSED_ON, detail)
        self._not_delivered += count

    def _report_not_delivered(self) -> None:
        if self._not_delivered:
            detail = TranslatableText(
                "{count} bytes were recorded, but not delivered to the host program",
                count=self._not_delivered,
            )
            self._wires.put_event(HOST, PortEventKind.NOT_PASSED_ON, detail, self._not_delivered)
            self._not_delivered = 0

    # From the host program to the port

    def _carry_control(self) -> None:
        try:
            while True:
                last = self._stopping
                was_in_use = self._host.in_use
                data = self._host.read()
                if self._host.in_use != was_in_use:
                    self._report_host(opened=not was_in_use)
                if self._host.in_use:
                    self._follow_baud()
                self._write_all(data)
                if last:
                    return
        except (OSError, termios.error) as error:
            self._lost = self._lost or OSError(*error.args)
            self._stopping = True

    def _write_all(self, data: bytes) -> None:
        if not data:
            self._wires.put_control(b"")
        while data:
            count = self._write(data)
            self._wires.put_control(data[:count])
            data = data[count:]
            if self._stopping and not count:
                self._not_written += len(data)
                return

    def _report_host(self, *, opened: bool) -> None:
        name = self._host.name
        if opened:
            kind = PortEventKind.OPENED
            detail = TranslatableText("a host program opened {name}", name=name)
        else:
            kind = PortEventKind.CLOSED
            detail = TranslatableText("a host program closed {name}", name=name)
        self._wires.put_event(HOST, kind, detail)

    def _follow_baud(self) -> None:
        baud = self._host.baud()
        if baud == self._baud:
            return
        before, self._baud = self._baud, baud
        if not baud:
            self._set_modem_lines(False, False)
            detail = TranslatableText("the host program hung up (0 baud): DTR and RTS are off")
            self._wires.put_event(HOST, PortEventKind.BAUD_CHANGED, detail)
            return
        if not before:
            self._set_modem_lines(*self._modem_lines)
        try:
            if not BAUD_RANGE[0] <= baud <= BAUD_RANGE[1]:
                raise ValueError(f"it is out of range, {BAUD_RANGE[0]}..{BAUD_RANGE[1]}")
            self._port.baudrate = baud
        except (ValueError, OSError, termios.error) as error:
            detail = TranslatableText(
                "{baud} baud is refused by the port: {error}", baud=baud, error=one_line(error)
            )
            self._wires.put_event(HOST, PortEventKind.NOT_PASSED_ON, detail)
            return
        self._wires.baud_requested(baud)

    def _set_modem_lines(self, dtr: bool, rts: bool) -> None:
        # A port without these lines raises; so does a lost one, which the next read detects.
        with suppress(OSError):
            self._port.dtr = dtr
        with suppress(OSError):
            self._port.rts = rts


# The end of the host program: a pseudo-terminal

HOST_BUFFER_BYTES = 256 * 1024
"""Bytes that are kept for a host program that does not read, besides the system's buffer."""

_MAX_READ = 65_536
_UNUSED_POLL_S = READ_TIMEOUT_S / 2


class PseudoTerminal:
    """A raw terminal device for other programs; `descriptor` is the non-blocking other end."""

    def __init__(self, baud: int, link: Path | None = None) -> None:
        """Create the device at `baud`, then a `link` to it.

        Raises FileError if the link cannot be created.
        """
        if link is not None:
            # First, because a new device often reuses the number that a stale link points to.
            _remove_stale(link)
        self.descriptor, theirs = os.openpty()
        os.set_blocking(self.descriptor, False)
        # Raw, so that nothing is echoed. Closed, so that POLLHUP shows whether a program uses it.
        tty.setraw(theirs)
        # Before the link: a program that waits for it may set its own speed at once.
        set_speed(self.descriptor, baud)
        self.device = os.ttyname(theirs)
        """The device file that programs open, as `/dev/pts/3`."""
        os.close(theirs)
        self._link: Path | None = None
        try:
            self._create(link)
        except FileError:
            os.close(self.descriptor)
            raise

    @property
    def name(self) -> str:
        """The path that users open: the link, or else the device."""
        return self.device if self._link is None else str(self._link)

    def close(self) -> None:
        """Remove the device and, if it still points there, the link."""
        if self._link is not None:
            with suppress(OSError):
                if str(self._link.readlink()) == self.device:
                    self._link.unlink()
        os.close(self.descriptor)

    def _create(self, link: Path | None) -> None:
        if link is None:
            return
        try:
            link.symlink_to(self.device)
        except FileExistsError:
            named = printable(str(link))
            raise FileError(f"{named} exists already: remove it, or name another") from None
        except (OSError, ValueError) as error:
            raise _link_error(link, error) from error
        self._link = link


def _remove_stale(link: Path) -> None:
    """Remove a link that a killed run left: it points to a pseudo-terminal that is gone."""
    try:
        if link.is_symlink() and str(link.readlink()).startswith(PTY_FOLDER) and not link.exists():
            link.unlink()
    except (OSError, ValueError) as error:
        raise _link_error(link, error) from error


def _link_error(link: Path, error: OSError | ValueError) -> FileError:
    reason = error.strerror if isinstance(error, OSError) else error
    return FileError(f"{printable(str(link))} cannot be made: {reason}")


class HostEnd:
    """The pseudo-terminal that a host program opens instead of the port.

    While no program uses it, written bytes are dropped, as on a real line without a listener. The
    next program starts with an empty buffer and a raw terminal.
    """

    in_use = False
    """True if a host program had it open at the latest read."""

    def __init__(self, baud: int, link: Path | None = None) -> None:
        """Create the device, at `baud` until a host program sets it; raises as `PseudoTerminal`."""
        self._link = link
        self._terminal = PseudoTerminal(baud, link)
        self.name = self._terminal.name
        self._descriptor = self._terminal.descriptor
        self._poll = select.poll()
        self._poll.register(self._descriptor, select.POLLIN)
        self._write_lock = threading.Lock()
        self._buffer = bytearray()

    def read(self) -> bytes:
        """Read what the host program has written; `b""` after READ_TIMEOUT_S at most."""
        ready = self._poll.poll(READ_TIMEOUT_S * 1000)
        events = ready[0][1] if ready else 0
        if events & select.POLLIN:
            self.in_use = True
            # If the program just hung up, the next read sees POLLHUP.
            with suppress(BlockingIOError, OSError):
                return os.read(self._descriptor, _MAX_READ)
        elif events & select.POLLHUP:
            if self.in_use:
                self._reset()
            time.sleep(_UNUSED_POLL_S)
        else:
            self.in_use = True
        return b""

    @property
    def buffered(self) -> int:
        """Number of bytes that wait for the host program to read."""
        return len(self._buffer)

    def baud(self) -> int:
        """Bits per second as the host program has set them; 0 means that it hung up."""
        return speed_of(self._descriptor)

    def write(self, data: bytes) -> int:
        """Write as much as the pseudo-terminal accepts now, and buffer the rest; never blocks.

        Returns the number of bytes dropped because the buffer is full. Call it regularly, also with
        `b""`, to write buffered bytes.
        """
        with self._write_lock:
            if not self.in_use:
                return 0
            if not self._buffer:
                data = data[self._try_write(data) :]
            kept = data[: HOST_BUFFER_BYTES - len(self._buffer)]
            self._buffer += kept
            if self._buffer:
                del self._buffer[: self._try_write(self._buffer)]
            return len(data) - len(kept)

    def close(self) -> None:
        """Hang up like an unplugged port: the host program reads end of file."""
        self.in_use = False
        self._terminal.close()

    def reopen(self, baud: int) -> HostEnd:
        """Create another one with the same link, after this one was closed."""
        return HostEnd(baud, self._link)

    def _try_write(self, data: bytes | bytearray) -> int:
        if not data:
            return 0
        try:
            return os.write(self._descriptor, data)
        except BlockingIOError:
            return 0

    def _reset(self) -> None:
        with self._write_lock:
            self.in_use = False
            self._buffer.clear()
            with suppress(OSError, termios.error):
                theirs = os.open(self._terminal.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
                try:
                    tty.setraw(theirs, termios.TCSANOW)
                    while os.read(theirs, _MAX_READ):
                        pass
                finally:
                    os.close(theirs)


# Speed of a terminal. `struct termios2` takes any baud, where termios knows a fixed list.

_TCGETS2, _TCSETS2 = 0x802C542A, 0x402C542B
_TERMIOS2 = struct.Struct("IIIIB19sII")
_BOTHER = 0o010000
_CONTROL_FLAGS = 2

_BAUD_OF_CODE: dict[int, int] = {
    getattr(termios, name): int(name[1:])
    for name in dir(termios)
    if name[0] == "B" and name[1:].isdecimal()
}
_CODE_OF_BAUD = {baud: code for code, baud in _BAUD_OF_CODE.items()}


def speed_of(descriptor: int) -> int:
    """The output speed of a terminal, bits per second; 0 means hung up."""
    try:
        reply = fcntl.ioctl(descriptor, _TCGETS2, bytes(_TERMIOS2.size))
    except OSError:
        code: int = termios.tcgetattr(descriptor)[5]
        return _BAUD_OF_CODE.get(code, int(code))
    return int(_TERMIOS2.unpack(reply)[-1])


def set_speed(descriptor: int, baud: int) -> None:
    """Set both directions of a terminal to `baud` bits per second."""
    try:
        reply = fcntl.ioctl(descriptor, _TCGETS2, bytes(_TERMIOS2.size))
    except OSError:
        attributes = termios.tcgetattr(descriptor)
        attributes[4] = attributes[5] = _CODE_OF_BAUD.get(baud, baud)
        termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
        return
    fields = list(_TERMIOS2.unpack(reply))
    flags = fields[_CONTROL_FLAGS] & ~(termios.CBAUD | termios.CIBAUD)
    fields[_CONTROL_FLAGS] = flags | _BOTHER
    fields[-2:] = baud, baud
    fcntl.ioctl(descriptor, _TCSETS2, _TERMIOS2.pack(*fields))
