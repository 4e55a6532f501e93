"""The values of rows in short words, fitted to a width."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Final

from rich.cells import cell_len

from fte_sniff.formats import cell_text
from fte_sniff.formats.cell_text import ELLIPSIS, fit
from fte_sniff.protocol import (
    FRAME_LENGTH,
    KIND_BY_NAME,
    Field,
    Frame,
    FrameKind,
    Row,
    spaced_hex,
)
from fte_sniff.protocol.row_schema import short_feedback, value_heads
from fte_sniff.tui.i18n import _, later

if TYPE_CHECKING:
    from fte_sniff.analysis.statistics import LineSetup


def short_values(row: Row, width: int | None = None) -> str:
    """The row's values by their short names: `motor=1 rpm=1000`.

    Flag bytes with their default value are left out. If the text does not fit the width, names are
    shortened (`M1 rpm=1000`, `M1 r=1000`), then left out (`M1 1000`).
    """
    kind = row.kind if isinstance(row, Frame) else None
    if kind is None:
        return ""
    forms = _forms(kind, row.raw)
    return next(forms) if width is None else first_fitting(forms, width)


def first_fitting(texts: Iterable[str], width: int) -> str:
    """The first text that fits into `width` cells, or else the last."""
    text = ""
    for text in texts:
        if cell_len(text) <= width:
            break
    return text


def _forms(kind: FrameKind, raw: bytes) -> Iterator[str]:
    """The values in several forms, each shorter than the one before."""
    values = [(field, field.read(raw)) for field in kind.fields]
    for heads in value_heads(kind):
        yield " ".join(
            head + _number(field, value)
            for head, (field, value) in zip(heads, values, strict=True)
            if field.defined_bits is None or field.raised(value)
        )


def is_raised(row: Row) -> bool:
    """Whether a flag byte of the row differs from its default."""
    kind = row.kind if isinstance(row, Frame) else None
    return kind is not None and any(field.raised(field.read(row.raw)) for field in kind.fields)


def _number(field: Field, value: int) -> str:
    return f"{value}" if field.defined_bits is None else f"{value:02X}"


def short_kind(name: str, width: int) -> str:
    """The name of a kind in at most `width` cells; feedback keeps a mark of its direction."""
    kind = KIND_BY_NAME.get(name)
    short = short_feedback(kind, width) if kind is not None and len(name) > width else None
    return fit(name, width).rstrip() if short is None else short


def faulty_text(row: Row, width: int) -> str:
    """The faults, then the bytes, for a table without room for both columns."""
    faults = ",".join(row.faults)
    words = f"{faults}  " if faults else ""
    return fit(words + bytes_text(row.raw, width - len(words)), width)


def bytes_text(raw: bytes, width: int) -> str:
    """The bytes as hex; if they are too long for the width, the first bytes and the length."""
    if len(raw) <= max(FRAME_LENGTH, (width + 1) // 3):
        return spaced_hex(raw)
    count = f" {ELLIPSIS} {len(raw)} bytes"
    return spaced_hex(raw[: max(0, (width - len(count) + 1) // 3)]) + count


TURNS: Final = later("{turns:,.3f} turns")


def span_text(ns: float | None) -> str:
    """A duration in three digits, in the language of the screen: `2.15 ms`."""
    return _(cell_text.span_text(ns))


def turns_text(pulses: int, line_setup: LineSetup) -> str:
    """A position in turns; empty if the pulses of a turn are unknown."""
    turns = line_setup.turns(pulses)
    return "" if turns is None else _(TURNS).format(turns=turns)
