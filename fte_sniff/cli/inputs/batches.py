"""Owns rows on their way through a command, many at once: counted, picked, cut, and written.

It must not know where they come from, nor any format. Rows come as objects where they are few, else
side by side (`packed_batches`); no command knows which.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, Self

from fte_sniff.formats.writers import RowWriter
from fte_sniff.protocol import PortEvent, Row

if TYPE_CHECKING:
    import polars as pl

    from fte_sniff.analysis.counters import Tally
    from fte_sniff.analysis.filter.row_filter import RowFilter
    from fte_sniff.recording.passages import Span
    from fte_sniff.row_batch import RowColumns, Words


class Batch(Protocol):
    """Some rows, in their order."""

    def __len__(self) -> int: ...

    def count(self, tally: Tally) -> None:
        """Add them to a tally."""
        ...

    def wanted(self, row_filter: RowFilter) -> Self:
        """Only those that the filter wants."""
        ...

    def first(self, count: int) -> Self:
        """Only so many of them."""
        ...

    def rows(self) -> list[Row]:
        """As objects."""
        ...

    def sequence(self) -> Sequence[Row]:
        """For a view: objects, or what takes their place and is cheaper."""
        ...

    @property
    def events(self) -> Sequence[PortEvent]:
        """What happened to ports among them."""
        ...

    @property
    def after_loss(self) -> bool:
        """Whether rows before them could not be read."""
        ...

    @property
    def times(self) -> tuple[int, int] | None:
        """Time of the first of them, and the latest; None where one has none, or there is none."""
        ...

    def write_to(self, writer: RowWriter) -> None:
        """Write them, in the way that is fastest."""
        ...

    def frame(self) -> pl.DataFrame:
        """As a frame of `analysis.table.TABLE_SCHEMA`."""
        ...

    def columns(self, words: Words) -> RowColumns:
        """Side by side; only rows that have a time can be."""
        ...


class LogBatch(Batch, Protocol):
    """Some rows of a log, which may have no times."""

    @property
    def timed(self) -> bool:
        """Whether each has a time."""
        ...

    def within(self, span: Span) -> Self:
        """Only those that lie in the span."""
        ...


@dataclass(frozen=True, slots=True)
class RowBatch:
    """Rows as objects."""

    held: Sequence[Row]

    def __len__(self) -> int:
        return len(self.held)

    def count(self, tally: Tally) -> None:
        """Add them to a tally."""
        tally.add(self.held)

    def wanted(self, row_filter: RowFilter) -> RowBatch:
        """Only those that the filter wants."""
        return RowBatch(row_filter.select(self.held))

    def first(self, count: int) -> RowBatch:
        """Only so many of them."""
        return RowBatch(self.held[:count])

    def rows(self) -> list[Row]:
        """As objects."""
        return list(self.held)

    @property
    def timed(self) -> bool:
        """Whether each has a time."""
        return all(row.t_ns is not None for row in self.held)

    def within(self, span: Span) -> RowBatch:
        """Only those that lie in the span."""
        return RowBatch([row for row in self.held if span.holds(row)])

    def sequence(self) -> Sequence[Row]:
        """The objects."""
        return self.held

    @property
    def events(self) -> Sequence[PortEvent]:
        """None: a log tells of no port."""
        return ()

    @property
    def after_loss(self) -> bool:
        """Never: a log is read whole, or not at all."""
        return False

    @property
    def times(self) -> tuple[int, int] | None:
        """Time of the first, and the latest."""
        times = [row.t_ns for row in self.held if row.t_ns is not None]
        return (times[0], max(times)) if times and len(times) == len(self.held) else None

    def write_to(self, writer: RowWriter) -> None:
        """Write them one by one."""
        writer.write(self.held)

    def frame(self) -> pl.DataFrame:
        """As a frame of `analysis.table.TABLE_SCHEMA`."""
        from fte_sniff.analysis.dataframe import rows_table

        return rows_table(self.held)

    def columns(self, words: Words) -> RowColumns:
        """Side by side; only rows that have a time can be."""
        from fte_sniff.row_batch import RowColumns

        return RowColumns.of_rows(words, self.held)
