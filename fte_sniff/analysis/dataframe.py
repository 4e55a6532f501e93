"""Rows to polars DataFrame.

time                     Datetime("ns", "UTC"), null where the row has no time
port, raw                String (raw: hex, upper case, no spaces)
direction, kind, status  Enum of the column's words
faults                   List(Enum), empty where nothing is wrong
offset, length           Int64, UInt32
cmd and the values       as wide as on the wire; null where the row has no such value
answer_ms, unanswered    Float64, Boolean; motor_hint Int8; null in rows without facts
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import lru_cache
from typing import Final

import numpy as np
import polars as pl

from fte_sniff.errors import encodable
from fte_sniff.protocol.columns import COLUMNS, PREVIOUS, Column, ColumnType
from fte_sniff.protocol.rows import Array, Bools, Rows


def column_dtype(column: Column) -> pl.DataType:
    """The polars type of a column's values, as narrow as the values allow."""
    words = pl.Enum([str(word) for word in column.words])
    types: dict[ColumnType, pl.DataType] = {
        ColumnType.TIME: pl.Datetime("ns", "UTC"),
        ColumnType.REAL: pl.Float64(),
        ColumnType.BOOL: pl.Boolean(),
        ColumnType.INT: getattr(pl, column.integer)(),
        ColumnType.WORD: words,
        ColumnType.WORDS: pl.List(words),
    }
    return types.get(column.type, pl.String())


_READABLE: Final = {column: column_dtype(column) for column in (*COLUMNS, *PREVIOUS.values())}
"""The columns that a filter reads, with their types."""

TABLE_SCHEMA: Final[Mapping[str, pl.DataType]] = {one.name: _READABLE[one] for one in COLUMNS}
"""The polars type of every column of the row contract, in its order."""


def table_frame(rows: Rows, names: Collection[str] | None = None) -> pl.DataFrame:
    """The rows, of any ports, as a frame of `TABLE_SCHEMA`.

    With `names`, of only these columns, which may be of `PREVIOUS` too.
    """
    wanted = COLUMNS if names is None else [one for one in _READABLE if one.name in names]
    return pl.DataFrame([_series(rows, column).alias(column.name) for column in wanted])


def _series(rows: Rows, column: Column) -> pl.Series:
    if column.of_rows is None:
        return _raw(rows)
    values, known, words = column.of_rows(rows)
    if words is None:
        return known_only(values, known).cast(_READABLE[column])
    return _words(column, tuple(words)).gather(pl.Series(values.astype(np.uint32)))


@lru_cache(maxsize=64)
def _words(column: Column, words: tuple[object, ...]) -> pl.Series:
    """The words of a column, which are the same in most batches."""
    if column.type is ColumnType.TEXT:
        # A device path may hold bytes that are not text; polars takes only valid Unicode.
        words = tuple(encodable(str(word)) for word in words)
    if column.type is ColumnType.WORDS:
        words = (*words, column.words)  # polars gathers slowly from lists that are all empty
    return pl.Series(words, dtype=_READABLE[column])


_DIGITS: Final = np.frombuffer(bytes(range(256)).hex().upper().encode(), np.uint16)
"""By byte, its two hex digits."""


def _raw(rows: Rows) -> pl.Series:
    width = int(rows.length.max(initial=1))
    digits = _DIGITS.take(rows.raw[:, :width]).view(np.uint8)
    texts = pl.Series(digits).cast(pl.List(pl.UInt8())).cast(pl.Binary()).cast(pl.String())
    if (rows.length == width).all():
        return texts
    return texts.str.head(pl.Series(2 * rows.length.astype(np.int64)))


def known_only(numbers: Array, known: Bools | None) -> pl.Series:
    """The numbers as a series, null where they are not known."""
    # The numbers may be a view of other bytes of the rows, which polars would copy bit by bit.
    values = pl.Series(np.ascontiguousarray(numbers))
    if known is None or known.all():
        return values
    return values.zip_with(pl.Series(known), pl.Series([None], dtype=values.dtype))
