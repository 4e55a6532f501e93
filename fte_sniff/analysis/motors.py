"""Motor state from commands and replies.

Whole batches are worked on at once. A state is small, however many rows went into it, and can be
copied; so the state at any row costs a copy of an earlier one and the rows between.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from copy import copy
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from fte_sniff.analysis.counters import Recent
from fte_sniff.analysis.fields import NO_TIME, Bools, Decoded, Ints, subject
from fte_sniff.protocol import KINDS, MOTORS, VALUE_FIELDS, Direction, FrameKind
from fte_sniff.protocol.spec import NUM_OFFSET


def _having(keep: Iterator[bool]) -> Bools:
    """By kind code, `NO_KIND` included, which never has what is asked for."""
    return np.array([*keep, False])


_COMMANDS: Final = _having(kind.direction is Direction.CONTROL for kind in KINDS)
_FEEDBACK: Final = _having(kind.direction is Direction.FEEDBACK for kind in KINDS)
_NAMES_MOTOR: Final = _having(kind.names_motor for kind in KINDS)


@dataclass(frozen=True, slots=True)
class Addressed:
    """The places, rising, of one batch's rows that concern motors."""

    commands: dict[int, Ints]
    """To each motor."""
    feedback: dict[int, Ints]
    """From each motor."""
    any_feedback: Ints
    """From all motors, in the order of the rows."""


def addressed(rows: Decoded) -> Addressed:
    """Whom the rows are to, and from."""
    commands = np.flatnonzero(_COMMANDS[rows.kinds])
    feedback = np.flatnonzero(_FEEDBACK[rows.kinds])
    to_all, to = ~_NAMES_MOTOR[rows.kinds[commands]], rows.nums[commands]
    answering = rows.nums[feedback]
    return Addressed(
        {motor: commands[(to == motor) | to_all] for motor in MOTORS},
        {motor: feedback[answering == motor] for motor in MOTORS},
        feedback[(answering >= MOTORS[0]) & (answering <= MOTORS[-1])],
    )


ANSWERABLE: Final = np.array(
    sorted({cmd for kind in KINDS if kind.direction is Direction.FEEDBACK for cmd in kind.cmds})
)
"""The CMDs that feedback can have: a command with another awaits nothing."""

_BEFORE: Final = -1
_NEVER: Final = 2**62


@dataclass(frozen=True, slots=True)
class Delays:
    """How long answers took, as far as that can be measured."""

    delays_ns: Ints
    """From a command's first byte to that of its answer, nanoseconds."""
    ends_ns: Ints
    """When each answer came, nanoseconds since 1970 UTC."""


_NO_DELAYS: Final = Delays(np.empty(0, np.int64), np.empty(0, np.int64))


@dataclass(frozen=True, slots=True)
class PendingCommands:
    """Some frames of a batch, in order."""

    places: Ints
    """Where in the batch they stand, from 0, rising."""
    cmds: Ints
    t_ns: Ints
    """Nanoseconds since 1970 UTC, or `NO_TIME`."""

    @classmethod
    def of(cls, rows: Decoded, places: Ints) -> PendingCommands:
        """Those of the rows that stand at these places."""
        return cls(places, rows.cmds[places].astype(np.int64), rows.t_ns[places])

    def before(self, cmd: int, t_ns: int) -> PendingCommands:
        """The same with one more that came before the batch."""
        return PendingCommands(
            np.concatenate(([_BEFORE], self.places)),
            np.concatenate(([cmd], self.cmds)),
            np.concatenate(([t_ns], self.t_ns)),
        )


class Pairing:
    """The commands to one motor so far, and how many of them were answered."""

    def __init__(self) -> None:
        self.answered = 0
        self.unanswered = 0
        self.delays = Recent()
        """From a command's first byte to that of its answer, nanoseconds, the latest of them."""
        self._waiting: tuple[int, int] | None = None

    def interrupt(self) -> None:
        """Frames are missing here: whether the last command was answered will never be known."""
        self._waiting = None

    def copied(self) -> Pairing:
        """The same, which later frames do not change."""
        other = copy(self)
        other.delays = copy(self.delays)
        return other

    @property
    def waiting(self) -> bool:
        """Whether the last command may still be answered."""
        return self._waiting is not None

    @property
    def waiting_since_ns(self) -> int | None:
        """The time of the command that waits, if there is one and it has a time."""
        if self._waiting is None or self._waiting[1] == NO_TIME:
            return None
        return self._waiting[1]

    def add(self, commands: PendingCommands, feedback: PendingCommands) -> Delays:
        """Take the commands to this motor, and its feedback, in the next batch of rows.

        Returns:
            The delays of the answers that it found.
        """
        if self._waiting is not None:
            commands = commands.before(*self._waiting)
        if not len(commands.places):
            return _NO_DELAYS
        answers, answered = _answers(commands, feedback)
        found = _delays(commands.t_ns[answered], feedback.t_ns[answers[answered]])
        self.delays.add(found.delays_ns)
        awaits = np.isin(commands.cmds, ANSWERABLE)
        waits = bool(awaits[-1] and not answered[-1])
        self._waiting = (int(commands.cmds[-1]), int(commands.t_ns[-1])) if waits else None
        self.answered += int(answered.sum())
        self.unanswered += int((awaits & ~answered).sum()) - waits
        return found


