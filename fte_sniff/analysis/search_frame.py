"""Text search in the displayed cells of many rows.

A module of its own because it imports polars, which a screen without a search does not need.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
import polars as pl

from fte_sniff.analysis.dataframe import row_frame
from fte_sniff.protocol import KINDS, Field, FrameKind
from fte_sniff.protocol.row_schema import VALUE_FORMS, short_feedback, value_heads
from fte_sniff.row_batch import RowBatch

_HEX_WORDS: Final = [f"{byte:02x}" for byte in range(256)]


def contains_text(
    text: str,
    columns: Collection[str],
    rows: RowBatch,
) -> npt.NDArray[np.bool_]:
    """Whether each row has the text in one of these columns."""
    found = np.zeros(len(rows), np.bool_)
    for cell in _CELLS:
        if found.all():
            break
        if cell.signs.issuperset(text) and (cell.column is None or cell.column in columns):
            frame = row_frame(rows, cell.names)
            has = cell.text.str.contains(text, literal=True).fill_null(False)
            found |= frame.select(has=has)["has"].to_numpy()
    return found


def _kind_text(kind: FrameKind, form: int) -> pl.Expr:
    """A kind with its values as displayed, in one of the forms of `value_heads`."""
    heads = value_heads(kind)[form]
    short = None if form == 0 else short_feedback(kind, len(kind.name))
    values = [_value(field, head) for field, head in zip(kind.fields, heads, strict=True)]
    return pl.concat_str([pl.lit(short or kind.name), *values])


def _value(field: Field, head: str) -> pl.Expr:
    value = pl.col(field.name)
    if field.defined_bits is None:
        return pl.format(f" {head.lower()}{{}}", value)
    digits = value.replace_strict(list(range(256)), _HEX_WORDS, return_dtype=pl.String())
    text = pl.format(f" {head.lower()}{{}}", digits)
    return pl.when(value == field.default).then(pl.lit("")).otherwise(text)


def _values(form: int) -> pl.Expr:
    text: pl.Expr = pl.lit(None, pl.String)
    for kind in KINDS:
        text = pl.when(pl.col("kind") == kind.name).then(_kind_text(kind, form)).otherwise(text)
    return text


def _field_names() -> Iterator[str]:
    for kind in KINDS:
        yield from (field.name for field in kind.fields)


@dataclass(frozen=True, slots=True)
class _Cell:
    column: str | None
    """Its column; None if every table shows it."""
    names: frozenset[str]
    """Columns that it is computed from."""
    signs: frozenset[str]
    text: pl.Expr


_DIGITS: Final = frozenset("0123456789")
_WORD_SIGNS: Final = _DIGITS | frozenset("abcdefghijklmnopqrstuvwxyz_=- ")
_CELLS: Final = (
    *(
        _Cell(None, frozenset({"kind", *_field_names()}), _WORD_SIGNS, _values(form))
        for form in range(VALUE_FORMS)
    ),
    _Cell(
        "time",
        frozenset({"time"}),
        _DIGITS | frozenset(":."),
        pl.col("time").dt.strftime("%H:%M:%S.%f"),
    ),
    _Cell("offset", frozenset({"offset"}), _DIGITS, pl.col("offset").cast(pl.String())),
)
"""All but port and faults, which many rows share."""
