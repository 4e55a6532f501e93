"""Texts of the columns of a DataFrame, and the lines of a table; apart, because it needs polars."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, timedelta, tzinfo
from typing import Final

import numpy as np
import polars as pl

from fte_sniff.errors import printable
from fte_sniff.formats.text_table import (
    GAP,
    KIND_WIDTH,
    OFFSET_WIDTH,
    PORT_WIDTH,
    RAW_WIDTH,
    VALUES_WIDTH,
    TextLayout,
    time_width,
)
from fte_sniff.protocol import FRAME_LENGTH, KINDS, Field, FrameKind, iso_time, zone_at
from fte_sniff.protocol.look import LOOKS
from fte_sniff.protocol.rows import Array

_SECOND_NS: Final = 1_000_000_000
_DAY_S: Final = 86_400
_QUARTER_S: Final = 900
_SECOND: Final = timedelta(seconds=1)
_OFFSET: Final = slice(len("1970-01-01T00:00:00.000000000"), None)
"""The end of a time, where a zone's offset is."""
_OFFSET_LENGTH: Final = len("+08:00")
_DIGITS: Final = np.frombuffer(b"".join(b"%02d" % pair for pair in range(100)), np.uint8)
"""Two characters for each number below 100."""


def time_texts(time: pl.Series, zone: tzinfo = UTC) -> pl.Series:
    """Times as `iso_time` formats them in a zone; null where they are null.

    The digits come in pairs from a table, which takes half as long as polars' format.
    """
    t_ns = time.to_physical().fill_null(0).to_numpy()
    seconds = t_ns // _SECOND_NS
    texts = np.empty((len(t_ns), time_width(zone)), np.uint8)
    texts[:] = np.frombuffer(iso_time(0, zone).encode(), np.uint8)
    if zone != UTC:
        seconds = seconds + _offsets_s(seconds, zone, texts)
    date = texts[:, : len("1970-01-01")]
    days = seconds // _DAY_S
    for day in days[:1] if (days == days[:1]).all() else np.unique(days):
        date[days == day] = np.frombuffer(f"{np.datetime64(int(day), 'D')}".encode(), np.uint8)
    pairs = _DIGITS.reshape(-1, 2)
    clock = (seconds - days * _DAY_S).astype(np.uint32)
    for at, unit, below in ((11, 3600, 24), (14, 60, 60), (17, 1, 60)):
        texts[:, at : at + 2] = pairs[clock // unit % below]
    left = (t_ns % _SECOND_NS).astype(np.uint32)
    for at in range(27, 20, -2):  # the last two digits first
        left, pair = np.divmod(left, 100)
        texts[:, at : at + 2] = pairs[pair]
    texts[:, 20] = left + ord("0")
    return _texts(texts).zip_with(time.is_not_null(), pl.Series([None], dtype=pl.String()))


def _offsets_s(seconds: Array, zone: tzinfo, texts: Array) -> Array:
    """Seconds to add to UTC for the times of another zone; writes the offsets into the texts.

    Zones change at quarters of an hour.
    """
    quarters, each = np.unique(seconds // _QUARTER_S, return_inverse=True)
    starts_ns = [quarter * _QUARTER_S * _SECOND_NS for quarter in quarters.tolist()]
    ends = "".join(iso_time(t_ns, zone)[_OFFSET] for t_ns in starts_ns).encode()
    texts[:, _OFFSET] = np.frombuffer(ends, np.uint8).reshape(-1, _OFFSET_LENGTH)[each]
    found = [zone_at(t_ns, zone).utcoffset(None) // _SECOND for t_ns in starts_ns]
    return np.array(found, np.int64)[each]


def _texts(characters: Array) -> pl.Series:
    """The rows of a table of ASCII characters."""
    of_rows = pl.Series(characters, dtype=pl.Array(pl.UInt8(), characters.shape[1]))
    return of_rows.cast(pl.List(pl.UInt8())).cast(pl.Binary()).cast(pl.String())


def faults_texts(faults: pl.Series) -> pl.Series:
    """The faults of each row, joined by commas; null for none, as in most rows."""
    some = faults.list.len() > 0
    found = faults.filter(some).cast(pl.List(pl.String())).list.join(",")
    none = pl.Series([None], dtype=pl.String()).new_from_index(0, len(faults))
    return none.scatter(some.arg_true(), found) if some.any() else none


def spaced_bytes(raw: pl.Series) -> pl.Series:
    """Bytes as hex with spaces, from hex without."""
    digits = 2 * FRAME_LENGTH
    odd = raw.str.len_bytes() != digits
    whole = raw if not odd.any() else raw.zip_with(~odd, pl.Series(["0" * digits]))
    pairs = np.frombuffer(whole.str.join("").item().encode(), np.uint8)
    spaced = np.full((len(raw), FRAME_LENGTH, 3), ord(" "), np.uint8)
    spaced[:, :, :2] = pairs.reshape(-1, FRAME_LENGTH, 2)
    texts = _texts(spaced.reshape(-1, 3 * FRAME_LENGTH)[:, :RAW_WIDTH])
    if not odd.any():
        return texts
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
