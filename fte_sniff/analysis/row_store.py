"""Append-only row store, blocks, paging, filtered view.

index   of a row since the run began; it never changes, also when older rows leave
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from itertools import accumulate
from typing import TYPE_CHECKING, Final, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from fte_sniff.analysis.fields import raised
from fte_sniff.protocol import Row
from fte_sniff.row_batch import Codebook, RowBatch

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter


Places: TypeAlias = npt.NDArray[np.int64]
"""Where rows stand in a block."""


class Block:
    """So many rows in sequence; `start` is the index of the first."""

    def __init__(self, start: int, room: int, codebook: Codebook) -> None:
        self.start = start
        self.capacity = room
        """Rows that fit into it."""
        self.rows = RowBatch.allocate(codebook, room)
        self.dropped = False
        """Whether its rows are not in memory; all else of it stays."""
        self.count = 0
        self.faulty = False
        """Whether any of its rows has a fault; known also while they are not in memory."""
        self.raised = False
        """The same of a flag byte that tells something else than that all is in order."""
        self.judged = 0
        """Rows that the filter has seen, from the start."""
        self.places: npt.NDArray[np.uint16] = np.empty(0, np.uint16)
        self.wanted = 0
        """How many of `places` are in use: those of wanted rows, rising."""

    @property
    def room(self) -> int:
        """Rows that still fit."""
        return self.capacity - self.count

    @property
    def end(self) -> int:
        """Index behind the last row."""
        return self.start + self.count

    def append(self, rows: RowBatch) -> None:
        """Store rows after those that are there."""
        self.rows.assign(self.count, rows)
        self.count += len(rows)

    def drop(self) -> None:
        """Free the rows; their number and the filter's results stay."""
        self.rows, self.dropped = RowBatch.allocate(self.rows.codebook, 0), True

    def restore(self, rows: RowBatch) -> None:
        """Store the rows again after `drop`.

        Raises:
            ValueError: there are more or fewer than before.
        """
        if len(rows) != self.count:
            raise ValueError(f"{len(rows)} rows came back of {self.count}")
        self.rows, self.dropped = rows, False

    def forget(self) -> None:
        """No row has been judged."""
        self.judged = self.wanted = 0

    def judge(self, row_filter: RowFilter) -> int:
        """Apply the filter to the rows that it has not seen; return how many those were."""
        start, end = self.judged, self.count
        found = np.flatnonzero(row_filter.matches(self.rows[start:end])) + start
        if len(self.places) < self.capacity:
            self.places = np.empty(self.capacity, np.uint16)
        self.places[self.wanted : self.wanted + len(found)] = found
        self.wanted += len(found)
        self.judged = end
        if not self.room:
            self.places = self.places[: self.wanted].copy()
        return end - start

    def wanted_before(self, place: int) -> int:
        """How many wanted rows stand before a place of the block."""
        return int(np.searchsorted(self.places[: self.wanted], place))


MOST_BLOCKS: Final = 128
"""Full blocks that stay in memory where nobody says otherwise: some 200 megabytes."""


class BlockSource(Protocol):
    """Gives rows again that a store has seen before."""

    def load(self, start: int, count: int, codebook: Codebook) -> RowBatch:
        """The rows from index `start` on, exactly `count`.

        Args:
            start: index of the first: how many rows came before it since the store began.
            count: how many.
            codebook: the store's; ports and faults get their numbers from it.

        Raises:
            FileError: they cannot be read any more.
        """
        ...


class BlockCache:
    """The blocks that may be dropped, those that were asked for last at the end."""

    def __init__(self, source: BlockSource | None, most: int, codebook: Codebook) -> None:
        """None has been dropped.

        Args:
            source: gives rows again; without one every block stays.
            most: full blocks in memory at most, at least 1.
            codebook: the store's.
        """
        self._source = source
        self._most = most
        self._codebook = codebook
        self._held: dict[int, Block] = {}

    @property
    def most_blocks(self) -> int | None:
        """Full blocks in memory at most; None where every block stays."""
        return None if self._source is None else self._most

    def bring(self, block: Block) -> Block:
        """The same block, with its rows in memory.

        Raises:
            FileError: they cannot be read any more.
        """
        if self._source is None:
            return block
        if block.dropped:
            block.restore(self._source.load(block.start, block.count, self._codebook))
        if not block.room:
            self._held.pop(block.start, None)
            self._held[block.start] = block
            self._make_room()
        return block

    def forget(self, block: Block) -> None:
        """The block has left the store."""
        self._held.pop(block.start, None)

    def _make_room(self) -> None:
        while len(self._held) > self._most:
            self._held.pop(next(iter(self._held))).drop()


