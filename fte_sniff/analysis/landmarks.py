"""Landmarks of a view: port events and gaps between rows, and where faults and flags are."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Final

import numpy as np

from fte_sniff.analysis.feed import StreamChange
from fte_sniff.analysis.row_store import Block, RowNote, RowStore
from fte_sniff.protocol import Gap, GapKind, PortEvent, PortEventKind
from fte_sniff.protocol.rows import NO_TIME, Ints

SHOWN_EVENTS: Final = frozenset(
    {
        PortEventKind.OPENED,
        PortEventKind.LOST,
        PortEventKind.FOUND_AGAIN,
        PortEventKind.OVERRUN,
        PortEventKind.CLOSED,
        PortEventKind.CLOCK_SET,
        PortEventKind.BAUD_CHANGED,
    }
)
"""Events that are landmarks; line errors are faults of rows."""

ROUTINE: Final = frozenset({PortEventKind.OPENED, PortEventKind.CLOSED})
"""Events that every capture has; the overview leaves them out."""

MOST_LANDMARKS: Final = 20_000

_LATE_ROWS: Final = 4_096
"""Rows that may come before an event that happened before them."""


@dataclass(frozen=True, slots=True)
class Landmark:
    """A port event or a gap."""

    index: int
    """Of the first row after it."""
    what: PortEvent | Gap

    @property
    def is_routine(self) -> bool:
        """Whether every capture has it."""
        return isinstance(self.what, PortEvent) and self.what.kind in ROUTINE


class Landmarks:
    """Port events and gaps between the rows of a store, the latest `MOST_LANDMARKS`."""

    def __init__(self, store: RowStore) -> None:
        self._store = store
        self._all: list[Landmark] = []
        """By index; events of the same index in their order."""
        self.gaps: list[int] = []
        """Indices of the rows before which rows are missing, rising."""

    def __len__(self) -> int:
        return len(self._all)

    def add(self, events: Sequence[PortEvent], changes: Sequence[StreamChange]) -> None:
        """Add the events and gaps of a poll, whose rows are in the store."""
        for event in events:
            if event.kind in SHOWN_EVENTS:
                self._insert(Landmark(self._index_at(event.t_ns), event))
        for change in changes:
            if not isinstance(change.what, Gap):
                continue
            if change.index > 0:  # before the first row nothing is missing
                self.gaps.append(change.index)
                if change.what.kind is not GapKind.PORT:
                    self._insert(Landmark(change.index, change.what))
        self._drop_old()

    def _insert(self, landmark: Landmark) -> None:
        at = bisect_left(self._all, landmark.index + 1, key=_index)
        self._all.insert(at, landmark)

    def _index_at(self, t_ns: int) -> int:
        """Index of the first of the newest rows that is later; that after the last one if none."""
        first = max(self._store.first, self._store.next - _LATE_ROWS)
        for rows in self._store.batches(first, self._store.next):
            later = np.flatnonzero((rows.t_ns > t_ns) & (rows.t_ns != NO_TIME))
            if len(later):
                return first + int(later[0])
            first += len(rows)
        return first

    def _drop_old(self) -> None:
        first = self._store.first
        old = bisect_left(self._all, first, key=_index)
        del self._all[: max(old, len(self._all) - MOST_LANDMARKS)]
        old = max(bisect_left(self.gaps, first), len(self.gaps) - MOST_LANDMARKS)
        del self.gaps[:old]

    def between(self, start: int, end: int) -> Sequence[Landmark]:
        """Those before the rows with indices from `start` up to `end`."""
        low, high = (bisect_left(self._all, at, key=_index) for at in (start, end))
        return self._all[low:high]

    def beyond(self, index: int, by: int) -> Iterator[Landmark]:
        """Those after a row (`by` 1) or before it (-1) that are not routine, the nearest first."""
        at = bisect_left(self._all, index + 1, key=_index)
        found = self._all[at:] if by > 0 else reversed(self._all[:at])
        return (one for one in found if not one.is_routine and one.index != index)


_index: Final = attrgetter("index")

NOTES: Final = tuple(note for note in RowNote if note)

_BUCKETS_PER_CELL: Final = 8


@dataclass(frozen=True, slots=True)
class OverviewCell:
    """What is in an equal share of the shown rows."""

    worst: RowNote
    share: float
    """Share of the rows with the worst note, 0 to 1."""


@dataclass(slots=True)
class _BlockCounts:
    key: tuple[object, ...]
    shown: int
    """Rows of the block that are shown."""
    counts: Ints
    """Rows by note and bucket; shape (notes, buckets)."""


class Overview:
    """Counts of rows with faults and flags in equal shares of the shown rows."""

    def __init__(self, store: RowStore) -> None:
        self._store = store
        self._blocks: dict[int, _BlockCounts] = {}

    def cells(self, count: int) -> list[OverviewCell]:
        """The shown rows in `count` equal shares, at least one row each; the last may be fewer."""
        view = self._store.view
        total = view.count
        if not total or count < 1:
            return []
        per_cell = -(-total // count)
        bucket = 1 << max(0, (per_cell // _BUCKETS_PER_CELL).bit_length() - 1)
        sums = np.zeros((len(NOTES), -(-total // per_cell)), np.int64)
        position, kept = 0, dict[int, _BlockCounts]()
        for block in self._store.blocks:
            found = kept[block.start] = self._counts(block, bucket)
            at = (position + bucket * np.arange(found.counts.shape[1])) // per_cell
            for number in range(len(NOTES)):
                np.add.at(sums[number], at, found.counts[number])
            position += found.shown
        self._blocks = kept
        return [_cell(sums[:, at], per_cell) for at in range(sums.shape[1])]

    def _counts(self, block: Block, bucket: int) -> _BlockCounts:
        view, first = self._store.view, max(0, self._store.first - block.start)
        # Playback moves the end of the rows that are shown.
        end = min(block.count, self._store.next - block.start)
        matching = block.matching if view.filter is not None else block.count
        known = self._blocks.get(block.start)
        key = (view.filter, bucket, first, end, matching, block.known)
        if known is not None and known.key == key:
            return known
        offsets = view.offsets(block)
        notes = block.notes()[offsets]
        starts = np.arange(0, len(notes), bucket)
        counts = np.zeros((len(NOTES), len(starts)), np.int64)
        if len(starts) and notes.any():
            for number, note in enumerate(NOTES):
                np.add.reduceat(notes == note, starts, dtype=np.int64, out=counts[number])
        return _BlockCounts(key, len(offsets), counts)

    def worst_between(self, start: int, end: int) -> int | None:
        """Position of the first shown row with the worst note, from `start` up to `end`."""
        view, position, best = self._store.view, 0, (RowNote.NONE, -1)
        for block in self._store.blocks:
            offsets = view.offsets(block)
            low, high = max(start - position, 0), min(end - position, len(offsets))
            if low < high:
                notes = block.notes()[offsets[low:high]]
                at = int(notes.argmax())
                if notes[at] > best[0]:
                    best = RowNote(int(notes[at])), position + low + at
            position += len(offsets)
        return best[1] if best[0] else None


def _cell(counts: Ints, rows: int) -> OverviewCell:
    worst = next((note for note in reversed(NOTES) if counts[NOTES.index(note)]), RowNote.NONE)
    return OverviewCell(worst, float(counts[NOTES.index(worst)]) / rows if worst else 0.0)
