"""Capture sources: the `Source` interface, and sources with a reader thread and a bounded queue.

a reader thread for each port:  read -> stamp -> bounded queue ->  consumer: for item in source

opened -> read -> stopped: closed
               -> lost:    wait for the port, then read on

When the consumer is too slow, chunks are dropped, and one `overrun` event for each port counts
their bytes.
"""

from __future__ import annotations

import queue
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from math import inf
from typing import Protocol, Self, TypeAlias

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.port_errors import one_line
from fte_sniff.capture.reconnect import FIRST_WAIT_S, Closable, OpenedPort, Reconnector, Reopen
from fte_sniff.capture.serial_port import PortSettings
from fte_sniff.errors import FileError, TranslatableText
from fte_sniff.protocol import Chunk, PortEvent, PortEventKind

Item: TypeAlias = Chunk | PortEvent

CAPACITY = 32 * 2**20
"""Default limit of the bytes that wait, bookkeeping included."""

_ITEM_COST = 256
"""Approximate memory of one waiting item besides its bytes."""

_HELD_UP_NS = 250_000_000
"""Time between two reads that shows that the reader did not run: it waits much shorter."""

_GATHER_S = 0.01
"""How long the consumer lets items gather: waking for each takes longer than processing it."""


@dataclass(slots=True)
class _PortState:
    """What a port has in the queue, and what was dropped of it."""

    put_items: int = 0
    put_bytes: int = 0
    # Only the consumer writes these, so reading needs no lock.
    taken_items: int = 0
    taken_bytes: int = 0
    dropped: int = 0
    dropped_at_ns: int = 0
    is_full: bool = False
    read_ns: float = inf
    unseen: bool = False

    @property
    def waiting_bytes(self) -> int:
        """Number of bytes that wait for the consumer."""
        return self.put_bytes - self.taken_bytes

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
        self._queue: queue.SimpleQueue[tuple[Item, _PortState, int] | None] = queue.SimpleQueue()
        self._lock = threading.Lock()

    @property
    def waiting(self) -> int:
        """Number of bytes that wait for the consumer."""
        return sum(port.waiting_bytes for port in self._ports.values())

    def __iter__(self) -> Iterator[Item]:
        while (item := self._next()) is not None:
            yield item
        # A later iteration also ends at once.
        self._queue.put(None)

    def put(self, chunk: Chunk) -> None:
        """Append a chunk. An empty one is ignored while others wait: it adds no information.

        After a pause of the reader it is ignored too: bytes may have arrived since it was read.
        """
        size = len(chunk.data)
        has_news = bool(size or chunk.line_errors)
        with self._lock:
            port = self._ports[chunk.port]
            held_up = port.was_held_up(chunk.t_ns or 0)
            if size and (held_up or port.unseen):
                chunk = chunk._replace(is_late=True)
            port.unseen = held_up and not has_news
            if port.unseen:
                return
            waiting = _ITEM_COST * (port.put_items - port.taken_items) + port.waiting_bytes
            if waiting and not has_news:
                return
            # Hysteresis: once full, wait until half is free. Each overrun cuts frames apart.
            limit = self._capacity // 2 if port.is_full else self._capacity
            port.is_full = waiting + _ITEM_COST + size > limit
            if port.is_full:
                port.dropped_at_ns = port.dropped_at_ns or chunk.t_ns or 0
                port.dropped += size
                return
            self._append(chunk, port, size)

    def put_event(self, event: PortEvent) -> None:
        """Append an event; events are never dropped."""
        with self._lock:
            self._append(event, self._ports[event.port], 0)

    def close(self) -> None:
        """End the iteration after the items that wait now, once all readers have closed it."""
        with self._lock:
            self._open -= 1
            if self._open <= 0:
                self._queue.put(None)

    def _append(self, item: Item, port: _PortState, size: int) -> None:
        if port.dropped:
            reason = TranslatableText("they arrived faster than they were processed")
            overrun = _overrun(item.port, port.dropped_at_ns, port.dropped, reason)
            port.dropped = port.dropped_at_ns = 0
            self._append(overrun, port, 0)
        port.put_items += 1
        port.put_bytes += size
        self._queue.put((item, port, size))

    def _next(self) -> Item | None:
        if self._queue.empty():
            time.sleep(_GATHER_S)
        entry = self._queue.get()
        if entry is None:
            return None
        item, port, size = entry
        port.taken_items += 1
        port.taken_bytes += size
        return item


def _overrun(port: str, t_ns: int, count: int, reason: str) -> PortEvent:
    detail = TranslatableText("{count} bytes were lost: {why}", count=count, why=reason)
    return PortEvent(t_ns, port, PortEventKind.OVERRUN, detail, count)


class SourceEnd(StrEnum):
    """How a source ended."""

    STOPPED = "stopped"
    LOST = "lost"


class Source(Protocol):
    """Open ports as one iterable of chunks and events, those of each port in order; iterate once.

    The first item of each port is the event `opened`. A silent port yields empty chunks several
    times a second. Where an event `lost` or `overrun` is, bytes are missing.
    """

    device: str | None = None
    """The device that host programs open; None for all but a bridge."""
    uncertainty_ns: Mapping[str, int]
    """By port: how much earlier than their time stamp bytes may have been on the wire."""
    capabilities: Mapping[str, str]
    """By port: what its driver supports, as text for users."""

    @property
    def end(self) -> SourceEnd | None:
        """Why reading ended, although items may still be queued; None while it continues."""

    def __iter__(self) -> Iterator[Item]: ...

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def stop(self) -> None:
        """Request the end: items that have arrived are still yielded, then iteration ends.

        Returns at once. Safe from any thread and from signal handlers; may be repeated.
        """

    def stop_at(self, t_ns: float) -> None:
        """Request the end at a time of the chunks' clock; returns at once."""

    @property
    def waiting(self) -> int:
        """Number of bytes that were read and not yet yielded."""

    def close(self) -> None:
        """Stop, and close the ports. Items that wait can still be iterated."""


