"""Owns a value over time in bounded memory, such that no spike is ever lost: its envelope.

It must not know what the value is, nor how it is drawn. Time is cut into buckets; each keeps the
least, the greatest and the last value in it. There are several levels, each with buckets eight
times as long as those of the level before, and each keeps its latest buckets:

    level 0    |.|.|.|.|.|.|.|.|                    short, the latest seconds
    level 1    |...|...|...|...|...|...|...|...|
    level 2    |.......|.......|.......|.......|    long, days

Whoever draws a span of time asks for as many columns as there are, and gets them from the finest
level that reaches back far enough.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from fte_sniff.analysis.columns.fields import Ints

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

    def before(self, t_ns: int) -> Told | None:
        """The last value in a bucket that ends by a time; None where none is kept."""
        numbers = self._numbers
        early = (numbers < t_ns // self.length_ns) & (numbers >= self._kept_from)
        if not early.any():
            return None
        slot = int(np.where(early, numbers, _NEVER).argmax())
        return Told(int(numbers[slot]) * self.length_ns, int(self._last[slot]))


@dataclass(frozen=True, slots=True)
class Told:
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

    def before(self, t_ns: int) -> Told | None:
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
