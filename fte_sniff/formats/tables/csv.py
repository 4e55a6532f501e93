"""Owns rows as comma-separated values: a header of the row contract's names, then one line a row.

It must not know where the rows come from.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from typing import TYPE_CHECKING, TextIO

from fte_sniff.errors import shown
from fte_sniff.protocol import COLUMN_BY_NAME, Row, Value, faults_text, iso_time, record
from fte_sniff.protocol.row_schema import TIME_FORMAT

if TYPE_CHECKING:
    import polars as pl


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
        names = {port: shown(port) or None for port in ports.unique()}
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
    values["port"] = shown(row.port)
    values["faults"] = faults_text(row.faults)
    return list(values.values())
