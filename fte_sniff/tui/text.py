"""Numbers, times and text fitted to a width."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, tzinfo
from itertools import takewhile
from textwrap import wrap as wrap_ascii
from typing import Final

from rich.cells import cell_len, chop_cells, set_cell_size

from fte_sniff.analysis.fields import short_feedback, value_heads
from fte_sniff.analysis.statistics import LineSetup
from fte_sniff.protocol import (
    FRAME_LENGTH,
    KIND_BY_NAME,
    Field,
    Frame,
    FrameKind,
    Row,
    iso_time,
    spaced_hex,
)
from fte_sniff.tui.i18n import _, later

ELLIPSIS = "…"
"""Stands where text was cut."""

_WIDE = "\u2e80-\u9fff\uff00-\uffef"
_CLOSING = "，。；：、）”！？"
_UNITS = re.compile(rf"\s+|[（“]*[{_WIDE}][{_CLOSING}]*|[^\s{_WIDE}]+[{_CLOSING}]*")
"""What a line is not broken in; between two characters of two cells it may be."""


def fit(text: str, width: int) -> str:
    """The text in exactly `width` cells: padded at the right, or cut with an ellipsis."""
    if text.isascii():
        room = width - len(text)
        if room >= 0:
            return text + " " * room
        return text[: width - 1] + ELLIPSIS if width > 0 else ""
    if cell_len(text) <= width:
        return set_cell_size(text, width)
    return set_cell_size(text, width - 1) + ELLIPSIS if width > 0 else ""


def fit_right(text: str, width: int) -> str:
    """The text in exactly `width` cells: padded at the left, or cut with an ellipsis."""
    room = width - cell_len(text)
    return " " * room + text if room >= 0 else fit(text, width)


def fit_path(path: str, width: int) -> str:
    """A path in at most `width` cells: its end is kept, for that is what tells files apart."""
    if cell_len(path) <= width:
        return path
    kept = ""
    for character in reversed(path):
        if cell_len(kept) + cell_len(character) > width - 1:
            break
        kept = character + kept
    return ELLIPSIS + kept if width > 0 else ""


def wrap(text: str, width: int) -> list[str]:
    """The text in lines of at most `width` cells; none where there is no text."""
    width = max(1, width)
    if text.isascii():
        return wrap_ascii(text, width, break_on_hyphens=False)
    lines, line = [], ""
    for unit in _UNITS.findall(text):
        if cell_len(line + unit.rstrip()) <= width:
            line += unit
            continue
        if line.strip():
            lines.append(line.rstrip())
        *whole, line = chop_cells(unit.lstrip(), width) or [""]
        lines += whole
    return [*lines, line.rstrip()] if line.strip() else lines


def padded(text: str, width: int) -> str:
    """The text with spaces behind it up to `width` cells; as it is where it has more."""
    return text + " " * (width - cell_len(text))


def values_text(row: Row, width: int | None = None) -> str:
    """The row's values by their short names: `motor=1 rpm=1000`.

    Flag bytes are left out where they have the value of the protocol's examples, that all is in
    order; they stand among the raw bytes at any rate. Where a width is given and the text does not
    fit, names are shortened (`M1 rpm=1000`, `M1 r=1000`), then left out (`M1 1000`): the kind
    tells them.
    """
    kind = row.kind if isinstance(row, Frame) else None
    if kind is None:
        return ""
    forms = _forms(kind, row.raw)
    text = next(forms)
    while width is not None and len(text) > width:
        shorter = next(forms, None)
        if shorter is None:
            break
        text = shorter
    return text


def _forms(kind: FrameKind, raw: bytes) -> Iterator[str]:
    """The values, each form shorter than the one before."""
    values = [(field, field.read(raw)) for field in kind.fields]
    for heads in value_heads(kind):
        yield " ".join(
            head + _number(field, value)
            for head, (field, value) in zip(heads, values, strict=True)
            if is_told(field, value)
        )


def is_told(field: Field, value: int) -> bool:
    """Whether a field stands among the values: flag bytes only where they are out of order."""
    return field.defined_bits is None or field.raised(value)


def is_raised(row: Row) -> bool:
    """Whether a flag byte of the row tells something else than that all is in order."""
    kind = row.kind if isinstance(row, Frame) else None
    return kind is not None and any(field.raised(field.read(row.raw)) for field in kind.fields)


def _number(field: Field, value: int) -> str:
    return f"{value}" if field.defined_bits is None else f"{value:02X}"


def kind_text(name: str, width: int) -> str:
    """A kind's name in at most `width` cells; that it is feedback is told before all else."""
    kind = KIND_BY_NAME.get(name)
    short = short_feedback(kind, width) if kind is not None and len(name) > width else None
    return fit(name, width).rstrip() if short is None else short


def faulty_text(row: Row, width: int) -> str:
    """What is wrong, then the bytes, for where there is no room for a column of each."""
    faults = ",".join(row.faults)
    words = f"{faults}  " if faults else ""
    return fit(words + bytes_text(row.raw, width - len(words)), width)


