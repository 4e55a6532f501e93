"""State of the motors, from commands and feedback.

Batches are processed as columns. A state has constant size and can be copied, so that the state at
any row can be computed from an earlier copy and the rows between.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final

import numpy as np

from fte_sniff.analysis.counters import RecentValues
from fte_sniff.analysis.model import Model
from fte_sniff.protocol import KINDS, MOTORS, VALUE_FIELDS, Direction, FrameKind, Gap, GapKind
from fte_sniff.protocol.rows import NO_TIME, Bools, Ints, Rows
from fte_sniff.protocol.spec import NUM_OFFSET, Role


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
class _Waiting:
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
_BEFORE_BATCH: Final = -1
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
            np.concatenate(([_BEFORE_BATCH], self.indices)),
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


_NO_COMMANDS: Final = DecidedCommands(_NONE, _NONE.astype(np.bool_), _NONE, _NONE, _NONE, _NONE)


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
        self._waiting: _Waiting | None = None
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
        decided = _NO_COMMANDS
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
            return _NO_COMMANDS
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
        self._waiting = _Waiting(*last) if waits else None
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


FLAG_FIELDS: Final = tuple(field.name for field in VALUE_FIELDS if field.legal_bits is not None)

BITS: Final = range(8)


@dataclass(frozen=True, slots=True)
class MotorReading:
    """A value and its time."""

    value: int
    t_ns: int | None
    """Start of the frame, nanoseconds since 1970 UTC; None without times."""


@dataclass(frozen=True, slots=True)
class MotorTarget:
    """The last command to a motor."""

    kind: FrameKind
    values: Mapping[str, int]
    """By column name, without the motor's number."""
    t_ns: int | None
    since_ns: int | None
    """Time of the first of the latest equal commands."""


@dataclass(frozen=True, slots=True)
class Flags:
    """A flag byte and when its bits changed."""

    byte: int
    changed_ns: tuple[int | None, ...]
    """By bit, from 0: time of the last change; None if it never changed."""


@dataclass(frozen=True, slots=True)
class AnsweredCommands:
    """The commands to one motor with one CMD, and their answers."""

    answered: int
    unanswered: int
    delay_p50_ns: int | None
    """Median of the latest answer times."""


