"""Bounded queue of chunks between reader thread and consumer."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator

from fte_sniff.capture.source import Item
from fte_sniff.errors import TranslatableText
from fte_sniff.protocol import Chunk, PortEvent, PortEventKind

CAPACITY = 32 * 2**20
"""Bytes that may wait for the consumer, its bookkeeping included, before reads are dropped."""

_ITEM_COST = 256
"""What one waiting item takes besides its bytes, roughly."""


class ChunkQueue:
    """What waits for the consumer: put from any thread, iterated by one."""

    def __init__(self, port: str, capacity: int = CAPACITY) -> None:
        """Nothing waits yet.

        Args:
            port: whose items wait here.
            capacity: how many bytes may wait.
        """
        self._port = port
        self._capacity = capacity
        self._queue: queue.SimpleQueue[Item | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._put_cost = self._put_bytes = 0
        # Written by the consumer alone: what was put less what was taken is what waits.
        self._taken_cost = self._taken_bytes = 0
        self._dropped = self._dropped_at_ns = 0
        self._full = self._unwanted = False

    @property
    def waiting(self) -> int:
        """How many bytes wait for the consumer."""
        return self._put_bytes - self._taken_bytes

    def __iter__(self) -> Iterator[Item]:
        while (item := self._take()) is not None:
            if self._unwanted:
                yield from self._without_bytes(item)
                break
            yield item
        # The end stays the end for whoever iterates again.
        self._queue.put(None)

    def put(self, chunk: Chunk) -> None:
        """Hand on a chunk; an empty one only where nothing waits, as it would tell nothing."""
        with self._lock:
            waiting = self._put_cost - self._taken_cost
            if waiting and not (chunk.data or chunk.line_errors):
                return
            # Once it was full, half is to be free again: each seam cuts frames, so few are made.
            room = self._capacity // 2 if self._full else self._capacity
            self._full = waiting + _cost(chunk) > room
            if self._full:
                self._dropped_at_ns = self._dropped_at_ns or chunk.t_ns or 0
                self._dropped += len(chunk.data)
                return
            self._tell_of_overrun()
            self._put(chunk)

    def tell(self, event: PortEvent) -> None:
        """Hand on an event; there is always room for it."""
        with self._lock:
            self._tell_of_overrun()
            self._put(event)

    def drop(self) -> None:
        """Have the consumer get no more bytes, but be told how many it is spared; returns at once.

        For the end alone: to be called from any thread, once nothing is put any more.
        """
        self._unwanted = True

    def end(self) -> None:
        """Nothing comes after what waits now."""
        self._queue.put(None)

    def _take(self) -> Item | None:
        item = self._queue.get()
        if item is not None:
            self._taken_cost += _cost(item)
            self._taken_bytes += _length(item)
        return item

    def _without_bytes(self, item: Item | None) -> Iterator[Item]:
        """This item and those behind it, with one overrun where their bytes were."""
        events: list[PortEvent] = []
        left = lost = first_ns = 0
        while item is not None:
            if isinstance(item, PortEvent) and item.kind is not PortEventKind.OVERRUN:
                events.append(item)
            else:
                if not (left or lost):
                    yield from events
                    events, first_ns = [], item.t_ns or 0
                left += _length(item)
                lost += item.count if isinstance(item, PortEvent) else 0
            item = self._take()
        if left or lost:
            why = TranslatableText(
                "{left} waited to be written at the end, {lost} came too fast before",
                left=left,
                lost=lost,
            )
            yield self._overrun(first_ns, left + lost, why)
        yield from events

    def _tell_of_overrun(self) -> None:
        if self._dropped:
            why = TranslatableText("they came faster than they were taken")
            self._put(self._overrun(self._dropped_at_ns, self._dropped, why))
            self._dropped = self._dropped_at_ns = 0

    def _overrun(self, t_ns: int, count: int, why: str) -> PortEvent:
        detail = TranslatableText("{count} bytes were not kept: {why}", count=count, why=why)
        return PortEvent(t_ns, self._port, PortEventKind.OVERRUN, detail, count)

    def _put(self, item: Item) -> None:
        self._put_cost += _cost(item)
        self._put_bytes += _length(item)
        self._queue.put(item)


def _length(item: Item) -> int:
    return len(item.data) if isinstance(item, Chunk) else 0


def _cost(item: Item) -> int:
    return _ITEM_COST + _length(item)