def _delays(asked_ns: Ints, answered_ns: Ints) -> Delays:
    measured = (asked_ns != NO_TIME) & (answered_ns != NO_TIME) & (answered_ns >= asked_ns)
    return Delays((answered_ns - asked_ns)[measured], answered_ns[measured])


def _answers(commands: PendingCommands, feedback: PendingCommands) -> tuple[Ints, Bools]:
    """For every command the place in `feedback` of its answer, and whether it has one."""
    answers = np.zeros(len(commands.places), np.int64)
    answered = np.zeros(len(commands.places), np.bool_)
    ends = np.append(commands.places[1:], _NEVER)
    for cmd in ANSWERABLE:
        asking = np.flatnonzero(commands.cmds == cmd)
        same = np.flatnonzero(feedback.cmds == cmd)
        if not len(asking) or not len(same):
            continue
        places = feedback.places[same]
        first = np.searchsorted(places, commands.places[asking], side="right")
        found = first < len(same)
        found[found] = places[first[found]] < ends[asking[found]]
        answered[asking[found]] = True
        answers[asking[found]] = same[first[found]]
    return answers, answered


FLAG_FIELDS: Final = tuple(field.name for field in VALUE_FIELDS if field.defined_bits is not None)
"""The row names of the flag bytes."""

BITS: Final = range(8)


@dataclass(frozen=True, slots=True)
class MotorReading:
    """A value, and when it was told."""

    value: int
    t_ns: int | None
    """When the frame began that told it, nanoseconds since 1970 UTC; None without times."""


@dataclass(frozen=True, slots=True)
class MotorTarget:
    """The last command that a motor was given."""

    kind: FrameKind
    values: Mapping[str, int]
    """By row name, without the motor's number."""
    t_ns: int | None
    since_ns: int | None
    """When the first came of the latest commands that all say the same."""


@dataclass(frozen=True, slots=True)
class Flags:
    """A flag byte, and when its bits changed."""

    byte: int
    changed_ns: tuple[int | None, ...]
    """By bit, from 0: when it was last seen to differ from before; None where it never was."""


@dataclass(frozen=True, slots=True)
class MotorState:
    """All that is known of one motor at one row; what is not known is None, never 0."""

    motor: int
    target: MotorTarget | None
    """The last command; a reset and a motion of the chassis are commands to every motor."""
    present: Mapping[str, MotorReading]
    """What feedback told last, by row name (`rpm`, `pulses`); those never told are not in it."""
    flags: Mapping[str, Flags]
    """The flag bytes in this motor's own feedback, by row name; empty before the first."""
    online: bool | None
    """This motor's bit in the ONLINE byte of the latest feedback of any motor.

    That bit 0 is motor 1 is an assumption (PROTOCOL.md, "What the document leaves open").
    """
    online_changed_ns: int | None
    commands: int
    feedback: int
    """Frames so far."""
    answered: int
    unanswered: int
    """Commands so far, by whether feedback came before the next command (see `pairing`)."""
    waiting_since_ns: int | None
    """The time of the last command while it is neither."""
    delay_p50_ns: int | None
    delay_p99_ns: int | None
    """From a command to its answer, over the latest ones."""
    commands_per_s: float | None
    feedback_per_s: float | None


class _FlagByte:
    """One flag byte over time."""

    def __init__(self) -> None:
        self.byte: int | None = None
        self._changed: list[int | None] = [None for _ in BITS]

    def add(self, bytes_: Ints, t_ns: Ints) -> None:
        """These values came at these times."""
        if not len(bytes_):
            return
        before = bytes_[0] if self.byte is None else self.byte
        changes = bytes_ ^ np.concatenate(([before], bytes_[:-1]))
        for bit in BITS if changes.any() else ():
            places = np.flatnonzero(changes >> bit & 1)
            if len(places):
                self._changed[bit] = _time(t_ns[places[-1]])
        self.byte = int(bytes_[-1])

    def copied(self) -> _FlagByte:
        other = copy(self)
        other._changed = self._changed.copy()
        return other

    @property
    def flags(self) -> Flags | None:
        return None if self.byte is None else Flags(self.byte, tuple(self._changed))


