"""Relations between rows: commands and their answers.

The answer of a command is the first feedback of the motor with the same CMD before the motor's next
command.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Final

import numpy as np

from fte_sniff.analysis.motors import (
    ANSWERABLE,
    COMMANDS,
    FEEDBACK,
    NAMES_MOTOR,
    MotorFrames,
    find_answers,
    motor_rows,
)
from fte_sniff.protocol import MOTORS
from fte_sniff.row_batch import NO_TIME, Bools, Ints, RowBatch

if TYPE_CHECKING:
    from fte_sniff.analysis.row_store import RowStore


@dataclass(frozen=True, slots=True)
class AnswerPairs:
    """Commands of a batch and their answers, by position in the batch."""

    commands: Ints
    answers: Ints


def answer_pairs(rows: RowBatch) -> AnswerPairs:
    """The commands whose answer is in the batch; a command to all motors has one from each."""
    found, commands, answers = motor_rows(rows), list[Ints](), list[Ints]()
    for motor in MOTORS:
        asking = MotorFrames.of(rows, found.commands[motor])
        feedback = MotorFrames.of(rows, found.feedback[motor])
        at, answered = find_answers(asking, feedback)
        commands.append(asking.indices[answered])
        answers.append(feedback.indices[at[answered]])
    return AnswerPairs(np.concatenate(commands), np.concatenate(answers))


class AnswerState(Enum):
    """Whether a command was answered."""

    ANSWERED = "answered"
    UNANSWERED = "unanswered"
    """Another command to the motor came first."""
    WAITING = "waiting"
    """It is the last command to the motor, and no answer came yet."""
    UNKNOWN = "unknown"
    """Rows are missing after it, or the next `MOST_SEARCHED` rows do not decide it."""


@dataclass(frozen=True, slots=True)
class CommandAnswer:
    """A command to one motor and its answer."""

    motor: int
    state: AnswerState
    command: int
    """Index of the command in the store."""
    answer: int | None = None
    """Index of the answer, if there is one."""
    delay_ns: int | None = None
    """From the start of the command to that of the answer; None if unknown."""


MOST_SEARCHED: Final = 20_000
"""Rows among which a command or its answer is searched for."""

_FIRST_STEP: Final = 256


class RowRelations:
    """Finds the related rows of a store's rows, by index."""

    def __init__(self, store: RowStore) -> None:
        self._store = store
        self.gaps: list[int] = []
        """Indices of the rows before which rows are missing, rising."""

    def answers(self, index: int) -> list[CommandAnswer]:
        """The answers of the command at an index, by motor; empty if the row has none."""
        row = self._batch(index)
        if row is None or not COMMANDS[row.kinds[0]] or row.cmds[0] not in ANSWERABLE:
            return []
        motors = [int(row.nums[0])] if NAMES_MOTOR[row.kinds[0]] else MOTORS
        return [self._answer(index, row, motor) for motor in motors if motor in MOTORS]

    def command(self, index: int) -> CommandAnswer | None:
        """The command that the feedback at an index answers; None if it answers none."""
        row = self._batch(index)
        if row is None or not FEEDBACK[row.kinds[0]]:
            return None
        motor = int(row.nums[0])
        for start, rows in self._before(index):
            commands, feedback = _frames_of(rows, motor, int(row.cmds[0]))
            found = np.flatnonzero(commands | feedback)
            if len(found):
                at = int(found[-1])
                if not commands[at] or rows.cmds[at] != row.cmds[0]:
                    return None
                return self._paired(motor, start + at, rows[at : at + 1], index, row)
        return None

    def _answer(self, index: int, row: RowBatch, motor: int) -> CommandAnswer:
        for start, rows in self._after(index):
            commands, feedback = _frames_of(rows, motor, int(row.cmds[0]))
            found = np.flatnonzero(commands | feedback)
            if len(found):
                at = int(found[0])
                if commands[at]:
                    return CommandAnswer(motor, AnswerState.UNANSWERED, index)
                return self._paired(motor, index, row, start + at, rows[at : at + 1])
        reached = self._end_after(index) == self._store.next
        state = AnswerState.WAITING if reached else AnswerState.UNKNOWN
        return CommandAnswer(motor, state, index)

    def _paired(
        self, motor: int, command: int, asking: RowBatch, answer: int, answering: RowBatch
    ) -> CommandAnswer:
        asked_ns, answered_ns = int(asking.t_ns[0]), int(answering.t_ns[0])
        known = NO_TIME not in (asked_ns, answered_ns) and answered_ns >= asked_ns
        delay_ns = answered_ns - asked_ns if known else None
        return CommandAnswer(motor, AnswerState.ANSWERED, command, answer, delay_ns)

    def _batch(self, index: int) -> RowBatch | None:
        """The row as a batch; None if it is not in the store."""
        return next(self._store.batches(index, index + 1), None) if index >= 0 else None

    def _end_after(self, index: int) -> int:
        """The end of the rows that may answer the one at an index."""
        gap = next((gap for gap in self.gaps if gap > index), self._store.next)
        return min(gap, self._store.next, index + 1 + MOST_SEARCHED)

    def _after(self, index: int) -> Iterator[tuple[int, RowBatch]]:
        """Rows after an index up to the next gap, with the index of the first of each batch."""
        start, end, step = index + 1, self._end_after(index), _FIRST_STEP
        while start < end:
            for rows in self._store.batches(start, min(end, start + step)):
                yield start, rows
                start += len(rows)
            step *= 2

    def _before(self, index: int) -> Iterator[tuple[int, RowBatch]]:
        """Rows before an index back to the last gap, the last first."""
        gap = next((gap for gap in reversed(self.gaps) if gap <= index), 0)
        first = max(gap, self._store.first, index - MOST_SEARCHED)
        step = _FIRST_STEP
        while index > first:
            start = max(first, index - step)
            for rows in reversed(list(self._store.batches(start, index))):
                index -= len(rows)
                yield index, rows
            step *= 2


def _frames_of(rows: RowBatch, motor: int, cmd: int) -> tuple[Bools, Bools]:
    """Masks of the commands to a motor, and of its feedback with a CMD."""
    own = rows.nums == motor
    commands = COMMANDS[rows.kinds] & (own | ~NAMES_MOTOR[rows.kinds])
    return commands, FEEDBACK[rows.kinds] & own & (rows.cmds == cmd)
