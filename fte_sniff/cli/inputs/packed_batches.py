"""Owns rows that lie side by side, on their way through a command: packed, or in columns.

It must not know where they come from. Packed ones come from logs that are framed here, those in
columns from recordings.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from fte_sniff.formats.writers import FrameWriter, RowWriter
from fte_sniff.protocol import PortEvent, Row

if TYPE_CHECKING:
    import polars as pl

    from fte_sniff.analysis.counters import Tally
    from fte_sniff.analysis.filter.row_filter import RowFilter
    from fte_sniff.recording.passages import Span
    from fte_sniff.row_batch import PackedRows, RowColumns, SideBySide, Words


@dataclass(frozen=True, slots=True)
class PackedBatch:
    """Rows packed, with or without times."""

    held: PackedRows

    def __len__(self) -> int:
        return len(self.held)

    def count(self, tally: Tally) -> None:
        """Add them to a tally."""
        _count(self.held, tally)

    def wanted(self, row_filter: RowFilter) -> PackedBatch:
        """Only those that the filter wants."""
        return PackedBatch(self.held.parted(row_filter.among(self.held).to_numpy()))

    def first(self, count: int) -> PackedBatch:
        """Only so many of them."""
        return self if count >= len(self) else PackedBatch(self.held.parted(slice(count)))

    def rows(self) -> list[Row]:
        """As objects."""
        return list(self.held)

    @property
    def timed(self) -> bool:
        """Whether each has a time."""
        return bool(self.held.timed.all())

    def within(self, span: Span) -> PackedBatch:
        """Only those that lie in the span."""
        return PackedBatch(self.held.parted(span.among(self.held.t_ns) & self.held.timed))

    def sequence(self) -> Sequence[Row]:
        """As they are."""
        return self.held

    @property
    def events(self) -> Sequence[PortEvent]:
        """None: a log tells of no port."""
        return ()

    @property
    def after_loss(self) -> bool:
        """A log is read from its first row on."""
        return False

    @property
    def times(self) -> tuple[int, int] | None:
        """Time of the first, and the latest."""
        t_ns = self.held.t_ns
        return (int(t_ns[0]), int(t_ns.max())) if len(t_ns) and self.timed else None

    def write_to(self, writer: RowWriter) -> None:
        """Write them at once where the format can."""
        _write(self, writer)

    def frame(self) -> pl.DataFrame:
        """As a frame of `analysis.table.TABLE_SCHEMA`."""
        return _frame(self.held)

    def columns(self, words: Words) -> RowColumns:
        """In the columns of a recording; only rows that have a time can be."""
        from fte_sniff.row_batch import row_columns

        return row_columns(words, self.held)


@dataclass(frozen=True, slots=True)
class ColumnBatch:
    """Rows in the columns of a recording."""

    held: RowColumns
    again: Callable[[], RowColumns] | None = None
    """Reads the same rows again, where that can be done."""
    after_loss: bool = False
    """Whether rows before them could not be read."""

    def __len__(self) -> int:
        return len(self.held)

    def count(self, tally: Tally) -> None:
        """Add them to a tally."""
        _count(self.held, tally)

    def wanted(self, row_filter: RowFilter) -> ColumnBatch:
        """Only those that the filter wants."""
        mask = row_filter.among(self.held).to_numpy()
        return replace(self, held=self.held.parted(mask, self.held.events), again=None)

    def first(self, count: int) -> ColumnBatch:
        """Only so many of them."""
        if count >= len(self):
            return self
        held = self.held.parted(slice(count), self.held.events)
        return replace(self, held=held, again=None)

    def rows(self) -> list[Row]:
        """As objects."""
        return list(self.held.rows())

    def sequence(self) -> Sequence[Row]:
        """Packed."""
        from fte_sniff.row_batch import packed_rows

        return packed_rows(self.held)

    @property
    def events(self) -> Sequence[PortEvent]:
        """What happened to ports among them."""
        return self.held.events

    @property
    def times(self) -> tuple[int, int] | None:
        """Time of the first, and the latest."""
        t_ns = self.held.t_ns
        return (int(t_ns[0]), int(t_ns.max())) if len(t_ns) else None

    def write_to(self, writer: RowWriter) -> None:
        """Write them at once where the format can."""
        _write(self, writer)

    def frame(self) -> pl.DataFrame:
        """As a frame of `analysis.table.TABLE_SCHEMA`."""
        return _frame(self.held)

    def columns(self, words: Words) -> RowColumns:
        """As they are: their words are their own."""
        return self.held


def _count(rows: SideBySide, tally: Tally) -> None:
    from fte_sniff.analysis.counters import count_columns

    count_columns(tally, rows)


def _write(batch: PackedBatch | ColumnBatch, writer: RowWriter) -> None:
    if isinstance(writer, FrameWriter) and not (writer.tells_order and batch.held.unordered.any()):
        writer.write_frame(batch.frame())
    else:
        writer.write(batch.rows())


def _frame(rows: SideBySide) -> pl.DataFrame:
    from fte_sniff.analysis.dataframe import table_frame

    return table_frame(rows)