BLOCK_ROWS: Final = 32_768
"""Rows in a block; a place in a block fits 16 bits."""

DEFAULT_BOUND: Final = 1_000_000
"""Rows that a run keeps where nobody says otherwise."""

ENDLESS: Final = 2**62
"""The bound of a run from which no row leaves."""


class RowRun:
    """The latest rows, as many as the bound allows."""

    def __init__(
        self,
        bound: int = DEFAULT_BOUND,
        block_rows: int = BLOCK_ROWS,
        source: BlockSource | None = None,
        most_blocks: int = MOST_BLOCKS,
    ) -> None:
        """No rows yet.

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
        self.codebook = Codebook()
        """What the numbers of ports and faults in packed rows stand for."""
        self._block_rows = block_rows
        self._pages = BlockCache(source, most_blocks, self.codebook)
        self._blocks: deque[Block] = deque()
        self._first = 0
        self._next = 0

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

    # Blocks

    @property
    def blocks(self) -> Sequence[Block]:
        """The blocks that hold rows which are kept, the oldest first."""
        return self._blocks

    def block_number(self, index: int) -> int:
        """Which of the blocks holds the row of an index that is kept."""
        return (index - self._blocks[0].start) // self._blocks[0].capacity

    def in_memory(self, block: Block) -> Block:
        """The same block, with its rows in memory.

        Raises:
            FileError: they cannot be read any more.
        """
        return self._pages.bring(block)

    # Rows

    def append(self, rows: Sequence[Row]) -> Sequence[Block]:
        """Take rows in; tells which blocks they went to, those that have left again among them."""
        batch, done = RowBatch.from_rows(rows, self.codebook), 0
        grown = []
        while done < len(batch):
            block = self._tail()
            piece = batch[done : done + block.room]
            block.append(piece)
            block.faulty |= bool((piece.faults != self.codebook.fault_code(())).any())
            block.raised = block.raised or bool(raised(piece).any())
            grown.append(self._pages.bring(block))
            done += len(piece)
            self._next += len(piece)
            self._drop_oldest()
        return grown

    def _tail(self) -> Block:
        if not self._blocks or not self._blocks[-1].room:
            self._blocks.append(Block(self._next, min(self._block_rows, self.bound), self.codebook))
        return self._blocks[-1]

    def _drop_oldest(self) -> None:
        self._first = max(self._first, self._next - self.bound)
        while self._blocks and self._blocks[0].end <= self._first:
            self._pages.forget(self._blocks.popleft())

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
        found: list[Row] = []
        for block, place, stop in self._pieces(start, end):
            found += block.rows[place:stop]
        return found

    def batches(self, start: int, end: int) -> Iterator[RowBatch]:
        """The same as `rows`, in batches that are views of the store: use at once, never write."""
        for block, place, stop in self._pieces(start, end):
            yield block.rows[place:stop]

    def _pieces(self, start: int, end: int) -> Iterator[tuple[Block, int, int]]:
        """The blocks of those indices, in memory, and from which place to which they stand in."""
        start, end = max(start, self._first), min(end, self._next)
        while start < end:
            block = self._pages.bring(self._blocks[self.block_number(start)])
            stop = min(end - block.start, block.count)
            yield block, start - block.start, stop
            start = block.start + stop


class FilteredView:
    """What a filter leaves of a run; all of it where there is none."""

    def __init__(self, run: RowRun) -> None:
        """All rows of the run are shown."""
        self._run = run
        self._filter: RowFilter | None = None
        self._pending: list[Block] = []
        self._sums: list[int] | None = None

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
        for block in self._run.blocks:
            block.forget()
        if row_filter is None:
            return
        middle = self._run.next if near is None else near
        far_first = sorted(self._run.blocks, key=lambda block: -abs(block.start - middle))
        self._pending = far_first

    def filter_step(self, budget_rows: int = 4 * BLOCK_ROWS) -> bool:
        """Judge some of the rows that wait, about `budget_rows` of them; True when none is left."""
        while self._filter and self._pending and budget_rows > 0:
            block = self._run.in_memory(self._pending.pop())
            budget_rows -= block.judge(self._filter)
            self._sums = None
        return not self._pending

    def follow(self, grown: Iterable[Block]) -> None:
        """Judge the rows that came to these blocks, but for blocks that wait as a whole."""
        self._sums = None
        first = self._run.first
        self._pending = [block for block in self._pending if block.end > first]
        if self._filter is None:
            return
        for block in grown:
            if block.end > first and block not in self._pending:
                self._run.in_memory(block).judge(self._filter)

    # What it leaves

    @property
    def count(self) -> int:
        """How many rows are shown: all, or those that the filter is known to want."""
        if self._filter is None:
            return len(self._run)
        return self._wanted_sums()[-1] - self._gone()

    def _wanted_sums(self) -> list[int]:
        """Wanted rows before each block, and in all."""
        if self._sums is None:
            self._sums = [0, *accumulate(block.wanted for block in self._run.blocks)]
        return self._sums

    def _gone(self) -> int:
        """Wanted rows of the oldest block that have left."""
        if not self._run.blocks:
            return 0
        oldest = self._run.blocks[0]
        return oldest.wanted_before(self._run.first - oldest.start)

    def index(self, position: int) -> int:
        """The index of the row at that position.

        Raises:
            IndexError: there are not so many, or the position is negative.
        """
        if not 0 <= position < self.count:
            raise IndexError(f"position {position} is not in 0..{self.count - 1}")
        if self._filter is None:
            return self._run.first + position
        rank = position + self._gone()
        sums = self._wanted_sums()
        at = bisect_right(sums, rank) - 1
        block = self._run.blocks[at]
        return block.start + int(block.places[rank - sums[at]])

    def position_of(self, index: int) -> int:
        """How many shown rows stand before that index: its own position, where it is shown."""
        run = self._run
        index = min(max(index, run.first), run.next)
        if self._filter is None or not run.blocks:
            return index - run.first
        at = min(run.block_number(index), len(run.blocks) - 1)
        block = run.blocks[at]
        return self._wanted_sums()[at] + block.wanted_before(index - block.start) - self._gone()

    def row(self, position: int) -> Row:
        """The row at that position.

        Raises:
            IndexError: there are not so many, or the position is negative.
        """
        return self._run.row(self.index(position))

    def has(self, index: int) -> bool:
        """Whether a row of that index is kept and shown."""
        if not self._run.first <= index < self._run.next:
            return False
        position = self.position_of(index)
        return position < self.count and self.index(position) == index

    def slice(self, start: int, end: int) -> list[tuple[int, Row]]:
        """Index and row of the positions from `start` up to `end`, as far as there are any."""
        start, end = max(start, 0), min(end, self.count)
        if start >= end:
            return []
        if self._filter is None:
            first = self._run.first + start
            return list(enumerate(self._run.rows(first, self._run.first + end), first))
        indices = [self.index(position) for position in range(start, end)]
        return [(index, self._run.row(index)) for index in indices]

    def places(self, block: Block) -> Places:
        """Places of the block's rows that are kept and shown, rising."""
        first = max(0, self._run.first - block.start)
        if self._filter is None:
            return np.arange(first, block.count)
        wanted = block.places[: block.wanted].astype(np.int64)
        return wanted[wanted >= first]


class RowStore(RowRun):
    """A bounded run of rows, judged by a filter as they come."""

    def __init__(
        self,
        bound: int = DEFAULT_BOUND,
        block_rows: int = BLOCK_ROWS,
        source: BlockSource | None = None,
        most_blocks: int = MOST_BLOCKS,
    ) -> None:
        """An empty store without a filter; what is told of it is that of a `RowRun`."""
        super().__init__(bound, block_rows, source, most_blocks)
        self.shown = FilteredView(self)
        """The rows that are shown, and the filter."""

    def append(self, rows: Sequence[Row]) -> Sequence[Block]:
        """Take rows in; under a filter they are judged at once."""
        grown = super().append(rows)
        self.shown.follow(grown)
        return grown
