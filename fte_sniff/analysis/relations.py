"""Relations of the rows of a store: the frame before of the stream, a command and its answers."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from fte_sniff.analysis.facts import (
    ANSWERABLE,
    COMMANDS,
    FEEDBACK,
    KEYS_PER_PORT,
    NAMES_MOTOR,
    NO_STREAM,
    MotorFrames,
    find_answers,
    is_overdue,
    motor_rows,
    stream_keys,
    streams_of,
)
from fte_sniff.protocol import MOTORS
from fte_sniff.protocol.rows import NO_FACT, NO_TIME, Bools, Codes, Ints, Rows
from fte_sniff.protocol.spec import motor_bit

if TYPE_CHECKING:
    from fte_sniff.analysis.row_store import RowStore

UNCHANGED: Final = 4
"""The age of a byte that has not changed in the latest frames, or never."""


def frames_before(rows: Rows) -> Ints:
    """For each row the position of the frame before of its stream in the batch, or -1."""
    found = np.full(len(rows), -1)
    for _port, _number, at in streams_of(rows):
        found[at[1:]] = at[:-1]
    return found


def change_ages(raw: Codes, before: Ints) -> Codes:
    """For each byte the frames of the stream since it changed: 0 if it differs from the last one.

    `before` is that of `frames_before`; the result has the shape of `raw` and values up to
    `UNCHANGED`.
    """
    known = before >= 0
    changed = (raw != raw[before]) & known[:, None]
    ages = np.where(changed, 0, UNCHANGED).astype(np.uint8)
    earlier = before
    for age in range(1, UNCHANGED):
        ages = np.where(changed[earlier] & (earlier >= 0)[:, None], np.minimum(ages, age), ages)
        earlier = np.where(earlier >= 0, before[earlier], -1)
    return ages


def answer_pairs(rows: Rows) -> tuple[Ints, Ints]:
    """The positions of commands and of their answers in the batch, for each motor's answer."""
    found, commands, answers = motor_rows(rows), list[Ints](), list[Ints]()
    for motor in MOTORS:
        asking = MotorFrames.of(rows, found.commands[motor])
        feedback = MotorFrames.of(rows, found.feedback[motor])
        at, answered = find_answers(asking, feedback)
        commands.append(asking.indices[answered])
        answers.append(feedback.indices[at[answered]])
    return np.concatenate(commands), np.concatenate(answers)


class AnswerState(Enum):
    """Whether a command was answered."""

    ANSWERED = "answered"
    UNANSWERED = "unanswered"
    """Another command to the motor, or the deadline, came first."""
    WAITING = "waiting"
    """No answer came yet, and the facts of its row are not known yet."""
    UNKNOWN = "unknown"
    """No feedback came before it, rows are missing after it, a port is lost, or `MOST_SEARCHED`
    rows do not decide it."""


@dataclass(frozen=True, slots=True)
class CommandAnswer:
    """A command to one motor and its answer."""

    motor: int
    state: AnswerState
    command: int
    answer: int | None = None
    """Index of the answer, if there is one."""
    delay_ns: int | None = None
    """From the start of the command to that of the answer; None if unknown."""


MOST_SEARCHED: Final = 20_000
"""Rows among which a command or its answer is searched for."""

_FIRST_STEP: Final = 256


@dataclass(frozen=True, slots=True)
class RowPast:
    """What came before a row."""

    frame_ns: int | None
    """Time of the frame before of its stream."""
    command_ns: int | None
    """Time of the command that it answers."""
    ages: bytes
    """For each of the first ten bytes, the result of `change_ages`."""


_LOOK_BACK: Final = 512
"""Rows before a row among which its past is searched for at once."""

_MOST_KNOWN: Final = 4_096

_FrameBefore: TypeAlias = tuple[int, bytes] | None
"""Time and bytes of a frame."""


