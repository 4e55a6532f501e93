"""Texts of the columns of a DataFrame; needs polars."""

from __future__ import annotations

from datetime import UTC, tzinfo
from typing import Final

import polars as pl

from fte_sniff.errors import printable
from fte_sniff.protocol import iso_time

_FORM: Final = "%Y-%m-%dT%H:%M:%S%.9fZ"


def time_texts(time: pl.Series, zone: tzinfo = UTC) -> pl.Series:
    """Times as `iso_time` formats them in a zone; null where they are null."""
    if zone == UTC:
        return time.dt.to_string(_FORM)
    texts = [None if t_ns is None else iso_time(t_ns, zone) for t_ns in time.to_physical()]
    return pl.Series(texts, dtype=pl.String())


def faults_texts(faults: pl.Series) -> pl.Series:
    """The faults of each row, joined by commas; null for none, as in most rows."""
    some = faults.list.len() > 0
    found = faults.filter(some).cast(pl.List(pl.String())).list.join(",")
    none = pl.Series([None], dtype=pl.String()).new_from_index(0, len(faults))
    return none.scatter(some.arg_true(), found) if some.any() else none


def printable_texts(texts: pl.Series) -> pl.Series:
    """Texts without characters that a terminal obeys; an empty one is null."""
    shown = {text: printable(text) or None for text in texts.unique()}
    return texts.replace_strict(shown, return_dtype=pl.String())
