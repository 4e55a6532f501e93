"""Owns the way from rows to the contract's columns as the filter computes with them.

It must not know who asks or where the frame goes, nor how a column is made (`table` does): all that
is done here is to make them wide, so that no sum or product runs over.

    time                        Datetime("ns", "UTC"), null where the input has no time
    port, raw                   String (raw: hex, upper case, no spaces)
    direction, kind, status     Enum of the column's words
    faults                      List(String), empty where nothing is wrong
    every other                 Int64, null where the row has no such value
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Final

import polars as pl

from fte_sniff.analysis.columns.packing import Codebook, Packed
from fte_sniff.analysis.columns.table import TABLE_SCHEMA, packed_table, rows_table
from fte_sniff.protocol import COLUMNS, ColumnType, Row

_WIDE: Final[Mapping[ColumnType, pl.DataType]] = {
    ColumnType.INT: pl.Int64(),
    ColumnType.WORDS: pl.List(pl.String()),
}

SCHEMA: Final[Mapping[str, pl.DataType]] = {
    column.name: _WIDE.get(column.type, TABLE_SCHEMA[column.name]) for column in COLUMNS
}
"""The polars type of every column of the row contract, in its order."""


def wide(table: pl.DataFrame) -> pl.DataFrame:
    """The same columns of a frame of `TABLE_SCHEMA`, in the types of `SCHEMA`."""
    return table.cast({name: SCHEMA[name] for name in table.columns})


def row_frame(rows: Sequence[Row], names: Collection[str] | None = None) -> pl.DataFrame:
    """The rows as a frame with the contract's names and types, in the contract's order.

    Args:
        rows: any rows, of any ports, in any order.
        names: only these columns, where not all are needed.
    """
    return wide(rows_table(rows, names))


def packed_frame(
    packed: Packed,
    long: Mapping[int, bytes],
    codebook: Codebook,
    names: Collection[str] | None = None,
) -> pl.DataFrame:
    """The same from packed rows; `long` holds the bytes of long rows by place in `packed`."""
    return wide(packed_table(packed, long, codebook, names))
