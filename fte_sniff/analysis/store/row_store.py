"""Owns the rows behind a screen: the latest ones, and which of them are shown.

It must not know how rows are kept (`row_run`), nor how a filter comes to what it leaves (`shown`).
"""

from __future__ import annotations

from collections.abc import Sequence

from fte_sniff.analysis.store.block import Block
from fte_sniff.analysis.store.paging import MOST_BLOCKS, BlockSource
from fte_sniff.analysis.store.row_run import BLOCK_ROWS, DEFAULT_BOUND, RowRun
from fte_sniff.analysis.store.shown import Shown
from fte_sniff.protocol import Row


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
        self.shown = Shown(self)
        """The rows that are shown, and the filter."""

    def append(self, rows: Sequence[Row]) -> Sequence[Block]:
        """Take rows in; under a filter they are judged at once."""
        grown = super().append(rows)
        self.shown.follow(grown)
        return grown
