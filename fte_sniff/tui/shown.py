"""The rows that are shown: positions, what is worth a look among them, and the events between them.

index     of a row since the view began; it never changes
position  of a row among those that are shown
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort
from collections.abc import Iterator
from dataclasses import dataclass
from operator import attrgetter
from typing import TYPE_CHECKING, Final

import numpy as np

from fte_sniff.analysis.store import STEP_ROWS, Matches, RowStore
from fte_sniff.protocol.items import Gap, PortEvent, PortEventKind
from fte_sniff.protocol.rows import Ints, Rows

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter
    from fte_sniff.analysis.table import RowTest

ROUTINE: Final = frozenset({PortEventKind.OPENED, PortEventKind.CLOSED})
"""Events that every capture has."""


@dataclass(frozen=True, slots=True)
class Landmark:
    """A port event or a gap before a row."""

    index: int
    what: PortEvent | Gap

    @property
    def is_routine(self) -> bool:
        """Whether every capture has it."""
        return isinstance(self.what, PortEvent) and self.what.kind in ROUTINE


class Shown:
    """The rows of a store that the filter shows, and the events between all rows."""

    def __init__(self, store: RowStore) -> None:
        """All rows are shown."""
        self.store = store
        self.matches: Matches | None = None
        """The rows that pass the filter; None without one."""
        self.landmarks: list[Landmark] = []
        """By rising index."""

    def set_filter(self, row_filter: RowFilter | None) -> None:
        """Show the rows that pass a filter, or all; `follow` applies it."""
        self.matches = None if row_filter is None else Matches(self.store, row_filter)

    def follow(self) -> bool:
        """Apply the filter to more rows; False if none is left."""
        return self.matches is not None and self.matches.extend()

    def place(self, what: PortEvent | Gap, index: int) -> None:
        """Put an event or a gap before a row."""
        insort(self.landmarks, Landmark(index, what), key=attrgetter("index"))

    @property
    def pending(self) -> int:
        """Rows to which the filter was not applied yet."""
        return 0 if self.matches is None else self.store.next - self.matches.tested

    @property
    def count(self) -> int:
        """Rows that are shown."""
        return self.store.next if self.matches is None else self.matches.count

    def index(self, position: int) -> int:
        """The index of a shown row."""
        return position if self.matches is None else int(self.matches.indices[position])

    def position_of(self, index: int) -> int:
        """The number of shown rows before an index."""
        if self.matches is None:
            return min(max(0, index), self.store.next)
        return self.matches.position_of(index)

    def has(self, index: int) -> bool:
        """Whether a row is shown."""
        position = self.position_of(index)
        return position < self.count and self.index(position) == index

    def between(self, start: int, end: int) -> Ints:
        """The indices of the shown rows from one index up to another."""
        if self.matches is None:
            return np.arange(max(0, start), min(end, self.store.next))
        return self.matches.indices[self.position_of(start) : self.position_of(end)]

    def rows(self, start: int, end: int) -> tuple[Ints, Rows]:
        """Indices and rows at the positions from one up to another."""
        if self.matches is None:
            return np.arange(start, end), self.store.batch(start, end)
        indices = self.matches.indices[start:end]
        return indices, self.store.rows_at(indices)

    def find(self, test: RowTest, index: int, by: int) -> int | None:
        """The next shown row after an index that passes a test, or before it (`by` -1)."""
        start, stop = (index + 1, self.store.next) if by > 0 else (0, index)
        while start < stop:
            low = start if by > 0 else max(start, stop - STEP_ROWS)
            high = min(stop, low + STEP_ROWS)
            passing = np.flatnonzero(test(self.store.batch(low, high))) + low
            if self.matches is not None:
                passing = np.intersect1d(passing, self.between(low, high), assume_unique=True)
            if len(passing):
                return int(passing[0 if by > 0 else -1])
            start, stop = (high, stop) if by > 0 else (start, low)
        return None

    def landmarks_between(self, start: int, end: int) -> Iterator[Landmark]:
        """The events and gaps before the rows from one index up to another."""
        by_index = attrgetter("index")
        low, high = (bisect_left(self.landmarks, at, key=by_index) for at in (start, end))
        return iter(self.landmarks[low:high])

    def next_landmark(self, index: int, by: int) -> int | None:
        """Index of the row after the next event that is not routine, or before it (`by` -1)."""
        at = [one.index for one in self.landmarks if not one.is_routine]
        found = at[bisect_right(at, index) :] if by > 0 else at[: bisect_left(at, index)][::-1]
        return found[0] if found else None
