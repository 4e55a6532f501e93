"""Values of many frames: kind and fields from their bytes; short names for display."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from fte_sniff.protocol import FRAME_LENGTH, KINDS, VALUE_FIELDS, Direction, Field, FrameKind
from fte_sniff.protocol.spec import CMD_OFFSET, FTE_FORMAT, NUM_OFFSET
from fte_sniff.row_batch import RowBatch

Array: TypeAlias = npt.NDArray[Any]
Bools: TypeAlias = npt.NDArray[np.bool_]
Codes: TypeAlias = npt.NDArray[np.uint8]
Ints: TypeAlias = npt.NDArray[np.int64]

NO_KIND: Final = len(KINDS)
"""The kind code of a row without a kind."""

NO_TIME: Final = -(2**63)
"""Time of a row without one."""


def _field_positions() -> dict[str, dict[tuple[int, int, bool], Bools]]:
    """By field name: its positions (start, size, signed), each with a mask of the kinds."""
    places: dict[str, dict[tuple[int, int, bool], Bools]] = {}
    for code, kind in enumerate(KINDS):
        for field in kind.fields:
            place = (field.start, field.size, field.signed)
            kinds = places.setdefault(field.name, {}).setdefault(
                place, np.zeros(len(KINDS) + 1, np.bool_)
            )
            kinds[code] = True
    return places


_KIND_CODES: Final = np.frombuffer(FTE_FORMAT.kind_codes(NO_KIND), np.uint8)
_FIELD_POSITIONS: Final = _field_positions()


def kind_codes(raw: Array, framed: Bools) -> Codes:
    """The index in `KINDS` of every row's kind, `NO_KIND` without one.

    `raw` has the first ten bytes of every row; `framed` is whether it is a frame.
    """
    kinds: Codes = _KIND_CODES.take(
        raw[:, 0].astype(np.uint16) << np.uint16(8) | raw[:, CMD_OFFSET]
    )
    kinds[~framed] = NO_KIND
    return kinds


def raised(rows: RowBatch) -> Bools:
    """Which rows are frames with a flag byte that is not in order; `Field.raised` for a batch."""
    raw, kinds = np.ascontiguousarray(rows.raw), kind_codes(rows.raw, rows.framed)
    found: Bools = np.zeros(len(rows), np.bool_)
    for field in VALUE_FIELDS:
        if field.defined_bits is not None:
            values, known = field_values(raw, kinds, field.name)
            found |= known & (values != field.default)
    return found


def field_values(raw: Array, kinds: Codes, name: str) -> tuple[Array, Bools]:
    """A field's value in every row, as wide as on the wire, and a mask of the rows that have it."""
    (place, having), *others = _FIELD_POSITIONS[name].items()
    values, known = read_field(raw, *place), having.take(kinds)
    for place, having in others:
        here = having.take(kinds)
        np.copyto(values, read_field(raw, *place), where=here)
        known |= here
    return values, known


def read_field(raw: Array, start: int, size: int, signed: bool) -> Array:
    """One field in every row; fields are big-endian (PROTOCOL.md, "Framing")."""
    wire = np.dtype(f">{'i' if signed else 'u'}{size}")
    if not len(raw):
        return np.empty(0, wire.newbyteorder("="))
    found: Array = np.ndarray((len(raw),), wire, np.ascontiguousarray(raw), start, (FRAME_LENGTH,))
    return found.astype(wire.newbyteorder("="))


class Decoded:
    """A batch with the columns that the models read."""

    def __init__(self, rows: RowBatch) -> None:
        self.rows = rows
        self.raw: npt.NDArray[np.uint8] = np.ascontiguousarray(rows.raw)
        """The first ten bytes of every row."""
        self.kinds = kind_codes(self.raw, rows.framed)
        """The index in `KINDS` of every row's kind; `NO_KIND` for rows without one."""
        self.has_time: Bools = rows.timed
        self.t_ns: Ints = np.where(rows.timed, rows.t_ns, NO_TIME)
        """Nanoseconds since 1970 UTC, or `NO_TIME`."""
        self.cmds = np.ascontiguousarray(self.raw[:, CMD_OFFSET])
        self.nums = np.ascontiguousarray(self.raw[:, NUM_OFFSET])

    def __len__(self) -> int:
        return len(self.rows)

    def value(self, name: str, place: int) -> int:
        """One field of the row at an index, which must have it."""
        return int(self.values(name, np.array([place]))[0])

    def values(self, name: str, places: Ints) -> Ints:
        """One field of the rows at these indices, which all must have it."""
        values, _ = field_values(self.raw[places], self.kinds[places], name)
        return values.astype(np.int64)


def subject(kind: FrameKind) -> str | None:
    """The main value of a kind: its last field with a unit, a speed or a position.

    None if the kind has no such field.
    """
    numbers = [field.name for field in kind.fields if field.unit]
    return numbers[-1] if numbers else None


FEEDBACK = "fb"
"""Abbreviation of "feedback" where a kind's name does not fit."""

VALUE_FORMS = 4
"""Number of forms of `value_heads`."""


def short_feedback(kind: FrameKind, width: int) -> str | None:
    """A feedback kind's name shortened to at most `width` cells; None for a command."""
    if kind.direction is not Direction.FEEDBACK:
        return None
    stem = kind.name.removesuffix(f"_{Direction.FEEDBACK}")
    return f"{stem[: max(0, width - len(FEEDBACK) - 1)]} {FEEDBACK}"[: max(0, width)]


@cache
def value_heads(kind: FrameKind) -> tuple[tuple[str, ...], ...]:
    """The labels of a kind's fields, in forms of falling length."""
    fields = kind.fields
    short = _shortest([field.option for field in fields])
    return (
        tuple(f"{field.option}=" for field in fields),
        tuple(_letter(field) or f"{field.option}=" for field in fields),
        tuple(_letter(field) or f"{short[field.option]}=" for field in fields),
        tuple(_letter(field) for field in fields),
    )


def _letter(field: Field) -> str:
    return "" if field.unit else field.option[0].upper()


def _shortest(names: Sequence[str]) -> dict[str, str]:
    """The shortest unique prefix of each name."""
    return {
        name: next(
            name[:size]
            for size in range(1, len(name) + 1)
            if size == len(name) or sum(other.startswith(name[:size]) for other in names) == 1
        )
        for name in names
    }
