"""Forward bytes both ways; chunks of the two wires; writing to the port.

feedback thread:  port read -> time -> host program -> wires
control thread:   host read -> port write -> wires
"""

from __future__ import annotations

import heapq
import os
import select
import termios
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from math import inf
from typing import TypeAlias

import serial
from serial.urlhandler import protocol_socket

from fte_sniff.capture.chunk_queue import CAPACITY, ChunkQueue
from fte_sniff.capture.clock import Clock
from fte_sniff.capture.port_errors import one_line
from fte_sniff.capture.pty import HostEnd
from fte_sniff.capture.serial_port import BAUD_RANGE, READ_TIMEOUT_S, reader_of
from fte_sniff.capture.source import Item
from fte_sniff.errors import TranslatableText
from fte_sniff.protocol import Chunk, PortEvent, PortEventKind, byte_time_ns

Put: TypeAlias = Callable[[bytes], int]
"""Puts the first of these bytes onto the line and tells how many: 0 when there is no room within
READ_TIMEOUT_S. Raises OSError when the port is lost."""


def writer_of(port: serial.Serial) -> Put:
    """The quickest way to write to `port`."""
    if isinstance(port, protocol_socket.Serial) or type(port).write is serial.Serial.write:
        return _DescriptorWriter(port.fileno()).put
    return _PortWriter(port).put


class _DescriptorWriter:
    """Writes what the system has room for; pyserial would not tell how much that was."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLOUT)

    def put(self, data: bytes) -> int:
        try:
            return os.write(self._descriptor, data)
        except BlockingIOError:
            self._poll.poll(READ_TIMEOUT_S * 1000)
            return 0


class _PortWriter:
    """Writes through pyserial's interface; for ports that have no descriptor of their own."""

    def __init__(self, port: serial.Serial) -> None:
        self._port = port

    def put(self, data: bytes) -> int:
        return self._port.write(data) or 0


HOST = "host"
"""What the wire from the host program is called; the other is called as the port is."""

MOST_AHEAD = 4096
"""Bytes that a driver holds before it lets a writer wait, about: none is timed later than these."""


class WireTimes:
    """When bytes that are put onto a line leave at its pace, one after the other."""

    free_ns = 0
    """When the latest of them leaves."""

    def __init__(self, baud: int) -> None:
        self.pace(baud)

    def pace(self, baud: int) -> None:
        """From now on the line has this speed, bits per second."""
        self._byte_ns = byte_time_ns(baud)

    def last_of(self, count: int, now_ns: int) -> int:
        """When the last of `count` bytes that are put onto the line now has left it."""
        taken_ns = count * self._byte_ns
        latest_ns = now_ns + max(taken_ns, MOST_AHEAD * self._byte_ns)
        self.free_ns = min(max(self.free_ns, now_ns) + taken_ns, latest_ns)
        return self.free_ns


class WireEvents:
    """The items of both wires on one time line; put from two threads, iterated by one.

    The chunks of the host's wire hold what was put onto the line. Their time is when their last
    byte will have left at the line's pace, so that they are dated back like any others.
    """

    def __init__(self, port: str, baud: int, clock: Clock, capacity: int = CAPACITY) -> None:
        """Nothing is told yet.

        Args:
            port: what the port's wire is called.
            baud: of both, bits per second.
            clock: what chunks and events are stamped with.
            capacity: how many bytes of each wire may wait for the consumer.
        """
        self.port = port
        self.clock = clock
        """What chunks and events are stamped with."""
        self._baud = baud
        self._departures = WireTimes(baud)
        self.end_ns = inf
        """When the end is due, by the clock."""
        self._backlogs = {wire: ChunkQueue(wire, capacity) for wire in (port, HOST)}

    def __iter__(self) -> Iterator[Item]:
        return heapq.merge(*self._backlogs.values(), key=lambda item: item.t_ns or 0)

    @property
    def due(self) -> bool:
        """Whether the end is due."""
        return self.clock.now_ns() >= self.end_ns

    @property
    def waiting(self) -> int:
        """How many bytes of both wires wait for the consumer."""
        return sum(backlog.waiting for backlog in self._backlogs.values())

    def drop(self) -> None:
        """Let the consumer have no more bytes, but an overrun a wire that counts them."""
        for backlog in self._backlogs.values():
            backlog.drop()

    def now_ns(self) -> int:
        """The time now, to be taken as soon as bytes were read."""
        return self.clock.now_ns()

    def read(self, t_ns: int, data: bytes) -> None:
        """Bytes were read from the port at `t_ns`; none mean silence."""
        self._backlogs[self.port].put(Chunk(self.port, t_ns, data))

    def written(self, data: bytes) -> None:
        """Bytes of the host program were put onto the line just now; none mean silence."""
        t_ns = self._departures.last_of(len(data), self.clock.now_ns())
        self._backlogs[HOST].put(Chunk(HOST, t_ns, data))

    def pace(self, baud: int) -> None:
        """Both wires have this speed from now on, bits per second."""
        self._pace(baud)
        kind = PortEventKind.BAUD_CHANGED
        self.tell(
            HOST, kind, TranslatableText("the host program asks for {baud} baud", baud=baud), baud
        )
        self.tell(self.port, kind, TranslatableText("it has {baud} baud now", baud=baud), baud)

    def start_again(self, baud: int) -> None:
        """The port was opened anew with this speed, whatever a host program had set before."""
        if baud != self._baud:
            self._pace(baud)
            detail = TranslatableText("it begins again with {baud} baud", baud=baud)
            for wire in self._backlogs:
                self.tell(wire, PortEventKind.BAUD_CHANGED, detail, baud)

    def tell(self, wire: str, kind: PortEventKind, detail: str, count: int = 0) -> None:
        """An event of a wire happened just now."""
        t_ns = self.clock.now_ns()
        if wire == HOST:
            t_ns = max(t_ns, self._departures.free_ns)
        self._backlogs[wire].tell(PortEvent(t_ns, wire, kind, detail, count))

    def end(self) -> None:
        """Nothing comes after what was told until now."""
        for backlog in self._backlogs.values():
            backlog.end()

    def _pace(self, baud: int) -> None:
        self._baud = baud
        self._departures.pace(baud)


