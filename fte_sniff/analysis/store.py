"""Owns the rows behind the screen: packed, bounded, and filtered as they come.

It must not know a screen, a clock or a file. Rows lie in blocks of equal size; a block holds its
rows packed and, under a filter, the places of those that are wanted. So appending, dropping the
oldest and jumping to any row cost the same whether there are a thousand rows or ten million, and
a new filter works through the blocks a few at a time.

    index      of a row since the store began; it never changes, also when older rows leave
    position   of a row among those shown now, from 0; it moves when older rows leave or are found

A row takes 48 bytes, and two more under a filter; bytes beyond the first ten of a row stand aside.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterator, Sequence
from itertools import accumulate
from typing import Final

import numpy as np
import numpy.typing as npt

from fte_sniff.analysis.columns import packed_frame
from fte_sniff.analysis.filter import RowFilter
from fte_sniff.analysis.packing import ROW_TYPE, Codebook, Packed, pack, unpack
from fte_sniff.protocol import Row

BLOCK_ROWS: Final = 32_768
"""Rows in a block; a place in a block fits 16 bits."""

DEFAULT_BOUND: Final = 1_000_000
"""Rows that a store keeps where nobody says otherwise."""


class _Block:
    """So many rows in sequence; `start` is the index of the first."""

    def __init__(self, start: int, room: int) -> None:
        self.start = start
        self.rows: Packed = np.empty(room, ROW_TYPE)
        self.count = 0
        self.long: dict[int, bytes] = {}
        """The bytes of rows longer than ten, by place in the block."""
        self.judged = 0
        """Rows that the filter has seen, from the start."""
        self.places: npt.NDArray[np.uint16] = np.empty(0, np.uint16)
        self.wanted = 0
        """How many of `places` are in use: those of wanted rows, rising."""

    @property
    def room(self) -> int:
        return len(self.rows) - self.count

    @property
    def end(self) -> int:
        return self.start + self.count

    def append(self, packed: Packed, long: dict[int, bytes], skipped: int) -> None:
        """Take rows; `long` counts places from `skipped` before them."""
        end = self.count + len(packed)
        self.rows[self.count : end] = packed
        shift = self.count - skipped
        self.long.update(
            (at + shift, raw) for at, raw in long.items() if self.count <= at + shift < end
        )
        self.count = end

    def forget(self) -> None:
        """No row has been judged."""
        self.judged = self.wanted = 0

    def judge(self, row_filter: RowFilter, codebook: Codebook) -> int:
        """Let the filter see the rows that it has not seen; how many those were."""
        start, end = self.judged, self.count
        long = {at - start: raw for at, raw in self.long.items() if at >= start}
        names = row_filter.names or ("offset",)
        frame = packed_frame(self.rows[start:end], long, codebook, names)
        found = np.flatnonzero(row_filter.mask(frame).to_numpy()) + start
        if len(self.places) < len(self.rows):
            self.places = np.empty(len(self.rows), np.uint16)
        self.places[self.wanted : self.wanted + len(found)] = found
        self.wanted += len(found)
        self.judged = end
        return end - start

    def wanted_before(self, place: int) -> int:
        """How many wanted rows stand before a place of the block."""
        return int(np.searchsorted(self.places[: self.wanted], place))


class RowStore:
    """A bounded run of rows, the latest ones, with a filter on top."""

    def __init__(self, bound: int = DEFAULT_BOUND, block_rows: int = BLOCK_ROWS) -> None:
        """An empty store.

        Args:
            bound: rows kept at most, at least 1; the oldest leave first.
            block_rows: rows in a block, 1 to 65536.
        """
        if bound < 1 or not 1 <= block_rows <= 2**16:
            raise ValueError(f"a store of {bound} rows in blocks of {block_rows} cannot be")
        self.bound = bound
        """Rows kept at most."""
        self._block_rows = block_rows
        self._codebook = Codebook()
        self._blocks: deque[_Block] = deque()
        self._first = 0
        self._next = 0
        self._filter: RowFilter | None = None
        self._pending: list[_Block] = []
        self._sums: list[int] | None = None

    def __len__(self) -> int:
        return self._next - self._first

    @property
    def first(self) -> int:
        """Index of the oldest row kept."""
        return self._first

    @property
    def next(self) -> int:
        """Index that the next row appended will have: all rows ever appended."""
        return self._next

    # Rows

    def append(self, rows: Sequence[Row]) -> None:
        """Take rows in; under a filter they are judged at once."""
        packed, long = pack(rows, self._codebook)
        done, touched = 0, []
        while done < len(packed):
            block = self._tail()
            piece = packed[done : done + block.room]
            if block.judged == block.count and block not in self._pending:
                touched.append(block)
            block.append(piece, long, done)
            done += len(piece)
            self._next += len(piece)
            self._drop_oldest()
        self._sums = None
        for block in touched:
            if self._filter and block.end > self._first:
                block.judge(self._filter, self._codebook)

    def _tail(self) -> _Block:
        if not self._blocks or not self._blocks[-1].room:
            self._blocks.append(_Block(self._next, min(self._block_rows, self.bound)))
        return self._blocks[-1]

    def _drop_oldest(self) -> None:
        self._first = max(self._first, self._next - self.bound)
        while self._blocks and self._blocks[0].end <= self._first:
            gone = self._blocks.popleft()
            if gone in self._pending:
                self._pending.remove(gone)

    def _block_of(self, index: int) -> int:
        return (index - self._blocks[0].start) // len(self._blocks[0].rows)

    def row(self, index: int) -> Row:
        """The row of that index.

        Raises:
            IndexError: it has left, or has not come.
        """
        if not self._first <= index < self._next:
            raise IndexError(f"row {index} is not in {self._first}..{self._next - 1}")
        return self.rows(index, index + 1)[0]

    def rows(self, start: int, end: int) -> list[Row]:
        """The rows of the indices from `start` up to `end`, as far as they are kept."""
        start, end = max(start, self._first), min(end, self._next)
        found: list[Row] = []
        while start < end:
            block = self._blocks[self._block_of(start)]
            place, stop = start - block.start, min(end - block.start, block.count)
            found += unpack(block.rows[place:stop], block.long, self._codebook, place)
            start = block.start + stop
        return found

    @property
    def codebook(self) -> Codebook:
        """What the numbers of ports and faults in packed rows stand for."""
        return self._codebook

    def packed(self, start: int, end: int) -> Iterator[Packed]:
        """The same as `rows`, packed and in pieces, to be read at once and never written."""
        start, end = max(start, self._first), min(end, self._next)
        while start < end:
            block = self._blocks[self._block_of(start)]
            stop = min(end - block.start, block.count)
            yield block.rows[start - block.start : stop]
            start = block.start + stop

    # The filter

    @property
    def filter(self) -> RowFilter | None:
        """The filter in force."""
        return self._filter

    @property
    def pending(self) -> int:
        """Rows that the filter has still to see."""
        return sum(block.count - block.judged for block in self._pending)

    def set_filter(self, row_filter: RowFilter | None, near: int | None = None) -> None:
        """Put a filter in force, or none. What is there already waits for `filter_step`.

        Args:
            row_filter: shows only the rows that it wants; None shows all.
            near: the index around which rows are judged first; by default the newest.
        """
        self._filter = row_filter
        self._sums = None
        self._pending = []
        for block in self._blocks:
            block.forget()
        if row_filter is None:
            return
        middle = self._next if near is None else near
        far_first = sorted(self._blocks, key=lambda block: -abs(block.start - middle))
        self._pending = far_first

    def filter_step(self, budget_rows: int = 4 * BLOCK_ROWS) -> bool:
        """Judge some of the rows that wait, about `budget_rows` of them; True when none is left."""
        while self._filter and self._pending and budget_rows > 0:
            budget_rows -= self._pending.pop().judge(self._filter, self._codebook)
            self._sums = None
        return not self._pending

    # What is shown

    @property
    def shown_count(self) -> int:
        """How many rows are shown: all, or those that the filter is known to want."""
        if self._filter is None:
            return len(self)
        return self._shown_sums()[-1] - self._gone()

    def _shown_sums(self) -> list[int]:
        """Wanted rows before each block, and in all."""
        if self._sums is None:
            self._sums = [0, *accumulate(block.wanted for block in self._blocks)]
        return self._sums

    def _gone(self) -> int:
        """Wanted rows of the oldest block that have left."""
        if not self._blocks:
            return 0
        return self._blocks[0].wanted_before(self._first - self._blocks[0].start)

    def shown_index(self, position: int) -> int:
        """The index of the row at that position among those shown.

        Raises:
            IndexError: there are not so many, or the position is negative.
        """
        if not 0 <= position < self.shown_count:
            raise IndexError(f"position {position} is not in 0..{self.shown_count - 1}")
        if self._filter is None:
            return self._first + position
        rank = position + self._gone()
        sums = self._shown_sums()
        at = bisect_right(sums, rank) - 1
        block = self._blocks[at]
        return block.start + int(block.places[rank - sums[at]])

    def position_of(self, index: int) -> int:
        """How many shown rows stand before that index: its own position, where it is shown."""
        index = min(max(index, self._first), self._next)
        if self._filter is None or not self._blocks:
            return index - self._first
        at = min(self._block_of(index), len(self._blocks) - 1)
        block = self._blocks[at]
        return self._shown_sums()[at] + block.wanted_before(index - block.start) - self._gone()

    def shown_row(self, position: int) -> Row:
        """The row at that position among those shown.

        Raises:
            IndexError: there are not so many, or the position is negative.
        """
        return self.row(self.shown_index(position))

    def fault_index(self, index: int, by: int) -> int | None:
        """Index of the nearest shown row with a fault behind `index`, or before it (`by` below 0).

        None where there is none; rows that the filter has still to see do not count.
        """
        blocks = [block for block in self._blocks if block.count]
        if by > 0:
            ahead = (block for block in blocks if block.end > index + 1)
        else:
            ahead = (block for block in reversed(blocks) if block.start < index)
        for block in ahead:
            found = self._faulty(block) + block.start
            found = found[found > index] if by > 0 else found[found < index]
            if len(found):
                return int(found[0 if by > 0 else -1])
        return None

    def _faulty(self, block: _Block) -> npt.NDArray[np.int64]:
        """Places of the block's shown rows that have a fault, rising."""
        places: npt.NDArray[np.int64] = np.arange(max(0, self._first - block.start), block.count)
        if self._filter is not None:
            wanted = block.places[: block.wanted].astype(np.int64)
            places = wanted[wanted >= self._first - block.start]
        clean = self._codebook.fault_code(())
        return np.compress(block.rows["faults"][places] != clean, places)

    def shown_slice(self, start: int, end: int) -> list[tuple[int, Row]]:
        """Index and row of the positions from `start` up to `end`, as far as there are any."""
        start, end = max(start, 0), min(end, self.shown_count)
        if start >= end:
            return []
        if self._filter is None:
            first = self._first + start
            return list(enumerate(self.rows(first, self._first + end), first))
        indices = [self.shown_index(position) for position in range(start, end)]
        return [(index, self.row(index)) for index in indices]
