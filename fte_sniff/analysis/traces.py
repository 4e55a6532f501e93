"""Min/max envelopes of values over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from fte_sniff.analysis.fields import Bools, Decoded, Ints, subject
from fte_sniff.protocol import KINDS, MOTORS, Direction

Floats: TypeAlias = npt.NDArray[np.float64]

FINEST_NS: Final = 1 << 22
"""Length of a bucket of the finest level, nanoseconds: about 4 ms."""

STEP: Final = 8
"""How many buckets of a level are one of the next."""

LEVELS: Final = 6
"""The longest bucket lasts about two minutes."""

BUCKETS: Final = 2048
"""Buckets that a level keeps: those of the last level are three days."""

_NEVER: Final = -(2**62)


@dataclass(frozen=True, slots=True)
class Spans:
    """A stretch of time in columns of equal length; NaN where nothing was told."""

    low: Floats
    high: Floats
    last: Floats


@dataclass(frozen=True, slots=True)
class _Groups:
    """Values by bucket, the numbers of the buckets rising."""

    numbers: Ints
    low: npt.NDArray[Any]
    high: npt.NDArray[Any]
    last: npt.NDArray[Any]

    def merged(self, numbers: Ints) -> _Groups:
        """The same under other numbers, which must not fall."""
        if not len(numbers):
            return self
        starts = np.flatnonzero(np.concatenate(([True], numbers[1:] != numbers[:-1])))
        ends = np.append(starts[1:], len(numbers)) - 1
        return _Groups(
            numbers[starts],
            np.minimum.reduceat(self.low, starts),
            np.maximum.reduceat(self.high, starts),
            self.last[ends],
        )

    def __getitem__(self, wanted: npt.NDArray[Any]) -> _Groups:
        return _Groups(self.numbers[wanted], self.low[wanted], self.high[wanted], self.last[wanted])


class _Level:
    """The latest buckets of one length, in a ring."""

    def __init__(self, length_ns: int, buckets: int) -> None:
        self.length_ns = length_ns
        self._numbers: Ints = np.full(buckets, _NEVER, np.int64)
        self._low = np.zeros(buckets, np.int32)
        self._high = np.zeros(buckets, np.int32)
        self._last = np.zeros(buckets, np.int32)
        self._newest = _NEVER
        self._oldest = -_NEVER

    def add(self, groups: _Groups) -> None:
        """Put more into the buckets; what is older than the ring reaches is dropped."""
        numbers = groups.numbers
        self._newest = max(self._newest, int(numbers[-1]))
        self._oldest = min(self._oldest, int(numbers[0]))
        groups = groups[numbers >= self._kept_from]
        slots = groups.numbers % len(self._numbers)
        begun = self._numbers[slots] == groups.numbers
        self._low[slots] = np.where(begun, np.minimum(self._low[slots], groups.low), groups.low)
        self._high[slots] = np.where(begun, np.maximum(self._high[slots], groups.high), groups.high)
        self._last[slots] = groups.last
        self._numbers[slots] = groups.numbers

    @property
    def _kept_from(self) -> int:
        return self._newest - len(self._numbers) + 1

    def reaches(self, start_ns: int) -> bool:
        """Whether no value from `start_ns` on has left the ring."""
        return self._kept_from <= max(start_ns // self.length_ns, self._oldest)

    def between(self, start_ns: int, end_ns: int) -> _Groups:
        """The buckets that touch a stretch of time, in order."""
        numbers = self._numbers
        first = max(self._kept_from, start_ns // self.length_ns)
        end = -(-end_ns // self.length_ns)
        found = np.flatnonzero((numbers >= first) & (numbers < end))
        found = found[np.argsort(numbers[found])]
        return _Groups(numbers, self._low, self._high, self._last)[found]

    def before(self, t_ns: int) -> Reported | None:
        """The last value in a bucket that ends by a time; None where none is kept."""
        numbers = self._numbers
        early = (numbers < t_ns // self.length_ns) & (numbers >= self._kept_from)
        if not early.any():
            return None
        slot = int(np.where(early, numbers, _NEVER).argmax())
        return Reported(int(numbers[slot]) * self.length_ns, int(self._last[slot]))


@dataclass(frozen=True, slots=True)
class Reported:
    """A value, and about when it was told."""

    t_ns: int
    """Begin of the bucket that holds it, nanoseconds since 1970 UTC."""
    value: int


class Envelope:
    """One value over time."""

    def __init__(
        self, finest_ns: int = FINEST_NS, levels: int = LEVELS, buckets: int = BUCKETS
    ) -> None:
        """Nothing was told yet.

        Args:
            finest_ns: length of the shortest buckets, nanoseconds.
            levels: how many lengths of buckets there are.
            buckets: how many each level keeps.
        """
        self._levels = [_Level(finest_ns * STEP**level, buckets) for level in range(levels)]

    def add(self, t_ns: Ints, values: Ints) -> None:
        """These values of 32 bits came, at times since 1970 UTC that should not fall."""
        if not len(t_ns):
            return
        order = np.argsort(t_ns, kind="stable") if (t_ns[1:] < t_ns[:-1]).any() else slice(None)
        narrow = values[order].astype(np.int32)
        numbers = t_ns[order] // self._levels[0].length_ns
        groups = _Groups(numbers, narrow, narrow, narrow).merged(numbers)
        for place, level in enumerate(self._levels):
            if place:
                groups = groups.merged(groups.numbers // STEP)
            level.add(groups)

    def spans(self, start_ns: int, end_ns: int, columns: int) -> Spans:
        """A stretch of time in so many columns, out of the finest level that has all of it.

        A bucket stands in the column in which its middle lies; one that reaches over an end of the
        stretch stands in the first or the last column.
        """
        level = next((one for one in self._levels if one.reaches(start_ns)), self._levels[-1])
        groups = level.between(start_ns, end_ns)
        middles = groups.numbers * level.length_ns + level.length_ns // 2
        places = (middles - start_ns) / max(1, end_ns - start_ns) * columns
        groups = groups.merged(np.clip(places.astype(np.int64), 0, columns - 1))
        return Spans(*(_placed(part, groups.numbers, columns) for part in _parts(groups)))

    def before(self, t_ns: int) -> Reported | None:
        """The last value from before the bucket of a time, as finely as it is still known."""
        for level in self._levels:
            told = level.before(t_ns)
            if told is not None:
                return told
        return None


def _parts(groups: _Groups) -> tuple[npt.NDArray[Any], ...]:
    return groups.low, groups.high, groups.last


def _placed(values: npt.NDArray[Any], places: Ints, columns: int) -> Floats:
    found = np.full(columns, np.nan)
    found[places] = values
    return found


_Key: TypeAlias = tuple[int, Direction, str]

_TRACED: Final = [
    (code, kind, name)
    for code, kind in enumerate(KINDS)
    if kind.names_motor and (name := subject(kind)) is not None
]

_ALL_MOTORS: Final = 0
_TO_ALL: Final = [
    code
    for code, kind in enumerate(KINDS)
    if kind.direction is Direction.CONTROL and not kind.names_motor
]

QUANTITIES: Final = tuple(dict.fromkeys(name for _, _, name in _TRACED))
"""The row names of what is traced: `rpm` and `pulses`."""


class Traces:
    """What every motor was asked and what it told, over time; rows without a time are left out."""

    def __init__(self) -> None:
        self._traces: dict[_Key, Envelope] = {}
        self.first_ns: int | None = None
        """The earliest time of a row, nanoseconds since 1970 UTC; None while there is none."""
        self.last_ns: int | None = None
        """The latest."""

    def add(self, rows: Decoded) -> None:
        """The next rows."""
        if not rows.has_time.any():
            return
        known = rows.t_ns[rows.has_time]
        self._stretch(int(known.min()), int(known.max()))
        for code, kind, name in _TRACED:
            own = np.flatnonzero((rows.kinds == code) & rows.has_time)
            for motor in MOTORS if len(own) else ():
                places = own[rows.nums[own] == motor]
                if len(places):
                    trace = self._trace(motor, kind.direction, name)
                    trace.add(rows.t_ns[places], rows.values(name, places))
        to_all = np.flatnonzero(np.isin(rows.kinds, _TO_ALL) & rows.has_time)
        if len(to_all):
            trace = self._trace(_ALL_MOTORS, Direction.CONTROL, "")
            trace.add(rows.t_ns[to_all], np.zeros(len(to_all), np.int64))

    def _trace(self, motor: int, direction: Direction, name: str) -> Envelope:
        return self._traces.setdefault((motor, direction, name), Envelope())

    def _stretch(self, first_ns: int, last_ns: int) -> None:
        self.first_ns = first_ns if self.first_ns is None else min(self.first_ns, first_ns)
        self.last_ns = last_ns if self.last_ns is None else max(self.last_ns, last_ns)

    def spans(
        self, motor: int, direction: Direction, name: str, window: tuple[int, int], columns: int
    ) -> Spans:
        """One quantity of a motor between two times, in so many columns; NaN where none was told.

        `direction` chooses what was asked (control) or what was told (feedback).
        """
        trace = self._traces.get((motor, direction, name))
        if trace is None:
            return Spans(*(np.full(columns, np.nan) for _ in range(3)))
        return trace.spans(*window, columns)

    def otherwise(self, motor: int, name: str, window: tuple[int, int], columns: int) -> Bools:
        """In which columns a motor was asked for something else than this quantity."""
        found = np.zeros(columns, np.bool_)
        for key in _others(motor, name):
            found |= ~np.isnan(self.spans(*key, window, columns).last)
        return found

    def standing(self, motor: int, name: str, t_ns: int) -> int | None:
        """What a motor was asked last before a time, if that was a value of this quantity.

        None where it was something else, or where it is not known.
        """
        own = self._before((motor, Direction.CONTROL, name), t_ns)
        others = [self._before(key, t_ns) for key in _others(motor, name)]
        if own is None or any(other is not None and other.t_ns > own.t_ns for other in others):
            return None
        return own.value

    def _before(self, key: _Key, t_ns: int) -> Reported | None:
        trace = self._traces.get(key)
        return None if trace is None else trace.before(t_ns)


def _others(motor: int, name: str) -> list[_Key]:
    """Where commands to a motor are traced that are not about a quantity."""
    others = [other for other in QUANTITIES if other != name]
    return [
        *((motor, Direction.CONTROL, other) for other in others),
        (_ALL_MOTORS, Direction.CONTROL, ""),
    ]
