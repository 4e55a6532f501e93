"""Owns the text of single cells: a row's values, bytes, times and kind in a number of cells.

It must not know which columns there are or how wide they are; the width comes with the question.
"""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, tzinfo

from fte_sniff.analysis.fields import short_feedback, value_heads
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
from fte_sniff.tui.fitting import ELLIPSIS, fit


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


def span_text(ns: int, width: int) -> str:
    """A distance in time in seconds with its sign, with as many digits as fit into the width."""
    sign, seconds, rest = "-" if ns < 0 else "+", *divmod(abs(ns), 1_000_000_000)
    for digits in (6, 3):
        text = f"{sign}{seconds}.{rest:09d}"[: len(f"{seconds}") + 2 + digits]
        if len(text) <= width:
            return text
    return f"{sign}{seconds}"
