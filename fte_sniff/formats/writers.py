"""Output formats, and the writers of CSV, JSON lines and hex.

CSV and JSON lines are written from DataFrames: whole columns at once.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from datetime import UTC, tzinfo
from enum import StrEnum
from functools import partial
from io import BytesIO, TextIOWrapper
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, TextIO, TypeAlias

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


RowWriter: TypeAlias = Callable[[Rows], None]
"""Writes rows to a text stream, which stays open."""

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
    match form:
        case OutputFormat.JSONL:
            return partial(_write_jsonl, stream, frame_of, columns)
        case OutputFormat.CSV:
            stream.write(",".join(columns) + "\n")
            return partial(_write_csv, stream, frame_of, columns, zone)
        case OutputFormat.HEX:
            return lambda rows: stream.writelines(f"{spaced_hex(row.raw)}\n" for row in rows)
    from fte_sniff.formats.text_table import TableWriter

    return TableWriter(stream, ports=ports, zone=zone)


def _write_jsonl(stream: TextIO, frame_of: FrameOf, columns: Sequence[str], rows: Rows) -> None:
    """Write one JSON object a row; `time` as ISO 8601 with nine digits."""
    if not len(rows):
        return
    from fte_sniff.formats.column_text import time_texts

    frame, lines = frame_of(rows), BytesIO()
    texts = frame.with_columns(time_texts(frame["time"]).alias("time"))
    texts.select(columns).write_ndjson(lines)
    data = lines.getvalue()
    if data.isascii() and isinstance(stream, TextIOWrapper):
        stream.flush()
        stream.buffer.write(data)  # the bytes that polars wrote, as they are
    else:
        stream.write(printable_json(data.decode()))


def _write_csv(
    stream: TextIO, frame_of: FrameOf, columns: Sequence[str], zone: tzinfo, rows: Rows
) -> None:
    """Write CSV: `time` as ISO 8601 with nine digits, null as empty, faults joined by commas."""
    if not len(rows):
        return
    from fte_sniff.formats.column_text import faults_texts, printable_texts, time_texts

    frame = frame_of(rows)
    texts = frame.with_columns(
        time=time_texts(frame["time"], zone),
        port=printable_texts(frame["port"]),
        faults=faults_texts(frame["faults"]),
    )
    chosen = texts.select(columns)
    stream.write(chosen.write_csv(include_header=False, line_terminator="\n"))


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
