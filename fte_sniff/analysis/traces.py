"""Targets and feedback of the motors over time, as min/max envelopes for plots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from fte_sniff.analysis.counters import extent
from fte_sniff.protocol import KINDS, MOTORS, Direction
from fte_sniff.protocol.rows import Bools, Ints, Rows

Floats: TypeAlias = npt.NDArray[np.float64]

FINEST_NS: Final = 1 << 22
"""Length of a bucket of the finest level, nanoseconds: about 4 ms."""

STEP: Final = 8

LEVELS: Final = 6
"""Levels; the buckets of the last one are about two minutes long."""

BUCKETS: Final = 2048
"""Buckets in a level; those of the last level cover three days."""

_NEVER: Final = -(2**62)


@dataclass(frozen=True, slots=True)
class EnvelopeColumns:
    """Minimum, maximum and last value in columns of equal duration; NaN without values."""

    low: Floats
    high: Floats
    last: Floats


@dataclass(frozen=True, slots=True)
class _Groups:
    """Values by bucket, with rising bucket numbers."""

    numbers: Ints
    values: npt.NDArray[Any]
    """Minimum, maximum and last value of each bucket; shape (3, buckets)."""

    def merged(self, numbers: Ints) -> _Groups:
        """These groups with other bucket numbers, which must not fall."""
        if not len(numbers):
            return self
        starts = np.flatnonzero(np.concatenate(([True], numbers[1:] != numbers[:-1])))
        ends = np.append(starts[1:], len(numbers)) - 1
        low, high, last = self.values
        lows, highs = np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)
        return _Groups(numbers[starts], np.stack((lows, highs, last[ends])))


class _Level:
    """Ring buffer of the latest buckets of one length."""

    def __init__(self, length_ns: int, buckets: int) -> None:
        self.length_ns = length_ns
        self._numbers: Ints = np.full(buckets, _NEVER, np.int64)
        self._values = np.zeros((3, buckets), np.int32)
        self._newest = _NEVER
        self._oldest = -_NEVER

    def update(self, groups: _Groups) -> None:
        self._newest = max(self._newest, int(groups.numbers[-1]))
        self._oldest = min(self._oldest, int(groups.numbers[0]))
        kept = groups.numbers >= self._oldest_kept
        numbers, (low, high, last) = groups.numbers[kept], groups.values[:, kept]
        slots = numbers % len(self._numbers)
        found = self._numbers[slots] == numbers
        old_low, old_high, _ = self._values[:, slots]
        low = np.where(found, np.minimum(old_low, low), low)
        high = np.where(found, np.maximum(old_high, high), high)
        self._values[:, slots] = low, high, last
        self._numbers[slots] = numbers

    @property
    def _oldest_kept(self) -> int:
        return self._newest - len(self._numbers) + 1

    def covers(self, start_ns: int) -> bool:
        """Whether the ring has all values since `start_ns`."""
        return self._oldest_kept <= max(start_ns // self.length_ns, self._oldest)

    def between(self, start_ns: int, end_ns: int) -> _Groups:
        numbers = self._numbers
        first = max(self._oldest_kept, start_ns // self.length_ns)
        end = -(-end_ns // self.length_ns)
        found = np.flatnonzero((numbers >= first) & (numbers < end))
        found = found[np.argsort(numbers[found])]
        return _Groups(numbers[found], self._values[:, found])

    def before(self, t_ns: int) -> Reported | None:
        """The last value in a bucket that ends before a time."""
        numbers = self._numbers
        early = (numbers < t_ns // self.length_ns) & (numbers >= self._oldest_kept)
        if not early.any():
            return None
        slot = int(np.where(early, numbers, _NEVER).argmax())
        return Reported(int(numbers[slot]) * self.length_ns, int(self._values[2, slot]))


@dataclass(frozen=True, slots=True)
class Reported:
    """A value and its approximate time."""

    t_ns: int
    """Start of its bucket, nanoseconds since 1970 UTC."""
    value: int


class Envelope:
    """Multi-resolution min/max envelope of one value."""

    def __init__(
        self, finest_ns: int = FINEST_NS, levels: int = LEVELS, buckets: int = BUCKETS
    ) -> None:
        self._levels = [_Level(finest_ns * STEP**level, buckets) for level in range(levels)]

    def update(self, t_ns: Ints, values: Ints) -> None:
        """Add 32-bit values and their times, which should not fall, nanoseconds since 1970 UTC."""
        if not len(t_ns):
            return
        order = np.argsort(t_ns, kind="stable") if (t_ns[1:] < t_ns[:-1]).any() else slice(None)
        narrow = values[order].astype(np.int32)
        numbers = t_ns[order] // self._levels[0].length_ns
        groups = _Groups(numbers, np.stack([narrow] * 3)).merged(numbers)
        for number, level in enumerate(self._levels):
            if number:
                groups = groups.merged(groups.numbers // STEP)
            level.update(groups)

    def resample(self, start_ns: int, end_ns: int, columns: int) -> EnvelopeColumns:
        """A time range in columns, from the finest level that covers it.

        A bucket belongs to the column of its middle; at the ends to the first or last column.
        """
        level = next((one for one in self._levels if one.covers(start_ns)), self._levels[-1])
        groups = level.between(start_ns, end_ns)
        middles = groups.numbers * level.length_ns + level.length_ns // 2
        at = (middles - start_ns) / max(1, end_ns - start_ns) * columns
        groups = groups.merged(np.clip(at.astype(np.int64), 0, columns - 1))
        values = np.full((3, columns), np.nan)
        values[:, groups.numbers] = groups.values
        return EnvelopeColumns(*values)

    def before(self, t_ns: int) -> Reported | None:
        """The last value before the bucket of a time, from the finest level that has one."""
        found = (level.before(t_ns) for level in self._levels)
        return next((value for value in found if value is not None), None)


_Key: TypeAlias = tuple[int, Direction, str]

_TRACED: Final = [
    (code, kind, name)
    for code, kind in enumerate(KINDS)
    if kind.names_motor and (name := kind.subject) is not None
]

_ALL_MOTORS: Final = 0
_TO_ALL: Final = [
    code
    for code, kind in enumerate(KINDS)
    if kind.direction is Direction.CONTROL and not kind.names_motor
]

QUANTITIES: Final = tuple(dict.fromkeys(name for _, _, name in _TRACED))
"""Column names of what is traced: `rpm` and `pulses`."""


class Traces:
    """Commands and feedback of every motor over time; rows without a time are ignored."""

    def __init__(self) -> None:
        self._traces: dict[_Key, Envelope] = {}
        self._window: tuple[int, int] | None = None
        self._resampled: dict[tuple[_Key, int], EnvelopeColumns] = {}
        """Results for that window, since a command is the target of one curve and ends another."""
        self.first_ns: int | None = None
        """Earliest time of a row, nanoseconds since 1970 UTC."""
        self.last_ns: int | None = None

    def observe(self, rows: Rows) -> None:
        """Add the next rows."""
        times = extent(rows.t_ns[rows.timed])
        if times is None:
            return
        self._window = None
        first, last = times
        self.first_ns = first if self.first_ns is None else min(self.first_ns, first)
        self.last_ns = last if self.last_ns is None else max(self.last_ns, last)
        for code, kind, name in _TRACED:
            own = np.flatnonzero((rows.kinds == code) & rows.timed)
            for motor in MOTORS if len(own) else ():
                at = own[rows.nums[own] == motor]
                if len(at):
                    trace = self._trace(motor, kind.direction, name)
                    trace.update(rows.t_ns[at], rows.values(name, at))
        to_all = np.flatnonzero(np.isin(rows.kinds, _TO_ALL) & rows.timed)
        if len(to_all):
            trace = self._trace(_ALL_MOTORS, Direction.CONTROL, "")
            trace.update(rows.t_ns[to_all], np.zeros(len(to_all), np.int64))

    def _trace(self, motor: int, direction: Direction, name: str) -> Envelope:
        return self._traces.setdefault((motor, direction, name), Envelope())

    def resample(
        self, motor: int, direction: Direction, name: str, window: tuple[int, int], columns: int
    ) -> EnvelopeColumns:
        """One quantity of a motor in a time window: its target (control) or feedback.

        The result is shared: never change it.
        """
        if window != self._window:
            self._window, self._resampled = window, {}
        key = motor, direction, name
        found, trace = self._resampled.get((key, columns)), self._traces.get(key)
        if found is None:
            empty = EnvelopeColumns(*np.full((3, columns), np.nan))
            found = empty if trace is None else trace.resample(*window, columns)
            self._resampled[key, columns] = found
        return found

    def other_commands(self, motor: int, name: str, window: tuple[int, int], columns: int) -> Bools:
        """In which columns a motor got a command that does not set this quantity."""
        found = np.zeros(columns, np.bool_)
        for key in _other_commands(motor, name):
            found |= ~np.isnan(self.resample(*key, window, columns).last)
        return found

    def target_before(self, motor: int, name: str, t_ns: int) -> int | None:
        """The target of a quantity just before a time.

        None if it is unknown, or the last command does not set this quantity.
        """
        own = self._before((motor, Direction.CONTROL, name), t_ns)
        others = [self._before(key, t_ns) for key in _other_commands(motor, name)]
        if own is None or any(other is not None and other.t_ns > own.t_ns for other in others):
            return None
        return own.value

    def _before(self, key: _Key, t_ns: int) -> Reported | None:
        trace = self._traces.get(key)
        return None if trace is None else trace.before(t_ns)


def _other_commands(motor: int, name: str) -> list[_Key]:
    others = [other for other in QUANTITIES if other != name]
    return [
        *((motor, Direction.CONTROL, other) for other in others),
        (_ALL_MOTORS, Direction.CONTROL, ""),
    ]
