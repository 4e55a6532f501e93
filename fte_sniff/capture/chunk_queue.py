"""Bounded queue of chunks between the reader thread and its consumer.

When the consumer is too slow, chunks are dropped, and one `overrun` event counts their bytes.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from dataclasses import replace
from math import inf

from fte_sniff.capture.source import Item
from fte_sniff.errors import TranslatableText
from fte_sniff.protocol import Chunk, PortEvent, PortEventKind

CAPACITY = 32 * 2**20
"""Default limit of the bytes that wait, bookkeeping included."""

_ITEM_COST = 256
"""Approximate memory of one waiting item besides its bytes."""

_HELD_UP_NS = 250_000_000
"""Time between two reads that shows that the reader did not run: it waits much shorter."""


class ChunkQueue:
    """Queue of chunks and events: put from any thread, iterated by one."""

    def __init__(self, port: str, capacity: int = CAPACITY) -> None:
        self._port = port
        self._capacity = capacity
        self._queue: queue.SimpleQueue[Item | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._put_cost = self._put_bytes = 0
        # Only the consumer writes these, so reading needs no lock.
        self._taken_cost = self._taken_bytes = 0
        self._dropped = self._dropped_at_ns = 0
        self._full = self._unwanted = False
        self._read_ns: float = inf
        self._unseen = False

    @property
    def waiting(self) -> int:
        """Number of bytes that wait for the consumer."""
        return self._put_bytes - self._taken_bytes

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
            held_up = self._was_held_up(chunk.t_ns or 0)
            if chunk.data and (held_up or self._unseen):
                chunk = replace(chunk, is_late=True)
            self._unseen = held_up and not (chunk.data or chunk.line_errors)
            if self._unseen:
                return
            waiting = self._put_cost - self._taken_cost
            if waiting and not (chunk.data or chunk.line_errors):
                return
            # Hysteresis: once full, wait until half is free. Each overrun cuts frames apart.
            limit = self._capacity // 2 if self._full else self._capacity
            self._full = waiting + _cost(chunk) > limit
            if self._full:
                self._dropped_at_ns = self._dropped_at_ns or chunk.t_ns or 0
                self._dropped += len(chunk.data)
                return
            self._append(chunk)

    def _was_held_up(self, t_ns: int) -> bool:
        """Whether the reader did not run before this time, so that bytes may have waited for it."""
        before_ns, self._read_ns = self._read_ns, t_ns
        return t_ns - before_ns > _HELD_UP_NS

    def put_event(self, event: PortEvent) -> None:
        """Append an event; events are never dropped."""
        with self._lock:
            self._append(event)

    def drop(self) -> None:
        """After the last `put`: replace the waiting bytes by one overrun that counts them."""
        self._unwanted = True

    def close(self) -> None:
        """End the iteration after the items that wait now."""
        self._queue.put(None)

    def _append(self, item: Item) -> None:
        if self._dropped:
            reason = TranslatableText("they arrived faster than they were processed")
            self._put(self._overrun(self._dropped_at_ns, self._dropped, reason))
            self._dropped = self._dropped_at_ns = 0
        self._put(item)

    def _put(self, item: Item) -> None:
        self._put_cost += _cost(item)
        self._put_bytes += _length(item)
        self._queue.put(item)

    def _next(self) -> Item | None:
        item = self._queue.get()
        if item is not None:
            self._taken_cost += _cost(item)
            self._taken_bytes += _length(item)
        return item

    def _without_bytes(self, item: Item | None) -> Iterator[Item]:
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
            item = self._next()
        if left or lost:
            reason = TranslatableText(
                "{left} were not yet written at the end, {lost} arrived too fast before",
                left=left,
                lost=lost,
            )
            yield self._overrun(first_ns, left + lost, reason)
        yield from events

    def _overrun(self, t_ns: int, count: int, reason: str) -> PortEvent:
        detail = TranslatableText("{count} bytes were lost: {why}", count=count, why=reason)
        return PortEvent(t_ns, self._port, PortEventKind.OVERRUN, detail, count)


def _length(item: Item) -> int:
    return len(item.data) if isinstance(item, Chunk) else 0


def _cost(item: Item) -> int:
    return _ITEM_COST + _length(item)
