"""Owns rows as JSON lines: one object a row, its keys the row contract's names in their order.

It must not know where the rows come from.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, TextIO

from fte_sniff.protocol import Row, iso_time, record
from fte_sniff.protocol.row_schema import TIME_FORMAT

if TYPE_CHECKING:
    import polars as pl


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
