"""The motors at a row: targets, present values, flags, answers, and which one is in trouble.

All of it is a function of the rows before that row, so it is the same live, at the cursor of a
recording, and after any filter. A screen calls it with the rows of some seconds:

    rows = store.batch(first, index + 1)
    states = motors_at(rows, store.runs(first, index + 1))
    states[0].trouble, states[0].text          # Trouble.ERROR, "ERROR 04"
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import Final, NamedTuple

import numpy as np
import polars as pl

from fte_sniff.analysis.events import is_more, off_target
from fte_sniff.analysis.relations import (
    ANSWERABLE,
    COMMANDS,
    FEEDBACK,
    NAMES_MOTOR,
    AnswerState,
    Runs,
    answers,
    feedback_with,
    last_of,
    with_late,
)
from fte_sniff.errors import TranslatableText
from fte_sniff.protocol.rows import NO_TIME, Bools, Row, Rows
from fte_sniff.protocol.spec import MOTORS, Role, motor_bit

HEALTH_NS: Final = 10_000_000_000
"""Time over which a motor's answers, damage and flags are judged."""

TROUBLED: Final = 0.02
"""Share of a motor's commands without an answer, or of its rows that are damaged, at most."""


class Trouble(Enum):
    """What is wrong with a motor in the last 10 s, the most serious first."""

    SILENT = "silent"
    """Commands went on, and it sent nothing."""
    OFFLINE = "offline"
    """Its bit in the latest ONLINE byte is 0."""
    ERROR = "ERROR"
    """Its latest ERROR byte is not 00."""
    UNANSWERED = "unanswered"
    DAMAGE = "damage"
    LATE = "late"
    OFF_TARGET = "off target"
    NONE = "ok"
    UNKNOWN = "–"
    """It had neither commands nor feedback."""


class MotorState(NamedTuple):
    """State of one motor at one row; an unknown value is None, never 0."""

    motor: int
    target: Row | None
    """The latest command to it, also of a command to all motors."""
    present: Sequence[Row]
    """The latest frame of each kind of feedback."""
    answered: int
    """Commands in the last 10 s that were answered; 0 where that cannot be known."""
    unanswered: int
    delay_p99_ns: float | None
    trouble: Trouble
    text: str
    """The trouble in a word or two; `ERROR 04` names the byte."""


def motors_at(rows: Rows, runs: Runs, now_ns: int | None = None) -> list[MotorState]:
    """The state of every motor after some rows, which have their facts, at a time not before."""
    now_ns = max(int(rows.t_ns.max(initial=NO_TIME)), now_ns or NO_TIME)
    found = with_late(answers(rows, runs)).filter(pl.col("cmd").is_in(ANSWERABLE))
    is_recent = rows.t_ns > now_ns - HEALTH_NS
    found = found.with_columns(recent=pl.Series(is_recent).gather(found["command"]))
    off = off_target(rows.select(is_recent), runs["number"][is_recent])
    return [_state(rows, found, motor, is_recent, motor in off) for motor in MOTORS]


def _state(
    rows: Rows, found: pl.DataFrame, motor: int, is_recent: Bools, is_off: bool
) -> MotorState:
    kinds, own = rows.kinds, rows.nums == motor
    commands = np.flatnonzero(COMMANDS[kinds] & (own | ~NAMES_MOTOR[kinds]))
    feedback = np.flatnonzero(FEEDBACK[kinds] & own)
    _, online = feedback_with(rows, Role.ONLINE)
    at, errors = feedback_with(rows, Role.ERRORS)
    error = int(errors[own[at]][-1:].sum())
    recent = found.filter(pl.col("motor") == motor, "recent")
    answered = int((recent["state"] == AnswerState.ANSWERED).sum())
    unanswered = int((recent["state"] == AnswerState.UNANSWERED).sum())
    damaged = np.count_nonzero((rows.motor_hint == motor) & is_recent)
    asked, received = answered + unanswered, np.count_nonzero(is_recent[feedback])
    troubles = {
        Trouble.UNKNOWN: not asked and not received,
        Trouble.SILENT: unanswered > 0 and not received,
        Trouble.OFFLINE: not (online[-1:] >> motor_bit(motor) & 1).all(),
        Trouble.ERROR: error > 0,
        Trouble.UNANSWERED: unanswered > TROUBLED * asked,
        Trouble.DAMAGE: damaged > TROUBLED * (received + asked),
        Trouble.LATE: _is_late(found, motor),
        Trouble.OFF_TARGET: is_off,
    }
    trouble = next((one for one, holds in troubles.items() if holds), Trouble.NONE)
    return MotorState(
        motor=motor,
        target=rows[int(commands[-1])] if len(commands) else None,
        present=[*rows.select(feedback[last_of(kinds[feedback].astype(np.int64))])],
        answered=answered,
        unanswered=unanswered,
        delay_p99_ns=recent["delay_ns"].quantile(0.99, "equiprobable"),
        trouble=trouble,
        text=f"ERROR {error:02X}" if trouble is Trouble.ERROR else TranslatableText(trouble.value),
    )


def _is_late(found: pl.DataFrame, motor: int) -> bool:
    """Whether more answers of the last 10 s are late than before, or than those of each other."""
    counts = (
        found.drop_nulls("late").group_by("motor", "recent").agg(pl.col("late").sum(), n=pl.len())
    )
    own = {(of, recent): (late, n) for of, recent, late, n in counts.iter_rows()}
    now, before = own.get((motor, True), (0, 0)), own.get((motor, False))
    others = [value for (of, recent), value in own.items() if recent and of != motor]
    most = max(others, key=lambda one: one[0] / one[1], default=None)
    return any(is_more(now, one) for one in (before, most) if one is not None)
