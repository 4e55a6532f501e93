"""Capture sources: connections whose readers put chunks and events into one queue.

    reader thread:  read -> stamp -> (forward) -> queue -> consumer: a batch of items

    connected -> read -> stopped: closed
                      -> lost:    away, until it is connected again

A connection is what is lost as a whole: a port; a port and the pseudo-terminal of a host program; a
traced program. What differs between them is how they connect, and what a reader returns.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from math import inf
from typing import Final, Self, TypeAlias

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.port_errors import RefusedError, one_line
from fte_sniff.errors import FteSniffError, PortError, TranslatableText
from fte_sniff.protocol.items import Chunk, PortEvent, PortEventKind

Received: TypeAlias = Chunk | PortEvent
"""What a reader returns, and a source yields."""

Reader: TypeAlias = Callable[[], Iterable[Received]]
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
    close: Callable[[], Iterable[Received]]
    """Closes the wires after the last read; returns what is left to report, which is taken."""
    device: str | None = None
    """The device that host programs open; None for all but a bridge."""
    place: str | None = None
    """What is read: the device file, or the programs that are watched; None for a URL."""
    comes_back: bool = True
    """Whether it can be found again after a loss."""
    uncertainty_ns: Mapping[str, int] = field(default_factory=dict)
    """By wire: how much earlier than their time stamp bytes may have been on the wire."""


Connect: TypeAlias = Callable[[], Connection]
"""Connects, or connects again. Raises PortError, with the fix, and FileError."""


HOST: Final = "host"
"""Name of the wire from a host program; the other wire has the port's name."""

AS_ASKED: Final = TranslatableText("as asked")
"""The detail of a port that was closed on request."""

CAPACITY: Final = 32 * 2**20
"""Memory of the items that wait at most, bytes; later chunks are dropped and counted."""
_ITEM_COST: Final = 256
"""Approximate memory of one waiting item besides its bytes."""

RECONNECT_S: Final = 0.5
"""Seconds before each attempt to connect again."""
_REPORTED_REFUSAL: Final = 2
"""The refused attempt that is reported; at the first, udev may just not be finished."""
_TICK_S: Final = 0.05
"""Time between empty chunks while a lost port is awaited."""
_HELD_UP_NS: Final = 250_000_000
"""Time between two reads that shows that the reader did not run: it waits much shorter."""
BATCH_S: Final = 0.05
"""Seconds in which the items of a batch gather: waking for each takes longer than processing it."""
_MOST_BATCH: Final = 2**18
"""Bytes after which a batch is full and the next one follows at once: a consumer with a backlog
keeps reporting."""
_CHECK_S: Final = 0.01
"""Seconds between two checks whether the ports are closed."""