class Exchange:
    """One exchange, from an open port to its loss or to the end."""

    def __init__(self, port: serial.Serial, host: HostEnd, wires: WireEvents) -> None:
        """Make ready; nothing is passed on before `run`."""
        self._port = port
        self._host = host
        self._wires = wires
        self._read = reader_of(port)
        self._put = writer_of(port)
        self._baud = port.baudrate
        self._lines = port.dtr, port.rts
        self._ending = False
        self._lost: OSError | None = None
        self._not_given = 0
        self._not_taken = 0

    def end(self) -> None:
        """Let `run` return once what has arrived until now is passed on; may be called anywhere."""
        self._ending = True

    def run(self) -> OSError | None:
        """Pass on until the end, or until the port is lost by the error that is returned.

        This thread carries feedback, another one control.
        """
        control = threading.Thread(target=self._carry_control, name="host to port", daemon=True)
        control.start()
        try:
            self._carry_feedback()
        except OSError as error:
            self._lost = self._lost or error
        self._ending = True
        control.join()
        self._tell_not_given()
        if self._not_taken:
            detail = TranslatableText(
                "{count} bytes of the host program: the port did not take them",
                count=self._not_taken,
            )
            self._wires.tell(HOST, PortEventKind.NOT_PASSED_ON, detail, self._not_taken)
        if self._host.present:
            self._wires.tell(HOST, PortEventKind.CLOSED, TranslatableText("the bridge hangs up"))
        return self._lost

    # From the port to the host program

    def _carry_feedback(self) -> None:
        while True:
            # Looked at before the read: what has arrived when the end is asked for is read yet.
            last = self._ending or self._wires.due
            data = self._read()
            t_ns = self._wires.now_ns()
            dropped = self._host.write(data)
            self._wires.read(t_ns, data)
            if dropped:
                self._drop(dropped)
            elif not self._host.behind:
                self._tell_not_given()
            if last:
                return

    def _drop(self, count: int) -> None:
        if not self._not_given:
            detail = TranslatableText(
                "the host program does not read: what comes for it is dropped, but kept here"
            )
            self._wires.tell(HOST, PortEventKind.NOT_PASSED_ON, detail)
        self._not_given += count

    def _tell_not_given(self) -> None:
        if self._not_given:
            detail = TranslatableText(
                "{count} bytes were kept here, but not given to the host program",
                count=self._not_given,
            )
            self._wires.tell(HOST, PortEventKind.NOT_PASSED_ON, detail, self._not_given)
            self._not_given = 0

    # From the host program to the port

    def _carry_control(self) -> None:
        try:
            while True:
                last = self._ending
                present = self._host.present
                data = self._host.read()
                if self._host.present != present:
                    self._tell_of_presence(not present)
                if self._host.present:
                    self._follow_baud()
                self._put_all(data)
                if last:
                    return
        except (OSError, termios.error) as error:
            self._lost = self._lost or OSError(*error.args)
            self._ending = True

    def _put_all(self, data: bytes) -> None:
        if not data:
            self._wires.written(b"")
        while data:
            count = self._put(data)
            self._wires.written(data[:count])
            data = data[count:]
            if self._ending and not count:
                self._not_taken += len(data)
                return

    def _tell_of_presence(self, present: bool) -> None:
        kind = PortEventKind.OPENED if present else PortEventKind.CLOSED
        name = self._host.name
        if present:
            detail = TranslatableText("a host program opened {name}", name=name)
        else:
            detail = TranslatableText("a host program closed {name}", name=name)
        self._wires.tell(HOST, kind, detail)

    def _follow_baud(self) -> None:
        baud = self._host.baud()
        if baud == self._baud:
            return
        before, self._baud = self._baud, baud
        if not baud:
            self._set_lines(False, False)
            detail = TranslatableText("the host program hung up (0 baud): DTR and RTS are off")
            self._wires.tell(HOST, PortEventKind.BAUD_CHANGED, detail)
            return
        if not before:
            self._set_lines(*self._lines)
        try:
            if not BAUD_RANGE[0] <= baud <= BAUD_RANGE[1]:
                raise ValueError(f"it is out of range, {BAUD_RANGE[0]}..{BAUD_RANGE[1]}")
            self._port.baudrate = baud
        except (ValueError, OSError, termios.error) as error:
            detail = TranslatableText(
                "{baud} baud is refused by the port: {error}", baud=baud, error=one_line(error)
            )
            self._wires.tell(HOST, PortEventKind.NOT_PASSED_ON, detail)
            return
        self._wires.pace(baud)

    def _set_lines(self, dtr: bool, rts: bool) -> None:
        # A port without such lines refuses; one that is lost is met by the next read.
        with suppress(OSError):
            self._port.dtr = dtr
        with suppress(OSError):
            self._port.rts = rts
