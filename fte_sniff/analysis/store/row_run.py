"""Owns a bounded run of rows: packed, in blocks of equal size, of which the oldest leave.

It must not know a filter, a screen, a clock or a file. Appending, dropping the oldest and jumping
to any row cost the same whether there are a thousand rows or ten million. A row takes 48 bytes;
bytes beyond the first ten of a row stand aside.

    index   of a row since the run began; it never changes, also when older rows leave
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from typing import Final

from fte_sniff.analysis.columns.fields import raised
from fte_sniff.analysis.columns.packing import Codebook, Packed, pack, unpack
from fte_sniff.analysis.store.block import Block
from fte_sniff.analysis.store.paging import MOST_BLOCKS, BlockSource, Pages
from fte_sniff.protocol import Row

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
        self._pages = Pages(source, most_blocks, self.codebook)
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
        packed, long = pack(rows, self.codebook)
        done, grown = 0, []
        clean = self.codebook.fault_code(())
        while done < len(packed):
            block = self._tail()
            piece = packed[done : done + block.room]
            block.append(piece, long, done)
            block.faulty |= bool((piece["faults"] != clean).any())
            block.raised = block.raised or bool(raised(piece).any())
            grown.append(self._pages.bring(block))
            done += len(piece)
            self._next += len(piece)
            self._drop_oldest()
        return grown

    def _tail(self) -> Block:
        if not self._blocks or not self._blocks[-1].room:
            self._blocks.append(Block(self._next, min(self._block_rows, self.bound)))
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
            found += unpack(block.rows[place:stop], block.long, self.codebook, place)
        return found

    def packed(self, start: int, end: int) -> Iterator[Packed]:
        """The same as `rows`, packed and in pieces, to be read at once and never written."""
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
