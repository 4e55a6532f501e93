"""Owns which rows are commands to a motor, and which are feedback from it.

It must not know what is made of them. A reset and a motion of the chassis name no motor and are
commands to every one. A frame with a motor number that there cannot be is nobody's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from fte_sniff.analysis.columns.fields import Bools, Decoded, Ints
from fte_sniff.protocol import KINDS, MOTORS, Direction


def _having(keep: Iterator[bool]) -> Bools:
    """By kind code, `NO_KIND` included, which never has what is asked for."""
    return np.array([*keep, False])


_COMMANDS: Final = _having(kind.direction is Direction.CONTROL for kind in KINDS)
_FEEDBACK: Final = _having(kind.direction is Direction.FEEDBACK for kind in KINDS)
_NAMES_MOTOR: Final = _having(kind.names_motor for kind in KINDS)


@dataclass(frozen=True, slots=True)
class Addressed:
    """The places, rising, of one batch's rows that concern motors."""

    commands: dict[int, Ints]
    """To each motor."""
    feedback: dict[int, Ints]
    """From each motor."""
    any_feedback: Ints
    """From all motors, in the order of the rows."""


def addressed(rows: Decoded) -> Addressed:
    """Whom the rows are to, and from."""
    commands = np.flatnonzero(_COMMANDS[rows.kinds])
    feedback = np.flatnonzero(_FEEDBACK[rows.kinds])
    to_all, to = ~_NAMES_MOTOR[rows.kinds[commands]], rows.nums[commands]
    answering = rows.nums[feedback]
    return Addressed(
        {motor: commands[(to == motor) | to_all] for motor in MOTORS},
        {motor: feedback[answering == motor] for motor in MOTORS},
        feedback[(answering >= MOTORS[0]) & (answering <= MOTORS[-1])],
    )