class RowRelations:
    """Finds the related rows of a store's rows, by index."""

    def __init__(self, store: RowStore) -> None:
        self._store, self._gaps = store, store.landmarks.gaps
        self._far: dict[int, _FrameBefore] = {}
        """Frames before that were far away, by index of the row."""
        self._asked = -1
        """Index of the last row whose relations were asked for."""
        self._decided: dict[int, CommandAnswer | None] = {}
        """Its relation by motor, as far as later rows cannot change it."""
        self._searched: dict[int, int] = {}
        """By motor, the end of the rows among which its answer is not."""

    def pasts(self, indices: Sequence[int]) -> dict[int, RowPast]:
        """The past of rows, given by rising indices."""
        found: dict[int, RowPast] = {}
        for run in _near_runs(indices):
            start = max(self._store.first, run[0] - _LOOK_BACK)
            batches = list(self._store.batches(start, run[-1] + 1))
            if batches:
                found |= self._pasts_in(Rows.concat(batches), start, run)
        return found

    def _pasts_in(self, rows: Rows, start: int, indices: Sequence[int]) -> dict[int, RowPast]:
        keys, before = stream_keys(rows), frames_before(rows)
        ages, (asking, answers) = change_ages(rows.raw, before), answer_pairs(rows)
        commands = dict(zip(answers.tolist(), asking.tolist(), strict=True))
        found = {}
        for at in (index - start for index in indices):
            own, frame_ns = ages[at].tobytes(), None
            if before[at] >= 0:
                frame_ns = _time(rows, int(before[at]))
            elif keys[at] % KEYS_PER_PORT != NO_STREAM:
                far = self._frame_before(start + at, int(keys[at]))
                if far is not None:
                    raw = rows.raw[at].tobytes()
                    frame_ns = None if far[0] == NO_TIME else far[0]
                    own = bytes(UNCHANGED * (a == b) for a, b in zip(raw, far[1], strict=True))
            command = commands.get(at)
            if command is not None and self._has_gap(start + command, start + at):
                command = None
            command_ns = None if command is None else _time(rows, command)
            found[start + at] = RowPast(frame_ns, command_ns, own)
        return found

    def _has_gap(self, start: int, end: int) -> bool:
        return bisect_right(self._gaps, start) != bisect_right(self._gaps, end)

    def _frame_before(self, index: int, key: int) -> _FrameBefore:
        """The frame before of a stream, among `MOST_SEARCHED` rows."""
        if index not in self._far:
            if len(self._far) >= _MOST_KNOWN:
                self._far.clear()
            self._far[index] = self._search_frame(index, key)
        return self._far[index]

    def _search_frame(self, index: int, key: int) -> _FrameBefore:
        first = max(self._store.first, index - MOST_SEARCHED)
        for _start, rows in self._backwards(first, index):
            found = np.flatnonzero(stream_keys(rows) == key)
            if len(found):
                return int(rows.t_ns[found[-1]]), rows.raw[found[-1]].tobytes()
        return None

    def related(self, index: int) -> list[int]:
        """Indices of a command's answers, or of the command that a row answers."""
        command = self.command(index)
        if command is not None:
            return [command.command]
        return [one.answer for one in self.answers(index) if one.answer is not None]

    def _ask(self, index: int) -> None:
        if index != self._asked:
            self._asked, self._decided, self._searched = index, {}, {}

    def answers(self, index: int) -> list[CommandAnswer]:
        """The answers of the command at an index, by motor; empty if the row has none."""
        row = self._batch(index)
        if row is None or not COMMANDS[row.kinds[0]] or row.cmds[0] not in ANSWERABLE:
            return []
        self._ask(index)
        motors = [int(row.nums[0])] if NAMES_MOTOR[row.kinds[0]] else MOTORS
        return [self._answer(index, row, motor) for motor in motors if motor in MOTORS]

    def command(self, index: int) -> CommandAnswer | None:
        """The command that the feedback at an index answers; None if it answers none."""
        row = self._batch(index)
        if row is None or not FEEDBACK[row.kinds[0]]:
            return None
        motor = int(row.nums[0])
        self._ask(index)
        if motor not in self._decided:
            self._decided[motor] = self._command(index, row, motor)
        return self._decided[motor]

    def _command(self, index: int, row: Rows, motor: int) -> CommandAnswer | None:
        for start, rows in self._before(index):
            commands, feedback = _frames_of(rows, motor, int(row.cmds[0]))
            found = np.flatnonzero(commands | feedback)
            if len(found):
                at = int(found[-1])
                if not commands[at] or rows.cmds[at] != row.cmds[0]:
                    return None
                return _paired(motor, start + at, rows[at : at + 1], index, row)
        return None

    def _answer(self, index: int, row: Rows, motor: int) -> CommandAnswer:
        decided = self._decided.get(motor)
        if decided is not None:
            return decided
        end = self._end_after(index)
        for start, rows in self._forwards(self._searched.get(motor, index + 1), end):
            commands, feedback = _frames_of(rows, motor, int(row.cmds[0]))
            found = np.flatnonzero(commands | feedback)
            if len(found):
                at = int(found[0])
                own = rows[at : at + 1]
                answer = None if commands[at] else _paired(motor, index, row, start + at, own)
                if answer is not None:
                    self._decided[motor] = answer
                    return answer
                break
        else:
            self._searched[motor] = max(end, index + 1)
        return CommandAnswer(motor, self._without_answer(index, row, motor), index)

    def _without_answer(self, index: int, row: Rows, motor: int) -> AnswerState:
        """The state of a command without an answer in the store, by the facts of its row."""
        missed = int(row.unanswered[0])
        if missed != NO_FACT and missed >> motor_bit(motor) & 1:
            return AnswerState.UNANSWERED
        return AnswerState.UNKNOWN if index < self._store.known else AnswerState.WAITING

    def _batch(self, index: int) -> Rows | None:
        """The row as a batch; None if it is not in the store."""
        return next(self._store.batches(index, index + 1), None) if index >= 0 else None

    def _end_after(self, index: int) -> int:
        """The end of the rows that may answer the one at an index."""
        at = bisect_right(self._gaps, index)
        gap = self._gaps[at] if at < len(self._gaps) else self._store.next
        return min(gap, self._store.next, index + 1 + MOST_SEARCHED)

    def _forwards(self, start: int, end: int) -> Iterator[tuple[int, Rows]]:
        """Rows from `start` up to `end`; each batch with its first index."""
        step = _FIRST_STEP
        while start < end:
            for rows in self._store.batches(start, min(end, start + step)):
                yield start, rows
                start += len(rows)
            step *= 2

    def _before(self, index: int) -> Iterator[tuple[int, Rows]]:
        """Rows before an index back to the last gap, the last first."""
        at = bisect_right(self._gaps, index)
        gap = self._gaps[at - 1] if at else 0
        return self._backwards(max(gap, self._store.first, index - MOST_SEARCHED), index)

    def _backwards(self, first: int, index: int) -> Iterator[tuple[int, Rows]]:
        """Rows from `first` up to an index, the last first; each batch with its first index."""
        step = _FIRST_STEP
        while index > first:
            start = max(first, index - step)
            for rows in reversed(list(self._store.batches(start, index))):
                index -= len(rows)
                yield index, rows
            step *= 2


