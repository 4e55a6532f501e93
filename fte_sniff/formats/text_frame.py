"""Bytes of a whole DataFrame as text, and the lines of a table; needs polars."""

from __future__ import annotations

import polars as pl

from fte_sniff.errors import printable
from fte_sniff.formats.text_layout import (
    GAP,
    KIND_WIDTH,
    OFFSET_WIDTH,
    PORT_WIDTH,
    RAW_WIDTH,
    TIME_WIDTH,
    VALUES_WIDTH,
    TextLayout,
)
from fte_sniff.protocol import FRAME_LENGTH, KINDS, Field, FrameKind
from fte_sniff.protocol.columns import TIME_FORMAT
from fte_sniff.protocol.look import LOOKS


def spaced_bytes(raw: pl.Series) -> pl.Series:
    """Bytes as hex with spaces, from hex without.

    A regular expression takes six times as long, so only rows of another length have one.
    """
    digits = 2 * FRAME_LENGTH
    pairs = [pl.col("raw").str.slice(at, 2) for at in range(0, digits, 2)]
    spaced = raw.alias("raw").to_frame().select(pl.concat_str(pairs, separator=" ")).to_series()
    others = raw.str.len_bytes() != digits
    if not others.any():
        return spaced
    found = raw.filter(others).str.replace_all("(..)", "$1 ").str.strip_suffix(" ")
    return spaced.scatter(others.arg_true(), found)


def frame_lines(frame: pl.DataFrame, layout: TextLayout) -> str:
    """Format all rows as lines, each with its line end."""
    cells = [
        pl.col("offset").cast(pl.String()).str.pad_start(OFFSET_WIDTH),
        pl.col("status")
        .cast(pl.String())
        .replace_strict({str(status): look.mark for status, look in LOOKS.items()}),
        pl.col("kind").cast(pl.String()).fill_null("-").str.pad_end(KIND_WIDTH),
        _values().str.pad_end(VALUES_WIDTH),
        pl.lit(spaced_bytes(frame["raw"])).str.pad_end(RAW_WIDTH),
        pl.col("faults").cast(pl.List(pl.String())).list.join(","),
    ]
    if layout.ports:
        names = {port: printable(port).ljust(PORT_WIDTH) for port in frame["port"].unique()}
        cells.insert(0, pl.col("port").replace_strict(names, return_dtype=pl.String()))
    if layout.times:
        time = pl.col("time").dt.strftime(TIME_FORMAT).fill_null("-")
        cells.insert(0, time.str.pad_end(TIME_WIDTH))
    lines = frame.select(pl.concat_str(cells, separator=GAP).str.strip_chars_end(" ")).to_series()
    return "\n".join([*lines, ""])


def _values() -> pl.Expr:
    kinds = [pl.when(pl.col("kind") == kind.name).then(_values_of(kind)) for kind in KINDS]
    unknown = pl.format("cmd=0x{}", _hex("cmd"))
    return pl.when(pl.col("cmd").is_null()).then(_length()).otherwise(pl.coalesce(*kinds, unknown))


def _length() -> pl.Expr:
    one = pl.col("length") == 1
    return pl.format("{} byte{}", "length", pl.when(one).then(pl.lit("")).otherwise(pl.lit("s")))


def _values_of(kind: FrameKind) -> pl.Expr:
    if not kind.fields:
        return pl.lit("")
    form = " ".join(f"{field.name}={{}}" for field in kind.fields)
    return pl.format(form, *map(_text, kind.fields))


def _text(field: Field) -> pl.Expr:
    if field.legal_bits is None:
        return pl.col(field.name).cast(pl.String())
    return pl.format("0x{}", _hex(field.name))


_HEX_PAIRS = pl.Series([f"{byte:02X}" for byte in range(256)])


def _hex(name: str) -> pl.Expr:
    return pl.lit(_HEX_PAIRS).gather(pl.col(name).cast(pl.UInt32()))
