"""Events of each motor over time: commands without an answer, late answers, damage, flags.

lanes of a motor      x    xx x        commands without an answer, at the time of the command
                       >  >            answers that came later than usual
                          !  !!        damaged rows that were probably to or from the motor
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Final

import numpy as np

from fte_sniff.analysis.counters import RecentValues
from fte_sniff.analysis.motors import Motors, motor_rows
from fte_sniff.analysis.series import Series
from fte_sniff.protocol import MOTORS
from fte_sniff.protocol.rows import NO_TIME, Bools, Ints, Rows
from fte_sniff.protocol.spec import Role, motor_bit


class MotorEvent(IntEnum):
    """What can be wrong, the gravest first; the value is its number among the series."""

    UNANSWERED = 0
    DAMAGE = 1
    LATE = 2
    FLAGS = 3
    """ERROR is not 00, or the motor's bit in ONLINE is missing."""


_ASKED: Final = len(MotorEvent)
"""Number of the series of commands whose answer came, or is missing."""

_GROUPS: Final = len(MotorEvent) + 1

FINEST_NS: Final = 1 << 22
"""Length of the shortest windows, nanoseconds: about 4 ms."""

_WINDOWS: Final = 2048
_LEVELS: Final = 6

LATE: Final = 2.0
"""An answer is late after this many times the median of the motor's latest answer times."""

_LEAST_ANSWERS: Final = 8
"""Answers from which on it is known what is usual."""

TROUBLED: Final = 0.02
"""Share of a motor's commands: with more events something is wrong."""

_LATEST: Final = 8192
"""Answer times of all motors that are kept, for percentiles of the last seconds."""


class Health(Enum):
    """How a motor answered in a span of time."""

    SOUND = "in the last 10 s its commands were answered, and at most 2 % had an event"
    TROUBLED = "events at more than 2 % of its commands: unanswered, late, damage, flags"
    SILENT = "none of its commands was answered"


@dataclass(frozen=True, slots=True)
class EventCounts:
    """Events of one motor in a span of time."""

    asked: int
    """Commands whose answer came, or is missing."""
    events: Mapping[MotorEvent, int]

    @property
    def unanswered(self) -> int:
        """Commands without an answer."""
        return self.events[MotorEvent.UNANSWERED]


class MotorEvents:
    """Events of all motors; rows without a time are ignored."""

    def __init__(self) -> None:
        self._series = Series(shortest_ns=FINEST_NS, windows=_WINDOWS, levels=_LEVELS)
        self._delays, self._ends = RecentValues(_LATEST), RecentValues(_LATEST)

    def observe(self, rows: Rows, motors: Motors) -> None:
        """Add the next rows, which `motors` has just observed."""
        found = motor_rows(rows)
        feedback = found.feedback
        for motor, decided in motors.decided.items():
            self._add(motor, _ASKED, decided.commands_ns)
            self._add(motor, MotorEvent.UNANSWERED, decided.commands_ns[~decided.answered])
            usual = motors.usual_delay_ns(motor, _LEAST_ANSWERS)
            if usual is not None:
                late = decided.delays_ns > LATE * usual
                self._add(motor, MotorEvent.LATE, decided.ends_ns[late])
            delays, ends = decided.measured
            self._delays.observe(delays)
            self._ends.observe(ends)
            at = feedback[motor]
            self._add(motor, MotorEvent.FLAGS, rows.t_ns[at[_raised(rows, at, motor)]])

    def observe_facts(self, rows: Rows) -> None:
        """Add the damage among the next rows whose facts are known."""
        for motor in MOTORS if (rows.motor_hint > 0).any() else ():
            self._add(motor, MotorEvent.DAMAGE, rows.t_ns[rows.motor_hint == motor])

    def _add(self, motor: int, number: int, t_ns: Ints) -> None:
        known = t_ns[t_ns != NO_TIME] if len(t_ns) else t_ns
        if len(known):
            self._series.observe(known, group=_group(motor, number))

    def ticks(self, motor: int, event: MotorEvent, span: tuple[int, int], columns: int) -> Ints:
        """The number of events in columns of a span (a start and an exclusive end)."""
        return self._series.totals(_group(motor, event), span, columns)

    def counts(self, motor: int, span: tuple[int, int]) -> EventCounts:
        """The events in a span."""
        asked, *events = (
            int(self._series.totals(_group(motor, number), span, 1)[0])
            for number in (_ASKED, *MotorEvent)
        )
        return EventCounts(asked, dict(zip(MotorEvent, events, strict=True)))

    def health(self, span: tuple[int, int]) -> Mapping[int, Health]:
        """How each motor answered in a span; motors without commands and events are left out."""
        found = {}
        for motor in MOTORS:
            counts = self.counts(motor, span)
            if counts.asked and counts.unanswered == counts.asked:
                found[motor] = Health.SILENT
            elif sum(counts.events.values()) > TROUBLED * counts.asked:
                found[motor] = Health.TROUBLED
            elif counts.asked:
                found[motor] = Health.SOUND
        return found

    def delay_ns(self, percent: float, span: tuple[int, int]) -> int | None:
        """A percentile (0 to 100) of the answer times that ended in a span; None without any."""
        ends = self._ends.values
        delays = self._delays.values[(ends >= span[0]) & (ends < span[1])]
        if not len(delays):
            return None
        return int(np.percentile(delays, percent, method="inverted_cdf"))


def _group(motor: int, number: int) -> int:
    return (motor - MOTORS[0]) * _GROUPS + number


def _raised(rows: Rows, at: Ints, motor: int) -> Bools:
    """Which of the rows of a motor's feedback report an error, or the motor as not online."""
    online = rows.values(Role.ONLINE, at) >> motor_bit(motor) & 1
    raised: Bools = (rows.values(Role.ERRORS, at) != 0) | (online == 0)
    return raised
