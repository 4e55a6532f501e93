"""Append-only store of rows in blocks, with a filtered view, landmarks and an overview.

index     of a row since the store began; it never changes, also when older rows are dropped
position  of a row among those that the view shows
landmark  a port event or a gap between two rows
overview  where faults and flags are: counts in equal shares of the shown rows
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import accumulate
from operator import attrgetter
from typing import TYPE_CHECKING, Final, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from fte_sniff.analysis.model import StreamChange
from fte_sniff.protocol import Gap, GapKind, PortEvent, PortEventKind, Row
from fte_sniff.protocol.rows import COLUMNS, FACTS, NO_TIME, Codes, Ints, Rows

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter

Offsets: TypeAlias = npt.NDArray[np.int64]


class RowNote(IntEnum):
    """Why a row is worth a look, the most important last."""

    NONE = 0
    RAISED = 1
    UNANSWERED = 2
    """Known later than the others, and for some rows never."""
    SUSPECT = 3
    MALFORMED = 4


_NOTES: Final = np.array([RowNote.NONE, RowNote.SUSPECT, RowNote.MALFORMED], np.uint8)
"""By number of the status."""


def row_notes(rows: Rows) -> Codes:
    """The `RowNote` of each row, without those that a fact gives."""
    notes: Codes = _NOTES[rows.statuses]
    notes[(notes == RowNote.NONE) & rows.raised()] = RowNote.RAISED
    return notes


class Block:
    """A run of consecutive rows; `start` is the index of the first."""

    def __init__(self, start: int, capacity: int) -> None:
        self.start = start
        self.capacity = capacity
        self.rows = Rows.blank(capacity)
        self._facts = {name: self.rows.columns[name] for name in FACTS}
        self.dropped = False
        """Whether the rows are not in memory; everything else stays."""
        self.count = 0
        self.known = 0
        """Rows whose facts are known, from the start."""
        self.faulty = False
        self.raised = False
        """Whether any row has a raised flag byte."""
        self.unanswered = False
        """Whether any row is known to be a command without an answer."""
        self.filtered = 0
        """Rows that the filter was applied to, from the start."""
        self.matching = 0
        self._matches: npt.NDArray[np.uint16] = np.empty(0, np.uint16)
        self._packed_notes: Codes | None = None
        """Three bits a row, once the block is full; without those that a fact gives."""

    @property
    def free(self) -> int:
        """Rows that can still be appended."""
        return self.capacity - self.count

    @property
    def end(self) -> int:
        """Index after the last row."""
        return self.start + self.count

    @property
    def matches(self) -> npt.NDArray[np.uint16]:
        """Offsets of the rows that pass the filter, rising."""
        return self._matches[: self.matching]

    def append(self, rows: Rows) -> None:
        """Append rows, not more than `free`."""
        for name in COLUMNS.keys() - self._facts.keys():
            self.rows.columns[name][self.count : self.count + len(rows)] = rows.columns[name]
        self.rows = Rows(self.rows.columns, rows.ports)
        self.count += len(rows)
        self.faulty |= bool(rows.faults.any())
        self.raised = self.raised or bool(rows.raised().any())
        if not self.free:
            notes = row_notes(self.rows)
            self._packed_notes = np.packbits((notes >> 2, notes >> 1 & 1, notes & 1), axis=1)

    def fill(self, facts: Rows) -> None:
        """Store the facts of the next rows, not more than there are."""
        end = self.known + len(facts)
        for name, stored in self._facts.items():
            stored[self.known : end] = getattr(facts, name)
        self.known = end
        self.unanswered = self.unanswered or bool((facts.unanswered > 0).any())

    def notes(self) -> Codes:
        """The `RowNote` of each row, also where the rows are not in memory."""
        notes: Codes
        if self._packed_notes is None:
            notes = row_notes(self.rows[: self.count])
        else:
            high, middle, low = np.unpackbits(self._packed_notes, axis=1, count=self.count)
            notes = 4 * high + 2 * middle + low
        missed = self._facts["unanswered"][: self.count] > 0
        notes[missed & (notes < RowNote.UNANSWERED)] = RowNote.UNANSWERED
        return notes

    def drop(self) -> None:
        """Free the memory of the rows."""
        self.rows, self.dropped = Rows.blank(0, self.rows.ports), True

    def restore(self, rows: Rows) -> None:
        """Store the rows again after `drop`; ValueError if their number differs."""
        if len(rows) != self.count:
            raise ValueError(f"{len(rows)} rows came back of {self.count}")
        self.rows, self.dropped = rows.replace(**self._facts), False

    def reset_filter(self) -> None:
        """Forget the results of the filter."""
        self.filtered = self.matching = 0

    def apply_filter(self, row_filter: RowFilter) -> int:
        """Apply the filter to the rows that it was not applied to; return their number."""
        start, end = self.filtered, self.known if row_filter.needs_facts else self.count
        found = np.flatnonzero(row_filter.matches(self.rows[start:end])) + start
        if len(self._matches) < self.capacity:
            self._matches = np.empty(self.capacity, np.uint16)
        self._matches[self.matching : self.matching + len(found)] = found
        self.matching += len(found)
        self.filtered = end
        if end == self.capacity:
            self._matches = self.matches.copy()
        return end - start

    def matching_before(self, offset: int) -> int:
        """Number of matching rows before an offset."""
        return int(np.searchsorted(self.matches, offset))


MOST_BLOCKS: Final = 128
"""Default number of full blocks in memory: about 200 megabytes."""


class BlockSource(Protocol):
    """Source that can load rows again that were appended to a store."""

    def load(self, start: int, count: int) -> Rows:
        """Exactly `count` rows from index `start` on.

        Raises FileError if they can no longer be read.
        """


BLOCK_ROWS: Final = 32_768
"""Default number of rows in a block; an offset fits 16 bits."""

DEFAULT_BOUND: Final = 1_000_000

UNBOUNDED: Final = 2**62


class RowStore:
    """The latest rows, up to a bound, and a filtered view of them."""

    def __init__(
        self,
        bound: int = DEFAULT_BOUND,
        block_rows: int = BLOCK_ROWS,
        source: BlockSource | None = None,
        most_blocks: int = MOST_BLOCKS,
    ) -> None:
        """An empty store without a filter, of at most `bound` rows; older ones are dropped.

        A block has 1 to 65536 rows. With a source, which loads rows again, at most `most_blocks`
        full blocks are in memory. Raises ValueError if a number is out of its range.
        """
        if bound < 1 or most_blocks < 1 or not 1 <= block_rows <= 2**16:
            raise ValueError(f"a store of {bound} rows in blocks of {block_rows} cannot be")
        self.bound = bound
        self.ports: tuple[str, ...] = ()
        """The ports of all rows so far."""
        self._block_rows = block_rows
        self._source, self._most_blocks = source, most_blocks
        self._full: dict[int, Block] = {}
        """The full blocks in memory, by start, the least recently used first; with a source."""
        self.blocks: deque[Block] = deque()
        """The oldest first."""
        self.first = 0
        """Index of the oldest row."""
        self.loaded = 0
        """Index after the last row, also where a limit hides it."""
        self.known = 0
        """Index after the last row whose facts are known; see `analysis.facts`."""
        self.limit: int | None = None
        """Index from which on rows are hidden, as if they had not come yet; None to hide none."""
        self.view = FilteredView(self)
        self.landmarks = Landmarks(self)

    @property
    def next(self) -> int:
        """Index of the next row: the number of all rows so far."""
        return self.loaded if self.limit is None else min(self.loaded, self.limit)

    def __len__(self) -> int:
        return self.next - self.first

    @property
    def most_in_memory(self) -> int:
        """Most rows in memory; other rows of the store are loaded again."""
        return self.bound if self._source is None else self._most_blocks * self._block_rows

    # Blocks

    def block_at(self, index: int) -> Block:
        """The block of the row with that index, which is in the store."""
        return self.blocks[self.block_number(index)]

    def block_number(self, index: int) -> int:
        """Position of that block in `blocks`."""
        return (index - self.blocks[0].start) // self.blocks[0].capacity

    def in_memory(self, block: Block) -> Block:
        """A block with its rows in memory; FileError if they can no longer be read."""
        if self._source is None:
            return block
        if block.dropped:
            block.restore(self._source.load(block.start, block.count).with_ports(self.ports))
        if not block.free:
            self._full.pop(block.start, None)
            self._full[block.start] = block
            while len(self._full) > self._most_blocks:
                self._full.pop(next(iter(self._full))).drop()
        return block

    # Rows

    def code_of(self, port: str) -> int:
        """The code of a port in the rows; -1 if none has it."""
        return self.ports.index(port) if port in self.ports else -1

    def append(self, rows: Rows) -> None:
        """Append rows, and apply the filter to them."""
        self.ports = tuple(dict.fromkeys((*self.ports, *rows.ports)))
        batch, done = rows.with_ports(self.ports), 0
        changed = []
        while done < len(batch):
            if not self.blocks or not self.blocks[-1].free:
                capacity = min(self._block_rows, self.bound)
                self.blocks.append(Block(self.loaded, capacity))
            block = self.blocks[-1]
            piece = batch[done : done + block.free]
            block.append(piece)
            changed.append(self.in_memory(block))
            done += len(piece)
            self.loaded += len(piece)
            self._drop_oldest()
        self.view.update(changed)

    def fill(self, facts: Rows) -> None:
        """Store the facts of the next rows from index `known` on."""
        start, stop = self.known, self.known + len(facts)
        changed = [one for one in self.blocks if one.start < stop and start < one.end]
        for block in changed:
            block.fill(facts[max(start, block.start) - start : min(stop, block.end) - start])
        self.known = stop
        if self.view.filter is not None and self.view.filter.needs_facts:
            self.view.update(changed)

    def _drop_oldest(self) -> None:
        self.first = max(self.first, self.loaded - self.bound)
        while self.blocks and self.blocks[0].end <= self.first:
            self._full.pop(self.blocks.popleft().start, None)

    def row(self, index: int) -> Row:
        """The row with that index; IndexError if it is not in the store."""
        if not self.first <= index < self.next:
            raise IndexError(f"row {index} is not in {self.first}..{self.next - 1}")
        return self.rows(index, index + 1)[0]

    def index_from(self, t_ns: int) -> int:
        """Index of the first row at or after a time, as if times never fell; at most the last one.

        The store must have a row.
        """

        def time(index: int) -> int:
            found = self.row(index).t_ns
            return NO_TIME if found is None else found

        found = bisect_left(range(self.first, self.next), t_ns, key=time)
        return min(self.first + found, self.next - 1)

    def rows(self, start: int, end: int) -> list[Row]:
        """The rows with indices from `start` up to `end` that are in the store."""
        return [row for batch in self.batches(start, end) for row in batch]

    def batches(self, start: int, end: int, *, hidden: bool = False) -> Iterator[Rows]:
        """Batches of the rows from `start` up to `end`: views of the store, to be read at once.

        With `hidden`, also rows that a limit hides.
        """
        start, end = max(start, self.first), min(end, self.loaded if hidden else self.next)
        while start < end:
            block = self.in_memory(self.block_at(start))
            stop = min(end, block.end)
            yield block.rows[start - block.start : stop - block.start]
            start = stop


class FilteredView:
    """The rows of a store that pass a filter; all rows without one."""

    def __init__(self, store: RowStore) -> None:
        self._store = store
        self.filter: RowFilter | None = None
        self._pending: list[Block] = []
        self._sums: list[int] | None = None

    # The filter

    @property
    def pending(self) -> int:
        """Number of rows that the filter was not applied to yet."""
        return sum(block.count - block.filtered for block in self._pending)

    def set_filter(self, row_filter: RowFilter | None, near: int | None = None) -> None:
        """Set or remove the filter; `filter_step` applies it to the rows that are there.

        It starts at the row with index `near`, by default at the newest.
        """
        self.filter = row_filter
        self._sums = None
        self._pending = []
        for block in self._store.blocks:
            block.reset_filter()
        if row_filter is not None:
            middle = self._store.next if near is None else near
            self._pending = sorted(self._store.blocks, key=lambda block: -abs(block.start - middle))

    def filter_step(self, budget_rows: int = 4 * BLOCK_ROWS) -> bool:
        """Apply the filter to about `budget_rows` pending rows; True if none is left."""
        while self.filter and self._pending and budget_rows > 0:
            block = self._store.in_memory(self._pending.pop())
            budget_rows -= block.apply_filter(self.filter)
            self._sums = None
        return not self._pending

    def update(self, changed: Iterable[Block]) -> None:
        """Apply the filter to rows that were appended to blocks."""
        self._sums = None
        first = self._store.first
        self._pending = [block for block in self._pending if block.end > first]
        if self.filter is None:
            return
        for block in changed:
            if block.end > first and block not in self._pending:
                self._store.in_memory(block).apply_filter(self.filter)

    # The rows

    @property
    def count(self) -> int:
        """Number of rows that are known to pass."""
        if self.filter is None:
            return len(self._store)
        if self._store.limit is not None:
            return self.position_of(self._store.next)
        return self._matching_sums()[-1] - self._dropped()

    def _matching_sums(self) -> list[int]:
        if self._sums is None:
            self._sums = [0, *accumulate(block.matching for block in self._store.blocks)]
        return self._sums

    def _dropped(self) -> int:
        """Matching rows of the oldest block that are no longer in the store."""
        if not self._store.blocks:
            return 0
        oldest = self._store.blocks[0]
        return oldest.matching_before(self._store.first - oldest.start)

    def index(self, position: int) -> int:
        """The index of the row at a position; IndexError if there is none."""
        if not 0 <= position < self.count:
            raise IndexError(f"position {position} is not in 0..{self.count - 1}")
        if self.filter is None:
            return self._store.first + position
        rank = position + self._dropped()
        sums = self._matching_sums()
        at = bisect_right(sums, rank) - 1
        block = self._store.blocks[at]
        return block.start + int(block.matches[rank - sums[at]])

    def position_of(self, index: int) -> int:
        """Number of shown rows before an index: the position of a shown row."""
        store = self._store
        index = min(max(index, store.first), store.next)
        if self.filter is None or not store.blocks:
            return index - store.first
        at = min(store.block_number(index), len(store.blocks) - 1)
        block = store.blocks[at]
        before = self._matching_sums()[at] + block.matching_before(index - block.start)
        return before - self._dropped()

    def row(self, position: int) -> Row:
        """The row at a position; IndexError if there is none."""
        return self._store.row(self.index(position))

    def has(self, index: int) -> bool:
        """Whether the row with that index is in the store and shown."""
        if not self._store.first <= index < self._store.next:
            return False
        position = self.position_of(index)
        return position < self.count and self.index(position) == index

    def slice(self, start: int, end: int) -> list[tuple[int, Row]]:
        """Index and row of the positions from `start` up to `end` that exist."""
        start, end = max(start, 0), min(end, self.count)
        if start >= end:
            return []
        if self.filter is None:
            first = self._store.first + start
            return list(enumerate(self._store.rows(first, self._store.first + end), first))
        indices = [self.index(position) for position in range(start, end)]
        return [(index, self._store.row(index)) for index in indices]

    def offsets(self, block: Block) -> Offsets:
        """Offsets of the block's shown rows, rising."""
        first = max(0, self._store.first - block.start)
        end = min(block.count, self._store.next - block.start)
        if self.filter is None:
            return np.arange(first, end)
        matches = block.matches.astype(np.int64)
        return matches[(matches >= first) & (matches < end)]


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
        first = max(self._store.first, self._store.loaded - _LATE_ROWS)
        for rows in self._store.batches(first, self._store.loaded, hidden=True):
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
