"""The motors at a row, from the rows before it: targets, present values, flags, answers, health."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Final

import numpy as np
import polars as pl

from fte_sniff.analysis.whole.relations import (
    ANSWERABLE,
    COMMANDS,
    FEEDBACK,
    NAMES_MOTOR,
    AnswerState,
    Runs,
    answers,
)
from fte_sniff.protocol import KINDS, MOTORS, FrameKind
from fte_sniff.protocol.rows import NO_TIME, Ints, Rows
from fte_sniff.protocol.spec import NAME_OF_ROLE, Role, motor_bit

LOOK_BACK: Final = 20_000
"""Rows before a row among which the state of the motors is looked for."""

RATE_NS: Final = 2_000_000_000
HEALTH_NS: Final = 10_000_000_000
LATE: Final = 2.0
TROUBLED: Final = 0.02
"""Share of a motor's commands: with more events something is wrong."""


class Health(Enum):
    """How a motor answered in the last 10 s."""

    SOUND = "in the last 10 s its commands were answered, and at most 2 % had an event"
    TROUBLED = "events at more than 2 % of its commands: unanswered, late, damage, flags"
    SILENT = "none of its commands was answered"


@dataclass(frozen=True, slots=True)
class Reading:
    """A value, the time of its frame, and since when it has been the same."""

    value: Mapping[str, int]
    kind: FrameKind
    t_ns: int | None
    since_ns: int | None


@dataclass(frozen=True, slots=True)
class MotorState:
    """State of one motor at one row; an unknown value is None, never 0."""

    motor: int
    target: Reading | None
    present: Mapping[FrameKind, Reading]
    """By kind of feedback, the latest frame."""
    online: bool | None
    """Its bit in the ONLINE byte of the latest feedback of any motor."""
    commands_per_s: float | None
    feedback_per_s: float | None
    answered: int
    unanswered: int
    """Commands in the last 10 s."""
    delay_p50_ns: float | None
    delay_p99_ns: float | None
    health: Health | None


def motors_at(rows: Rows, runs: Runs) -> list[MotorState]:
    """The state of every motor after the last of some rows, which have their facts."""
    now_ns = int(rows.t_ns.max(initial=NO_TIME))
    recent = answers(rows, runs)
    return [_state(rows, recent, motor, now_ns) for motor in MOTORS]


def _state(rows: Rows, found: pl.DataFrame, motor: int, now_ns: int) -> MotorState:
    own = rows.nums == motor
    commands = np.flatnonzero(COMMANDS[rows.kinds] & (own | ~NAMES_MOTOR[rows.kinds]))
    anyone = np.flatnonzero(FEEDBACK[rows.kinds])
    feedback = anyone[own[anyone]]
    online = rows.values(Role.ONLINE, anyone[-1:]) >> motor_bit(motor) & 1
    t_ns = rows.t_ns[found["command"].to_numpy()]
    mine = found.filter(
        pl.col("motor") == motor, pl.col("cmd").is_in(ANSWERABLE), pl.Series(t_ns > now_ns - HEALTH_NS)
    )
    answered = int((mine["state"] == AnswerState.ANSWERED).sum())
    unanswered = int((mine["state"] == AnswerState.UNANSWERED).sum())
    delays = mine["delay_ns"]
    damaged = np.count_nonzero((rows.motor_hint == motor) & (rows.t_ns > now_ns - HEALTH_NS))
    late = int((delays > LATE * (delays.median() or 0)).sum())  # type: ignore[operator]
    flagged = feedback[rows.t_ns[feedback] > now_ns - HEALTH_NS]
    raised = np.count_nonzero(rows.values(Role.ERRORS, flagged))
    return MotorState(
        motor=motor,
        target=_reading(rows, commands),
        present={
            KINDS[code]: reading
            for code in np.unique(rows.kinds[feedback]).tolist()
            if (reading := _reading(rows, feedback[rows.kinds[feedback] == code]))
        },
        online=bool(online[0]) if len(online) else None,
        commands_per_s=_rate(rows.t_ns[commands], now_ns),
        feedback_per_s=_rate(rows.t_ns[feedback], now_ns),
        answered=answered,
        unanswered=unanswered,
        delay_p50_ns=delays.quantile(0.5, "equiprobable"),
        delay_p99_ns=delays.quantile(0.99, "equiprobable"),
        health=_health(answered, unanswered, late + raised + int(damaged)),
    )


def _health(answered: int, unanswered: int, events: int) -> Health | None:
    if not answered + unanswered:
        return None
    if not answered:
        return Health.SILENT
    troubled = events + unanswered > TROUBLED * (answered + unanswered)
    return Health.TROUBLED if troubled else Health.SOUND


def _reading(rows: Rows, at: Ints) -> Reading | None:
    """The last of some frames of a motor, and since when its bytes have been the same."""
    if not len(at):
        return None
    last = int(at[-1])
    kind = KINDS[rows.kinds[last]]
    values = {one.name: one.read(rows.raw[last].tobytes()) for one in kind.fields}
    values.pop(NAME_OF_ROLE[Role.MOTOR], None)
    others = np.flatnonzero((rows.raw[at] != rows.raw[last]).any(axis=1))
    first = at[others[-1] + 1] if len(others) else at[0]
    times = (None if rows.t_ns[one] == NO_TIME else int(rows.t_ns[one]) for one in (last, first))
    return Reading(values, kind, *times)


def _rate(t_ns: Ints, now_ns: int) -> float | None:
    """The rate in the last two seconds; None without times."""
    if not len(t_ns) or now_ns == NO_TIME:
        return None
    return np.count_nonzero(t_ns > now_ns - RATE_NS) * 1e9 / RATE_NS
