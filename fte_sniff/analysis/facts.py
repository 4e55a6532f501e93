"""Facts of rows that depend on other rows: answers, the motor of damage, the frame before.

    commands   c1      c1           c1        c1
    feedback       f1                                      deadline: 1 s
    unanswered no      yes (c1)     yes (deadline)   null (the rows end)

The answer of a command is the motor's first feedback with the same CMD before the motor's next
command and the deadline. Before the first feedback of a recording no command is unanswered: null,
since the wire of the answers may not be recorded.

`Facts` gives each row its facts, so rows wait. A fact depends only on the rows up to `DEADLINE_NS`
before and after its row, and on at most `MOST_HELD` of them. So few rows are held back, and any
division of the input into batches gives the same facts. `Pairing` counts the answers of one motor
at once, and holds no rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from fte_sniff.analysis.counters import RecentValues
from fte_sniff.analysis.model import Model, StreamChange
from fte_sniff.protocol import (
    FRAME_LENGTH,
    KINDS,
    MOTORS,
    Direction,
    Fault,
    Gap,
    GapKind,
)
from fte_sniff.protocol.rows import (
    COLUMNS,
    FACTS,
    NO_FACT,
    NO_KIND,
    NO_ROWS,
    NO_TIME,
    Bools,
    Ints,
    Rows,
)
from fte_sniff.protocol.spec import (
    CMD_OFFSET,
    FTE_FORMAT,
    HEADERS,
    NUM_OFFSET,
    TAIL,
    motor_bit,
)

# Commands and their answers


def _by_kind(values: Iterator[bool]) -> Bools:
    return np.array([*values, False])


COMMANDS: Final = _by_kind(kind.direction is Direction.CONTROL for kind in KINDS)
"""By kind code, whether it is a command."""

FEEDBACK: Final = _by_kind(kind.direction is Direction.FEEDBACK for kind in KINDS)
"""By kind code, whether it is feedback."""

NAMES_MOTOR: Final = _by_kind(kind.names_motor for kind in KINDS)
"""By kind code, whether NUM is a motor; a command without one is to all motors."""


@dataclass(frozen=True, slots=True)
class MotorRows:
    """Indices, rising, of the rows of a batch that are to or from motors."""

    commands: dict[int, Ints]
    feedback: dict[int, Ints]
    any_feedback: Ints
    first_feedback: int
    """The result of the function `first_feedback`."""


def first_feedback(rows: Rows) -> int:
    """The index of the first feedback, to which motor it may belong; `len(rows)` without any."""
    found = FEEDBACK[rows.kinds]
    return int(found.argmax()) if found.any() else len(rows)


def motor_rows(rows: Rows) -> MotorRows:
    """Find the rows that are to or from motors."""
    commands = np.flatnonzero(COMMANDS[rows.kinds])
    feedback = np.flatnonzero(FEEDBACK[rows.kinds])
    to_all, to = ~NAMES_MOTOR[rows.kinds[commands]], rows.nums[commands]
    answering = rows.nums[feedback]
    return MotorRows(
        {motor: commands[(to == motor) | to_all] for motor in MOTORS},
        {motor: feedback[answering == motor] for motor in MOTORS},
        feedback[(answering >= MOTORS[0]) & (answering <= MOTORS[-1])],
        first_feedback(rows),
    )


@dataclass(frozen=True, slots=True)
class _OpenCommand:
    """A command that may still be answered."""

    cmd: int
    t_ns: int
    covered: bool
    """Whether feedback came before it."""


ANSWERABLE: Final = np.array(
    sorted({cmd for kind in KINDS if kind.direction is Direction.FEEDBACK for cmd in kind.cmds})
)
"""The CMDs of feedback: commands with another CMD have no answer."""

DEADLINE_NS: Final = 1_000_000_000
"""Time in which a command must be answered."""

_NO_CMD: Final = -1
BEFORE_BATCH: Final = -1
_NEVER: Final = 2**62
_NONE: Final[Ints] = np.empty(0, np.int64)


@dataclass(frozen=True, slots=True)
class MotorFrames:
    """Commands to one motor, or its feedback, in a batch."""

    indices: Ints
    """In the batch, rising."""
    cmds: Ints
    t_ns: Ints
    """Nanoseconds since 1970 UTC, or `NO_TIME`."""

    @classmethod
    def of(cls, rows: Rows, indices: Ints) -> MotorFrames:
        """The rows with these indices."""
        return cls(indices, rows.cmds[indices].astype(np.int64), rows.t_ns[indices])

    def after(self, cmd: int, t_ns: int) -> MotorFrames:
        """These frames after one from before the batch."""
        return MotorFrames(
            np.concatenate(([BEFORE_BATCH], self.indices)),
            np.concatenate(([cmd], self.cmds)),
            np.concatenate(([t_ns], self.t_ns)),
        )


def _frames(cmds_and_times: Sequence[tuple[int, int]], after: int = 0) -> MotorFrames:
    """Frames from an index of a batch on, by CMD and time."""
    columns = np.array(cmds_and_times, np.int64).reshape(-1, 2)
    return MotorFrames(np.arange(len(columns)) + after, columns[:, 0], columns[:, 1])


_COMMAND: Final = "command"
_GAP: Final = "gap"


@dataclass(frozen=True, slots=True)
class DecidedCommands:
    """Commands to one motor that were answered, or followed by another command first."""

    indices: Ints
    """In the batch, rising; -1 for a command from before it."""
    answered: Bools
    delays_ns: Ints
    """From the command to its answer, or `NO_TIME`."""
    ends_ns: Ints
    """Times of the answers, or `NO_TIME`."""
    commands_ns: Ints
    """Times of the commands, or `NO_TIME`."""
    uncovered: Ints
    """Indices of other commands: without an answer, before the first feedback."""

    @property
    def measured(self) -> tuple[Ints, Ints]:
        """The known answer times, and the times of those answers."""
        known = self.delays_ns != NO_TIME
        return self.delays_ns[known], self.ends_ns[known]


NO_COMMANDS: Final = DecidedCommands(_NONE, _NONE.astype(np.bool_), _NONE, _NONE, _NONE, _NONE)


class Pairing(Model):
    """Matches the commands to one motor with its feedback.

    The answer of a command is the first feedback with the same CMD before the next command and the
    deadline. While a port is lost, and before the first feedback of a recording (the wire of the
    answers may not be recorded), a command may be answered, but it is never unanswered.
    """

    def __init__(self) -> None:
        self.answered = 0
        self.unanswered = 0
        self.uncovered = 0
        """Commands without an answer before the first feedback of their recording."""
        self._early_count = 0
        """Those of them that are unanswered if feedback came before these rows."""
        self.delays = RecentValues()
        """Latest answer times, nanoseconds."""
        self._waiting: _OpenCommand | None = None
        """The last command, if it may still be answered."""
        self._early: dict[int, int] = {}
        """By CMD, the time of the first feedback before `_begins_with`."""
        self._early_ns = NO_TIME
        """The latest time of a row before `_begins_with`."""
        self._begins_with: str | None = None
        """Whether the first command or gap is a `command` or a `gap`; None before it."""
        self._port_lost: bool | None = None
        """Whether a port is lost, so that no command is unanswered; None before it is known."""
        self.has_feedback = False
        """Whether feedback, of any motor, came in this recording."""
        self.has_start = False
        """Whether the recording began among these rows."""

    def interrupt(self, gap: Gap | None = None) -> None:
        """Frames are missing here: whether the last command was answered remains unknown."""
        self._waiting = None
        self._begins_with = self._begins_with or _GAP
        if gap is None:
            return
        if gap.port_lost is not None:
            self._port_lost = gap.port_lost
        if gap.kind is GapKind.OTHER_RECORDING:
            self.has_feedback, self.has_start = False, True

    def merge(self, later: Pairing) -> DecidedCommands:
        """Add the frames that follow; returns what became of the command that was open here."""
        decided = NO_COMMANDS
        if self._waiting is not None:
            answers = [one for one in later._early.items() if one[0] == self._waiting.cmd]
            follows = later._begins_with == _COMMAND
            decided = self._decide(
                _frames([(_NO_CMD, NO_TIME)] if follows else [], after=len(answers)),
                _frames(answers),
                np.array([later._early_ns]),
            )
        if self._begins_with is None:
            self._early = {**later._early, **self._early}
            self._early_ns = max(self._early_ns, later._early_ns)
            self._begins_with = later._begins_with
        follows = self.has_feedback and not later.has_start
        if later._begins_with is not None:
            self._waiting = later._waiting
            if self._waiting is not None and follows:
                self._waiting = replace(self._waiting, covered=True)
        if later._port_lost is not None:
            self._port_lost = later._port_lost
        self.delays.merge(later.delays)
        self.answered += later.answered
        self.unanswered += later.unanswered
        self.uncovered += later.uncovered
        if self.has_feedback:
            self.unanswered += later._early_count
            self.uncovered -= later._early_count
        elif not self.has_start:
            self._early_count += later._early_count
        self.has_feedback = later.has_feedback or follows
        self.has_start |= later.has_start
        return decided

    def _observe_early(self, commands: MotorFrames, feedback: MotorFrames, t_ns: Ints) -> None:
        """Note feedback before the first command: it may answer a command before all rows."""
        stop = commands.indices[0] if len(commands.indices) else _NEVER
        self._early_ns = max(self._early_ns, int(t_ns[:stop].max(initial=NO_TIME)))
        early = feedback.cmds[feedback.indices < stop]
        for cmd in ANSWERABLE.tolist():
            same = np.flatnonzero(early == cmd)
            if len(same):
                self._early.setdefault(cmd, int(feedback.t_ns[same[0]]))
        if len(commands.indices):
            self._begins_with = _COMMAND

    @property
    def waiting(self) -> bool:
        """Whether the last command may still be answered."""
        return self._waiting is not None

    @property
    def waiting_cmd(self) -> int | None:
        """The CMD of that command, if there is one."""
        return None if self._waiting is None else self._waiting.cmd

    @property
    def waiting_since_ns(self) -> int | None:
        """The time of that command, if it has one."""
        if self._waiting is None or self._waiting.t_ns == NO_TIME:
            return None
        return self._waiting.t_ns

    def observe(self, rows: Rows, found: MotorRows, motor: int) -> DecidedCommands:
        """Match the next rows; returns what became of the commands that they decide."""
        commands = MotorFrames.of(rows, found.commands[motor])
        feedback = MotorFrames.of(rows, found.feedback[motor])
        covered_from = 0 if self.has_feedback else found.first_feedback
        self.has_feedback |= found.first_feedback < len(rows)
        return self._decide(commands, feedback, rows.t_ns, covered_from)

    def _decide(
        self, commands: MotorFrames, feedback: MotorFrames, t_ns: Ints, covered_from: int = 0
    ) -> DecidedCommands:
        """Match commands and feedback; commands before an index are not covered.

        `t_ns` are the times of all rows of the batch, for the deadline of the last command.
        """
        if self._begins_with is None:
            self._observe_early(commands, feedback, t_ns)
        covered = commands.indices >= covered_from
        if self._waiting is not None:
            commands = commands.after(self._waiting.cmd, self._waiting.t_ns)
            covered = np.concatenate(([self._waiting.covered], covered))
        if not len(commands.indices):
            return NO_COMMANDS
        answers, answered = find_answers(commands, feedback)
        ends_ns = np.full(len(answers), NO_TIME, np.int64)
        ends_ns[answered] = feedback.t_ns[answers[answered]]
        known = (commands.t_ns != NO_TIME) & (ends_ns != NO_TIME) & (ends_ns >= commands.t_ns)
        delays_ns = np.where(known, ends_ns - commands.t_ns, NO_TIME)
        self.delays.observe(delays_ns[known])
        answerable = np.isin(commands.cmds, ANSWERABLE)
        overdue = is_overdue(int(commands.t_ns[-1]), t_ns[int(commands.indices[-1]) + 1 :])
        waits = bool(answerable[-1] and not answered[-1] and not overdue)
        last = int(commands.cmds[-1]), int(commands.t_ns[-1]), bool(covered[-1])
        self._waiting = _OpenCommand(*last) if waits else None
        unanswered = answerable & ~answered & (not self._port_lost)
        unanswered[-1] &= overdue
        uncovered = commands.indices[unanswered & ~covered]
        self.uncovered += len(uncovered)
        if not self.has_start:
            self._early_count += len(uncovered)
        unanswered &= covered
        self.answered += int(answered.sum())
        self.unanswered += int(unanswered.sum())
        decided = answered | unanswered
        return DecidedCommands(
            commands.indices[decided],
            answered[decided],
            delays_ns[decided],
            ends_ns[decided],
            commands.t_ns[decided],
            uncovered,
        )


def is_overdue(asked_ns: int, later_ns: Ints) -> bool:
    """Whether the deadline of a command passed, by the times of the rows after it."""
    latest = int(later_ns.max(initial=NO_TIME))
    return NO_TIME not in (asked_ns, latest) and latest - asked_ns > DEADLINE_NS


def find_answers(commands: MotorFrames, feedback: MotorFrames) -> tuple[Ints, Bools]:
    """For every command the position in `feedback` of its answer, and whether it has one.

    The answer is the first feedback with the same CMD before the next command and the deadline.
    """
    answers = np.zeros(len(commands.indices), np.int64)
    answered = np.zeros(len(commands.indices), np.bool_)
    ends = np.append(commands.indices[1:], _NEVER)
    for cmd in ANSWERABLE:
        asking = np.flatnonzero(commands.cmds == cmd)
        same = np.flatnonzero(feedback.cmds == cmd)
        if not len(asking) or not len(same):
            continue
        indices = feedback.indices[same]
        first = np.searchsorted(indices, commands.indices[asking], side="right")
        found = first < len(same)
        found[found] = indices[first[found]] < ends[asking[found]]
        asked, same = asking[found], same[first[found]]
        delays_ns = feedback.t_ns[same] - commands.t_ns[asked]
        timed = (feedback.t_ns[same] != NO_TIME) & (commands.t_ns[asked] != NO_TIME)
        in_time = ~(timed & (delays_ns > DEADLINE_NS))
        answered[asked[in_time]] = True
        answers[asked[in_time]] = same[in_time]
    return answers, answered


# Streams: the frames of one kind, to or from one motor, on one port

_NUMS: Final = 256


def _stream_codes() -> tuple[list[tuple[int, int | None]], Ints]:
    """Kind code and motor of every stream, and the stream's number by kind code and NUM."""
    codes = np.full((NO_KIND + 1, _NUMS), -1, np.int64)
    found: list[tuple[int, int | None]] = []
    for code, kind in enumerate(KINDS):
        if kind.names_motor:
            for motor in MOTORS:
                codes[code, motor] = len(found)
                found.append((code, motor))
        else:
            codes[code, :] = len(found)
            found.append((code, None))
    codes[codes < 0] = len(found)
    return found, codes


