"""Output formats, and the writers of CSV, JSONL and hex.

CSV and JSON lines are written from DataFrames: whole columns at once.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from datetime import UTC, tzinfo
from enum import StrEnum
from io import BytesIO, TextIOWrapper
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Protocol, TextIO, TypeAlias

from fte_sniff.protocol import COLUMN_BY_NAME, Rows, spaced_hex

if TYPE_CHECKING:
    import polars as pl


class OutputFormat(StrEnum):
    """The formats that rows can be written in."""

    TABLE = "table"
    JSONL = "jsonl"
    CSV = "csv"
    PARQUET = "parquet"
    MCAP = "mcap"
    PCAPNG = "pcapng"
    HEX = "hex"
    RAW = "raw"


TEXT_FORMATS = (OutputFormat.TABLE, OutputFormat.JSONL, OutputFormat.CSV)
"""The text formats that hold all values of a row."""

FORMAT_BY_SUFFIX: Final = MappingProxyType(
    {
        ".csv": OutputFormat.CSV,
        ".jsonl": OutputFormat.JSONL,
        ".parquet": OutputFormat.PARQUET,
        ".mcap": OutputFormat.MCAP,
        ".pcapng": OutputFormat.PCAPNG,
        ".txt": OutputFormat.TABLE,
        ".hex": OutputFormat.HEX,
        ".raw": OutputFormat.RAW,
        ".bin": OutputFormat.RAW,
    }
)
"""By file name suffix, in lower case."""


class RowWriter(Protocol):
    """Writes rows to a text stream, which stays open."""

    def write(self, rows: Rows) -> None:
        """Write the rows."""

    def close(self) -> None:
        """Write what the format requires at its end."""


FrameOf: TypeAlias = "Callable[[Rows], pl.DataFrame]"
"""Makes a DataFrame with the columns of the row contract."""

ALL_COLUMNS: Final = tuple(COLUMN_BY_NAME)
"""The names of all columns, in order."""

CHOOSABLE: Final = (OutputFormat.JSONL, OutputFormat.CSV)
"""The formats whose columns can be chosen."""


def row_writer(
    form: OutputFormat,
    stream: TextIO,
    frame_of: FrameOf,
    *,
    ports: bool,
    columns: Sequence[str] = ALL_COLUMNS,
    zone: tzinfo = UTC,
) -> RowWriter:
    """Create the writer of a text format or hex; a table is coloured on a terminal.

    Args:
        form: the format.
        stream: the text stream.
        frame_of: makes the DataFrames of CSV and JSON lines.
        ports: whether a table has a column for the port.
        columns: those of `CHOOSABLE` formats.
        zone: that of the times in a table or CSV; JSON lines have UTC.
    """
    if form is OutputFormat.JSONL:
        return JsonlWriter(stream, frame_of, columns)
    if form is OutputFormat.CSV:
        return CsvWriter(stream, frame_of, columns, zone)
    if form is OutputFormat.HEX:
        return HexWriter(stream)
    from fte_sniff.formats.text_table import PlainWriter, RichWriter

    if not stream.isatty():
        return PlainWriter(stream, ports=ports, zone=zone)
    from rich.console import Console

    return RichWriter(Console(file=stream), ports=ports, zone=zone)


class JsonlWriter:
    """Writes one JSON object a row; `time` as ISO 8601 with nine digits."""

    def __init__(self, stream: TextIO, frame_of: FrameOf, columns: Sequence[str]) -> None:
        self._stream, self._frame_of, self._columns = stream, frame_of, columns

    def write(self, rows: Rows) -> None:
        """Write the rows."""
        if not len(rows):
            return
        from fte_sniff.formats.column_text import time_texts

        frame, lines = self._frame_of(rows), BytesIO()
        texts = frame.with_columns(time_texts(frame["time"]).alias("time"))
        texts.select(self._columns).write_ndjson(lines)
        data = lines.getvalue()
        if data.isascii() and isinstance(self._stream, TextIOWrapper):
            self._stream.flush()
            self._stream.buffer.write(data)  # the bytes that polars wrote, as they are
        else:
            self._stream.write(printable_json(data.decode()))

    def close(self) -> None:
        """Do nothing: all rows are written."""


def json_text(value: object) -> str:
    """A value as JSON in one line that a terminal can show."""
    return printable_json(json.dumps(value, ensure_ascii=False, separators=(",", ":")))


def printable_json(text: str) -> str:
    """Escape characters of a JSON text that a terminal obeys or does not show, such as U+202E."""
    return text if text.isascii() else _NOT_ASCII.sub(_escaped, text)


_NOT_ASCII = re.compile(r"[^\x00-\x7f]+")


def _escaped(found: re.Match[str]) -> str:
    if found[0].isprintable():
        return found[0]
    return "".join(c if c.isprintable() else json.dumps(c)[1:-1] for c in found[0])


class CsvWriter:
    """Writes CSV: `time` as ISO 8601 with nine digits, null as empty, faults joined by commas."""

    def __init__(
        self, stream: TextIO, frame_of: FrameOf, columns: Sequence[str], zone: tzinfo
    ) -> None:
        self._stream, self._frame_of = stream, frame_of
        self._columns, self._zone = columns, zone
        self._header = ",".join(columns) + "\n"

    def write(self, rows: Rows) -> None:
        """Write the rows, after the header."""
        if not len(rows):
            return
        from fte_sniff.formats.column_text import faults_texts, printable_texts, time_texts

        self.close()
        frame = self._frame_of(rows)
        texts = frame.with_columns(
            time=time_texts(frame["time"], self._zone),
            port=printable_texts(frame["port"]),
            faults=faults_texts(frame["faults"]),
        )
        chosen = texts.select(self._columns)
        self._stream.write(chosen.write_csv(include_header=False, line_terminator="\n"))

    def close(self) -> None:
        """Write the header if there were no rows."""
        self._stream.write(self._header)
        self._header = ""


class HexWriter:
    """Writes the bytes of each row as hex: `AA 01 01 03 E8 00 00 00 00 EE`."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, rows: Rows) -> None:
        """Write the bytes of the rows."""
        self._stream.writelines(f"{spaced_hex(row.raw)}\n" for row in rows)

    def close(self) -> None:
        """Do nothing: all rows are written."""
