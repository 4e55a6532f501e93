"""Owns the text of single cells: a row's values, bytes, times and kind in a number of cells.

It must not know which columns there are or how wide they are; the width comes with the question.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime

from fte_sniff.protocol import (
    FRAME_LENGTH,
    KIND_BY_NAME,
    Direction,
    Field,
    Frame,
    FrameKind,
    Row,
    spaced_hex,
)
from fte_sniff.tui.fitting import ELLIPSIS, fit

FEEDBACK = "fb"
"""What stands for the word feedback where a kind's name does not fit."""


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
    told = [(field, field.read(raw)) for field in kind.fields]
    told = [(field, value) for field, value in told if is_told(field, value)]
    yield " ".join(f"{field.option}={_number(field, value)}" for field, value in told)
    yield " ".join(_short(field, value, f"{field.option}=") for field, value in told)
    short = _shortest([field.option for field, _ in told])
    yield " ".join(_short(field, value, f"{short[field.option]}=") for field, value in told)
    yield " ".join(_short(field, value, "") for field, value in told)


def _shortest(names: Sequence[str]) -> dict[str, str]:
    """Of each name so much that no other begins alike."""
    return {
        name: next(
            name[:size]
            for size in range(1, len(name) + 1)
            if size == len(name) or sum(other.startswith(name[:size]) for other in names) == 1
        )
        for name in names
    }


def is_told(field: Field, value: int) -> bool:
    """Whether a field stands among the values: flag bytes only where they are out of order."""
    return field.defined_bits is None or field.raised(value)


def is_raised(row: Row) -> bool:
    """Whether a flag byte of the row tells something else than that all is in order."""
    kind = row.kind if isinstance(row, Frame) else None
    return kind is not None and any(field.raised(field.read(row.raw)) for field in kind.fields)


def _number(field: Field, value: int) -> str:
    return f"{value}" if field.defined_bits is None else f"{value:02X}"


def _short(field: Field, value: int, name: str) -> str:
    """A value by a short name; what has no unit keeps the first letter of its own."""
    first = "" if field.unit else field.option[0].upper()
    return f"{first or name}{_number(field, value)}"


def kind_text(name: str, width: int) -> str:
    """A kind's name in at most `width` cells; that it is feedback is told before all else."""
    kind = KIND_BY_NAME.get(name)
    if len(name) <= width or kind is None or kind.direction is not Direction.FEEDBACK:
        return fit(name, width).rstrip()
    stem = name.removesuffix(f"_{Direction.FEEDBACK}")
    return f"{stem[: max(0, width - len(FEEDBACK) - 1)]} {FEEDBACK}"[: max(0, width)]


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


def clock_text(t_ns: int, digits: int) -> str:
    """The time of day, UTC, with so many digits (1-9) behind the second."""
    seconds, nanoseconds = divmod(t_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%H:%M:%S}.{nanoseconds:09d}"[: 9 + digits]


def span_text(ns: int, width: int) -> str:
    """A distance in time in seconds with its sign, with as many digits as fit into the width."""
    sign, seconds, rest = "-" if ns < 0 else "+", *divmod(abs(ns), 1_000_000_000)
    for digits in (6, 3):
        text = f"{sign}{seconds}.{rest:09d}"[: len(f"{seconds}") + 2 + digits]
        if len(text) <= width:
            return text
    return f"{sign}{seconds}"
