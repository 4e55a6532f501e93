"""The motors: state, statistics, and events over time, from commands and feedback.

Batches are processed as columns. A state has constant size and can be copied, so that the state at
any row can be computed from an earlier copy and the rows between.

Events of a motor over time:

    lanes of a motor      x    xx x        commands without an answer, at the time of the command
                           >  >            answers that came later than usual
                              !  !!        damaged rows that were probably to or from the motor
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from types import MappingProxyType
from typing import Final

import numpy as np

from fte_sniff.analysis.counters import Durations, RecentValues, Series, extent
from fte_sniff.analysis.facts import (
    ANSWERABLE,
    BEFORE_BATCH,
    NO_COMMANDS,
    DecidedCommands,
    MotorRows,
    Pairing,
    motor_rows,
)
from fte_sniff.analysis.model import Ends, Model, RowCount
from fte_sniff.errors import TranslatableText
from fte_sniff.protocol import FRAME_LENGTH, KINDS, MOTORS, VALUE_FIELDS, Direction, FrameKind, Gap
from fte_sniff.protocol.rows import NO_TIME, Bools, Ints, Rows
from fte_sniff.protocol.spec import NUM_OFFSET, Role, motor_bit, online_bit_text

# State

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


class _AnswersToCmd(Model):
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


class _TrackedMotor(Model):
    def __init__(self, number: int) -> None:
        self.number = number
        self.commands = self.feedback = 0
        self.pairing = Pairing()
        self.decided = NO_COMMANDS
        """The commands that the last batch decided."""
        self._answers = {cmd: _AnswersToCmd() for cmd in ANSWERABLE.tolist()}
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
            cmds[decided.indices == BEFORE_BATCH] = open_cmd
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
        self._motors = [_TrackedMotor(number) for number in MOTORS]
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


# Statistics


@dataclass
class FlagStats(Model):
    """The flags of one motor."""

    motor: int
    error_bits: dict[int, RowCount] = field(default_factory=dict)
    """Frames by bit of ERROR, from 0; only bits that were set in this motor's feedback."""
    offline: RowCount = field(default_factory=RowCount)
    """Feedback of any motor whose ONLINE byte lacks this motor's bit."""
    times_lost: int = 0
    """Number of times that the bit changed from 1 to 0."""

    def merge(self, other: FlagStats) -> None:
        """Add the frames of other statistics of the same motor."""
        for bit, count in other.error_bits.items():
            self.error_bits.setdefault(bit, RowCount()).merge(count)
        self.offline.merge(other.offline)
        self.times_lost += other.times_lost


class FlagCounts(Model):
    """The flags of all motors so far."""

    def __init__(self) -> None:
        self._motors = {number: FlagStats(number) for number in MOTORS}
        self._online = Ends[int]()
        """The ONLINE bytes of the first and the last feedback."""

    def merge(self, later: FlagCounts) -> None:
        """Add the flags of the rows that follow."""
        before, after = self._online.merge(later._online) or (0, 0)
        for number, motor in self._motors.items():
            motor.merge(later._motors[number])
            motor.times_lost += (before & ~after) >> motor_bit(number) & 1

    def observe(self, rows: Rows, found: MotorRows) -> None:
        """Add the next rows, in order of time."""
        for number, own in found.feedback.items():
            self._count_errors(self._motors[number], rows.values(Role.ERRORS, own), rows.t_ns[own])
        feedback = found.any_feedback
        if len(feedback):
            self._count_online(rows.values(Role.ONLINE, feedback), rows.t_ns[feedback])

    def _count_errors(self, motor: FlagStats, errors: Ints, t_ns: Ints) -> None:
        ever = int(np.bitwise_or.reduce(errors)) if len(errors) else 0
        for bit in BITS:
            if ever >> bit & 1:
                having = (errors >> bit & 1).astype(np.bool_)
                _count(motor.error_bits.setdefault(bit, RowCount()), t_ns[having])

    def _count_online(self, online: Ints, t_ns: Ints) -> None:
        before = self._online.append(int(online[0]), int(online[-1]))
        before = int(online[0]) if before is None else before
        lost = np.concatenate(([before], online[:-1])) & ~online
        always = int(np.bitwise_and.reduce(online))
        for number, motor in self._motors.items():
            bit = motor_bit(number)
            if not always >> bit & 1:
                _count(motor.offline, t_ns[(online >> bit & 1) == 0])
                motor.times_lost += int((lost >> bit & 1).sum())

    def stats(self) -> list[FlagStats]:
        """By motor."""
        for motor in self._motors.values():
            motor.error_bits = dict(sorted(motor.error_bits.items()))
        return list(self._motors.values())


