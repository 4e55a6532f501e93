"""Bounded queue of chunks between the reader threads of one or more ports and their consumer.

When the consumer is too slow, chunks are dropped, and one `overrun` event for each port counts
their bytes.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import inf
from typing import TypeAlias

from fte_sniff.errors import TranslatableText
from fte_sniff.protocol import Chunk, PortEvent, PortEventKind

Item: TypeAlias = Chunk | PortEvent

CAPACITY = 32 * 2**20
"""Default limit of the bytes that wait, bookkeeping included."""

_ITEM_COST = 256
"""Approximate memory of one waiting item besides its bytes."""

_HELD_UP_NS = 250_000_000
"""Time between two reads that shows that the reader did not run: it waits much shorter."""


@dataclass(slots=True)
class _PortState:
    """What a port has in the queue, and what was dropped of it."""

    put_cost: int = 0
    put_bytes: int = 0
    # Only the consumer writes these, so reading needs no lock.
    taken_cost: int = 0
    taken_bytes: int = 0
    dropped: int = 0
    dropped_at_ns: int = 0
    is_full: bool = False
    read_ns: float = inf
    unseen: bool = False

    def was_held_up(self, t_ns: int) -> bool:
        """Whether the reader did not run before this time, so that bytes may have waited for it."""
        before_ns, self.read_ns = self.read_ns, t_ns
        return t_ns - before_ns > _HELD_UP_NS


class ChunkQueue:
    """Queue of chunks and events: put from any thread, iterated by one.

    The items of each port keep their order.
    """

    def __init__(self, *ports: str, capacity: int = CAPACITY, readers: int = 1) -> None:
        """Create it for these ports; `capacity` limits the bytes of each that wait.

        It ends when each of the `readers` has closed it.
        """
        self._ports = {port: _PortState() for port in ports}
        self._capacity = capacity
        self._open = readers
        self._queue: queue.SimpleQueue[Item | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._unwanted = False

    @property
    def waiting(self) -> int:
        """Number of bytes that wait for the consumer."""
        return sum(port.put_bytes - port.taken_bytes for port in self._ports.values())

    def __iter__(self) -> Iterator[Item]:
        while (item := self._next()) is not None:
            if self._unwanted:
                yield from self._without_bytes(item)
                break
            yield item
        # A later iteration also ends at once.
        self._queue.put(None)

    def put(self, chunk: Chunk) -> None:
        """Append a chunk. An empty one is ignored while others wait: it adds no information.

        After a pause of the reader it is ignored too: bytes may have arrived since it was read.
        """
        with self._lock:
            port = self._ports[chunk.port]
            held_up = port.was_held_up(chunk.t_ns or 0)
            if chunk.data and (held_up or port.unseen):
                chunk = replace(chunk, is_late=True)
            port.unseen = held_up and not (chunk.data or chunk.line_errors)
            if port.unseen:
                return
            waiting = port.put_cost - port.taken_cost
            if waiting and not (chunk.data or chunk.line_errors):
                return
            # Hysteresis: once full, wait until half is free. Each overrun cuts frames apart.
            limit = self._capacity // 2 if port.is_full else self._capacity
            port.is_full = waiting + _cost(chunk) > limit
            if port.is_full:
                port.dropped_at_ns = port.dropped_at_ns or chunk.t_ns or 0
                port.dropped += len(chunk.data)
                return
            self._append(chunk)

    def put_event(self, event: PortEvent) -> None:
        """Append an event; events are never dropped."""
        with self._lock:
            self._append(event)

    def drop(self) -> None:
        """After the last `put`: replace the waiting bytes by overruns that count them."""
        self._unwanted = True

    def close(self) -> None:
        """End the iteration after the items that wait now, once all readers have closed it."""
        with self._lock:
            self._open -= 1
            if self._open <= 0:
                self._queue.put(None)

    def _append(self, item: Item) -> None:
        port = self._ports[item.port]
        if port.dropped:
            reason = TranslatableText("they arrived faster than they were processed")
            self._put(_overrun(item.port, port.dropped_at_ns, port.dropped, reason))
            port.dropped = port.dropped_at_ns = 0
        self._put(item)

    def _put(self, item: Item) -> None:
        port = self._ports[item.port]
        port.put_cost += _cost(item)
        port.put_bytes += _length(item)
        self._queue.put(item)

    def _next(self) -> Item | None:
        item = self._queue.get()
        if item is not None:
            port = self._ports[item.port]
            port.taken_cost += _cost(item)
            port.taken_bytes += _length(item)
        return item

    def _without_bytes(self, item: Item | None) -> Iterator[Item]:
        waiting: dict[str, list[Item]] = {port: [] for port in self._ports}
        while item is not None:
            waiting[item.port].append(item)
            item = self._next()
        for port, items in waiting.items():
            yield from _counted(port, items)


def _counted(port: str, items: list[Item]) -> Iterator[Item]:
    """The events of a port, and one overrun in place of its bytes and overruns."""
    lost = [one for one in items if isinstance(one, Chunk) or one.kind is PortEventKind.OVERRUN]
    left = sum(map(_length, lost))
    before = sum(one.count for one in lost if isinstance(one, PortEvent))
    reason = TranslatableText(
        "{left} were not yet written at the end, {lost} arrived too fast before",
        left=left,
        lost=before,
    )
    is_first = bool(left or before)
    for one in items:
        if one not in lost:
            yield one
        elif is_first and (_length(one) or isinstance(one, PortEvent)):
            is_first = False
            yield _overrun(port, one.t_ns or 0, left + before, reason)


def _overrun(port: str, t_ns: int, count: int, reason: str) -> PortEvent:
    detail = TranslatableText("{count} bytes were lost: {why}", count=count, why=reason)
    return PortEvent(t_ns, port, PortEventKind.OVERRUN, detail, count)


def _length(item: Item) -> int:
    return len(item.data) if isinstance(item, Chunk) else 0


def _cost(item: Item) -> int:
    return _ITEM_COST + _length(item)
