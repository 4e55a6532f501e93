"""Output formats, and the writers of CSV, JSONL and hex."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Sequence
from datetime import UTC, tzinfo
from enum import StrEnum
from io import BytesIO
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Protocol, TextIO, runtime_checkable

from fte_sniff.errors import printable
from fte_sniff.protocol import COLUMN_BY_NAME, Row, Value, faults_text, iso_time, record, spaced_hex

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

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows."""

    def close(self) -> None:
        """Write what the format requires at its end."""


@runtime_checkable
class FrameWriter(Protocol):
    """Writes the rows of a DataFrame, faster than one by one and with the same result."""

    shows_order: bool
    """Whether it marks rows whose order is uncertain, which a DataFrame does not contain."""

    def write_frame(self, frame: pl.DataFrame) -> None:
        """Write the rows of a DataFrame with the columns of the row contract."""


ALL_COLUMNS: Final = tuple(COLUMN_BY_NAME)
"""The names of all columns, in order."""

CHOOSABLE: Final = (OutputFormat.JSONL, OutputFormat.CSV)
"""The formats whose columns can be chosen."""


def row_writer(
    form: OutputFormat,
    stream: TextIO,
    *,
    ports: bool,
    columns: Sequence[str] = ALL_COLUMNS,
    zone: tzinfo = UTC,
) -> RowWriter:
    """Create the writer of a text format or hex; a table is coloured on a terminal.

    `ports` is whether a table has a column for the port, `columns` those of `CHOOSABLE` formats,
    `zone` that of the times in a table or CSV; JSON lines have UTC.
    """
    if form is OutputFormat.JSONL:
        return JsonlWriter(stream, columns)
    if form is OutputFormat.CSV:
        return CsvWriter(stream, columns, zone)
    if form is OutputFormat.HEX:
        return HexWriter(stream)
    from fte_sniff.formats.text_table import PlainWriter, RichWriter

    if not stream.isatty():
        return PlainWriter(stream, ports=ports, zone=zone)
    from rich.console import Console

    return RichWriter(Console(file=stream), ports=ports, zone=zone)


class _LineWriter:
    shows_order = False

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def close(self) -> None:
        """Do nothing: all rows are written."""


class JsonlWriter(_LineWriter):
    """Writes one JSON object a row; `time` as ISO 8601 with nine digits."""

    def __init__(self, stream: TextIO, columns: Sequence[str] = ALL_COLUMNS) -> None:
        super().__init__(stream)
        self._columns = columns

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows."""
        self._stream.writelines(_line(row, self._columns) for row in rows)

    def write_frame(self, frame: pl.DataFrame) -> None:
        """Write the rows of a DataFrame with the columns of the row contract."""
        from fte_sniff.formats.text_frame import time_texts

        lines = BytesIO()
        texts = frame.with_columns(time_texts(frame["time"]).alias("time"))
        texts.select(self._columns).write_ndjson(lines)
        self._stream.write(printable_json(lines.getvalue().decode()))


def _line(row: Row, columns: Sequence[str]) -> str:
    values = record(row)
    if row.t_ns is not None:
        values["time"] = iso_time(row.t_ns)
    chosen: dict[str, object] = {name: values[name] for name in columns}
    return json_text(chosen) + "\n"


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


class CsvWriter(_LineWriter):
    """Writes CSV: `time` as ISO 8601 with nine digits, null as empty, faults joined by commas."""

    def __init__(
        self, stream: TextIO, columns: Sequence[str] = ALL_COLUMNS, zone: tzinfo = UTC
    ) -> None:
        super().__init__(stream)
        self._columns, self._zone = columns, zone
        self._writer = csv.writer(stream, lineterminator="\n")
        self._has_header = False

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows, after the header."""
        self._write_header()
        self._writer.writerows(_values(row, self._columns, self._zone) for row in rows)

    def write_frame(self, frame: pl.DataFrame) -> None:
        """Write the rows of a DataFrame with the columns of the row contract."""
        import polars as pl

        from fte_sniff.formats.text_frame import faults_texts, time_texts

        self._write_header()
        ports = frame.get_column("port")
        names = {port: printable(port) or None for port in ports.unique()}
        if any(port != name for port, name in names.items()):
            ports = ports.replace_strict(names, return_dtype=pl.String())
        times = time_texts(frame["time"], self._zone)
        faults = faults_texts(frame["faults"])
        texts = frame.with_columns(ports, time=times, faults=faults).select(self._columns)
        self._stream.write(texts.write_csv(include_header=False, line_terminator="\n"))

    def close(self) -> None:
        """Write the header if there were no rows."""
        self._write_header()

    def _write_header(self) -> None:
        if not self._has_header:
            self._has_header = True
            self._writer.writerow(self._columns)


def _values(row: Row, columns: Sequence[str], zone: tzinfo) -> list[Value]:
    values = record(row)
    values["time"] = None if row.t_ns is None else iso_time(row.t_ns, zone)
    values["port"] = printable(row.port)
    values["faults"] = faults_text(row.faults)
    chosen = (values[name] for name in columns)
    return [_lower(value) if isinstance(value, bool) else value for value in chosen]


def _lower(truth: bool) -> str:
    """As JSON and polars write it."""
    return str(truth).lower()


class HexWriter(_LineWriter):
    """Writes the bytes of each row as hex: `AA 01 01 03 E8 00 00 00 00 EE`."""

    def write(self, rows: Sequence[Row]) -> None:
        """Write the bytes of the rows."""
        self._stream.writelines(f"{spaced_hex(row.raw)}\n" for row in rows)

    def write_frame(self, frame: pl.DataFrame) -> None:
        """Write the bytes of the rows of a DataFrame."""
        from fte_sniff.formats.text_frame import joined_lines, spaced_bytes

        self._stream.write(joined_lines(spaced_bytes(frame["raw"])))
