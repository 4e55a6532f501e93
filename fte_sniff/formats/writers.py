"""Output formats, and the writers of CSV and JSON lines.

CSV and JSON lines are written from DataFrames: whole columns at once.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from datetime import UTC, tzinfo
from enum import StrEnum
from io import BytesIO
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from fte_sniff.errors import printable
from fte_sniff.protocol.columns import COLUMN_BY_NAME, iso_time

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


ALL_COLUMNS: Final = tuple(COLUMN_BY_NAME)
"""The names of all columns, in order."""

CHOOSABLE: Final = (OutputFormat.JSONL, OutputFormat.CSV)
"""The formats whose columns can be chosen."""


class _Kept(BytesIO):
    """Keeps what is written; polars writes all lines in one piece, which is not copied."""

    data = b""

    def write(self, data: Any) -> int:
        """Append the bytes."""
        self.data += data
        return len(data)


def json_lines(frame: pl.DataFrame, columns: Sequence[str]) -> str | bytes:
    """One JSON object a row, `time` as ISO 8601 with nine digits, in UTC; bytes if all is ASCII."""
    lines = _Kept()
    frame.with_columns(time=time_texts(frame["time"])).select(columns).write_ndjson(lines)
    data = lines.data
    return data if data.isascii() else printable_json(data.decode())


def csv_lines(frame: pl.DataFrame, columns: Sequence[str], zone: tzinfo) -> str:
    """CSV: `time` as ISO 8601 with nine digits, null as empty, faults joined by commas."""
    import polars as pl

    faults, ports = pl.col("faults"), frame["port"]
    shown = {port: printable(port) or None for port in ports.unique()}
    texts = frame.with_columns(
        time=time_texts(frame["time"], zone),
        port=ports.replace_strict(shown, return_dtype=pl.String()),
        faults=pl.when(faults.list.len() > 0).then(
            faults.cast(pl.List(pl.String())).list.join(",")
        ),
    )
    return texts.select(columns).write_csv(include_header=False, line_terminator="\n")


def time_texts(time: pl.Series, zone: tzinfo = UTC) -> pl.Series:
    """Times as `iso_time` formats them in a zone; null where they are null."""
    import polars as pl

    if zone == UTC:
        return time.dt.to_string("%Y-%m-%dT%H:%M:%S%.9fZ")
    texts = [None if t_ns is None else iso_time(t_ns, zone) for t_ns in time.to_physical()]
    return pl.Series(texts, dtype=pl.String())


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
