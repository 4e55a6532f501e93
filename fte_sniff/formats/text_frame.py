"""Texts of the columns of a DataFrame, and the lines of a table; apart, because it needs polars."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, timedelta, tzinfo
from typing import Final

import numpy as np
import polars as pl

from fte_sniff.errors import printable
from fte_sniff.formats.looks import LOOKS
from fte_sniff.formats.text_table import (
    GAP,
    KIND_WIDTH,
    OFFSET_WIDTH,
    PORT_WIDTH,
    RAW_WIDTH,
    VALUES_WIDTH,
    TextLayout,
)
from fte_sniff.protocol import FRAME_LENGTH, KINDS, Field, FrameKind, iso_time, zone_at

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


def spaced_bytes(raw: pl.Series) -> pl.Series:
    """Bytes as hex with spaces, from hex without."""
    pairs = (pl.lit(raw).str.slice(2 * at, 2) for at in range(FRAME_LENGTH))
    texts = pl.select(pl.concat_str(pairs, separator=" ")).to_series()
    odd = raw.str.len_bytes() != 2 * FRAME_LENGTH
    if not odd.any():
        return texts
    # The same for any length, five times as slow.
    found = raw.filter(odd).str.replace_all("(..)", "$1 ").str.strip_suffix(" ")
    return texts.scatter(odd.arg_true(), found)


def frame_lines(frame: pl.DataFrame, layout: TextLayout) -> str:
    """Format all rows as lines, each with its line end."""
    kinds = {kind.name: kind.name.ljust(KIND_WIDTH) for kind in KINDS}
    cells = [
        frame["offset"].cast(pl.String()).str.pad_start(OFFSET_WIDTH),
        _replaced(frame["status"], {status: look.mark for status, look in LOOKS.items()}),
        _replaced(frame["kind"], kinds).fill_null("-".ljust(KIND_WIDTH)),
        _values(frame).str.pad_end(VALUES_WIDTH),
        spaced_bytes(frame["raw"]).str.pad_end(RAW_WIDTH),
        faults_texts(frame["faults"]).fill_null(""),
    ]
    if layout.ports:
        ports = {port: printable(port).ljust(PORT_WIDTH) for port in frame["port"].unique()}
        cells.insert(0, _replaced(frame["port"], ports))
    if layout.times:
        times = time_texts(frame["time"], layout.zone).fill_null("-")
        cells.insert(0, times.str.pad_end(layout.time_width))
    lines = pl.concat_str(map(pl.lit, cells), separator=GAP).str.strip_chars_end(" ")
    return joined_lines(pl.select(lines).to_series())


def joined_lines(lines: pl.Series) -> str:
    """The lines, each with its line end."""
    return lines.str.join("\n").item() + "\n" if len(lines) else ""


def _replaced(words: pl.Series, texts: Mapping[str, str]) -> pl.Series:
    return words.replace_strict(texts, return_dtype=pl.String())


def _values(frame: pl.DataFrame) -> pl.Series:
    """The values of each row, by the form of its kind."""
    kinds = frame["kind"].to_physical().fill_null(len(KINDS)).to_numpy()
    needed = frame.select("length", "cmd", *{field.name for kind in KINDS for field in kind.fields})
    parts = [
        needed.filter(pl.Series(kinds == code)).select(values=form).to_series()
        for code, form in enumerate([*map(_values_of, KINDS), _without_kind()])
    ]
    places = np.empty(len(kinds), np.uint32)
    places[kinds.argsort(kind="stable")] = np.arange(len(kinds))
    return pl.concat(parts).gather(pl.Series(places))


def _without_kind() -> pl.Expr:
    one = pl.col("length") == 1
    length = pl.format("{} byte{}", "length", pl.when(one).then(pl.lit("")).otherwise(pl.lit("s")))
    unknown = pl.format("cmd=0x{}", _hex("cmd"))
    return pl.when(pl.col("cmd").is_null()).then(length).otherwise(unknown)


def _values_of(kind: FrameKind) -> pl.Expr:
    if not kind.fields:
        return pl.repeat("", pl.len(), dtype=pl.String())
    form = " ".join(f"{field.name}={{}}" for field in kind.fields)
    return pl.format(form, *map(_text, kind.fields))


def _text(field: Field) -> pl.Expr:
    if field.legal_bits is None:
        return pl.col(field.name).cast(pl.String())
    return pl.format("0x{}", _hex(field.name))


_HEX_PAIRS: Final = pl.Series([f"{byte:02X}" for byte in range(256)])


def _hex(name: str) -> pl.Expr:
    return pl.lit(_HEX_PAIRS).gather(pl.col(name).cast(pl.UInt32()))
