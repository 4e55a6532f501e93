"""Merge: the rows of several lanes in one order, with watermarks.

A lane is a port, a stream of a log, or a file. Its rows come in the order of their keys, mostly
their times. Its watermark is the smallest key that a row to come can have. A row is settled if no
lane can have one before it; rows with equal keys come in the order of the lanes:

    lane A   ───a1──────────a2─────────┤ watermark
    lane B   ────────b1──────┤ watermark
             taken: a1 b1     waits: a2

Where lanes are uncertain, the bytes of a row may have been on the wire that much earlier than its
time. If that reaches a row of another lane, their order is uncertain, and both are marked.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from fte_sniff.protocol import PortEvent
from fte_sniff.protocol.rows import Rows

if TYPE_CHECKING:
    from fte_sniff.protocol.rows import Bools, Ints

Key: TypeAlias = tuple[int, ...]
"""One integer, or two if the second decides between rows whose first ones are equal."""

_NEVER: Final = -(2**63)
_EVER: Final = 2**63 - 1
_FAR: Final = 2**62
"""Farther than all times, and yet the difference of a time and its negative fits in 64 bits."""


@dataclass(slots=True)
class LanePart:
    """Rows that were put together; those before `start` were taken."""

    rows: Rows
    keys: Ints
    """Shape (integers of a key, rows)."""
    origin: Any
    """What the rows belong to, for the caller."""
    start: int = 0

    def count_to(self, limit: Key, *, inclusive: bool) -> int:
        """The index after the rows before the limit, or up to it."""
        side: Any = "right" if inclusive else "left"
        first = self.keys[0]
        if len(self.keys) == 1:
            return int(first.searchsorted(limit[0], side))
        start, stop = first.searchsorted(limit[0]), first.searchsorted(limit[0], "right")
        return int(start + self.keys[1, start:stop].searchsorted(limit[1], side))


@dataclass(slots=True)
class MergeLane:
    """The rows and events of one lane that wait."""

    uncertainty_ns: int = 0
    """How much earlier than their times its rows may have begun."""
    reached: Key = (_NEVER, _NEVER)
    """The watermark, unless `last` is later."""
    last: Key = (_NEVER, _NEVER)
    """The key of the last row that was put."""
    taken_ns: int = -_FAR
    """The key of the last row that was taken."""
    parts: deque[LanePart] = field(default_factory=deque)
    events: deque[PortEvent] = field(default_factory=deque)

    def put(self, rows: Rows, keys: Ints | None = None, origin: Any = None) -> None:
        """Append rows and events. Without keys, they come in the order of their rising times."""
        if keys is None:
            keys = np.maximum.accumulate(np.maximum(rows.t_ns, self.last[0]))
        keys = np.atleast_2d(keys)
        if len(rows) or origin is not None:
            self.parts.append(LanePart(rows, keys, origin))
        self.events.extend(rows.events)
        if len(rows):
            self.last = tuple(keys[:, -1].tolist())

    def swap_keys(self) -> None:
        """From now on, the second integer of each key comes first."""
        self.last = self.last[::-1]
        for part in self.parts:
            part.keys = part.keys[::-1]

    @property
    def times(self) -> Ints:
        """The keys of the rows that wait."""
        return np.concatenate([part.keys[0, part.start :] for part in self.parts] or [_NO_TIMES])

    def take(self, limit: Key, *, inclusive: bool, is_last: bool) -> Iterator[Slice]:
        """Remove the rows before the limit, or up to it; without rows, only if it `is_last`."""
        while self.parts:
            part = self.parts[0]
            stop = part.count_to(limit, inclusive=inclusive)
            is_whole = stop == len(part.rows)
            if stop > part.start or (is_whole and is_last):
                yield Slice(part, part.start, stop)
                self.taken_ns = int(part.keys[0, stop - 1]) if stop else self.taken_ns
                part.start = stop
            if not is_whole or not (stop or is_last):
                return
            self.parts.popleft()

    def take_events(self, t_ns: int) -> list[PortEvent]:
        """Remove the events up to a time."""
        found = list(takewhile(lambda event: event.t_ns <= t_ns, self.events))
        for _ in found:
            self.events.popleft()
        return found


_NO_TIMES: Final = np.empty(0, np.int64)


@dataclass(frozen=True, slots=True)
class Slice:
    """Consecutive rows of a part."""

    part: LanePart
    start: int
    stop: int

    def __len__(self) -> int:
        return self.stop - self.start


@dataclass(frozen=True, slots=True)
class Taken:
    """Rows and events in order."""

    rows: Rows
    slices: Sequence[Slice]
    """Where they come from."""
    order: Ints | None
    """For each row its index in the slices, one after the other; None if it is the same."""

    @property
    def lengths(self) -> list[int]:
        """The number of rows of each slice."""
        return [len(one) for one in self.slices]


class Merge:
    """Merges the rows and events of lanes."""

    def __init__(self, *, marks: bool = False) -> None:
        """Create it without lanes; with `marks`, rows whose order is uncertain are marked."""
        self.lanes: list[MergeLane] = []
        self._marks = marks

    @property
    def waiting(self) -> int:
        """Rows that wait."""
        return sum(len(part.rows) - part.start for lane in self.lanes for part in lane.parts)

    def take(self, *, least: int = _NEVER, final: bool = False) -> Taken | None:
        """Remove and return what is settled, or up to the key `least`; all of it if `final`.

        What a single lane has is settled.
        """
        final = final or len(self.lanes) == 1
        limit, last = min(
            (max(lane.reached, lane.last), number) for number, lane in enumerate(self.lanes)
        )
        if final or limit[0] < least:
            limit, last = (_EVER if final else least, _EVER), len(self.lanes)
        marked = self._uncertain(limit, last) if self._marks and len(self.lanes) > 1 else None
        slices, lanes, events = list[Slice](), set[int](), list[PortEvent]()
        for number, lane in enumerate(self.lanes):
            is_last = number == last or final
            found = list(lane.take(limit, inclusive=number <= last, is_last=is_last))
            slices += found
            lanes |= {number} if any(map(len, found)) else set()
            events += lane.take_events(limit[0] - (number > last))
        if not slices and not events:
            return None
        return _joined(slices, sorted(events, key=attrgetter("t_ns")), marked, len(lanes) > 1)

    def _uncertain(self, limit: Key, last: int) -> Bools:
        """Which rows of those to be taken, lane after lane, may have another order."""
        times = [lane.times for lane in self.lanes]
        found: list[Bools] = []
        for number, lane in enumerate(self.lanes):
            side: Any = "right" if number <= last else "left"
            own = times[number][: times[number].searchsorted(limit[0], side)]
            marked = np.zeros(len(own), np.bool_)
            for beside, other in enumerate(self.lanes):
                if other is not lane:
                    at = times[beside].searchsorted(own, "right" if beside < number else "left")
                    before = np.append(other.taken_ns, times[beside])[at]
                    after = np.append(times[beside], _FAR)[at]
                    marked |= own - before <= lane.uncertainty_ns
                    marked |= after - own <= other.uncertainty_ns
            found.append(marked)
        return np.concatenate(found)


def _joined(
    slices: Sequence[Slice], events: Sequence[PortEvent], marked: Bools | None, is_mixed: bool
) -> Taken:
    if len(slices) == 1:
        (one,) = slices
        rows = one.part.rows
        if len(one) < len(rows) or list(rows.events) != events:
            rows = rows[one.start : one.stop].replace(events)
    else:
        rows = Rows.concat([one.part.rows[one.start : one.stop] for one in slices])
        rows = rows.replace(events)
    if marked is not None and marked.any():
        rows = rows.replace(unordered=rows.unordered | marked)
    if not is_mixed:
        return Taken(rows, slices, None)
    keys = np.hstack([one.part.keys[:, one.start : one.stop] for one in slices])
    order = np.lexsort(keys[::-1])
    return Taken(rows.select(order, tuple(events)), slices, order)
