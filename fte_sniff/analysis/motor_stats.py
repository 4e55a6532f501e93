"""Flags seen and answer times."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fte_sniff.analysis.counters import Durations
from fte_sniff.analysis.fields import NO_TIME, Bools, Decoded, Ints
from fte_sniff.analysis.motors import Addressed, Pairing, PendingCommands
from fte_sniff.protocol import MOTORS

BITS = range(8)


@dataclass(slots=True)
class FlagCount:
    """How often something was so, and when it was first and last."""

    frames: int = 0
    first_ns: int | None = None
    """Nanoseconds since 1970 UTC; None where no such frame has a time."""
    last_ns: int | None = None

    def add(self, having: Bools, t_ns: Ints) -> None:
        """Frames, those that have it, and their times."""
        times = t_ns[having]
        self.frames += len(times)
        times = times[times != NO_TIME]
        if len(times):
            self.first_ns = int(times[0]) if self.first_ns is None else self.first_ns
            self.last_ns = int(times[-1])


@dataclass(slots=True)
class FlagNumbers:
    """What was told of one motor."""

    motor: int
    error_bits: dict[int, FlagCount] = field(default_factory=dict)
    """By bit of ERROR, from 0; only those that were ever set in this motor's feedback."""
    offline: FlagCount = field(default_factory=FlagCount)
    """Feedback of any motor whose ONLINE byte lacks this motor's bit."""
    times_lost: int = 0
    """How often the bit was there, and then was not."""


class FlagsSeen:
    """The flags of every motor so far."""

    def __init__(self) -> None:
        self._motors = {number: FlagNumbers(number) for number in MOTORS}
        self._online: int | None = None

    def add(self, rows: Decoded, found: Addressed) -> None:
        """The next rows, in order of time, and whom they are to and from."""
        for number, places in found.feedback.items():
            self._add_errors(self._motors[number], rows.values("error", places), rows.t_ns[places])
        places = found.any_feedback
        if len(places):
            self._add_online(rows.values("online", places), rows.t_ns[places])

    def _add_errors(self, motor: FlagNumbers, errors: Ints, t_ns: Ints) -> None:
        ever = int(np.bitwise_or.reduce(errors)) if len(errors) else 0
        for bit in BITS:
            if ever >> bit & 1:
                having = (errors >> bit & 1).astype(np.bool_)
                motor.error_bits.setdefault(bit, FlagCount()).add(having, t_ns)

    def _add_online(self, online: Ints, t_ns: Ints) -> None:
        before = online[0] if self._online is None else self._online
        lost = np.concatenate(([before], online[:-1])) & ~online
        always = int(np.bitwise_and.reduce(online))
        for number, motor in self._motors.items():
            bit = number - MOTORS[0]
            if not always >> bit & 1:
                motor.offline.add((online >> bit & 1) == 0, t_ns)
                motor.times_lost += int((lost >> bit & 1).sum())
        self._online = int(online[-1])

    def numbers(self) -> list[FlagNumbers]:
        """Every motor, by its number."""
        for motor in self._motors.values():
            motor.error_bits = dict(sorted(motor.error_bits.items()))
        return list(self._motors.values())


@dataclass(frozen=True, slots=True)
class AnswerNumbers:
    """One motor."""

    motor: int
    commands: int
    """Frames to it; a reset and a motion of the chassis are commands to every motor."""
    feedback: int
    """Frames from it."""
    answered: int
    unanswered: int
    """Commands by whether feedback came before the next one; those that await none are neither."""
    neither: int
    """Commands that await no feedback, and those behind which the rows end or were left out."""
    waiting: bool
    """Whether the last command was neither answered nor followed by another."""
    delays: Durations
    """From each command to its answer; its ends are when the answer came."""


class _Motor:
    """One motor as the rows run."""

    def __init__(self) -> None:
        self.commands = self.feedback = 0
        self.pairing = Pairing()
        self.delays = Durations()


class Answers:
    """The commands and the feedback of every motor so far."""

    def __init__(self) -> None:
        self._motors = {number: _Motor() for number in MOTORS}

    def add(self, rows: Decoded, found: Addressed) -> None:
        """The next rows, in order of time, and whom they are to and from."""
        for number, motor in self._motors.items():
            commands, feedback = found.commands[number], found.feedback[number]
            motor.commands += len(commands)
            motor.feedback += len(feedback)
            took = motor.pairing.add(
                PendingCommands.of(rows, commands), PendingCommands.of(rows, feedback)
            )
            motor.delays.add(took.delays_ns, took.ends_ns)

    def interrupt(self) -> None:
        """Rows are missing here: no answer is looked for behind this."""
        for motor in self._motors.values():
            motor.pairing.interrupt()

    def numbers(self) -> list[AnswerNumbers]:
        """Every motor, by its number."""
        return [
            AnswerNumbers(
                number,
                motor.commands,
                motor.feedback,
                motor.pairing.answered,
                motor.pairing.unanswered,
                motor.commands - motor.pairing.answered - motor.pairing.unanswered,
                motor.pairing.waiting,
                motor.delays,
            )
            for number, motor in self._motors.items()
        ]
