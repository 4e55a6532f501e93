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
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from fte_sniff.analysis.columns.packing import Codebook, Packed, pack, unpack
from fte_sniff.analysis.store.block import Block, Places
from fte_sniff.analysis.store.paging import MOST_BLOCKS, BlockSource, Pages
from fte_sniff.protocol import Row

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter

BLOCK_ROWS: Final = 32_768
"""Rows in a block; a place in a block fits 16 bits."""

DEFAULT_BOUND: Final = 1_000_000
"""Rows that a store keeps where nobody says otherwise."""

ENDLESS: Final = 2**62
"""The bound of a store from which no row leaves."""

SELECT_ROWS: Final = 4096
"""Rows that one `select` looks at, at most: they take a few hundredths of a second to unpack."""

Bools: TypeAlias = npt.NDArray[np.bool_]

RowTest: TypeAlias = Callable[[Packed, Mapping[int, bytes], Codebook], Bools]
"""Says of packed rows which of them pass; the mapping holds the bytes of long ones by place."""


@dataclass(frozen=True, slots=True)
class Step:
    """What looking in one block brought."""

    found: int | None
    """Index of a row that passes."""
    onward: int | None
    """Index to look at next; None where a row was found, or there are no more."""


class RowStore:
    """A bounded run of rows, the latest ones, with a filter on top."""

    def __init__(
        self,
        bound: int = DEFAULT_BOUND,
        block_rows: int = BLOCK_ROWS,
        source: BlockSource | None = None,
        most_blocks: int = MOST_BLOCKS,
    ) -> None:
        """An empty store.

        Args:
            bound: rows kept at most, at least 1; the oldest leave first.
            block_rows: rows in a block, 1 to 65536.
            source: gives rows again, so that not all need to lie in memory; None where none can.
            most_blocks: full blocks in memory at most, at least 1, where there is a source.
        """
        if bound < 1 or most_blocks < 1 or not 1 <= block_rows <= 2**16:
            raise ValueError(f"a store of {bound} rows in blocks of {block_rows} cannot be")
        self.bound = bound
        """Rows kept at most."""
        self._block_rows = block_rows
        self._codebook = Codebook()
        self._pages = Pages(source, most_blocks, self._codebook)
        self._blocks: deque[Block] = deque()
        self._first = 0
        self._next = 0
        self._filter: RowFilter | None = None
        self._pending: list[Block] = []
        self._sums: list[int] | None = None

    def __len__(self) -> int:
        return self._next - self._first

    @property
    def most_in_memory(self) -> int:
        """Rows that lie in memory at most; others that are kept are read again."""
        most = self._pages.most_blocks
        return self.bound if most is None else most * self._block_rows

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
        clean = self._codebook.fault_code(())
        while done < len(packed):
            block = self._tail()
            piece = packed[done : done + block.room]
            if block.judged == block.count and block not in self._pending:
                touched.append(block)
            block.append(piece, long, done)
            block.faulty |= bool((piece["faults"] != clean).any())
            self._pages.bring(block)
            done += len(piece)
            self._next += len(piece)
            self._drop_oldest()
        self._sums = None
        for block in touched:
            if self._filter and block.end > self._first:
                self._pages.bring(block).judge(self._filter, self._codebook)

    def _tail(self) -> Block:
        if not self._blocks or not self._blocks[-1].room:
            self._blocks.append(Block(self._next, min(self._block_rows, self.bound)))
        return self._blocks[-1]

    def _drop_oldest(self) -> None:
        self._first = max(self._first, self._next - self.bound)
        while self._blocks and self._blocks[0].end <= self._first:
            gone = self._blocks.popleft()
            self._pages.forget(gone)
            if gone in self._pending:
                self._pending.remove(gone)

    def _block_of(self, index: int) -> int:
        return (index - self._blocks[0].start) // self._blocks[0].capacity

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
            block = self._pages.bring(self._blocks[self._block_of(start)])
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
            block = self._pages.bring(self._blocks[self._block_of(start)])
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
            block = self._pages.bring(self._pending.pop())
            budget_rows -= block.judge(self._filter, self._codebook)
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

    def is_shown(self, index: int) -> bool:
        """Whether a row of that index is kept and shown."""
        if not self._first <= index < self._next:
            return False
        position = self.position_of(index)
        return position < self.shown_count and self.shown_index(position) == index

    def fault_index(self, index: int, by: int) -> int | None:
        """Index of the nearest shown row with a fault behind `index`, or before it (`by` below 0).

        None where there is none; rows that the filter has still to see do not count.
        """
        clean = self._codebook.fault_code(())

        def faulty(packed: Packed, _: Mapping[int, bytes], __: Codebook) -> Bools:
            return np.asarray(packed["faults"] != clean)

        step = Step(None, index + by)
        while step.found is None and step.onward is not None:
            step = self.find_step(faulty, self._past_clean(step.onward, by), by)
        return step.found

    def _past_clean(self, index: int, by: int) -> int:
        """The index at which a look for faults goes on, without blocks that have none."""
        while self._first <= index < self._next:
            block = self._blocks[self._block_of(index)]
            if block.faulty:
                break
            index = block.end if by > 0 else block.start - 1
        return index

    def offset_index(self, port: str, offset: int) -> int | None:
        """Index of the first shown row that holds that byte of a port's stream, or None."""
        code = self._codebook.port_code(port)

        def holds(packed: Packed, _: Mapping[int, bytes], __: Codebook) -> Bools:
            behind = offset - packed["offset"]
            return np.asarray(
                (packed["port"] == code) & (behind >= 0) & (behind < packed["length"])
            )

        return self._nearest(holds, self._first, 1)

    def _nearest(self, test: RowTest, index: int, by: int) -> int | None:
        step = self.find_step(test, index, by)
        while step.found is None and step.onward is not None:
            step = self.find_step(test, step.onward, by)
        return step.found

    def find_step(self, test: RowTest, index: int, by: int) -> Step:
        """Look in one block for the nearest shown row that passes a test.

        Args:
            test: says of packed rows which of them pass; it may be asked of any of the block's.
            index: the first row to look at; where it is not kept, the nearest that is.
            by: 1 to look at later rows after it, -1 at earlier ones.
        """
        index = max(index, self._first) if by > 0 else min(index, self._next - 1)
        if not self._first <= index < self._next:
            return Step(None, None)
        block = self._blocks[self._block_of(index)]
        places = self._shown_places(block)
        here = index - block.start
        places = places[places >= here] if by > 0 else places[places <= here]
        passing = places
        if len(places):
            part = self._pages.bring(block).part(places)
            passing = places[test(*part, self._codebook)]
        if len(passing):
            return Step(block.start + int(passing[0 if by > 0 else -1]), None)
        onward = block.end if by > 0 else block.start - 1
        return Step(None, onward if self._first <= onward < self._next else None)

    def _shown_places(self, block: Block) -> Places:
        """Places of the block's rows that are kept and shown, rising."""
        first = max(0, self._first - block.start)
        if self._filter is None:
            return np.arange(first, block.count)
        wanted = block.places[: block.wanted].astype(np.int64)
        return wanted[wanted >= first]

    def select(self, start: int, end: int, row_filter: RowFilter | None) -> tuple[list[Row], int]:
        """The rows of one block from index `start` on, before `end`, that a filter wants.

        The filter need not be the one in force. Also tells the index to go on from: `end`, or less.
        """
        start, end = max(start, self._first), min(end, self._next)
        if start >= end:
            return [], end
        block = self._pages.bring(self._blocks[self._block_of(start)])
        end = min(end, block.end, start + SELECT_ROWS)
        places: Places = np.arange(start - block.start, end - block.start)
        if row_filter is not None:
            places = places[row_filter.of_packed(*block.part(places), self._codebook)]
        return unpack(*block.part(places), self._codebook), end

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
