"""Owns the choice of the form in which the rows of a log go through a command.

It must not know a format of logs, nor what becomes of the rows.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Final

from fte_sniff.cli.inputs.batches import LogBatch, RowBatch
from fte_sniff.cli.inputs.packed_batches import PackedBatch

if TYPE_CHECKING:
    from fte_sniff.protocol.framer.segments import Decided


FEW: Final = 20_000
"""Fewer rows are read one by one before what takes many at once is loaded."""

_FEWEST: Final = 100
"""Fewer rows are never taken at once."""


def log_batches(portions: Iterable[Decided], few: int = FEW) -> Iterator[LogBatch]:
    """The rows of all that was decided, in the form that is quickest.

    Args:
        portions: as they come.
        few: so many rows come as objects, whatever is behind them.
    """
    count = 0
    for portion in portions:
        rows = len(portion)
        count += rows
        if count < few or rows < min(few, _FEWEST):
            yield RowBatch(portion.rows())
            continue
        from fte_sniff.row_batch import packed_tiles

        yield PackedBatch(packed_tiles(portion))