STREAMS, _STREAM_CODES = _stream_codes()
"""Kind code and motor (None for kinds without one) of the streams of a port, by number."""

NO_STREAM: Final = len(STREAMS)
"""The number of rows that belong to no stream."""

KEYS_PER_PORT: Final = NO_STREAM + 1


def stream_keys(rows: Rows) -> Ints:
    """For each row: the code of its port * `KEYS_PER_PORT` + the number of its stream."""
    return rows.port.astype(np.int64) * KEYS_PER_PORT + _STREAM_CODES[rows.kinds, rows.nums]


def streams_of(rows: Rows) -> Iterator[tuple[str, int, Ints]]:
    """Port and number of each stream that has rows, and the positions of these, rising."""
    keys = stream_keys(rows)
    # A small integer type makes numpy use a radix sort.
    small = keys.astype(np.min_scalar_type(int(keys.max(initial=0))))
    order = np.argsort(small, kind="stable")
    starts = np.flatnonzero(np.diff(keys[order], prepend=-1)).tolist()
    for start, end in pairwise((*starts, len(order))):
        port, number = divmod(int(keys[order[start]]), KEYS_PER_PORT)
        if number != NO_STREAM:
            yield rows.ports[port], number, order[start:end]


# Facts of rows


class PreviousFrames(Model):
    """The frame before of the same stream, for consecutive rows."""

    def __init__(self) -> None:
        self._last: dict[tuple[str, int], int] = {}
        """By port and number of the stream, the payload of the last frame."""

    def add(self, rows: Rows, changes: Sequence[StreamChange] = ()) -> Rows:
        """The next rows, with `previous`; it is not known across the gaps between them."""
        found, start = [], 0
        for change in changes:
            if isinstance(change.what, Gap):
                found.append(self._added(rows[start : change.index]))
                self.interrupt()
                start = change.index
        found.append(self._added(rows[start:]))
        return rows.replace(previous=np.concatenate(found))

    def interrupt(self) -> None:
        """Rows are missing here."""
        self._last.clear()

    def _added(self, rows: Rows) -> Ints:
        found, payloads = np.full(len(rows), NO_FACT, np.int64), rows.payloads
        for port, number, at in streams_of(rows):
            own = payloads[at]
            found[at[0]] = self._last.get((port, number), NO_FACT)
            found[at[1:]] = own[:-1]
            self._last[port, number] = int(own[-1])
        return found


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
        whole = rows.replace(**{name: facts[name].astype(COLUMNS[name][0]) for name in FACTS})
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
    damaged = np.flatnonzero(rows.is_malformed)
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
    in_step = rows.has(Fault.BAD_HEADER)[at]
    whole = (
        in_step
        & (length == FRAME_LENGTH)
        & (raw[:, FRAME_LENGTH - 1] == TAIL)
        & np.isin(cmds, _NAMING_CMDS)
    )
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
