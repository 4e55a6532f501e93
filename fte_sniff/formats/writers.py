"""Registry and CSV, JSONL, hex writers."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Protocol, TextIO, runtime_checkable

from fte_sniff.errors import printable
from fte_sniff.protocol import COLUMN_BY_NAME, Row, Value, faults_text, iso_time, record, spaced_hex
from fte_sniff.protocol.row_schema import TIME_FORMAT

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
        return JsonlWriter(stream)
    if form is OutputFormat.CSV:
        return CsvWriter(stream)
    if form is OutputFormat.HEX:
        return HexWriter(stream)
    from fte_sniff.formats.text_table import PlainWriter, RichWriter

    if not stream.isatty():
        return PlainWriter(stream, ports=ports)
    from rich.console import Console

    return RichWriter(Console(file=stream), ports=ports)


class JsonlWriter:
    """Writes one JSON object a row; `time` as ISO 8601 with nine digits, absent values as null."""

    tells_order = False

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows."""
        self._stream.writelines(map(_line, rows))

    def write_frame(self, frame: pl.DataFrame) -> None:
        """Write the rows of a frame that has the contract's columns."""
        import polars as pl

        time = pl.col("time").dt.strftime(TIME_FORMAT)
        self._stream.write(frame.with_columns(time).write_ndjson())

    def end(self) -> None:
        """Nothing is held back."""


def _line(row: Row) -> str:
    values = record(row)
    if row.t_ns is not None:
        values["time"] = iso_time(row.t_ns)
    return json.dumps(values, ensure_ascii=False, separators=(",", ":")) + "\n"


class CsvWriter:
    """Writes CSV: `time` as ISO 8601 with nine digits, absent values empty, faults joined."""

    tells_order = False

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._writer = csv.writer(stream, lineterminator="\n")
        self._headed = False

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows, under the header if it is not out yet."""
        self._head()
        self._writer.writerows(map(_values, rows))

    def write_frame(self, frame: pl.DataFrame) -> None:
        """Write the rows of a frame that has the contract's columns."""
        import polars as pl

        self._head()
        ports = frame.get_column("port")
        names = {port: printable(port) or None for port in ports.unique()}
        if any(port != name for port, name in names.items()):
            ports = ports.replace_strict(names, return_dtype=pl.String())
        # An empty text would be written as two quotes.
        faults = pl.col("faults").cast(pl.List(pl.String())).list.join(",")
        texts = frame.with_columns(ports, faults.replace("", None))
        self._stream.write(
            texts.write_csv(include_header=False, datetime_format=TIME_FORMAT, line_terminator="\n")
        )

    def end(self) -> None:
        """Write the header, if no row has brought it."""
        self._head()

    def _head(self) -> None:
        if not self._headed:
            self._headed = True
            self._writer.writerow(COLUMN_BY_NAME)


def _values(row: Row) -> list[Value]:
    values = record(row)
    values["time"] = None if row.t_ns is None else iso_time(row.t_ns)
    values["port"] = printable(row.port)
    values["faults"] = faults_text(row.faults)
    return list(values.values())


class HexWriter:
    """Writes `AA 01 01 03 E8 00 00 00 00 EE`, and nothing else of a row."""

    tells_order = False

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows' bytes."""
        self._stream.writelines(f"{spaced_hex(row.raw)}\n" for row in rows)

    def write_frame(self, frame: pl.DataFrame) -> None:
        """Write the bytes of the rows of a frame that has the contract's columns."""
        spaced = frame.get_column("raw").str.replace_all("(..)", "$1 ").str.strip_suffix(" ")
        self._stream.writelines(f"{line}\n" for line in spaced)

    def end(self) -> None:
        """Nothing is held back."""