def bytes_text(raw: bytes, width: int) -> str:
    """The bytes as hex; of a run too long for the width, the first ones and how many there are."""
    if len(raw) <= max(FRAME_LENGTH, (width + 1) // 3):
        return spaced_hex(raw)
    count = f" {ELLIPSIS} {len(raw)} bytes"
    return spaced_hex(raw[: max(0, (width - len(count) + 1) // 3)]) + count


def clock_text(t_ns: int, digits: int, zone: tzinfo = UTC) -> str:
    """The time of day in a zone, with so many digits (1-9) behind the second."""
    seconds, nanoseconds = divmod(t_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, zone):%H:%M:%S}.{nanoseconds:09d}"[: 9 + digits]


def moment_text(t_ns: int, zone: tzinfo = UTC) -> str:
    """Day and time in a zone, whole; what is not UTC says how far from it."""
    if zone == UTC:
        return iso_time(t_ns)
    seconds, nanoseconds = divmod(t_ns, 1_000_000_000)
    moment = datetime.fromtimestamp(seconds, zone)
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{nanoseconds:09d}{moment.isoformat()[19:]}"


def elapsed_text(ns: int, width: int) -> str:
    """A distance in time in seconds with its sign, with as many digits as fit into the width."""
    sign, seconds, rest = "-" if ns < 0 else "+", *divmod(abs(ns), 1_000_000_000)
    for digits in (6, 3):
        text = f"{sign}{seconds}.{rest:09d}"[: len(f"{seconds}") + 2 + digits]
        if len(text) <= width:
            return text
    return f"{sign}{seconds}"


UNKNOWN: Final = "–"
"""Stands for what was never told or cannot be."""

TURNS: Final = later("{turns:,.3f} turns")

_SPANS: Final = (
    (1_000, 1, "{:.0f} ns"),
    (1_000_000, 1_000, "{:.3g} µs"),
    (1_000_000_000, 1_000_000, "{:.3g} ms"),
    (120_000_000_000, 1_000_000_000, "{:.3g} s"),
    (7_200_000_000_000, 60_000_000_000, "{:.3g} min"),
    (172_800_000_000_000, 3_600_000_000_000, "{:.3g} h"),
)
_DAYS: Final = 86_400_000_000_000
_SHORT: Final = ((1e9, "G"), (1e6, "M"), (1e4, "k"))
_BLOCKS: Final = " ▁▂▃▄▅▆▇█"


def span_text(ns: float | None) -> str:
    """A duration of 0 or more nanoseconds in three digits: `2.15 ms`."""
    if ns is None:
        return UNKNOWN
    for below, unit, form in _SPANS:
        # What rounds up to the next unit is told in that.
        if ns < below * 0.9995:
            return _plain(form, ns / unit)
    return _("{days:,.0f} days").format(days=ns / _DAYS)


def _plain(form: str, number: float) -> str:
    """Three digits, but never with an exponent."""
    return form.replace(".3g", ".0f").format(number) if number >= 100 else form.format(number)


def rate_text(per_s: float | None) -> str:
    """A rate: `12.5/s`; what comes now and then does not come 0 times."""
    if per_s is None:
        return UNKNOWN
    if 0 < per_s < 0.05:
        return "<0.1/s"
    return f"{per_s:,.0f}/s" if per_s >= 1000 else f"{per_s:.1f}/s"


def share_text(share: float | None) -> str:
    """A share of 1: `12.5 %`; what there is a little of is not 0."""
    if share is None:
        return UNKNOWN
    return "<0.1 %" if 0 < share < 0.0005 else f"{share * 100:.1f} %"


def short_number(value: float) -> str:
    """A number of up to ten digits in at most six cells: `-12.3k`."""
    for unit, sign in _SHORT:
        if abs(value) >= unit:
            scaled = value / (1e3 if sign == "k" else unit)
            return f"{scaled:.0f}{sign}" if abs(scaled) >= 100 else f"{scaled:.3g}{sign}"
    return f"{value:.0f}"


def turns_text(pulses: int, bench: LineSetup) -> str:
    """A position in turns; empty where nobody said how many pulses a turn has."""
    turns = bench.turns(pulses)
    return "" if turns is None else _(TURNS).format(turns=turns)


def sparkline(values: Sequence[float], width: int, full: float | None = None) -> str:
    """The values as blocks in `width` cells: the greatest of those that share a cell.

    `full` is what fills a cell; by default the greatest of all. Only 0 leaves a cell empty.
    """
    if not values or width < 1:
        return ""
    width = min(width, len(values))
    edges = [len(values) * cell // width for cell in range(width + 1)]
    tops = [max(values[edges[cell] : edges[cell + 1]]) for cell in range(width)]
    most = full or max(tops) or 1
    steps = len(_BLOCKS) - 1
    return "".join(
        _BLOCKS[min(steps, max(1, round(top / most * steps))) if top > 0 else 0] for top in tops
    )


_SEPARATORS = "/\\:?& "


def short_names(names: Sequence[str], width: int) -> dict[str, str]:
    """Each name in at most `width` cells, and no two alike as far as the width allows.

    What all begin with is left out up to the last part of a path. What is still too long is cut in
    its middle; where that would make two alike, at its start; and else each has its number.
    """
    parts = _without_prefix(names)
    ways = (
        [_cut_middle(part, width) for part in parts],
        [fit_path(part, width) for part in parts],
        [fit(part, width).rstrip() for part in parts],
    )
    numbered = [fit(f"{at} {part}", width).rstrip() for at, part in enumerate(parts, 1)]
    chosen = next((way for way in ways if len(set(way)) == len(set(names))), numbered)
    return dict(zip(names, chosen, strict=True))


def _without_prefix(names: Sequence[str]) -> list[str]:
    signs = zip(*names, strict=False) if len(set(names)) > 1 else ()
    common = "".join(sign[0] for sign in takewhile(lambda sign: len(set(sign)) == 1, signs))
    start = 1 + max(common.rfind(separator) for separator in _SEPARATORS)
    parts = [name[start:] for name in names]
    return parts if all(parts) else list(names)


def _cut_middle(text: str, width: int) -> str:
    if cell_len(text) <= width:
        return text
    left = (width - 1) // 2
    return fit(text, left + 1).rstrip(ELLIPSIS).rstrip() + fit_path(text, width - left)
