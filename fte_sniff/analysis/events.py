"""Events of trouble, counted by window of time: what `findings` looks for spans in.

A window has 2^30 ns. Its counts are sums, its ranges are lowest and highest values, so the counts
of two parts of a recording merge by addition. With more than `MOST_WINDOWS` windows, pairs are
merged: a column of counts then needs no more memory, whatever the length of the recording.

    windows    1 column a count      commands of a motor, those without answer, answers by octave
               1 column a range      targets and present values of a motor
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from fte_sniff.analysis.feed import BaudChange
from fte_sniff.analysis.model import Model
from fte_sniff.analysis.motors import ANSWERABLE, NAMES_MOTOR, motor_rows
from fte_sniff.analysis.series import Keep
from fte_sniff.protocol import (
    KINDS,
    MOTORS,
    Direction,
    Gap,
    PortEvent,
    PortEventKind,
    Status,
    status_of,
)
from fte_sniff.protocol.rows import NO_FACT, NO_TIME, Bools, Ints, Rows
from fte_sniff.protocol.spec import HEADERS, FrameKind, Role, motor_bit

SHIFT: Final = 30
"""A window has 2 to this power of nanoseconds at first, about a second."""

MOST_WINDOWS: Final = 1 << 14

RUNNING: Final = 3
"""Frames in a row with a raised flag from which on it is not a flipped bit."""

GRADES: Final = 24
"""Grades of a value: half octaves."""


class Windows(Model):
    """Counts and ranges by window, in named columns; only windows with rows take memory."""

    def __init__(self) -> None:
        self.shift = SHIFT
        self._keys: Ints = np.zeros(0, np.int64)
        self._columns: dict[tuple[Keep, str], Ints] = {}

    def __len__(self) -> int:
        return len(self._keys)

    @property
    def starts_ns(self) -> Ints:
        """The start of each window, rising."""
        return self._keys << self.shift

    @property
    def width_ns(self) -> int:
        """Nanoseconds of a window."""
        return 1 << self.shift

    def _column(self, keep: Keep, name: str) -> Ints:
        found = self._columns.get((keep, name))
        return keep.empty(len(self)) if found is None else found

    def count(self, name: str) -> Ints:
        """A column of counts."""
        return self._column(Keep.TOTAL, name)

    def names(self) -> list[str]:
        """The columns of counts."""
        return [name for keep, name in self._columns if keep is Keep.TOTAL]

    def range_of(self, name: str) -> tuple[Ints, Ints, Bools]:
        """The lowest and the highest value by window, and which windows have one."""
        low, high = self._column(Keep.LOW, name), self._column(Keep.HIGH, name)
        return low, high, high != Keep.HIGH.value

    def add(self, batch: Batch) -> None:
        """Add what a batch counted."""
        self._merge(batch.keys, batch.columns)

    def merge(self, other: Windows) -> None:
        """Add the windows of other rows."""
        while self.shift < other.shift:
            self._halve()
        self._merge(other._keys >> (self.shift - other.shift), other._columns)

    def _merge(self, keys: Ints, columns: dict[tuple[Keep, str], Ints]) -> None:
        if not len(keys):
            return
        merged, at = np.unique(np.concatenate((self._keys, keys)), return_inverse=True)
        old, new = at[: len(self._keys)], at[len(self._keys) :]
        own, self._columns = self._columns, {}
        for keep, name in {**own, **columns}:
            column = self._columns[keep, name] = keep.empty(len(merged))
            for places, having in ((old, own), (new, columns)):
                if (keep, name) in having:
                    keep.add(column, places, having[keep, name])
        self._keys = merged
        while len(self._keys) > MOST_WINDOWS:
            self._halve()

    def _halve(self) -> None:
        keys, columns = self._keys >> 1, self._columns
        self.shift += 1
        self._keys, self._columns = np.zeros(0, np.int64), {}
        self._merge(keys, columns)

    def since(self, first_ns: int) -> Windows:
        """The windows from a time on."""
        found, own = Windows(), self.starts_ns + self.width_ns > first_ns
        found.shift, found._keys = self.shift, self._keys[own]
        found._columns = {name: column[own] for name, column in self._columns.items()}
        return found


class Batch:
    """Counts of one batch by its windows."""

    def __init__(self, t_ns: Ints, shift: int) -> None:
        self.keys, self._at = np.unique(t_ns >> shift, return_inverse=True)
        self.columns: dict[tuple[Keep, str], Ints] = {}

    def _add(self, keep: Keep, name: str, rows: Ints | Bools, values: Ints | int) -> None:
        at = self._at[rows]
        if len(at):
            column = self.columns.setdefault((keep, name), keep.empty(len(self.keys)))
            keep.add(column, at, values)

    def count(self, name: str, rows: Ints | Bools) -> None:
        """Count rows, by a mask or by indices."""
        self._add(Keep.TOTAL, name, rows, 1)

    def range(self, name: str, rows: Ints, values: Ints) -> None:
        """Extend a range by the values of rows, by indices."""
        self._add(Keep.LOW, name, rows, values)
        self._add(Keep.HIGH, name, rows, values)


def grade_of(values: Ints) -> Ints:
    """Half octaves of values from 1 on."""
    grades = (2 * np.log2(np.maximum(values, 1))).astype(np.int64)
    return np.minimum(grades, GRADES - 1)


def least_of(grade: int) -> float:
    """The least value of a grade."""
    return float(2 ** (grade / 2))


DELAY_UNIT_NS: Final = 250_000
"""Answer times are graded in this unit, nanoseconds."""

RATIO_UNIT: Final = 4
"""Grades of the ratio of two periods: quarters of an octave."""


def by_role(role: Role, *, target: bool) -> list[FrameKind]:
    """The kinds that name a motor and have a target, or a present value, of that role."""
    direction = Direction.CONTROL if target else Direction.FEEDBACK
    return [
        kind
        for kind in KINDS
        if kind.direction is direction
        and kind.names_motor
        and kind.subject is not None
        and any(one.role is role and one.name == kind.subject for one in kind.fields)
    ]


@dataclass
class _Carried(Model):
    """What of the rows before concerns the next ones."""

    raised: dict[str, Bools] = field(default_factory=dict)
    """By flag, the last frames, whether it was raised."""
    periods: dict[str, tuple[int, int]] = field(default_factory=dict)
    """By stream, the time of the last command, and the period before it."""
    values: dict[str, Ints] = field(default_factory=dict)
    """By stream, the last two values."""


_NO_PERIOD: Final = -1
_NO_VALUES: Final = np.zeros(0, np.int64)


class Events(Model):
    """Counts the events of all causes; rows must have facts."""

    def __init__(self) -> None:
        self.windows = Windows()
        """What is about motors."""
        self.ports: dict[str, Windows] = {}
        self.lost: list[tuple[str, int, int | None]] = []
        """Ports that were lost: from when, and until when."""
        self.bytes: dict[tuple[str, int], int] = {}
        """By flag and motor, the bits that were raised."""
        self._carried = _Carried()

    def since(self, first_ns: int) -> Events:
        """The events from a time on."""
        found = Events()
        found.windows = self.windows.since(first_ns)
        found.ports = {port: one.since(first_ns) for port, one in self.ports.items()}
        found.lost = [one for one in self.lost if one[2] is None or one[2] >= first_ns]
        found.bytes = self.bytes
        return found

    def interrupt(self) -> None:
        """Rows are missing here."""
        self._carried = _Carried()

    def observe_change(self, change: Gap | BaudChange) -> None:
        """Apply a change before the next rows."""
        if isinstance(change, Gap):
            self.interrupt()

    def observe_events(self, events: Sequence[PortEvent]) -> None:
        """Add port events."""
        for event in events:
            if event.kind is PortEventKind.LOST:
                self.lost.append((event.port, event.t_ns, None))
            elif event.kind is PortEventKind.FOUND_AGAIN:
                for at, (port, start, end) in enumerate(self.lost):
                    if port == event.port and end is None:
                        self.lost[at] = port, start, event.t_ns
            elif event.kind in (PortEventKind.LINE_ERROR, PortEventKind.OVERRUN):
                t_ns = np.array([event.t_ns])
                windows = self.ports.setdefault(event.port, Windows())
                batch = Batch(t_ns, windows.shift)
                batch.count(event.kind, np.array([0]))
                windows.add(batch)

    def merge(self, later: Events) -> None:
        """Add the rows that follow."""
        self.windows.merge(later.windows)
        for port, windows in later.ports.items():
            self.ports.setdefault(port, Windows()).merge(windows)
        self.lost += later.lost
        for key, bits in later.bytes.items():
            self.bytes[key] = self.bytes.get(key, 0) | bits
        self.interrupt()

    def observe(self, rows: Rows) -> None:
        """Add the next rows, which have facts."""
        timed = rows.timed
        if not timed.all():
            rows = rows.select(timed)
        if not len(rows):
            return
        for code in rows.counts("port"):
            port = rows.codebook.ports[code]
            self._count_damage(port, rows, np.flatnonzero(rows.port == code))
        batch = Batch(rows.t_ns, self.windows.shift)
        found = motor_rows(rows)
        asked = rows.unanswered != NO_FACT
        for motor in MOTORS:
            commands, feedback = found.commands[motor], found.feedback[motor]
            own = commands[asked[commands]]
            batch.count(f"asked {motor}", own)
            batch.count(f"missed {motor}", own[rows.unanswered[own] >> motor_bit(motor) & 1 == 1])
            batch.count(f"commands {motor}", commands[np.isin(rows.cmds[commands], ANSWERABLE)])
            batch.count(f"feedback {motor}", feedback)
            self._count_delays(batch, rows, commands, motor)
            self._count_flag(
                batch, f"error {motor}", feedback, rows.values(Role.ERRORS, feedback), motor
            )
            self._count_periods(batch, rows, commands, motor)
            self._count_values(batch, rows, commands, feedback, motor)
        batch.count("feedback", found.any_feedback)
        online = rows.values(Role.ONLINE, found.any_feedback)
        for motor in MOTORS:
            missing = ~online >> motor_bit(motor) & 1
            self._count_flag(batch, f"offline {motor}", found.any_feedback, missing, motor)
        self.windows.add(batch)

    def _count_damage(self, port: str, rows: Rows, own: Ints) -> None:
        windows = self.ports.setdefault(port, Windows())
        batch = Batch(rows.t_ns[own], windows.shift)
        faults = rows.codebook.faults
        malformed = np.array([status_of(one) is Status.MALFORMED for one in faults])
        damaged = np.flatnonzero(malformed[rows.faults[own]])
        batch.count("rows", np.arange(len(own)))
        batch.count("frames", np.flatnonzero(rows.framed[own]))
        batch.count("commands", np.flatnonzero(rows.directions[own] == _CODES[Direction.CONTROL]))
        batch.count("feedback", np.flatnonzero(rows.directions[own] == _CODES[Direction.FEEDBACK]))
        if len(damaged):
            batch.count("damaged", damaged)
            at, heads = own[damaged], rows.raw[own[damaged], 0]
            for direction, header in HEADERS.items():
                batch.count(f"damaged {direction}", damaged[heads == header])
            for motor in MOTORS:
                batch.count(f"hint {motor}", damaged[rows.motor_hint[at] == motor])
            for code in np.unique(rows.faults[at]).tolist():
                batch.count(f"fault {faults[code][0]}", damaged[rows.faults[at] == code])
        windows.add(batch)

    def _count_delays(self, batch: Batch, rows: Rows, commands: Ints, motor: int) -> None:
        known = commands[rows.answer_ns[commands] != NO_FACT]
        known = known[NAMES_MOTOR[rows.kinds[known]]]
        for code in np.unique(rows.kinds[known]).tolist():
            own = known[rows.kinds[known] == code]
            grades = grade_of(rows.answer_ns[own] // DELAY_UNIT_NS)
            for grade in np.unique(grades).tolist():
                batch.count(f"delay {motor} {KINDS[code].name} {grade}", own[grades == grade])

    def _count_flag(self, batch: Batch, name: str, at: Ints, values: Ints, motor: int) -> None:
        """Count frames with a value other than 0, and before them too, as `RUNNING`."""
        if not len(at):
            return
        before = self._carried.raised.get(name, np.zeros(0, np.bool_))
        raised = np.concatenate((before, values != 0))
        running = raised[RUNNING - 1 :].copy() if len(raised) >= RUNNING else raised[:0]
        for by in range(RUNNING - 1):
            running &= raised[by : by + len(running)]
        hits = at[len(at) - len(running) :][running[-len(at) :]] if len(running) else at[:0]
        batch.count(name, hits)
        if len(hits):
            bits = int(np.bitwise_or.reduce(values))
            self.bytes[name, motor] = self.bytes.get((name, motor), 0) | bits
        self._carried.raised[name] = raised[1 - RUNNING :]

    def _count_periods(self, batch: Batch, rows: Rows, commands: Ints, motor: int) -> None:
        """Grade how much each period of a stream of commands differs from the one before."""
        for code in np.unique(rows.kinds[commands]).tolist():
            if not NAMES_MOTOR[code] and motor != MOTORS[0]:
                continue
            own = commands[rows.kinds[commands] == code]
            stream = f"{motor} {KINDS[code].name}"
            last, before = self._carried.periods.get(stream, (NO_TIME, _NO_PERIOD))
            times = rows.t_ns[own] if last == NO_TIME else np.append(last, rows.t_ns[own])
            periods = np.diff(times)
            every = periods if before == _NO_PERIOD else np.append(before, periods)
            if len(every) > 1:
                pairs = np.maximum(every, 1).astype(np.float64)
                ratios = np.abs(np.log2(pairs[1:] / pairs[:-1]))
                grades = np.minimum(ratios * RATIO_UNIT, GRADES - 1).astype(np.int64)
                for grade in np.unique(grades).tolist():
                    batch.count(
                        f"ratio {stream} {grade}", own[len(own) - len(grades) :][grades == grade]
                    )
            if len(times):
                self._carried.periods[stream] = int(times[-1]), int(every[-1]) if len(every) else -1

    def _count_values(
        self, batch: Batch, rows: Rows, commands: Ints, feedback: Ints, motor: int
    ) -> None:
        names = NAMES_MOTOR[rows.kinds[commands]]
        batch.count(f"free {motor}", commands[~names])
        for role in (Role.SPEED, Role.POSITION):
            for kind in by_role(role, target=True):
                own = commands[rows.kinds[commands] == KINDS.index(kind)]
                batch.range(f"target {role} {motor}", own, rows.values(role, own))
            for kind in by_role(role, target=False):
                own = feedback[rows.kinds[feedback] == KINDS.index(kind)]
                values = rows.values(role, own)
                batch.range(f"present {role} {motor}", own, values)
                self._count_jumps(batch, own, values, f"{role} {motor}")

    def _count_jumps(self, batch: Batch, own: Ints, values: Ints, stream: str) -> None:
        """Grade how far each value is from both neighbours, where these are near each other."""
        before = self._carried.values.get(stream, _NO_VALUES)
        every = np.concatenate((before, values))
        self._carried.values[stream] = every[-2:]
        if len(every) < 3:
            return
        first, middle, last = every[:-2], every[1:-1], every[2:]
        off = np.minimum(np.abs(middle - first), np.abs(middle - last))
        off = np.where(np.abs(last - first) <= off // 4, off, 0)
        at = own[len(own) - min(len(own), len(off)) :]
        off = off[len(off) - len(at) :]
        batch.count(f"steps {stream}", at)
        for grade in np.unique(grade_of(off[off > _LEAST_JUMP])).tolist():
            batch.count(
                f"jump {stream} {grade}", at[(off > _LEAST_JUMP) & (grade_of(off) == grade)]
            )


_LEAST_JUMP: Final = 64
_CODES: Final = {direction: code for code, direction in enumerate(Direction)}
