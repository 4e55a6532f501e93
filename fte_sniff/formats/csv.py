"""Owns rows as comma-separated values: a header of the row contract's names, then one line a row.

It must not know where the rows come from.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from typing import TextIO

from fte_sniff.errors import shown
from fte_sniff.protocol import COLUMN_BY_NAME, Row, Value, faults_text, iso_time, record


class CsvWriter:
    """Writes CSV: `time` as ISO 8601 with nine digits, absent values empty, faults joined."""

    def __init__(self, stream: TextIO) -> None:
        self._writer = csv.writer(stream, lineterminator="\n")
        self._headed = False

    def write(self, rows: Sequence[Row]) -> None:
        """Write the rows, under the header if it is not out yet."""
        self._head()
        self._writer.writerows(map(_values, rows))

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