_SUBJECTS: Final = [
    (code, name)
    for code, kind in enumerate(KINDS)
    if kind.direction is Direction.FEEDBACK and (name := subject(kind))
]


class _Motor:
    """One motor's state, as it changes."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.commands = self.feedback = 0
        self.pairing = Pairing()
        self._target: MotorTarget | None = None
        self._present: dict[str, MotorReading] = {}
        self._flags = {name: _FlagByte() for name in FLAG_FIELDS}
        self._command_times, self._feedback_times = Recent(), Recent()

    def add(self, rows: Decoded, commands: Ints, feedback: Ints) -> None:
        """The places in the batch of the commands to this motor, and of its feedback."""
        self.pairing.add(PendingCommands.of(rows, commands), PendingCommands.of(rows, feedback))
        self.commands += len(commands)
        self.feedback += len(feedback)
        self._command_times.add(_known(rows.t_ns[commands]))
        self._feedback_times.add(_known(rows.t_ns[feedback]))
        if len(commands):
            self._aim(rows, commands)
        if not len(feedback):
            return
        for code, name in _SUBJECTS:
            places = feedback[rows.kinds[feedback] == code]
            if len(places):
                last = int(places[-1])
                self._present[name] = MotorReading(rows.value(name, last), _time(rows.t_ns[last]))
        for name, flag_byte in self._flags.items():
            flag_byte.add(rows.values(name, feedback), rows.t_ns[feedback])

    def interrupt(self) -> None:
        self.pairing.interrupt()
        self._command_times, self._feedback_times = Recent(), Recent()

    def _aim(self, rows: Decoded, commands: Ints) -> None:
        place = int(commands[-1])
        kind = KINDS[rows.kinds[place]]
        fields = [field for field in kind.fields if field.start != NUM_OFFSET]
        values = {field.name: rows.value(field.name, place) for field in fields}
        told = [at for field in fields for at in field.offsets]
        same = rows.kinds[commands] == rows.kinds[place]
        same &= (rows.raw[np.ix_(commands, told)] == rows.raw[place, told]).all(axis=1)
        others, before = np.flatnonzero(~same), self._target
        first = int(others[-1]) + 1 if len(others) else 0
        since = _time(rows.t_ns[commands[first]])
        if not first and before and (before.kind, before.values) == (kind, values):
            since = before.since_ns
        self._target = MotorTarget(kind, MappingProxyType(values), _time(rows.t_ns[place]), since)

    def copied(self) -> _Motor:
        other = copy(self)
        other.pairing = self.pairing.copied()
        other._present = self._present.copy()
        other._flags = {name: byte.copied() for name, byte in self._flags.items()}
        other._command_times = copy(self._command_times)
        other._feedback_times = copy(self._feedback_times)
        return other

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
        )


class Motors:
    """Every motor of the controller, as far as the rows added so far tell."""

    def __init__(self) -> None:
        self._motors = [_Motor(number) for number in MOTORS]
        self._online = _FlagByte()

    def add(self, rows: Decoded, found: Addressed | None = None) -> None:
        """The next rows, in order of time, and whom they are to and from, where that is known."""
        found = found or addressed(rows)
        for motor in self._motors:
            motor.add(rows, found.commands[motor.number], found.feedback[motor.number])
        named = found.any_feedback
        self._online.add(rows.values("online", named), rows.t_ns[named])

    def interrupt(self) -> None:
        """Rows are missing here: no answer is looked for behind this, and no rate goes over it."""
        for motor in self._motors:
            motor.interrupt()

    def copied(self) -> Motors:
        """The same, which later rows do not change."""
        other = Motors()
        other._motors = [motor.copied() for motor in self._motors]
        other._online = self._online.copied()
        return other

    def states(self, now_ns: int | None) -> list[MotorState]:
        """What is known of each motor; rates are those at `now_ns`, not before the last row."""
        online = self._online.flags
        return [motor.state(online, now_ns) for motor in self._motors]


def _time(t_ns: int) -> int | None:
    return None if t_ns == NO_TIME else int(t_ns)


def _known(t_ns: Ints) -> Ints:
    known: Ints = t_ns[t_ns != NO_TIME]
    return known
