"""The values of rows in short words, fitted to a width."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from datetime import UTC, tzinfo
from functools import cache, reduce
from typing import TYPE_CHECKING, Final, TypeAlias

from rich.cells import cell_len

from fte_sniff.errors import printable
from fte_sniff.formats import cell_text
from fte_sniff.formats.cell_text import ELLIPSIS, clock_text, fit
from fte_sniff.protocol import (
    FRAME_LENGTH,
    KIND_BY_NAME,
    Field,
    Frame,
    FrameKind,
    Gap,
    PortEvent,
    PortEventKind,
    Row,
    spaced_hex,
)
from fte_sniff.protocol.columns import short_feedback, value_heads
from fte_sniff.tui.i18n import _, later

if TYPE_CHECKING:
    from fte_sniff.analysis.statistics import LineSetup


ValuePart: TypeAlias = tuple[str, Field]
"""A value with its short name, and its field."""


def _is_telling(field: Field, value: int) -> bool:
    return field.legal_bits is None or value != field.default


def value_parts(
    kind: FrameKind, raw: bytes, width: int, shown: Callable[[Field, int], bool] = _is_telling
) -> list[ValuePart]:
    """A frame's values by their short names, `motor=1`, which fit into `width` cells with spaces.

    Only values that are `shown`; by default, flag bytes with their default value are left out. If
    the text does not fit the width, names are shortened (`M1 rpm=1000`, `M1 r=1000`), then left out
    (`M1 1000`).
    """
    parts: list[ValuePart] = []
    values = [(field, field.read(raw)) for field in kind.fields]
    for heads in value_heads(kind):
        parts = [
            (head + _number(field, value), field)
            for head, (field, value) in zip(heads, values, strict=True)
            if shown(field, value)
        ]
        if sum(len(text) + 1 for text, _field in parts) <= width + 1:
            break
    return parts


def first_fitting(texts: Iterable[str], width: int) -> str:
    """The first text that fits into `width` cells, or else the last."""
    text = ""
    for text in texts:
        if cell_len(text) <= width:
            break
    return text


@cache
def _flag_bytes(name: str) -> tuple[tuple[int, int | None], ...]:
    """Offset and default of each flag byte of the kind of that name."""
    fields = KIND_BY_NAME[name].fields
    return tuple((one.start, one.default) for one in fields if one.legal_bits is not None)


def is_raised(row: Row) -> bool:
    """Whether a flag byte of the row differs from its default."""
    kind = row.kind if isinstance(row, Frame) else None
    if kind is None:
        return False
    raw = row.raw
    return any(raw[start] != default for start, default in _flag_bytes(kind.name))


def _number(field: Field, value: int) -> str:
    return f"{value}" if field.legal_bits is None else f"{value:02X}"


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


def span_text(ns: float | None) -> str:
    """A duration in three digits, in the language of the screen: `2.15 ms`."""
    return _(cell_text.span_text(ns))


def turns_text(pulses: int, line_setup: LineSetup) -> str:
    """A position in turns; empty if the pulses of a turn are unknown."""
    turns = line_setup.turns(pulses)
    return "" if turns is None else _("{turns:,.3f} turns", turns=turns)


WITH_DETAIL: Final = later("{event}: {detail}")


def event_text(event: PortEvent, zone: tzinfo = UTC) -> str:
    """A port event on one line, with its time of day in a zone."""
    text = f"{event.port} {_(event_words(event.kind))}"
    if event.detail:
        text = _(WITH_DETAIL, event=text, detail=_detail(event.detail))
    return printable(f"{clock_text(event.t_ns, 3, zone)}  {text}")


def _detail(text: str) -> str:
    """The text in the language of the screen; of one from a file, the parts that are known."""
    shown = _(text)
    if shown != text:
        return shown
    parts = map(_known, text.split("; "))
    return reduce(lambda one, other: _("{one}; {other}", one=one, other=other), parts)


_SETTINGS = re.compile(r"(\d+) baud 8N1, DTR (\w+), RTS (\w+)")
"""`PortSettings` in a recording."""


def _known(part: str) -> str:
    if found := _SETTINGS.fullmatch(part):
        form = later("{baud} baud 8N1, DTR {dtr}, RTS {rts}")
        return _(form, baud=found[1], dtr=_(found[2]), rts=_(found[3]))
    return _(part)


def event_words(kind: PortEventKind) -> str:
    """A kind of event in English words."""
    return kind.replace("_", " ")


def landmark_text(what: PortEvent | Gap, zone: tzinfo = UTC) -> str:
    """A port event or a gap on one line."""
    if isinstance(what, PortEvent):
        return event_text(what, zone)
    text = _("rows are missing here")
    if what.rows:
        text = _("{count:,} rows are missing here", count=what.rows)
    if what.reason:
        text = _(WITH_DETAIL, event=text, detail=_(what.reason))
    return printable(text)
