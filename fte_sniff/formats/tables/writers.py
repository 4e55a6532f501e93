"""Owns what all row writers have in common, and which one serves a format.

It must not know where the rows come from. Each writer's module is loaded when it is asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Protocol, TextIO, runtime_checkable

from fte_sniff.protocol import Row

if TYPE_CHECKING:
    import polars as pl


class OutputFormat(StrEnum):
    """The forms that rows can be written in."""

    TABLE = "table"
    JSONL = "jsonl"
    CSV = "csv"
    PARQUET = "parquet"
    MCAP = "mcap"
    HEX = "hex"
    RAW = "raw"


TEXT_FORMS = (OutputFormat.TABLE, OutputFormat.JSONL, OutputFormat.CSV)
"""The forms that are text and tell all of a row."""


FORM_BY_END: Final = MappingProxyType(
    {
        ".csv": OutputFormat.CSV,
        ".jsonl": OutputFormat.JSONL,
        ".parquet": OutputFormat.PARQUET,
        ".mcap": OutputFormat.MCAP,
        ".txt": OutputFormat.TABLE,
        ".hex": OutputFormat.HEX,
        ".raw": OutputFormat.RAW,
        ".bin": OutputFormat.RAW,
    }
)
"""By the end of a file's name, in lower case, what it is taken to hold."""


class RowWriter(Protocol):
    """Writes rows to a text stream that it does not own."""

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows at once, or keep them until `end`."""
        ...

    def end(self) -> None:
        """Write what the format owes at its end; the stream stays open."""
        ...


@runtime_checkable
class FrameWriter(Protocol):
    """Writes rows that lie side by side, faster than one by one and with the same outcome."""

    tells_order: bool
    """Whether it marks rows whose order is uncertain, which a frame does not tell."""

    def write_frame(self, frame: pl.DataFrame) -> None:
        """Write the rows of a frame that has the contract's columns."""
        ...


def row_writer(form: OutputFormat, stream: TextIO, *, ports: bool) -> RowWriter:
    """The writer of `form` to `stream`.

    Args:
        form: which format, one of `TEXT_FORMS` or hex.
        stream: where to; a table is coloured where this is a terminal, and plain elsewhere.
        ports: whether rows of several ports or files are to be told apart in a table.
    """
    if form is OutputFormat.JSONL:
        from fte_sniff.formats.tables.jsonl import JsonlWriter

        return JsonlWriter(stream)
    if form is OutputFormat.CSV:
        from fte_sniff.formats.tables.csv import CsvWriter

        return CsvWriter(stream)
    if form is OutputFormat.HEX:
        from fte_sniff.formats.tables.hex_lines import HexWriter

        return HexWriter(stream)
    from fte_sniff.formats.tables.lines import PlainWriter, RichWriter

    if not stream.isatty():
        return PlainWriter(stream, ports=ports)
    from rich.console import Console

    return RichWriter(Console(file=stream), ports=ports)
