"""The bridge: forward bytes between a host program and a port, and capture both directions.

feedback thread:  port read -> stamp -> host program -> queue
control thread:   host read -> port write -> queue

opened -> forward -> stopped: closed
                  -> lost:    hang up the pseudo-terminal; wait for the port, then begin again
"""

from __future__ import annotations

import fcntl
import termios
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self
from urllib.parse import urlencode

import serial

from fte_sniff.capture.chunk_queue import CAPACITY, ChunkQueue, Item
from fte_sniff.capture.clock import Clock
from fte_sniff.capture.discovery import sharing_note
from fte_sniff.capture.port_errors import one_line
from fte_sniff.capture.pty import HostEnd
from fte_sniff.capture.reconnect import OpenedPort, Reopen, reopener
from fte_sniff.capture.serial_port import (
    BAUD_RANGE,
    DEFAULT_SETTINGS,
    PortSettings,
    device_of,
    max_latency_ns,
    open_port,
    reader_of,
    request_low_latency,
    writer_of,
)
from fte_sniff.capture.source import ThreadedSource
from fte_sniff.errors import TranslatableText
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