class _Answers(Model):
    def __init__(self) -> None:
        self._answered = self._unanswered = 0
        self._delays = RecentValues()

    def observe(self, answered: Bools, delays_ns: Ints) -> None:
        self._answered += int(answered.sum())
        self._unanswered += len(answered) - int(answered.sum())
        self._delays.observe(delays_ns[answered & (delays_ns != NO_TIME)])

    @property
    def counts(self) -> AnsweredCommands | None:
        """None before the first command."""
        if not self._answered + self._unanswered:
            return None
        delays = np.sort(self._delays.values)
        middle = int(delays[len(delays) // 2]) if len(delays) else None
        return AnsweredCommands(self._answered, self._unanswered, middle)


@dataclass(frozen=True, slots=True)
class MotorState:
    """State of one motor at one row; an unknown value is None, never 0."""

    motor: int
    target: MotorTarget | None
    """A reset and a chassis motion are commands to every motor."""
    present: Mapping[str, MotorReading]
    """Latest feedback by column name (`rpm`, `pulses`), without names that never came."""
    flags: Mapping[str, Flags]
    """Flag bytes in this motor's own feedback, by column name; empty before the first."""
    online: bool | None
    """This motor's bit in the ONLINE byte of the latest feedback of any motor.

    That bit 0 is motor 1 is an assumption (docs/reference/protocol.md, "What the
    document leaves open").
    """
    online_changed_ns: int | None
    commands: int
    feedback: int
    answered: int
    unanswered: int
    """Commands so far, see `Pairing`."""
    waiting_since_ns: int | None
    """Time of the last command, if it may still be answered."""
    delay_p50_ns: int | None
    delay_p99_ns: int | None
    """Answer times, over the latest commands."""
    commands_per_s: float | None
    feedback_per_s: float | None
    answers: Mapping[int, AnsweredCommands]
    """By CMD of the commands, without those that never came."""


class _FlagByte(Model):
    def __init__(self) -> None:
        self.byte: int | None = None
        self._changed: list[int | None] = [None for _ in BITS]

    def observe(self, bytes_: Ints, t_ns: Ints) -> None:
        if not len(bytes_):
            return
        before = bytes_[0] if self.byte is None else self.byte
        changes = bytes_ ^ np.concatenate(([before], bytes_[:-1]))
        for bit in BITS if changes.any() else ():
            changed = np.flatnonzero(changes >> bit & 1)
            if len(changed):
                self._changed[bit] = _time(t_ns[changed[-1]])
        self.byte = int(bytes_[-1])

    @property
    def flags(self) -> Flags | None:
        return None if self.byte is None else Flags(self.byte, tuple(self._changed))


_SUBJECTS: Final = [
    (code, name)
    for code, kind in enumerate(KINDS)
    if kind.direction is Direction.FEEDBACK and (name := kind.subject)
]


class _Motor(Model):
    def __init__(self, number: int) -> None:
        self.number = number
        self.commands = self.feedback = 0
        self.pairing = Pairing()
        self.decided = _NO_COMMANDS
        """The commands that the last batch decided."""
        self._answers = {cmd: _Answers() for cmd in ANSWERABLE.tolist()}
        self._target: MotorTarget | None = None
        self._present: dict[str, MotorReading] = {}
        self._flags = {name: _FlagByte() for name in FLAG_FIELDS}
        self._command_times, self._feedback_times = RecentValues(), RecentValues()

    def observe(self, rows: Rows, found: MotorRows) -> None:
        """Apply the commands to this motor and its feedback."""
        self._pair(rows, found)
        commands, feedback = found.commands[self.number], found.feedback[self.number]
        self.commands += len(commands)
        self.feedback += len(feedback)
        self._command_times.observe(_known_times(rows.t_ns[commands]))
        self._feedback_times.observe(_known_times(rows.t_ns[feedback]))
        if len(commands):
            self._set_target(rows, commands)
        if not len(feedback):
            return
        for code, name in _SUBJECTS:
            having = feedback[rows.kinds[feedback] == code]
            if len(having):
                last = int(having[-1])
                self._present[name] = MotorReading(rows.value(name, last), _time(rows.t_ns[last]))
        for name, flag_byte in self._flags.items():
            flag_byte.observe(rows.values(name, feedback), rows.t_ns[feedback])

    def _pair(self, rows: Rows, found: MotorRows) -> None:
        open_cmd = self.pairing.waiting_cmd
        decided = self.decided = self.pairing.observe(rows, found, self.number)
        if not len(decided.indices):
            return
        cmds = rows.cmds[decided.indices].astype(np.int64)
        if open_cmd is not None:
            cmds[decided.indices == _BEFORE_BATCH] = open_cmd
        for cmd, answers in self._answers.items():
            own = cmds == cmd
            if own.any():
                answers.observe(decided.answered[own], decided.delays_ns[own])

    def interrupt(self, gap: Gap | None) -> None:
        self.pairing.interrupt(gap)
        self._command_times, self._feedback_times = RecentValues(), RecentValues()

    def _set_target(self, rows: Rows, commands: Ints) -> None:
        last = int(commands[-1])
        kind = KINDS[rows.kinds[last]]
        fields = [field for field in kind.fields if field.start != NUM_OFFSET]
        values = {field.name: rows.value(field.name, last) for field in fields}
        offsets = [offset for field in fields for offset in field.offsets]
        same = rows.kinds[commands] == rows.kinds[last]
        same &= (rows.raw[np.ix_(commands, offsets)] == rows.raw[last, offsets]).all(axis=1)
        others, before = np.flatnonzero(~same), self._target
        first = int(others[-1]) + 1 if len(others) else 0
        since = _time(rows.t_ns[commands[first]])
        if not first and before and (before.kind, before.values) == (kind, values):
            since = before.since_ns
        self._target = MotorTarget(kind, MappingProxyType(values), _time(rows.t_ns[last]), since)

    def state(self, online: Flags | None, now_ns: int | None) -> MotorState:
        delays, bit = self.pairing.delays, self.number - MOTORS[0]
        flags = {name: byte.flags for name, byte in self._flags.items()}
        return MotorState(
            motor=self.number,
            target=self._target,
            present=dict(self._present),
            flags={name: known for name, known in flags.items() if known},
            online=None if online is None else bool(online.byte >> bit & 1),
            online_changed_ns=None if online is None else online.changed_ns[bit],
            commands=self.commands,
            feedback=self.feedback,
            answered=self.pairing.answered,
            unanswered=self.pairing.unanswered,
            waiting_since_ns=self.pairing.waiting_since_ns,
            delay_p50_ns=delays.percentile(50),
            delay_p99_ns=delays.percentile(99),
            commands_per_s=None if now_ns is None else self._command_times.per_second(now_ns),
            feedback_per_s=None if now_ns is None else self._feedback_times.per_second(now_ns),
            answers={cmd: counts for cmd, one in self._answers.items() if (counts := one.counts)},
        )


class Motors(Model):
    """Models of all motors."""

    def __init__(self) -> None:
        self._motors = [_Motor(number) for number in MOTORS]
        self._online = _FlagByte()

    def observe(self, rows: Rows, found: MotorRows | None = None) -> None:
        """Apply the next rows, in order of time; `found` is `motor_rows(rows)` if known."""
        found = found or motor_rows(rows)
        for motor in self._motors:
            motor.observe(rows, found)
        feedback = found.any_feedback
        self._online.observe(rows.values(Role.ONLINE, feedback), rows.t_ns[feedback])

    def interrupt(self, gap: Gap | None = None) -> None:
        """Rows are missing here: no answer and no rate spans the gap."""
        for motor in self._motors:
            motor.interrupt(gap)

    @property
    def decided(self) -> Mapping[int, DecidedCommands]:
        """By motor, the commands that the last batch decided."""
        return {motor.number: motor.decided for motor in self._motors}

    def usual_delay_ns(self, motor: int, least: int) -> int | None:
        """The median of a motor's latest answer times; None where there are fewer than `least`."""
        delays = self._motors[motor - MOTORS[0]].pairing.delays
        return delays.percentile(50) if len(delays.values) >= least else None

    def states(self, now_ns: int | None) -> list[MotorState]:
        """The state of every motor, with rates at `now_ns`, which is not before the last row."""
        online = self._online.flags
        return [motor.state(online, now_ns) for motor in self._motors]


def _time(t_ns: int) -> int | None:
    return None if t_ns == NO_TIME else int(t_ns)


def _known_times(t_ns: Ints) -> Ints:
    known: Ints = t_ns[t_ns != NO_TIME]
    return known