class Wiring(Protocol):
    """Which ports to open, and how. Can be pickled."""

    @property
    def names(self) -> tuple[str, ...]:
        """The port names in chunks, rows and events."""

    @property
    def settings(self) -> PortSettings:
        """How each port is opened."""

    def open(self, clock: Clock) -> Source:
        """Open all ports and start to read; raises PortError, with none open, if one fails."""


AS_ASKED = TranslatableText("as asked")
"""The detail of a port that was closed on request."""

_SILENCE_INTERVAL_S = 0.05  # between empty chunks while a lost port is awaited


class ThreadedSource(Source, ABC):
    """Base class of sources with a reader thread; subclasses implement the reading."""

    end: SourceEnd | None = None
    _awaited = TranslatableText("waiting for it to come back")
    """What follows after a loss."""

    def __init__(
        self,
        port: Closable,
        name: str,
        items: ChunkQueue,
        clock: Clock,
        reopen: Reopen | None,
    ) -> None:
        """Take over an open port; without `reopen` the source ends when the port is lost."""
        self.name = name
        self._port = port
        self._items = items
        self._clock = clock
        self._reopen = reopen
        self._stopping = False
        self._stop_at_ns = inf

    def __iter__(self) -> Iterator[Item]:
        try:
            yield from self._items
        finally:
            self.close()

    def stop(self) -> None:
        """Request the end, as `Source.stop`."""
        self._stopping = True

    def stop_at(self, t_ns: float) -> None:
        """Request the end at a time of the clock; returns at once."""
        self._stop_at_ns = t_ns

    def _end_due(self) -> bool:
        """True once `stop` was called or the time of `stop_at` has come."""
        return self._stopping or self._clock.now_ns() >= self._stop_at_ns

    @property
    def waiting(self) -> int:
        """Number of bytes that were read and not yet yielded."""
        return self._items.waiting

    def close(self) -> None:
        """Stop, wait for the reader thread (about 10 ms), and close the port."""
        self.stop()
        self._thread.join()
        self._close_port()

    def _start(self, thread_name: str, detail: str) -> None:
        self._put_event(PortEventKind.OPENED, detail)
        self._thread = threading.Thread(target=self._run, name=thread_name, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            self._read_until_end()
        finally:
            self._items.close()

    def _read_until_end(self) -> None:
        while (error := self._read_until_lost()) is not None:
            lost = one_line(error)
            if self._reopen is None:
                self._finish(self._end_after(error), PortEventKind.LOST, lost)
                return
            detail = TranslatableText("{error}; {awaited}", error=lost, awaited=self._awaited)
            self._put_event(PortEventKind.LOST, detail)
            lost_ns = self._clock.now_ns()
            opened = self._wait_for_port(self._reopen)
            if opened is None:
                break
            try:
                self._resume(opened, (self._clock.now_ns() - lost_ns) / 1e9)
            except FileError as refused:
                self._finish(SourceEnd.LOST, PortEventKind.LOST, refused.message)
                return
        self._finish(SourceEnd.STOPPED, PortEventKind.CLOSED, AS_ASKED)

    def _end_after(self, _error: OSError) -> SourceEnd:
        """How the capture ends after a loss that ends it."""
        return SourceEnd.LOST

    def _wait_for_port(self, reopen: Reopen) -> OpenedPort | None:
        self._close_port()
        reconnector = Reconnector(reopen, self._first_wait_s())
        while not self._end_due():
            opened = reconnector.wait(_SILENCE_INTERVAL_S)
            if opened is not None:
                return opened
            if refusal := reconnector.refusal():
                self._put_event(PortEventKind.NOT_OPENED, refusal)
            self._put_silence()
        reconnector.cancel()
        return None

    def _put_found_again(self, opened: OpenedPort, away_s: float, note: str = "") -> None:
        renamed = opened.name != self.name
        self._put_event(
            PortEventKind.FOUND_AGAIN,
            TranslatableText(
                "after {seconds:.1f} s{named}{shared}",
                seconds=away_s,
                named=TranslatableText(" as {port}", port=opened.name) if renamed else "",
                shared=note,
            ),
        )

    def _first_wait_s(self) -> float:
        return FIRST_WAIT_S

    def _finish(self, end: SourceEnd, kind: PortEventKind, detail: str) -> None:
        self.end = end
        self._put_event(kind, detail)

    def _close_port(self) -> None:
        with suppress(OSError):
            self._port.close()

    @abstractmethod
    def _read_until_lost(self) -> OSError | None:
        """Read until the end is due (returns None) or the port is lost (returns the error)."""

    @abstractmethod
    def _resume(self, opened: OpenedPort, away_s: float) -> None:
        """Prepare to read again and put `found_again`; a FileError loses the port for good."""

    def _put_event(self, kind: PortEventKind, detail: str) -> None:
        """Put an event of the port, stamped with the time now."""
        self._items.put_event(PortEvent(self._clock.now_ns(), self.name, kind, detail))

    def _put_silence(self) -> None:
        """Put an empty chunk for each wire, so that no consumer waits for a port that is away."""
        self._items.put(Chunk(self.name, self._clock.now_ns(), b""))
