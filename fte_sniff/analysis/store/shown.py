"""Owns which rows of a run are shown: those that a filter wants, as far as it has seen them.

It must not know a screen, nor how rows are kept. Under a filter each block has the places of its
rows that are wanted, two bytes each; a new filter works through the blocks a few at a time.

    position   of a row among those shown now, from 0; it moves when older rows leave or are found
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable
from itertools import accumulate
from typing import TYPE_CHECKING

import numpy as np

from fte_sniff.analysis.store.block import Block, Places
from fte_sniff.analysis.store.row_run import BLOCK_ROWS, RowRun
from fte_sniff.protocol import Row

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter


class Shown:
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
            budget_rows -= block.judge(self._filter, self._run.codebook)
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
                self._run.in_memory(block).judge(self._filter, self._run.codebook)

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
