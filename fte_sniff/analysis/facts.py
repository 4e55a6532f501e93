"""Facts of rows that depend on other rows: answers, the motor of damage, the frame before.

    commands   c1      c1           c1        c1
    feedback       f1                                      deadline: 1 s
    unanswered no      yes (c1)     yes (deadline)   null (the rows end)

Before the first feedback of a recording no command is unanswered: null, since the wire of the
answers may not be recorded. Otherwise a fact depends only on the rows up to `DEADLINE_NS` before
and after its row, and on at most `MOST_HELD` of them. So `Facts` holds few rows back, and any
division of the input into batches gives the same facts.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from fte_sniff.analysis.feed import StreamChange
from fte_sniff.analysis.model import Model
from fte_sniff.analysis.motors import (
    ANSWERABLE,
    COMMANDS,
    DEADLINE_NS,
    NAMES_MOTOR,
    MotorFrames,
    find_answers,
    first_feedback,
    is_overdue,
    motor_rows,
)
from fte_sniff.analysis.previous_frames import PreviousFrames
from fte_sniff.protocol import FRAME_LENGTH, KINDS, MOTORS, Fault, Gap, GapKind, Status, status_of
from fte_sniff.protocol.rows import FACTS, NO_FACT, NO_KIND, NO_ROWS, NO_TIME, Bools, Ints, Rows
from fte_sniff.protocol.spec import (
    CMD_OFFSET,
    FTE_FORMAT,
    HEADERS,
    NUM_OFFSET,
    TAIL,
    Direction,
    motor_bit,
)

MOST_HELD: Final = 20_000
"""Rows after a command among which its answer is searched for, whatever their times."""

_KIND_OF_HEAD: Final = np.frombuffer(FTE_FORMAT.kind_codes(NO_KIND), np.uint8)
"""By header * 256 + CMD: the index in `KINDS`, or `NO_KIND`."""

_NAMING_CMDS: Final = np.array(
    sorted({cmd for kind in KINDS if kind.names_motor for cmd in kind.cmds})
)
"""The CMDs of frames that name a motor."""


class Facts(Model):
    """Computes the columns of `rows.FACTS`; rows wait until all of their facts are decided."""

    def __init__(self, *, previous: bool = True) -> None:
        """Compute all of them, or without the frame before of each row."""
        self._held = NO_ROWS
        self._past = _Past()
        self._previous = PreviousFrames() if previous else None
        self._lost: bool | None = None
        """Whether a port is lost, so that no command is unanswered."""
        self._has_feedback = False
        """Whether feedback came in this recording, among the rows before those that wait."""

    def feed(self, rows: Rows, changes: Sequence[StreamChange] = ()) -> Rows:
        """The next rows, with the gaps between them; returns the rows that are decided now."""
        found, start = [], 0
        for change in changes:
            if isinstance(change.what, Gap):
                found += [self._decide(rows[start : change.index]), self.interrupt(change.what)]
                start = change.index
        found.append(self._decide(rows[start:] if start else rows))
        return Rows.concat([one for one in found if len(one)] or [NO_ROWS])

    def interrupt(self, gap: Gap | None = None) -> Rows:
        """A gap, or the end: returns the rows that waited; what they lack is not known."""
        found, self._held = self._with_facts(self._held)[0], NO_ROWS
        self._past = _Past()
        if self._previous is not None:
            self._previous.interrupt()
        self._has_feedback |= first_feedback(found) < len(found)
        if gap is not None:
            self._has_feedback &= gap.kind is not GapKind.OTHER_RECORDING
            if gap.port_lost is not None:
                self._lost = gap.port_lost
        return found

    def _decide(self, rows: Rows) -> Rows:
        if not len(rows):
            return NO_ROWS
        if self._previous is not None:
            rows = self._previous.add(rows)
        rows = Rows.concat([self._held, rows]) if len(self._held) else rows
        whole, decided = self._with_facts(rows)
        open_at = np.flatnonzero(~decided)
        end = int(open_at[0]) if len(open_at) else len(rows)
        self._past = self._past.after(rows[:end])
        self._has_feedback |= first_feedback(rows) < end
        self._held = rows[end:]
        return whole[:end]

    def _covered_from(self, rows: Rows) -> int:
        """The index of the first row that can be known to be unanswered."""
        if self._lost:
            return len(rows)
        if self._has_feedback:
            return 0
        return first_feedback(rows)

    def _with_facts(self, rows: Rows) -> tuple[Rows, Bools]:
        """The rows with their facts as far as they are known, and which of them are decided."""
        answer_ns, unanswered, decided = _answers(rows, self._covered_from(rows))
        hints, hinted = _hints(rows, self._past)
        facts = {
            "answer_ns": answer_ns,
            "unanswered": unanswered,
            "motor_hint": hints,
            "previous": rows.previous,
        }
        whole = rows.with_facts({name: facts[name].astype(FACTS[name]) for name in FACTS})
        return whole, decided & hinted


def _answers(rows: Rows, covered_from: int) -> tuple[Ints, Ints, Bools]:
    """Answer times and the motors that did not answer, by row; and which rows are decided.

    No row before the index `covered_from` is unanswered.
    """
    count = len(rows)
    answer_ns = np.full(count, NO_FACT, np.int64)
    missed = np.zeros(count, np.int64)
    unknown, asked = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    waits, untimed = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    found = motor_rows(rows)
    for motor in MOTORS:
        commands = MotorFrames.of(rows, found.commands[motor])
        if not len(commands.indices):
            continue
        feedback = MotorFrames.of(rows, found.feedback[motor])
        at, answered = find_answers(commands, feedback)
        answerable = np.isin(commands.cmds, ANSWERABLE)
        own = commands.indices
        ends = feedback.indices[at[answered]]
        near = answered.copy()
        near[answered] = ends - own[answered] <= MOST_HELD
        late = near & (commands.t_ns != NO_TIME)
        late[answered] &= feedback.t_ns[at[answered]] == NO_TIME
        for one in np.flatnonzero(late).tolist():
            # An answer without a time is late if a row before it is after the deadline.
            between = rows.t_ns[own[one] + 1 : feedback.indices[at[one]]]
            near[one] = not is_overdue(int(commands.t_ns[one]), between)
        delays = np.full(len(own), NO_FACT, np.int64)
        delays[answered] = feedback.t_ns[at[answered]] - commands.t_ns[answered]
        timed = answered & (commands.t_ns != NO_TIME) & (delays >= 0)
        timed[answered] &= feedback.t_ns[at[answered]] != NO_TIME
        follows = np.append(np.diff(own), MOST_HELD + 1) <= MOST_HELD
        missing = answerable & ~near & follows
        for at_end in np.flatnonzero(answerable & ~near & ~follows).tolist():
            later = rows.t_ns[own[at_end] + 1 : own[at_end] + 1 + MOST_HELD]
            missing[at_end] = is_overdue(int(commands.t_ns[at_end]), later)
        far = own + MOST_HELD < count
        asked[own[answerable]] = True
        missed[own[missing]] |= 1 << motor_bit(motor)
        unknown[own[answerable & ~near & ~missing & far]] = True
        waits[own[answerable & ~near & ~missing & ~far]] = True
        untimed[own[near & ~timed]] = True
        shown = near & timed
        answer_ns[own[shown]] = np.maximum(answer_ns[own[shown]], delays[shown])
    unanswered = np.full(count, NO_FACT)
    unanswered[asked] = 0
    unanswered[waits | unknown] = NO_FACT
    any_missed = missed > 0
    unanswered[any_missed] = missed[any_missed]
    unanswered[:covered_from][any_missed[:covered_from]] = NO_FACT
    answer_ns[any_missed | waits | unknown | untimed] = NO_FACT
    return answer_ns, unanswered, ~waits | any_missed


_TAIL_ROWS: Final = 256
"""Rows at the end of a batch in which the last frames usually are."""


class _Past(NamedTuple):
    """What damage needs to know of the rows before a batch; rows without time have `NO_TIME`."""

    steps: tuple[tuple[tuple[int, int], ...], ...] = ((), ())
    """By direction, the motors and times of the last two frames."""
    turns: tuple[tuple[int, int, bool], ...] = ()
    """Motor and time of the last two commands or feedback, and whether it is a command."""

    def after(self, rows: Rows) -> _Past:
        """The past of the rows that follow these."""
        if len(rows) > _TAIL_ROWS:
            found = _Past().after(rows[-_TAIL_ROWS:])
            if min(map(len, found.steps)) == _AROUND:
                return found
        motors, t_ns, is_command = _motor_frames(rows)[1:]
        frames = list(
            zip(motors[-2:].tolist(), t_ns[-2:].tolist(), is_command[-2:].tolist(), strict=True)
        )
        steps = []
        for before, own in zip(self.steps, (is_command, ~is_command), strict=True):
            last = zip(motors[own][-2:].tolist(), t_ns[own][-2:].tolist(), strict=True)
            steps.append((*before, *last)[-2:])
        return _Past(tuple(steps), (*self.turns, *frames)[-2:])


def _motor_frames(rows: Rows) -> tuple[Ints, Ints, Ints, Bools]:
    """Indices, motors and times of the frames to and from one motor, and which are commands."""
    kinds, nums = rows.kinds, rows.nums
    named = NAMES_MOTOR[kinds] & (nums >= MOTORS[0]) & (nums <= MOTORS[-1])
    at = np.flatnonzero(named)
    return at, nums[at].astype(np.int64), rows.t_ns[at], COMMANDS[kinds[at]]


def _hints(rows: Rows, past: _Past) -> tuple[Ints, Bools]:
    """The motors that damaged rows probably belonged to, and which rows are decided.

    The first of these that names a motor: the row's own NUM; the frames of a direction before and
    after it, in which one motor is missing; the command that alone awaits an answer.
    """
    hints = np.full(len(rows), NO_FACT)
    decided = np.ones(len(rows), np.bool_)
    malformed = np.array([status_of(one) is Status.MALFORMED for one in rows.codebook.faults])
    damaged = np.flatnonzero(malformed[rows.faults])
    if not len(damaged):
        return hints, decided
    own = _own_motors(rows, damaged)
    hints[damaged] = own
    damaged = damaged[own == NO_FACT]
    at, motors, t_ns, is_command = _motor_frames(rows)
    times, heads = rows.t_ns[damaged], rows.raw[damaged, 0]
    by_direction = []
    waits = np.zeros(len(damaged), np.bool_)
    for header, before, of in zip(_HEADERS, past.steps, (is_command, ~is_command), strict=True):
        frames = _Frames.of(before, at[of], motors[of], t_ns[of])
        missing, open_ = frames.missing_motor(damaged, times)
        other = np.isin(heads, _HEADERS) & (heads != header)
        by_direction.append(np.where(other, NO_FACT, missing))
        waits |= open_ & ~other
    commanded, answered = by_direction
    found = np.where(commanded == NO_FACT, answered, commanded)
    clash = (answered != NO_FACT) & (answered != found)
    turns = _Frames.of([one[:2] for one in past.turns], at, motors, t_ns)
    kinds = np.concatenate((np.array([one[2] for one in past.turns], np.bool_), is_command))
    asked = np.where(
        heads == HEADERS[Direction.CONTROL], NO_FACT, turns.asked(kinds, damaged, times)
    )
    hints[damaged] = np.where(clash, NO_FACT, np.where(found == NO_FACT, asked, found))
    latest_after = np.maximum.accumulate(rows.t_ns[::-1])[::-1][damaged]
    timed = (times != NO_TIME) & (latest_after - times > DEADLINE_NS)
    over = timed | (damaged + MOST_HELD < len(rows))
    decided[damaged[waits & ~over]] = False
    return hints, decided


def _own_motors(rows: Rows, at: Ints) -> Ints:
    """NUM of the rows in which header and CMD, or CMD and tail, name a kind that names a motor."""
    raw, length = rows.raw[at], rows.length[at]
    cmds, nums = raw[:, CMD_OFFSET], raw[:, NUM_OFFSET].astype(np.int64)
    heads = raw[:, 0].astype(np.int64) << 8 | cmds
    in_step = np.array([Fault.BAD_HEADER in one for one in rows.codebook.faults])[rows.faults[at]]
    whole = in_step & (length == FRAME_LENGTH) & (raw[:, -1] == TAIL) & np.isin(cmds, _NAMING_CMDS)
    names = (NAMES_MOTOR[_KIND_OF_HEAD[heads]] | whole) & (length > NUM_OFFSET)
    return np.where(names & (nums >= MOTORS[0]) & (nums <= MOTORS[-1]), nums, NO_FACT)


_HEADERS: Final = tuple(HEADERS[one] for one in (Direction.CONTROL, Direction.FEEDBACK))

_AROUND: Final = 2
"""Frames before damage, and after it, that must be in step."""


class _Frames(NamedTuple):
    """Frames by rising index; those before the batch have negative indices."""

    at: Ints
    motors: Ints
    t_ns: Ints

    @classmethod
    def of(cls, past: Sequence[tuple[int, int]], at: Ints, motors: Ints, t_ns: Ints) -> _Frames:
        """Frames of a batch, after the motors and times of earlier ones."""
        earlier = np.array(past, np.int64).reshape(-1, 2)
        return cls(
            np.concatenate((np.arange(-len(earlier), 0), at)),
            np.concatenate((earlier[:, 0], motors)),
            np.concatenate((earlier[:, 1], t_ns)),
        )

    def _near(self, numbers: Ints, at: Ints, t_ns: Ints) -> Bools:
        """Whether frames exist, and are not too far from the rows at these indices."""
        if not len(self.at):
            return np.zeros(len(at), np.bool_)
        exists = (numbers >= 0) & (numbers < len(self.at))
        numbers = np.clip(numbers, 0, len(self.at) - 1)
        own = self.t_ns[numbers]
        timed = (own != NO_TIME) & (t_ns != NO_TIME)
        far = timed & (np.abs(own - t_ns) > DEADLINE_NS)
        near: Bools = exists & ~far & (self.at[numbers] - at <= MOST_HELD)
        return near

    def missing_motor(self, at: Ints, t_ns: Ints) -> tuple[Ints, Bools]:
        """The motor that is missing at each row, and whether later frames may decide it."""
        end = np.searchsorted(self.at, at)
        near, motors = np.ones(len(at), np.bool_), []
        for by in range(-_AROUND, _AROUND):
            near &= self._near(end + by, at, t_ns)
            motors.append(
                self.motors[np.clip(end + by, 0, max(0, len(self.at) - 1))] if len(self.at) else end
            )
        second, first, next_, last = motors
        step, count = first - second, len(MOTORS)
        near &= ((first + 2 * step - next_) % count == 0) & ((first + 3 * step - last) % count == 0)
        missing = (first + step - MOTORS[0]) % count + MOTORS[0]
        return np.where(near, missing, NO_FACT), end + _AROUND > len(self.at)

    def asked(self, is_command: Bools, at: Ints, t_ns: Ints) -> Ints:
        """The motor whose command alone awaits an answer at each row."""
        if not len(self.at):
            return np.full(len(at), NO_FACT)
        end = np.searchsorted(self.at, at)
        last, before = np.maximum(end - 1, 0), np.maximum(end - 2, 0)
        alone = (end < 2) | ~is_command[before] | (self.motors[before] == self.motors[last])
        asked = self._near(end - 1, at, t_ns) & is_command[last] & alone
        return np.where(asked, self.motors[last], NO_FACT)