def _count(flag: RowCount, t_ns: Ints) -> None:
    flag.count(len(t_ns), len(t_ns) * FRAME_LENGTH, extent(t_ns[t_ns != NO_TIME]))


FLAGS_IN_ORDER: Final = TranslatableText(
    "no ERROR bit was ever set, and every motor was always ONLINE"
)

TimeText = Callable[[int | None], str]
"""Formats nanoseconds since 1970 UTC; a dash for None."""


def flag_texts(
    motors: Sequence[FlagStats], time_text: TimeText, *, in_order: bool
) -> Iterator[TranslatableText]:
    """A line for each flag that was raised; `in_order` says whether rows are ordered by time."""
    for motor in motors:
        for bit, seen in motor.error_bits.items():
            yield TranslatableText(
                "motor {motor}: ERROR bit {bit} set in {seen}",
                motor=motor.motor,
                bit=bit,
                seen=_count_text(seen, time_text),
            )
        if motor.offline.rows:
            text = TranslatableText(
                "{bit} was 0 in {seen}",
                bit=online_bit_text(motor.motor),
                seen=_count_text(motor.offline, time_text),
            )
            lost = _lost_text(motor.times_lost)
            yield TranslatableText("{one}; {other}", one=text, other=lost) if in_order else text


def _count_text(seen: RowCount, time_text: TimeText) -> TranslatableText:
    """`12 frames, 12:00:01.000 to 12:00:09.000`."""
    frames = TranslatableText("{count:,} frames", count=seen.rows)
    if seen.rows == 1:
        frames = TranslatableText("1 frame")
    if seen.first_ns is None:
        return frames
    times = from_to(seen.first_ns, seen.last_ns, time_text)
    return TranslatableText("{frames}, {time}", frames=frames, time=times)


def _lost_text(times: int) -> TranslatableText:
    if times == 1:
        return TranslatableText("lost once")
    return TranslatableText("lost {count:,} times", count=times)


def from_to(first_ns: int, last_ns: int | None, time_text: TimeText) -> str:
    """`12:00:01.000 to 12:00:09.000`; one time if both are the same."""
    if first_ns == last_ns:
        return time_text(first_ns)
    return TranslatableText("{start} to {end}", start=time_text(first_ns), end=time_text(last_ns))


@dataclass
class AnswerStats(Model):
    """The commands to one motor, and their answers."""

    motor: int
    commands: int = 0
    """Frames to it; a reset and a chassis motion are commands to every motor."""
    feedback: int = 0
    """Frames from it."""
    pairing: Pairing = field(default_factory=Pairing)
    delays: Durations = field(default_factory=Durations)
    """From each command to its answer; its ends are the times of the answers."""

    @property
    def unanswered(self) -> int | None:
        """Commands without an answer; None where feedback never came: its wire may be missing."""
        pairing = self.pairing
        covered = pairing.answered or pairing.unanswered or not pairing.uncovered
        return pairing.unanswered if covered else None

    @property
    def neither(self) -> int:
        """Commands that expect no feedback, or of which it is not known whether they were answered.

        They are before the first feedback, a gap, or the end of the rows.
        """
        return self.commands - self.pairing.answered - self.pairing.unanswered


class Answers(Model):
    """The commands and answers of all motors so far."""

    def __init__(self) -> None:
        self._motors = [AnswerStats(number) for number in MOTORS]

    def observe(self, rows: Rows, found: MotorRows) -> None:
        """Add the next rows, in order of time."""
        for motor in self._motors:
            commands, feedback = found.commands[motor.motor], found.feedback[motor.motor]
            motor.commands += len(commands)
            motor.feedback += len(feedback)
            motor.delays.observe(*motor.pairing.observe(rows, found, motor.motor).measured)

    def merge(self, later: Answers) -> None:
        """Add the rows that follow."""
        for motor, other in zip(self._motors, later._motors, strict=True):
            motor.commands += other.commands
            motor.feedback += other.feedback
            motor.delays.observe(*motor.pairing.merge(other.pairing).measured)
            motor.delays.merge(other.delays)

    def interrupt(self, gap: Gap | None = None) -> None:
        """Rows are missing here: a command before the gap has no answer after it."""
        for motor in self._motors:
            motor.pairing.interrupt(gap)

    def stats(self) -> list[AnswerStats]:
        """By motor."""
        return self._motors


# Events over time


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
        self._series = Series()
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
