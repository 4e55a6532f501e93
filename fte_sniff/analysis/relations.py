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
    MotorRows,
    find_answers,
    motor_rows,
    stream_keys,
    streams_of,
)
from fte_sniff.protocol import MOTORS
from fte_sniff.protocol.rows import NO_FACT, NO_ROWS, NO_TIME, Codes, Ints, Rows
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
    found = motor_rows(rows)
    pairs = [_answers_of(rows, found, motor) for motor in MOTORS]
    commands, answers = (np.concatenate(one) for one in zip(*pairs, strict=True))
    return commands[answers >= 0], answers[answers >= 0]


def _answers_of(rows: Rows, found: MotorRows, motor: int) -> tuple[Ints, Ints]:
    """The positions of the commands to a motor, and for each that of its answer, or -1."""
    asking = MotorFrames.of(rows, found.commands[motor])
    feedback = MotorFrames.of(rows, found.feedback[motor])
    at, answered = find_answers(asking, feedback)
    answers = np.full(len(at), -1)
    answers[answered] = feedback.indices[at[answered]]
    return asking.indices, answers


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

_FIRST_REACH: Final = 256


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
        for reach in _reaches(index - first):
            rows = self._rows(index - reach, index)
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

    def answers(self, index: int) -> list[CommandAnswer]:
        """The answers of the command at an index, by motor; empty if the row has none."""
        row = self._rows(index, index + 1)
        if not len(row) or not COMMANDS[row.kinds[0]] or row.cmds[0] not in ANSWERABLE:
            return []
        motors = [int(row.nums[0])] if NAMES_MOTOR[row.kinds[0]] else MOTORS
        return [self._answer(index, row, motor) for motor in motors if motor in MOTORS]

    def _answer(self, index: int, row: Rows, motor: int) -> CommandAnswer:
        at = bisect_right(self._gaps, index)
        gap = self._gaps[at] if at < len(self._gaps) else self._store.next
        end = min(gap, self._store.next, index + 1 + MOST_SEARCHED)
        for reach in _reaches(end - index):
            rows = self._rows(index, index + reach)
            commands, answers = _answers_of(rows, motor_rows(rows), motor)
            if answers[0] >= 0:
                return _answered(motor, index, rows, 0, int(answers[0]))
            if len(commands) > 1:
                break
        return CommandAnswer(motor, self._without_answer(index, row, motor), index)

    def command(self, index: int) -> CommandAnswer | None:
        """The command that the feedback at an index answers; None if it answers none."""
        row = self._rows(index, index + 1)
        if not len(row) or not FEEDBACK[row.kinds[0]] or int(row.nums[0]) not in MOTORS:
            return None
        motor, gaps = int(row.nums[0]), bisect_right(self._gaps, index)
        gap = self._gaps[gaps - 1] if gaps else 0
        first = max(gap, self._store.first, index - MOST_SEARCHED)
        for reach in _reaches(index + 1 - first):
            start = index + 1 - reach
            rows = self._rows(start, index + 1)
            commands, answers = _answers_of(rows, motor_rows(rows), motor)
            for command in commands[answers == reach - 1].tolist():
                return _answered(motor, start, rows, command, reach - 1)
            same = FEEDBACK[rows.kinds] & (rows.nums == motor) & (rows.cmds == row.cmds[0])
            if len(commands) or same[:-1].any():
                break
        return None

    def _without_answer(self, index: int, row: Rows, motor: int) -> AnswerState:
        """The state of a command without an answer in the store, by the facts of its row."""
        missed = int(row.unanswered[0])
        if missed != NO_FACT and missed >> motor_bit(motor) & 1:
            return AnswerState.UNANSWERED
        return AnswerState.UNKNOWN if index < self._store.known else AnswerState.WAITING

    def _rows(self, start: int, end: int) -> Rows:
        """The rows from `start` up to `end` that are in the store."""
        batches = list(self._store.batches(start, end)) if start >= 0 else []
        return Rows.concat(batches) if batches else NO_ROWS


def _reaches(most: int) -> Iterator[int]:
    """The numbers of rows among which is searched: ever more, and at last `most`."""
    reach = _FIRST_REACH
    while reach < most:
        yield reach
        reach *= 4
    yield most


def _answered(motor: int, start: int, rows: Rows, command: int, answer: int) -> CommandAnswer:
    """A command and its answer by their positions in rows, of which the first has an index."""
    asked_ns, answered_ns = int(rows.t_ns[command]), int(rows.t_ns[answer])
    known = NO_TIME not in (asked_ns, answered_ns) and answered_ns >= asked_ns
    delay_ns = answered_ns - asked_ns if known else None
    return CommandAnswer(motor, AnswerState.ANSWERED, start + command, start + answer, delay_ns)


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
