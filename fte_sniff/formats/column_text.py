"""Texts of the columns of a DataFrame; needs polars."""

from __future__ import annotations

from datetime import UTC, timedelta, tzinfo
from typing import Final

import polars as pl

from fte_sniff.errors import printable
from fte_sniff.protocol import iso_time, zone_at

_QUARTER_NS: Final = 900_000_000_000
"""A quarter of an hour: the offsets of zones change between two."""
_LOCAL: Final = "%Y-%m-%dT%H:%M:%S%.9f"
_OFFSET: Final = slice(len("1970-01-01T00:00:00.000000000"), None)
"""The end of a time, where a zone's offset is."""
_MICROSECOND: Final = timedelta(microseconds=1)


def time_texts(time: pl.Series, zone: tzinfo = UTC) -> pl.Series:
    """Times as `iso_time` formats them in a zone; null where they are null."""
    if zone == UTC:
        return time.dt.to_string(f"{_LOCAL}Z")
    t_ns = time.to_physical()
    quarters = t_ns // _QUARTER_NS
    starts = {quarter: quarter * _QUARTER_NS for quarter in quarters.drop_nulls().unique()}
    ends = {quarter: iso_time(start, zone)[_OFFSET] for quarter, start in starts.items()}
    offsets = {
        quarter: zone_at(start, zone).utcoffset(None) // _MICROSECOND * 1000
        for quarter, start in starts.items()
    }
    shift = quarters.replace_strict(offsets, default=None, return_dtype=pl.Int64())
    local = (t_ns + shift).cast(pl.Datetime("ns")).dt.to_string(_LOCAL)
    return local + quarters.replace_strict(ends, default=None, return_dtype=pl.String())


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