class Source:
    """Open connections as one iterable of batches of chunks and events, those of a wire in order.

    The first item of each connection is the event `opened`. A wire that is silent or away yields
    empty chunks several times a second. Where an event `lost` or `overrun` is, bytes are missing.
    Entering the source starts its threads; iterate once.
    """

    def __init__(self, connects: Sequence[Connect], clock: Clock, *, reconnect: bool) -> None:
        """Connect all; with `reconnect`, connect again what is lost and can come back.

        Raises PortError or FileError, with nothing open, if one fails.
        """
        self._clock, self._reconnect = clock, reconnect
        self.lost: PortEvent | None = None
        """The latest loss for good; None where all ended as asked, or with their programs."""
        self._stop_at_ns = inf
        self.received_bytes = self._taken_bytes = 0
        """Bytes that were read and not dropped, and those of them that were yielded."""
        self._dropped: Counter[str] = Counter()
        self._items: queue.SimpleQueue[Received] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._opened_ns = self._tick_ns = clock.now_ns()  # before the first byte that is seen
        opened = list[Connection]()
        try:
            opened.extend(connect() for connect in connects)
        except BaseException:
            for connection in opened:
                tuple(connection.close())
            raise
        self.connections = opened
        """Those of the start."""
        self._open = self._unfinished = len(opened)
        """Connections that are open, and those that are open or awaited."""
        self._away = set[str]()
        """The wires of those that are not open."""
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

    def __iter__(self) -> Iterator[list[Received]]:
        """Yield what came, 20 times a second, until all has ended."""
        with self:
            while True:
                is_over = self.is_over  # first: what is put before the end is still yielded
                due_s = time.monotonic() + BATCH_S
                self._tick()
                batch, size = list[Received](), 0
                while size < _MOST_BATCH and not self._items.empty():
                    item = self._items.get()
                    batch.append(item)
                    size += len(item.data) if isinstance(item, Chunk) else 0
                self._taken_bytes += size
                yield batch
                if size < _MOST_BATCH:
                    if is_over:
                        return
                    time.sleep(max(0.0, due_s - time.monotonic()))

    @property
    def device(self) -> str | None:
        """The device that host programs open; None for all but a bridge."""
        return self.connections[0].device

    @property
    def uncertainty_ns(self) -> dict[str, int]:
        """By wire: how much earlier than their time stamp bytes may have been on the wire."""
        return {name: ns for one in self.connections for name, ns in one.uncertainty_ns.items()}

    @property
    def waiting(self) -> int:
        """Number of bytes that were read and not yet yielded."""
        return self.received_bytes - self._taken_bytes

    @property
    def is_over(self) -> bool:
        """Whether no more bytes are read, although items may still be queued."""
        return self._is_due() and not self._open

    def stop(self) -> None:
        """Request the end: items that have arrived are still yielded, then iteration ends.

        Returns at once. Safe from any thread and from signal handlers; may be repeated.
        """
        self._stop_at_ns = 0

    def stop_at(self, t_ns: float) -> None:
        """Request the end at a time of the chunks' clock; returns at once."""
        self._stop_at_ns = min(self._stop_at_ns, t_ns)

    def note(self, kind: PortEventKind, detail: str) -> None:
        """Put an event of the first wire, from before its first byte."""
        self._put(PortEvent(self._opened_ns, self.connections[0].names[0], kind, detail))

    def close(self) -> None:
        """Stop, and wait until the ports are closed; items that wait can be iterated."""
        self.stop()
        self.__enter__()  # a thread that never ran closes its connection
        while self._open:
            time.sleep(_CHECK_S)

    def _tick(self) -> None:
        """Put empty chunks for the wires that are away, so that no other wire waits for them."""
        now_ns = self._clock.now_ns()
        if self._away and now_ns >= self._tick_ns:
            self._tick_ns = now_ns + round(_TICK_S * 1e9)
            for name in tuple(self._away):
                self._put(Chunk(name, now_ns, b""))

    def _put(self, item: Received) -> None:
        """Append an item; a chunk without room is dropped, and its bytes are counted."""
        with self._lock:
            if isinstance(item, Chunk):
                size = len(item.data)
                if self.waiting + _ITEM_COST * self._items.qsize() > CAPACITY:
                    self._dropped[item.port] += size
                    return
                self.received_bytes += size
            if self._dropped and (count := self._dropped.pop(item.port, 0)):
                self._items.put(self._overrun(item.port, count))
            self._items.put(item)

    def _overrun(self, port: str, count: int) -> PortEvent:
        detail = TranslatableText(
            "{count} bytes were lost: they arrived faster than they were processed", count=count
        )
        return PortEvent(self._clock.now_ns(), port, PortEventKind.OVERRUN, detail, count)

    def _put_event(self, connection: Connection, kind: PortEventKind, detail: str) -> PortEvent:
        event = PortEvent(self._clock.now_ns(), connection.names[0], kind, detail)
        self._put(event)
        return event

    def _is_due(self) -> bool:
        return self._clock.now_ns() >= self._stop_at_ns

    # The thread of a connection

    def _run(self, connect: Connect, first: Connection) -> None:
        opened = PortEventKind.OPENED
        self._put(PortEvent(self._opened_ns, first.names[0], opened, first.detail))
        connection: Connection | None = first
        while connection is not None:
            connection = self._next_connection(connect, connection)
        self._unfinished -= 1
        if not (self._reconnect and self._unfinished):  # without, the first loss ends all
            self.stop()

    def _next_connection(self, connect: Connect, connection: Connection) -> Connection | None:
        """Read until the end, or a loss; returns what was connected again then, None at the end."""
        error = self._read_until_lost(connection)
        is_awaited = error is not None and self._reconnect and connection.comes_back
        if error is None:
            self._put_event(connection, PortEventKind.CLOSED, AS_ASKED)
        elif is_awaited:
            detail = TranslatableText("{error}; waiting for it", error=one_line(error))
            self._put_event(connection, PortEventKind.LOST, detail)
        else:
            self._lose(connection, one_line(error), is_error=not isinstance(error, EOFError))
        with self._lock:
            self._open -= 1
            self._away |= {*connection.names}
        return self._connected_again(connect, connection) if is_awaited else None

    def _lose(self, connection: Connection, why: str, *, is_error: bool = True) -> None:
        """Report a loss for good; a program that is over is not an error."""
        event = self._put_event(connection, PortEventKind.LOST, why)
        if is_error:
            self.lost = event

    def _connected_again(self, connect: Connect, before: Connection) -> Connection | None:
        """Try until a connection can be made; None if the end comes first, or it never can.

        An attempt may take seconds; the end does not wait for it.
        """
        lost_ns, refusals = self._clock.now_ns(), 0
        while not self._is_due():
            time.sleep(RECONNECT_S)
            try:
                again = connect()
            except RefusedError as error:
                refusals += 1
                if refusals == _REPORTED_REFUSAL:
                    detail = TranslatableText("it is back, but {why}", why=error.message)
                    self._put_event(before, PortEventKind.NOT_OPENED, detail)
            except PortError:
                continue
            except FteSniffError as error:
                self._lose(before, error.message)
                break
            else:
                if self._is_due():
                    tuple(again.close())
                    break
                with self._lock:
                    self._open += 1
                    self._away -= {*again.names}
                self._put_event(again, PortEventKind.FOUND_AGAIN, self._found(again, lost_ns))
                return again
        return None

    def _found(self, again: Connection, lost_ns: int) -> TranslatableText:
        seconds, port = (self._clock.now_ns() - lost_ns) / 1e9, again.place
        if port in (None, again.names[0]):
            return TranslatableText("after {seconds:.1f} s", seconds=seconds)
        return TranslatableText("after {seconds:.1f} s as {port}", seconds=seconds, port=port)

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
        began_ns, is_last = self._clock.now_ns(), False
        while not is_last:
            before_ns, began_ns = began_ns, self._clock.now_ns()
            # Checked before the read, so that bytes that arrived before the end are still read.
            is_last = began_ns >= self._stop_at_ns or bool(errors)
            try:
                for item in reader():  # what came before an error stays
                    self._put(_dated(item, before_ns, began_ns))
            except (OSError, EOFError) as error:
                errors.append(error)
                is_last = True


def _dated(item: Received, before_ns: int, began_ns: int) -> Received:
    """An item of a read that began at a time, after one that began `before_ns`.

    If the reader was held up, its bytes may be late. Silence is certain only up to the read.
    """
    if not isinstance(item, Chunk) or item.t_ns is None:
        return item
    if not item.data:
        return item._replace(t_ns=began_ns) if item.t_ns > began_ns else item
    return item._replace(is_late=True) if item.t_ns - before_ns > _HELD_UP_NS else item
