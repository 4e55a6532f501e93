"""Owns how each motor was answered for, over all rows: commands, answers, and how long they took.

It must not know which feedback answers a command (`pairing` does), nor a screen. What it keeps does
not grow with the rows. All rows are taken to be of one controller, as in `motors`.
"""

from __future__ import annotations

from dataclasses import dataclass

from fte_sniff.analysis.accumulators.durations import Durations
from fte_sniff.analysis.columns.fields import Decoded
from fte_sniff.analysis.models.addressing import Addressed
from fte_sniff.analysis.models.pairing import Moments, Pairing
from fte_sniff.protocol import MOTORS


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
            took = motor.pairing.add(Moments.of(rows, commands), Moments.of(rows, feedback))
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
