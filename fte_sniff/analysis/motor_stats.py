"""Statistics of motors: flags and their texts, and answer times."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from fte_sniff.analysis.counters import Durations, extent
from fte_sniff.analysis.model import Ends, Model
from fte_sniff.analysis.motors import BITS, MotorRows, Pairing
from fte_sniff.analysis.tally import RowCount
from fte_sniff.errors import TranslatableText
from fte_sniff.protocol import FRAME_LENGTH, MOTORS, Gap
from fte_sniff.protocol.rows import NO_TIME, Ints, Rows
from fte_sniff.protocol.spec import Role, motor_bit, online_bit_text


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
