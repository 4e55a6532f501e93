"""Owns the short names of kinds and values, for where there is little room, and for finding them.

It must not know how much room there is, nor a row. They come from the frame table: what has no unit
keeps its first letter, feedback is `fb`.

    speed_feedback     motor=1 rpm=1000 error=08
    speed fb           M1 rpm=1000 E08
                       M1 r=1000 E08
                       M1 1000 E08
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

from fte_sniff.protocol import Direction, Field, FrameKind

FEEDBACK = "fb"
"""What stands for the word feedback where a kind's name does not fit."""


VALUE_FORMS = 4
"""How many forms `value_heads` has."""


def short_feedback(kind: FrameKind, width: int) -> str | None:
    """A feedback kind's name in at most `width` cells, short; None of a command."""
    if kind.direction is not Direction.FEEDBACK:
        return None
    stem = kind.name.removesuffix(f"_{Direction.FEEDBACK}")
    return f"{stem[: max(0, width - len(FEEDBACK) - 1)]} {FEEDBACK}"[: max(0, width)]


@cache
def value_heads(kind: FrameKind) -> tuple[tuple[str, ...], ...]:
    """What stands before the value of each of a kind's fields, each form shorter than the last."""
    fields = kind.fields
    short = _shortest([field.option for field in fields])
    return (
        tuple(f"{field.option}=" for field in fields),
        tuple(_letter(field) or f"{field.option}=" for field in fields),
        tuple(_letter(field) or f"{short[field.option]}=" for field in fields),
        tuple(_letter(field) for field in fields),
    )


def _letter(field: Field) -> str:
    """The first letter of the name of what has no unit."""
    return "" if field.unit else field.option[0].upper()


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
