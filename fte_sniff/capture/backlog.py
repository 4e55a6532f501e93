"""Owns the bounded way from the threads that read a port to the one consumer of what they read.

It must not know where chunks come from. Putting never blocks; what there is no room for is counted
and told as an overrun, where it happened.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator

from fte_sniff.capture.items import Item
from fte_sniff.protocol import Chunk, PortEvent, PortEventKind

CAPACITY = 32 * 2**20
"""Bytes that may wait for the consumer, its bookkeeping included, before reads are dropped."""

_ITEM_COST = 256
"""What one waiting item takes besides its bytes, roughly."""


class Backlog:
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
        self._put_cost = 0
        # Written by the consumer alone: what was put less what was taken is what waits.
        self._taken_cost = 0
        self._dropped = self._dropped_at_ns = 0

    def __iter__(self) -> Iterator[Item]:
        while (item := self._queue.get()) is not None:
            self._taken_cost += _cost(item)
            yield item
        # The end stays the end for whoever iterates again.
        self._queue.put(None)

    def put(self, chunk: Chunk) -> None:
        """Hand on a chunk; an empty one only where nothing waits, as it would tell nothing."""
        with self._lock:
            waiting = self._put_cost - self._taken_cost
            if waiting and not chunk.data:
                return
            if waiting + _cost(chunk) > self._capacity:
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

    def end(self) -> None:
        """Nothing comes after what waits now."""
        self._queue.put(None)

    def _tell_of_overrun(self) -> None:
        if self._dropped:
            detail = f"{self._dropped} bytes were not kept: they came faster than they were taken"
            kind, count = PortEventKind.OVERRUN, self._dropped
            self._put(PortEvent(self._dropped_at_ns, self._port, kind, detail, count))
            self._dropped = self._dropped_at_ns = 0

    def _put(self, item: Item) -> None:
        self._put_cost += _cost(item)
        self._queue.put(item)


def _cost(item: Item) -> int:
    return _ITEM_COST + (len(item.data) if isinstance(item, Chunk) else 0)
