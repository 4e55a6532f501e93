"""Events of trouble, counted by window of time: what `findings` searches for spans.

A window has a power of two of nanoseconds, a second or more, so that there are at most
`MOST_WINDOWS`. A column has a number for each window:

    count   `missed 3`     commands of motor 3 without an answer
    range   `target speed 3`, and of the times of events: the lowest and the highest value

All rows are there when they are counted, so what is usual is known before: an answer is late if it
takes twice the median of its motor and kind.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import polars as pl

from fte_sniff.analysis.whole.relations import ANSWERABLE, NAMES_MOTOR, AnswerState
from fte_sniff.analysis.whole.table import Table
from fte_sniff.protocol import KINDS, MOTORS, Direction, PortEventKind, Status, status_of
from fte_sniff.protocol.rows import Bools, Ints, Rows
from fte_sniff.protocol.spec import FrameKind, Role, motor_bit

SHIFT: Final = 30
"""The shortest window has 2 to this power of nanoseconds, about a second."""

MOST_WINDOWS: Final = 1 << 14

RUNNING: Final = 3
"""Frames in a row with a flag from which on it is not a flipped bit."""

LATE: Final = 2.0
"""An answer is late from this many times the median on."""

IRREGULAR: Final = 0.5
"""Octaves by which a period differs from the one before it, from which on it is irregular."""

_LEAST_JUMP: Final = 64
_NO_LOW: Final = 2**63 - 1
_NO_HIGH: Final = -(2**63)


class Windows:
    """Counts and ranges of events by window, in named columns."""

    def __init__(self, t_ns: Ints, shift: int) -> None:
        """Windows of events, by their times, in which rows are."""
        self.t_ns, self.shift = t_ns, shift
        self._keys, self._at = np.unique(t_ns >> shift, return_inverse=True)
        self._counts: dict[str, Ints] = {}
        self._ranges: dict[str, tuple[Ints, Ints]] = {}

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

    def names(self) -> list[str]:
        """The columns of counts."""
        return [*self._counts]

    def count(self, name: str) -> Ints:
        """A column of counts."""
        return self._counts.get(name, np.zeros(len(self), np.int64))

    def range_of(self, name: str) -> tuple[Ints, Ints, Bools]:
        """The lowest and the highest value by window, and which windows have one."""
        none = np.full(len(self), _NO_LOW), np.full(len(self), _NO_HIGH)
        low, high = self._ranges.get(name, none)
        return low, high, high != _NO_HIGH

    def add(self, name: str, rows: Ints) -> None:
        """Count rows, by indices."""
        if len(rows):
            counts = np.bincount(self._at[rows], minlength=len(self))
            self._counts[name] = self.count(name) + counts

    def add_range(self, name: str, rows: Ints, values: Ints) -> None:
        """Extend a range by the values of rows."""
        low, high, _ = self.range_of(name)
        np.minimum.at(low, self._at[rows], values)
        np.maximum.at(high, self._at[rows], values)
        self._ranges[name] = low, high

    def add_events(self, name: str, rows: Ints) -> None:
        """Count rows, and extend the range of their times."""
        self.add(name, rows)
        self.add_range(name, rows, self.t_ns[rows])


def by_role(role: Role, *, target: bool) -> list[FrameKind]:
    """The kinds that name a motor and have a target, or a present value, of that role."""
    direction = Direction.CONTROL if target else Direction.FEEDBACK
    return [
        kind
        for kind in KINDS
        if kind.direction is direction
        and kind.names_motor
        and any(one.role is role and one.name == kind.subject for one in kind.fields)
    ]


# Events that depend on the frames beside them; none of them spans a gap


def running(flags: Ints, runs: Ints) -> Bools:
    """Values in which a bit is set that at least `RUNNING` values in a row have."""
    found = np.zeros(len(flags), np.bool_)
    if len(flags) >= RUNNING:
        beside = np.lib.stride_tricks.sliding_window_view(flags, RUNNING)
        one_run = runs[RUNNING - 1 :] == runs[: 1 - RUNNING]
        is_long = (np.bitwise_and.reduce(beside, axis=1) != 0) & one_run
        for by in range(RUNNING):
            found[by : by + len(is_long)] |= is_long
    return found


def jumps(values: Ints, runs: Ints) -> Bools:
    """Values far from both neighbours, where these are near each other."""
    first, middle, last = values[:-2], values[1:-1], values[2:]
    off = np.minimum(np.abs(middle - first), np.abs(middle - last))
    is_far = (off > _LEAST_JUMP) & (np.abs(last - first) <= off // 4) & (runs[2:] == runs[:-2])
    return np.concatenate(([False], is_far, [False]))[: len(values)]


def irregular(t_ns: Ints, runs: Ints) -> Bools:
    """Whether the period before each time differs from the one before it."""
    periods = np.maximum(np.diff(t_ns), 1).astype(np.float64)
    changes = np.abs(np.log2(periods[1:] / periods[:-1])) >= IRREGULAR
    changes &= runs[2:] == runs[:-2]
    return np.concatenate(([False, False], changes))[: len(t_ns)]


class Events:
    """The events of all causes in a table."""

    def __init__(self, table: Table) -> None:
        timed = np.flatnonzero(table.rows.timed)
        self._rows = rows = table.with_facts.select(timed)
        self._runs = table.runs.number[timed]
        shift = SHIFT
        while len(np.unique(rows.t_ns >> shift)) > MOST_WINDOWS:
            shift += 1
        self.windows = Windows(rows.t_ns, shift)
        """What is about motors."""
        self.ports = {
            rows.codebook.ports[code]: self._damage(np.flatnonzero(rows.port == code), shift)
            for code in np.unique(rows.port).tolist()
        }
        """What is about each port."""
        self.lost = list(_lost(table))
        """Ports that were lost: from when, and until when."""
        for event in table.rows.events:
            if event.kind in (PortEventKind.LINE_ERROR, PortEventKind.OVERRUN):
                self._add_event(event.kind, event.port, event.t_ns)
        self._count_answers(table, np.cumsum(table.rows.timed) - 1)
        for motor in MOTORS:
            self._count_motor(rows, motor)

    def _add_event(self, kind: PortEventKind, port: str, t_ns: int) -> None:
        """Count an event of a port in the window of the nearest row."""
        if windows := self.ports.get(port):
            at = min(int(np.searchsorted(windows.t_ns, t_ns)), len(windows.t_ns) - 1)
            windows.add(kind, np.array([at]))
            windows.add_range(kind, np.array([at]), np.array([t_ns]))

    def _damage(self, own: Ints, shift: int) -> Windows:
        rows = self._rows
        windows = Windows(rows.t_ns[own], shift)
        is_malformed = np.array([status_of(one) is Status.MALFORMED for one in rows.codebook.faults])
        is_damaged, faults = is_malformed[rows.faults[own]], rows.faults[own]
        named = np.where(NAMES_MOTOR[rows.kinds[own]], rows.nums[own], 0)
        motors = np.where(is_damaged, rows.motor_hint[own], named)
        windows.add("rows", np.arange(len(own)))
        windows.add("frames", np.flatnonzero(rows.framed[own]))
        windows.add_events("damaged", np.flatnonzero(is_damaged))
        for motor in MOTORS:
            windows.add(f"rows {motor}", np.flatnonzero(motors == motor))
            windows.add_events(f"damaged {motor}", np.flatnonzero(is_damaged & (motors == motor)))
        for code, direction in enumerate(Direction):
            sent = rows.directions[own] == code
            windows.add(_WHAT[direction], np.flatnonzero(sent))
            windows.add(f"damaged {direction}", np.flatnonzero(is_damaged & sent))
        for code in np.unique(faults[is_damaged]).tolist():
            name = f"fault {rows.codebook.faults[code][0]}"
            windows.add(name, np.flatnonzero(is_damaged & (faults == code)))
        after = np.flatnonzero(is_damaged[1:] & is_damaged[:-1]) + 1
        windows.add("burst", after[self._runs[own][after] == self._runs[own][after - 1]])
        return windows

    def _count_answers(self, table: Table, index: Ints) -> None:
        """Commands that are answered, late or not; `index` is that among the rows with times."""
        found = table.answers.filter(pl.col("cmd").is_in(ANSWERABLE)).drop_nulls("t_ns")
        codes = table.rows.kinds[found["command"].to_numpy()]
        found = found.with_columns(at=index[found["command"].to_numpy()], kind=codes)
        usual = pl.col("delay_ns").median().over("motor", "kind")
        found = found.with_columns(usual=usual, late=pl.col("delay_ns") >= LATE * usual)
        self.usual = {
            (motor, KINDS[kind].name): ns
            for motor, kind, ns in found.group_by("motor", "kind").agg(usual.first()).iter_rows()
        }
        """By motor and kind of command, the median answer time, nanoseconds; None without any."""
        for (motor,), own in found.partition_by("motor", as_dict=True).items():
            decided = own.filter(pl.col("state") <= AnswerState.UNANSWERED)
            missed = decided.filter(pl.col("state") == AnswerState.UNANSWERED)
            self.windows.add_events(f"commands {motor}", own["at"].to_numpy())
            self.windows.add(f"asked {motor}", decided["at"].to_numpy())
            self.windows.add_events(f"missed {motor}", missed["at"].to_numpy())
        named = found.filter(pl.Series(NAMES_MOTOR[found["kind"].to_numpy()])).drop_nulls("late")
        for (motor, kind), own in named.partition_by("motor", "kind", as_dict=True).items():
            name = f"late {motor} {KINDS[kind].name}"
            self.windows.add_events(name, own.filter("late")["at"].to_numpy())
            self.windows.add(f"timed {motor} {KINDS[kind].name}", own["at"].to_numpy())

    def _count_motor(self, rows: Rows, motor: int) -> None:
        windows, runs, bit = self.windows, self._runs, motor_bit(motor)
        is_command = rows.directions == [*Direction].index(Direction.CONTROL)
        is_named = NAMES_MOTOR[rows.kinds]
        own = rows.nums == motor
        windows.add(f"free {motor}", np.flatnonzero(is_command & ~is_named & (rows.kinds < len(KINDS))))
        anyone = np.flatnonzero(rows.field("online")[1])
        feedback = anyone[own[anyone]]
        windows.add_events(f"feedback {motor}", feedback)
        if motor == MOTORS[0]:
            windows.add("feedback", anyone)
            lacking = rows.values(Role.ONLINE, anyone) & _ALL_ONLINE != _ALL_ONLINE
            windows.add("any offline", anyone[lacking])
        errors, offline = rows.values(Role.ERRORS, feedback), ~rows.values(Role.ONLINE, anyone) >> bit & 1
        raised = running(errors, runs[feedback])
        windows.add_events(f"raised {motor}", feedback[raised])
        for one in range(8):
            windows.add(f"raised {motor} bit {one}", feedback[raised & (errors >> one & 1 == 1)])
        windows.add_events(f"offline {motor}", anyone[running(offline, runs[anyone])])
        windows.add("any raised", feedback[errors != 0])
        for code, kind in enumerate(KINDS):
            at = np.flatnonzero((rows.kinds == code) & (own | ~is_named))
            if kind.direction is Direction.CONTROL and (kind.names_motor or motor == MOTORS[0]):
                windows.add(f"period {motor} {kind.name}", at)
                uneven = at[irregular(rows.t_ns[at], runs[at])]
                windows.add_events(f"irregular {motor} {kind.name}", uneven)
        for role in (Role.SPEED, Role.POSITION):
            for is_target in (True, False):
                for kind in by_role(role, target=is_target):
                    self._count_values(rows, motor, role, np.flatnonzero(own & (rows.kinds == KINDS.index(kind))), is_target)

    def _count_values(self, rows: Rows, motor: int, role: Role, at: Ints, is_target: bool) -> None:
        values = rows.values(role, at)
        name = f"{'target' if is_target else 'present'} {role} {motor}"
        self.windows.add_range(name, at, values)
        if not is_target:
            self.windows.add(name, at)
            self.windows.add_events(f"jump {role} {motor}", at[jumps(values, self._runs[at])])


_ALL_ONLINE: Final = sum(1 << motor_bit(motor) for motor in MOTORS)
_WHAT: Final = {Direction.CONTROL: "commands", Direction.FEEDBACK: "feedback"}


def _lost(table: Table) -> Iterator[tuple[str, int, int | None]]:
    """Ports that were lost: from when, and until when."""
    kinds = (PortEventKind.LOST, PortEventKind.FOUND_AGAIN)
    changes = [one for one in table.rows.events if one.kind in kinds]
    for number, event in enumerate(changes):
        if event.kind is PortEventKind.LOST:
            later = (one for one in changes[number + 1 :] if one.port == event.port)
            end = next(later, None)
            is_found = end is not None and end.kind is PortEventKind.FOUND_AGAIN
            yield event.port, event.t_ns, end.t_ns if end is not None and is_found else None
