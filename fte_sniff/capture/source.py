"""Capture sources: connections whose readers put chunks and events into one queue.

    reader thread:  read -> stamp -> (forward) -> queue -> consumer: for item in source

    connected -> read -> stopped: closed
                      -> lost:    connect again, then read on

A connection is what is lost as a whole: a port; a port and the pseudo-terminal of a host program; a
traced program. What differs between them is how they connect, and what a reader returns.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import inf
from typing import Final, Protocol, Self, TypeAlias

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.port_errors import RefusedError, one_line
from fte_sniff.capture.serial_port import PortSettings
from fte_sniff.errors import FteSniffError, PortError, TranslatableText
from fte_sniff.protocol.items import Chunk, PortEvent, PortEventKind

Item: TypeAlias = Chunk | PortEvent

Reader: TypeAlias = Callable[[], Iterable[Item]]
"""Waits for up to 50 ms, and returns what came, or an empty chunk. Raises OSError when the port is
lost, EOFError when a program has ended that was watched."""


@dataclass(frozen=True, slots=True)
class Connection:
    """Open wires that are lost together."""

    names: Sequence[str]
    """The wires; events of the connection are those of the first."""
    detail: str
    """Text of the event `opened`."""
    readers: Sequence[Reader]
    """Each is called by a thread of its own."""
    close: Callable[[], Iterable[Item]]
    """Closes the wires after the last read; returns what is left to report, which is taken."""
    device: str | None = None
    """The device that host programs open; None for all but a bridge."""
    place: str | None = None
    """What is read: the device file, or the programs that are watched; None for a URL."""
    comes_back: bool = True
    """Whether it can be found again after a loss."""
    awaited: str = TranslatableText("waiting for it to come back")
    """What follows after a loss."""
    uncertainty_ns: Mapping[str, int] = field(default_factory=dict)
    """By wire: how much earlier than their time stamp bytes may have been on the wire."""
    capabilities: str = ""
    """What the driver supports, as text for users."""


Connect: TypeAlias = Callable[[], Connection]
"""Connects, or connects again. Raises PortError, with the fix, and FileError."""


class Wiring(Protocol):
    """Which ports to open, and how. Can be pickled."""

    @property
    def names(self) -> tuple[str, ...]:
        """The port names in chunks, rows and events."""

    @property
    def settings(self) -> PortSettings:
        """How each port is opened."""

    def open(self, clock: Clock) -> Source:
        """Open all ports, to be read once the source is entered.

        Raises PortError, with none open, if one fails.
        """


class SourceEnd(StrEnum):
    """How a source ended."""

    STOPPED = "stopped"
    LOST = "lost"


AS_ASKED: Final = TranslatableText("as asked")
"""The detail of a port that was closed on request."""

CAPACITY: Final = 32 * 2**20
"""Memory of the items that wait at most, bytes; later chunks are dropped and counted."""
_ITEM_COST: Final = 256
"""Approximate memory of one waiting item besides its bytes."""

FIRST_WAIT_S: Final = 0.25
"""Seconds before the first attempt to connect again; each wait is twice the one before."""
LONGEST_WAIT_S: Final = 1.0
_REPORTED_REFUSAL: Final = 2
"""The refused attempt that is reported; at the first, udev may just not be finished."""
_SILENCE_S: Final = 0.05
"""Time between empty chunks while a lost port is awaited."""
_HELD_UP_NS: Final = 250_000_000
"""Time between two reads that shows that the reader did not run: it waits much shorter."""
_GATHER_S: Final = 0.01
"""How long the consumer lets items gather: waking for each takes longer than processing it."""


class Source:
    """Open connections as one iterable of chunks and events, those of each wire in order.

    The first item of each connection is the event `opened`. A silent wire yields empty chunks
    several times a second. Where an event `lost` or `overrun` is, bytes are missing. Entering the
    source starts its threads; iterate once.
    """

    def __init__(self, connects: Sequence[Connect], clock: Clock, *, reconnect: bool) -> None:
        """Connect all; with `reconnect`, connect again what is lost and can come back.

        Raises PortError or FileError, with nothing open, if one fails.
        """
        self._clock, self._reconnect = clock, reconnect
        self.end: SourceEnd | None = None
        """Why reading ended, although items may still be queued; None while it continues."""
        self._loss: SourceEnd | None = None
        self._stop_at_ns = inf
        self._put_bytes = self._taken_bytes = 0
        self._dropped: Counter[str] = Counter()
        self._last_ns: Counter[str] = Counter()
        """By wire: no later item has an earlier time."""
        self._items: queue.SimpleQueue[Item | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._opened_ns = clock.now_ns()  # before the first byte that is seen
        opened = list[Connection]()
        try:
            opened.extend(connect() for connect in connects)
        except BaseException:
            for connection in opened:
                tuple(connection.close())
            raise
        self.device = opened[0].device
        self.uncertainty_ns = {
            name: ns for one in opened for name, ns in one.uncertainty_ns.items()
        }
        self.capabilities = {name: one.capabilities for one in opened for name in one.names}
        self._running = len(opened)
        self._threads = [
            threading.Thread(target=self._run, args=(connect, connection), daemon=True)
            for connect, connection in zip(connects, opened, strict=True)
        ]

    def __enter__(self) -> Self:
        for thread in self._threads:
            if thread.ident is None:
                thread.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def __iter__(self) -> Iterator[Item]:
        with self:
            while (item := self._next()) is not None:
                yield item
            self._items.put(None)  # a later iteration also ends at once

    @property
    def waiting(self) -> int:
        """Number of bytes that were read and not yet yielded."""
        return self._put_bytes - self._taken_bytes

    def stop(self) -> None:
        """Request the end: items that have arrived are still yielded, then iteration ends.

        Returns at once. Safe from any thread and from signal handlers; may be repeated.
        """
        self._stop_at_ns = 0

    def stop_at(self, t_ns: float) -> None:
        """Request the end at a time of the chunks' clock; returns at once."""
        self._stop_at_ns = min(self._stop_at_ns, t_ns)

    def close(self) -> None:
        """Stop, wait for the threads, and close the ports; items that wait can be iterated."""
        self.stop()
        self.__enter__()  # a thread that never ran closes its connection
        for thread in self._threads:
            thread.join()

    def _next(self) -> Item | None:
        if self._items.empty():
            time.sleep(_GATHER_S)
        item = self._items.get()
        if isinstance(item, Chunk):
            self._taken_bytes += len(item.data)
        return item

    def _put(self, item: Item) -> None:
        """Append an item; a chunk without room is dropped, and its bytes are counted."""
        with self._lock:
            item = self._in_order(item)
            if isinstance(item, Chunk):
                size = len(item.data)
                if self.waiting + _ITEM_COST * self._items.qsize() > CAPACITY:
                    self._dropped[item.port] += size
                    return
                self._put_bytes += size
            if self._dropped and (count := self._dropped.pop(item.port, 0)):
                self._items.put(self._overrun(item.port, count))
            self._items.put(item)

    def _in_order(self, item: Item) -> Item:
        t_ns, last_ns = item.t_ns or 0, self._last_ns[item.port]
        if t_ns >= last_ns:
            self._last_ns[item.port] = t_ns
            return item
        if isinstance(item, Chunk):
            return item._replace(t_ns=last_ns)
        return replace(item, t_ns=last_ns)

    def _overrun(self, port: str, count: int) -> PortEvent:
        detail = TranslatableText(
            "{count} bytes were lost: they arrived faster than they were processed", count=count
        )
        return PortEvent(self._clock.now_ns(), port, PortEventKind.OVERRUN, detail, count)

    def _put_event(self, connection: Connection, kind: PortEventKind, detail: str) -> None:
        self._put(PortEvent(self._clock.now_ns(), connection.names[0], kind, detail))

    def _is_due(self) -> bool:
        return self._clock.now_ns() >= self._stop_at_ns

    # The thread of a connection

    def _run(self, connect: Connect, connection: Connection) -> None:
        name, kind = connection.names[0], PortEventKind.OPENED
        self._put(PortEvent(self._opened_ns, name, kind, connection.detail))
        try:
            self._read_until_end(connect, connection)
        finally:
            with self._lock:
                self._running -= 1
                is_last = not self._running
            if is_last:
                self.end = self._loss or SourceEnd.STOPPED
                self._items.put(None)

    def _read_until_end(self, connect: Connect, connection: Connection) -> None:
        taken = self._put_bytes
        while (error := self._read_until_lost(connection)) is not None:
            # A port that came back without any byte is likely to go again: it is asked slowly.
            wait_s = FIRST_WAIT_S if self._put_bytes > taken else LONGEST_WAIT_S
            text, lost_ns = one_line(error), self._clock.now_ns()
            if not (self._reconnect and connection.comes_back):
                # A program that is over is not an error.
                is_over = isinstance(error, EOFError)
                self._lose(connection, text, SourceEnd.STOPPED if is_over else SourceEnd.LOST)
                return
            awaited = TranslatableText("{error}; {awaited}", error=text, awaited=connection.awaited)
            self._put_event(connection, PortEventKind.LOST, awaited)
            try:
                again = self._connect_again(connect, connection, wait_s)
            except FteSniffError as refused:
                self._lose(connection, refused.message, SourceEnd.LOST)
                return
            if again is None:
                break
            self._put_event(connection, PortEventKind.FOUND_AGAIN, self._found(again, lost_ns))
            connection, taken = again, self._put_bytes
        self._put_event(connection, PortEventKind.CLOSED, AS_ASKED)

    def _lose(self, connection: Connection, text: str, end: SourceEnd) -> None:
        """Lose a connection for good; the others go on, unless the first loss is to end all."""
        self._loss = end
        self._put_event(connection, PortEventKind.LOST, text)
        if not self._reconnect:
            self.stop()

    def _found(self, again: Connection, lost_ns: int) -> TranslatableText:
        after = TranslatableText(
            "after {seconds:.1f} s", seconds=(self._clock.now_ns() - lost_ns) / 1e9
        )
        if again.place in (None, again.names[0]):
            return after
        return TranslatableText("{after} as {port}", after=after, port=again.place)

    def _connect_again(
        self, connect: Connect, before: Connection, first_wait_s: float
    ) -> Connection | None:
        """Connect in another thread, since that may take seconds; None if the end comes first.

        Raises FteSniffError if it can never connect.
        """
        found = Future[Connection]()
        arguments = connect, before, first_wait_s, found
        threading.Thread(target=self._attempt, args=arguments, daemon=True).start()
        while not self._is_due():
            for name in before.names:
                self._put(Chunk(name, self._clock.now_ns(), b""))
            with suppress(TimeoutError):
                return found.result(_SILENCE_S)
        found.add_done_callback(_close_late)
        return None

    def _attempt(
        self, connect: Connect, before: Connection, wait_s: float, found: Future[Connection]
    ) -> None:
        refusals = 0
        while not (found.done() or self._is_due()):
            time.sleep(wait_s)
            wait_s = min(2 * wait_s, LONGEST_WAIT_S)
            try:
                found.set_result(connect())
            except PortError as error:
                refusals += isinstance(error, RefusedError)
                if isinstance(error, RefusedError) and refusals == _REPORTED_REFUSAL:
                    detail = TranslatableText("it is back, but {why}", why=error.message)
                    self._put_event(before, PortEventKind.NOT_OPENED, detail)
            except FteSniffError as error:
                found.set_exception(error)

    def _read_until_lost(self, connection: Connection) -> BaseException | None:
        """Read all wires until the end is due (returns None) or one is lost (returns the error)."""
        errors = list[BaseException]()
        threads = [
            threading.Thread(target=self._read, args=(reader, errors), daemon=True)
            for reader in connection.readers
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        with suppress(OSError):
            for item in connection.close():
                self._put(item)
        return errors[0] if errors else None

    def _read(self, reader: Reader, errors: list[BaseException]) -> None:
        read_ns, unseen, last = self._clock.now_ns(), False, False
        while not last:
            # Checked before the read, so that bytes that arrived before the end are still read.
            last = read_ns >= self._stop_at_ns or bool(errors)
            items = list[Item]()
            try:
                items.extend(reader())  # what came before an error stays
            except (OSError, EOFError) as error:
                errors.append(error)
                last = True
            before_ns, read_ns = read_ns, self._clock.now_ns()
            held_up = read_ns - before_ns > _HELD_UP_NS
            for item in items:
                if isinstance(item, Chunk):
                    if item.data:
                        item = item._replace(is_late=True) if held_up or unseen else item
                        unseen = False
                    elif held_up and not last:
                        # Bytes may have arrived since it was read: the next ones may be late.
                        unseen = True
                        continue
                self._put(item)


def _close_late(found: Future[Connection]) -> None:
    """Close a connection that came after the end."""
    if found.exception() is None:
        tuple(found.result().close())
