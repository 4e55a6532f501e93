"""What models observe and share: changes between rows; observe, merge, copy; counts and rates.

Numpy is loaded on first use, so that commands count the rows of a short log without it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from operator import attrgetter, itemgetter
from typing import TYPE_CHECKING, Any, Final, Generic, Self, TypeVar

from fte_sniff.protocol import (
    Fault,
    Gap,
    GapKind,
    PortEvent,
    PortEventKind,
    Rows,
    Status,
    status_of,
)
from fte_sniff.protocol.items import BaudChange
from fte_sniff.protocol.rows import faults_in

if TYPE_CHECKING:
    from fte_sniff.protocol.rows import Ints

# Gaps and baud changes between rows

GAP_EVENTS: Final = frozenset(
    {PortEventKind.LOST, PortEventKind.FOUND_AGAIN, PortEventKind.OVERRUN}
)
"""Events at which bytes of a port are missing."""


@dataclass(frozen=True, slots=True)
class StreamChange:
    """A gap or a change of speed between two rows."""

    index: int
    """Of the first row after it, among the rows that it is reported with."""
    what: Gap | BaudChange


def shifted(changes: Iterable[StreamChange], by: int) -> list[StreamChange]:
    """These changes with their indices raised by `by`."""
    return [replace(change, index=change.index + by) for change in changes]


class GapDetector:
    """Detects gaps and baud changes between rows that come in batches."""

    def __init__(self) -> None:
        self._bauds: dict[str, int] = {}
        self._edges: deque[tuple[int, Gap]] = deque()
        """The reported gaps: the first time in each, and the first time after it."""
        self._interruption: Gap | None = None
        self._last_ns: int | None = None
        self._not_shown = 0
        self.lost: set[str] = set()
        """Ports that are lost and were not found again."""
        self.found: set[str] = set()
        """Ports that were found again without having been lost: they were lost before."""

    def begin(self, bauds: Mapping[str, int], gaps: Iterable[Gap] = ()) -> list[StreamChange]:
        """Begin an input, which reports `gaps`; returns the changes before its first row.

        Later changes of the baud are followed only of the ports in `bauds`, bits per second.
        """
        self._edges.clear()
        self.expect(gaps)
        # The next file of a capture names the baud of the beginning, not of the end.
        new = {port: baud for port, baud in bauds.items() if self._bauds.get(port) != baud}
        self._bauds.update(new)
        return [StreamChange(0, BaudChange(port, baud)) for port, baud in new.items()]

    def expect(self, gaps: Iterable[Gap]) -> None:
        """Add gaps that the input reports before their rows."""
        edges = [(t_ns, gap) for gap in gaps for t_ns in _edges(gap)]
        self._edges = deque(sorted([*self._edges, *edges], key=itemgetter(0)))

    def interrupt(self, kind: GapKind, reason: str = "") -> StreamChange:
        """Report that rows are missing before the next ones."""
        port_lost = False if kind is GapKind.OTHER_RECORDING else None
        self._interruption = Gap(kind, reason=reason, port_lost=port_lost)
        return StreamChange(0, self._interruption)

    def observe(self, times: tuple[int, int] | None) -> Gap | None:
        """Rows came: returns the gap that `interrupt` reported, now that both ends are known.

        `times` are those of the first row and the latest one; None if they have no times.
        """
        if times is None:
            return None
        gap, self._interruption = self._interruption, None
        (first_ns, latest_ns), last_ns = times, self._last_ns
        self._last_ns = latest_ns if last_ns is None else max(last_ns, latest_ns)
        if gap is None or last_ns is None or first_ns - last_ns <= 1:
            return None
        return gap._replace(start_ns=last_ns + 1, end_ns=first_ns - 1)

    def changes(self, rows: Rows, not_shown: int = 0) -> list[StreamChange]:
        """The changes before, between and after the next rows, by rising index.

        `not_shown` counts the rows that were left out of the view so far, these included.
        """
        found: list[StreamChange] = []
        if not_shown > self._not_shown:
            found.append(StreamChange(0, Gap(GapKind.NOT_SHOWN, not_shown - self._not_shown)))
            self._not_shown = not_shown
        happened = [(event.t_ns, what) for event in rows.events if (what := self._effect(event))]
        if not happened and not self._edges:
            return found
        times = rising_times(rows)
        found += [StreamChange(int(times.searchsorted(t)), what) for t, what in happened]
        while self._edges:
            t_ns, gap = self._edges[0]
            index = int(times.searchsorted(t_ns))
            if index == len(times):
                break
            found.append(StreamChange(index, gap))
            while self._edges and self._edges[0][0] <= times[index]:
                self._edges.popleft()
        return sorted(found, key=attrgetter("index"))

    def _effect(self, event: PortEvent) -> Gap | BaudChange | None:
        if event.kind in GAP_EVENTS:
            t_ns, port = event.t_ns, event.port
            if event.kind is PortEventKind.LOST:
                self.lost.add(port)
            elif event.kind is PortEventKind.FOUND_AGAIN:
                self.found |= {port} - self.lost
                self.lost.discard(port)
            return Gap(GapKind.PORT, None, t_ns, t_ns, event.detail, port, bool(self.lost))
        if event.kind is PortEventKind.BAUD_CHANGED and event.count and event.port in self._bauds:
            return BaudChange(event.port, event.count)
        return None


def _edges(gap: Gap) -> Iterator[int]:
    if gap.start_ns is not None and gap.end_ns is not None:
        yield gap.start_ns
        yield gap.end_ns + 1


def rising_times(rows: Rows, floor_ns: int = -(2**63)) -> Ints:
    """For each row, the latest time up to it, at least `floor_ns`; int64."""
    import numpy as np

    return np.asarray(np.maximum.accumulate(np.maximum(rows.t_ns, floor_ns)))


# Models

_End = TypeVar("_End")


class Model:
    """A state that is copied; other objects than containers, arrays and models never change."""

    def copy(self) -> Self:
        """An independent copy."""
        other = copy(self)
        for name, value in vars(self).items():
            setattr(other, name, _copied(value))
        return other


def _copied(value: Any) -> Any:
    match value:
        case dict() | list() | deque():
            found = copy(value)  # of its own type: a Counter adds where a dict replaces
            for key, one in value.items() if isinstance(value, dict) else enumerate(value):
                found[key] = _copied(one)
            return found
        case set() | Model():
            return value.copy()
    return value.copy() if hasattr(value, "dtype") else value  # numpy is not loaded for this


class Ends(Model, Generic[_End]):
    """Facts of the first and the last row, by which later rows continue those before a cut."""

    def __init__(self, *, interrupted: bool = False) -> None:
        """`interrupted` is whether rows are missing before the first one."""
        self.interrupted = interrupted
        """Whether rows are missing somewhere."""
        self._first: _End | None = None
        """Of the first row, unless a gap is before it."""
        self._last: _End | None = None
        """Of the last row, unless a gap is after it."""

    def append(self, first: _End, last: _End) -> _End | None:
        """Add rows; returns the last one before them, None without one or after a gap."""
        before, self._last = self._last, last
        if self._first is None and not self.interrupted:
            self._first = first
        return before

    def interrupt(self) -> None:
        """Rows are missing here."""
        self._last, self.interrupted = None, True

    def merge(self, later: Ends[_End]) -> tuple[_End, _End] | None:
        """Add the rows that follow; returns the last one here and the first there, if adjacent."""
        before = None if later._first is None else self.append(later._first, later._first)
        if later.interrupted:
            self.interrupt()
        if later._last is not None:
            self._last = later._last
        return None if later._first is None or before is None else (before, later._first)


class RowModel(Model, ABC):
    """A model of consecutive rows, with the port events, gaps and baud changes among them."""

    def begin(self, name: str) -> None:
        """Start the next input."""

    def observe(self, rows: Rows, changes: Sequence[StreamChange] = ()) -> None:
        """Add the next rows with their port events, and the changes among them."""
        start = 0
        for change in changes:
            if change.index > start:
                self._observe(rows[start : change.index])
            self.observe_change(change.what)
            start = change.index
        if len(rows) > start:
            self._observe(rows[start:])
        self.observe_events(rows.events)

    @abstractmethod
    def _observe(self, rows: Rows) -> None:
        """Add rows, at least one."""

    def observe_events(self, events: Sequence[PortEvent]) -> None:
        """Add port events."""

    @abstractmethod
    def observe_change(self, change: Gap | BaudChange) -> None:
        """Apply a change before the next rows."""

    @abstractmethod
    def merge(self, later: Self) -> None:
        """Add the rows that follow, as if they had been observed here."""


# Counts and rates of rows


@dataclass
class RowCount(Model):
    """Number of rows and bytes, and the range of their times."""

    rows: int = 0
    bytes: int = 0
    """Bytes on the wire."""
    first_ns: int | None = None
    """Earliest time of a row, nanoseconds since 1970 UTC; None if no row has one."""
    last_ns: int | None = None

    def count(self, rows: int, bytes_: int, times: tuple[int, int] | None) -> None:
        """Add rows; `times` are the earliest and the latest time of those that have one."""
        self.rows += rows
        self.bytes += bytes_
        if times is not None:
            first, last = times
            self.first_ns = first if self.first_ns is None else min(self.first_ns, first)
            self.last_ns = last if self.last_ns is None else max(self.last_ns, last)

    def observe(self, rows: Rows) -> None:
        """Add rows."""
        self.count(len(rows), rows.size, rows.replace(()).span_ns)

    def merge(self, other: RowCount) -> None:
        """Add the rows of another count."""
        self.count(other.rows, other.bytes, other.times)

    @property
    def times(self) -> tuple[int, int] | None:
        """Earliest and latest time; None if no row has one."""
        if self.first_ns is None or self.last_ns is None:
            return None
        return self.first_ns, self.last_ns

    @property
    def duration_ns(self) -> int | None:
        """Nanoseconds from the earliest time to the latest."""
        return None if self.times is None else self.times[1] - self.times[0]


@dataclass
class Tally(RowCount):
    """Counts of rows by port and faults; its own count is that of all rows."""

    frames: int = 0
    """Rows whose framing holds, malformed or not."""
    _counts: dict[tuple[str, tuple[Fault, ...]], RowCount] = field(default_factory=dict)
    """By port, in order of first occurrence, and combination of faults."""

    def observe(self, rows: Rows) -> None:
        """Add rows."""
        import numpy as np

        RowCount.observe(self, rows)
        self.frames += int(np.count_nonzero(rows.framed))
        keys = rows.port.astype(np.int64) << 16 | rows.faults
        found, first = np.unique(keys, return_index=True)
        for key in found[first.argsort()].tolist():
            own = rows.select(keys == key)
            name = rows.ports[key >> 16], faults_in(key & 0xFFFF)
            self._counts.setdefault(name, RowCount()).observe(own)

    def merge(self, other: RowCount) -> None:
        """Add the rows of another tally."""
        RowCount.merge(self, other)
        if isinstance(other, Tally):
            self.frames += other.frames
            for name, count in other._counts.items():
                self._counts.setdefault(name, RowCount()).merge(count)

    @property
    def ports(self) -> tuple[str, ...]:
        """The ports of the rows."""
        return tuple(dict.fromkeys(port for port, _ in self._counts))

    @property
    def faults(self) -> tuple[Fault, ...]:
        """The faults of the rows, in order of first occurrence."""
        return tuple(dict.fromkeys(fault for _, faults in self._counts for fault in faults))

    def by_fault(self, port: str | None = None) -> dict[Fault, RowCount]:
        """By fault that occurred; a row counts once for each of its faults."""
        found = {fault: RowCount() for fault in Fault}
        for faults, count in self._on(port):
            for fault in set(faults):
                found[fault].merge(count)
        return {fault: count for fault, count in found.items() if count.rows}

    def by_status(self, port: str | None = None) -> dict[Status, RowCount]:
        """By status, all of them."""
        found = {status: RowCount() for status in Status}
        for faults, count in self._on(port):
            found[status_of(faults)].merge(count)
        return found

    def _on(self, port: str | None) -> Iterator[tuple[tuple[Fault, ...], RowCount]]:
        for (name, faults), count in self._counts.items():
            if port is None or name == port:
                yield faults, count

    @property
    def malformed(self) -> int:
        """Malformed rows."""
        return self.by_status()[Status.MALFORMED].rows

    @property
    def malformed_share(self) -> float:
        """Share of malformed rows, 0 to 1."""
        return self.malformed / self.rows if self.rows else 0.0


RATE_WINDOW_NS: Final = 2_000_000_000
"""Window of a rate, nanoseconds."""


class Rate:
    """Rate per second in a sliding window."""

    def __init__(self, window_ns: int = RATE_WINDOW_NS) -> None:
        """`window_ns` is more than 0."""
        self._window_ns = window_ns
        self._counts: deque[tuple[int, int]] = deque()
        self._sum = 0
        self._since_ns: int | None = None

    def observe(self, count: int, t_ns: int) -> None:
        """Add a count at a time; times must not fall."""
        if self._since_ns is None:
            self._since_ns = t_ns
        self._counts.append((t_ns, count))
        self._sum += count
        self._expire(t_ns)

    def per_second(self, now_ns: int) -> float:
        """The rate in the window that ends now; at first, since the first update."""
        self._expire(now_ns)
        if self._since_ns is None:
            return 0.0
        span_ns = min(self._window_ns, now_ns - self._since_ns)
        return self._sum * 1e9 / span_ns if span_ns > 0 else 0.0

    def _expire(self, now_ns: int) -> None:
        while self._counts and self._counts[0][0] <= now_ns - self._window_ns:
            self._sum -= self._counts.popleft()[1]
