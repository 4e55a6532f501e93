"""Owns what a bridge tells of its two wires: the chunks and events of each, and their times.

It must not know how bytes are passed on. A wire's times never fall.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from math import inf

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.sources.backlog import CAPACITY, Backlog
from fte_sniff.capture.sources.items import Item
from fte_sniff.errors import Said
from fte_sniff.protocol import Chunk, PortEvent, PortEventKind, byte_time_ns

HOST = "host"
"""What the wire from the host program is called; the other is called as the port is."""

MOST_AHEAD = 4096
"""Bytes that a driver holds before it lets a writer wait, about: none is timed later than these."""


class Departures:
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


class Wires:
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
        self._departures = Departures(baud)
        self.end_ns = inf
        """When the end is due, by the clock."""
        self._backlogs = {wire: Backlog(wire, capacity) for wire in (port, HOST)}

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
        self.tell(HOST, kind, Said("the host program asks for {baud} baud", baud=baud), baud)
        self.tell(self.port, kind, Said("it has {baud} baud now", baud=baud), baud)

    def start_again(self, baud: int) -> None:
        """The port was opened anew with this speed, whatever a host program had set before."""
        if baud != self._baud:
            self._pace(baud)
            detail = Said("it begins again with {baud} baud", baud=baud)
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