def _paired(
    motor: int, command: int, asking: Rows, answer: int, answering: Rows
) -> CommandAnswer | None:
    """A command and its answer; None if that came after the deadline."""
    asked_ns, answered_ns = int(asking.t_ns[0]), int(answering.t_ns[0])
    if is_overdue(asked_ns, answering.t_ns):
        return None
    known = NO_TIME not in (asked_ns, answered_ns) and answered_ns >= asked_ns
    delay_ns = answered_ns - asked_ns if known else None
    return CommandAnswer(motor, AnswerState.ANSWERED, command, answer, delay_ns)


def _frames_of(rows: Rows, motor: int, cmd: int) -> tuple[Bools, Bools]:
    """Masks of the commands to a motor, and of its feedback with a CMD."""
    own = rows.nums == motor
    commands = COMMANDS[rows.kinds] & (own | ~NAMES_MOTOR[rows.kinds])
    return commands, FEEDBACK[rows.kinds] & own & (rows.cmds == cmd)


def _near_runs(indices: Sequence[int]) -> Iterator[Sequence[int]]:
    """Runs of rising indices whose rows before overlap."""
    start = 0
    for at in range(1, len(indices) + 1):
        if at == len(indices) or indices[at] - indices[at - 1] > _LOOK_BACK:
            yield indices[start:at]
            start = at


def _time(rows: Rows, at: int) -> int | None:
    t_ns = int(rows.t_ns[at])
    return None if t_ns == NO_TIME else t_ns
