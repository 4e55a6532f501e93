"""Numbers over rows: histogram of durations, recent values, and series over time.

The histogram of durations has logarithmic bins, 1024 in an octave:

    octave -1    0 ns                        its last bin
    octave 0     1 ns                        one bin for each ns: exact, up to 1,024 ns
    octave 10    1,024 ns ... 2,047 ns       the last octave that is exact
    octave 22    4.2 ms ... 8.4 ms           bins of 4,096 ns

A series keeps totals, extremes, and the last value of windows of time, by group:

    level 0    |.|.|.|.|.|.|.|.|        the latest windows, as short as possible
    level 1    |       .       |   ...  each eight times as long, so they reach further back
    last level                          covers all times: its windows get longer to fit

Windows begin at multiples of their duration since 1970. So adding the windows of another series
gives the series of a single pass, however the rows were divided between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final, NamedTuple, Self, TypeAlias

import numpy as np
import numpy.typing as npt

from fte_sniff.analysis.model import RATE_WINDOW_NS, Model
from fte_sniff.protocol.rows import Ints

PER_OCTAVE: Final = 1024

_Floats: TypeAlias = npt.NDArray[np.float64]


class Durations(Model):
    """Histogram of durations, 0 ns or longer."""

    def __init__(self) -> None:
        self.count = 0
        self.longest_ns: int | None = None
        self.longest_at_ns: int | None = None
        """End of the longest one, nanoseconds since 1970 UTC; the first of several."""
        self._shortest_ns = 0
        self._bins: Ints = np.zeros(0, np.int64)
        self._first = 0
        """Number of the first bin in `_bins`; the first of an octave."""

    def observe(self, durations_ns: Ints, ends_ns: Ints) -> None:
        """Count durations, none of them negative, each with the time of its end."""
        if not len(durations_ns):
            return
        longest, shortest = int(durations_ns.argmax()), int(durations_ns.min())
        self._shortest_ns = min(self._shortest_ns, shortest) if self.count else shortest
        self.count += len(durations_ns)
        if self.longest_ns is None or durations_ns[longest] > self.longest_ns:
            self.longest_ns = int(durations_ns[longest])
            self.longest_at_ns = int(ends_ns[longest])
        bins = _bins_of(durations_ns)
        self._cover(int(bins.min()), int(bins.max()))
        np.add.at(self._bins, bins - self._first, 1)

    def _cover(self, low: int, high: int) -> None:
        """Extend `_bins` to whole octaves that contain two bins."""
        end = self._first + len(self._bins)
        first = min(low, self._first if len(self._bins) else low) // PER_OCTAVE * PER_OCTAVE
        last = max(high + 1, end)
        if first == self._first and last == end:
            return
        last += -last % PER_OCTAVE
        old, at = self._bins, self._first - first
        self._bins = np.zeros(last - first, np.int64)
        if len(old):
            self._bins[at : at + len(old)] = old
        self._first = first

    def merge(self, later: Durations) -> None:
        """Add durations that ended later."""
        if later.longest_ns is None:
            return
        shortest = later._shortest_ns
        self._shortest_ns = min(self._shortest_ns, shortest) if self.count else shortest
        self.count += later.count
        if self.longest_ns is None or later.longest_ns > self.longest_ns:
            self.longest_ns, self.longest_at_ns = later.longest_ns, later.longest_at_ns
        self._cover(later._first, later._first + len(later._bins) - 1)
        at = later._first - self._first
        self._bins[at : at + len(later._bins)] += later._bins

    def __getstate__(self) -> dict[str, object]:
        """The state with only the bins that are not empty, which are few in a short recording."""
        filled = np.flatnonzero(self._bins)
        return {**self.__dict__, "_bins": (len(self._bins), filled, self._bins[filled])}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        size, filled, counts = state["_bins"]
        self._bins = np.zeros(size, np.int64)
        self._bins[filled] = counts

    def percentile_ns(self, percent: float) -> float | None:
        """The percentile (above 0, to 100) with an error of 0.05 %; None without durations."""
        if self.longest_ns is None:
            return None
        rank = np.ceil(self.count * percent / 100)
        number = self._first + int(np.searchsorted(np.cumsum(self._bins), rank))
        middle = float(_middles(np.array([number]))[0])
        return min(max(middle, float(self._shortest_ns)), float(self.longest_ns))

    def between(self, low_ns: float, high_ns: float) -> int:
        """The number of durations in the bins whose middle is in [`low_ns`, `high_ns`)."""
        middles = _middles(np.arange(self._first, self._first + len(self._bins)))
        return int(self._bins[(middles >= low_ns) & (middles < high_ns)].sum())


def _bins_of(durations_ns: Ints) -> Ints:
    fractions, exponents = np.frexp(np.maximum(durations_ns, 1).astype(np.float64))
    within = ((2 * fractions - 1) * PER_OCTAVE).astype(np.int64)
    bins: Ints = (exponents.astype(np.int64) - 1) * PER_OCTAVE + within
    bins[durations_ns == 0] = _NO_TIME_BIN
    return bins


_NO_TIME_BIN: Final = -1
"""The bin of 0 ns."""


def _middles(bins: Ints) -> _Floats:
    octaves, within = np.divmod(bins, PER_OCTAVE)
    low = np.ldexp(1 + within / PER_OCTAVE, octaves)
    width = np.ldexp(1.0, octaves) / PER_OCTAVE
    middles = np.where(width > 1, low + (width - 1) / 2, np.ceil(low))
    return np.where(bins == _NO_TIME_BIN, 0.0, middles)


RECENT: Final = 256


class RecentValues(Model):
    """Ring buffer of the latest values."""

    def __init__(self, size: int = RECENT) -> None:
        """`size` is at least 1."""
        self._size = size
        self.values: npt.NDArray[np.int64] = np.empty(0, np.int64)
        """The latest last."""

    def observe(self, values: npt.NDArray[np.int64]) -> None:
        """Append values."""
        if len(values):
            self.values = np.concatenate((self.values, values[-self._size :]))[-self._size :]

    def merge(self, later: RecentValues) -> None:
        """Append the values of another buffer."""
        self.observe(later.values)

    def percentile(self, percent: float) -> int | None:
        """A percentile (0 to 100) of the values, itself one of them; None without values."""
        if not len(self.values):
            return None
        return int(np.percentile(self.values, percent, method="inverted_cdf"))

    def per_second(self, now_ns: int) -> float | None:
        """The rate of times in two seconds before `now_ns`; None if unknown, 0 if all are older."""
        times = self.values
        if not len(times):
            return None
        late = times[times > now_ns - RATE_WINDOW_NS]
        if len(late) == len(times):
            # All values are in the window: what was before them is unknown.
            span = int(late[-1] - late[0])
            return (len(late) - 1) * 1e9 / span if span > 0 else None
        return len(late) * 1e9 / RATE_WINDOW_NS


def extent(t_ns: Ints) -> tuple[int, int] | None:
    """The earliest and the latest of some times; None without times."""
    return (int(t_ns.min()), int(t_ns.max())) if len(t_ns) else None


Floats: TypeAlias = npt.NDArray[np.float64]

SHORTEST_NS: Final = 1 << 22
"""Default duration of the shortest windows, nanoseconds: about 4 ms."""

WINDOWS: Final = 2048
"""Default number of windows of a level."""

LEVELS: Final = 6
"""Default number of levels; the windows of the last one are at least two minutes long."""

_STEP: Final = 8
"""How many times as long the windows of the next level are."""


class Keep(Enum):
    """What is kept of the values in a window; the value is that of an empty window."""

    TOTAL = 0
    LOW = 2**63 - 1
    HIGH = -(2**63)
    LAST = -(2**63) + 1

    def empty(self, *shape: int) -> Ints:
        """Windows without values."""
        return np.full(shape, self.value, np.int64)

    def add(self, kept: Ints, cells: Ints, values: Ints | int) -> None:
        """Add values, in order of time, to the windows `cells` of `kept`."""
        match self:
            case Keep.TOTAL:
                np.add.at(kept, cells, values)
            case Keep.LOW:
                np.minimum.at(kept, cells, values)
            case Keep.HIGH:
                np.maximum.at(kept, cells, values)
            case Keep.LAST:
                kept[cells] = values  # of equal indices, numpy assigns the last


class Counts(NamedTuple):
    """A number for each of equally long windows."""

    start_ns: int
    """Start of the first window, nanoseconds since 1970 UTC."""
    window_ns: int
    values: Sequence[float]


@dataclass(frozen=True, slots=True)
class EnvelopeColumns:
    """Minimum, maximum and last value in columns of equal duration; NaN without values."""

    low: Floats
    high: Floats
    last: Floats


class _Resolution(Model):
    """The latest windows of one duration."""

    def __init__(self, window_ns: int, keep: Sequence[Keep], first: int = 0) -> None:
        self.window_ns = window_ns
        self.first = first
        """Number of the first window."""
        self.kept: dict[Keep, Ints] = {one: np.empty((0, 0), np.int64) for one in keep}
        """By what is kept: a number by group and window."""

    @property
    def shape(self) -> tuple[int, int]:
        """The number of groups, and of windows."""
        groups, windows = next(iter(self.kept.values())).shape
        return groups, windows

    @property
    def end(self) -> int:
        """The number after that of the last window."""
        return self.first + self.shape[1]

    def spanned(self, first_ns: int, last_ns: int) -> range:
        """The windows with which this level would cover another span too."""
        first, end = first_ns // self.window_ns, last_ns // self.window_ns + 1
        if not self.shape[1]:
            return range(first, end)
        return range(min(first, self.first), max(end, self.end))

    def extend(self, windows: range, groups: int) -> None:
        """Have these windows, in which the known ones end, and at least this number of groups."""
        known, size = self.shape
        if windows == range(self.first, self.end) and groups <= known:
            return
        start = max(self.first, windows.start)
        for keep, old in self.kept.items():
            new = keep.empty(max(groups, known), len(windows))
            kept = old[:, start - self.first :] if size else old
            new[:known, start - windows.start : start - windows.start + kept.shape[1]] = kept
            self.kept[keep] = new
        self.first = windows.start

    def add(self, t_ns: Ints, values: Ints | int, groups: Ints | int) -> None:
        """Add values in order of time; those before the first window are dropped."""
        numbers = t_ns // self.window_ns - self.first
        if numbers.min() < 0:
            known = numbers >= 0
            numbers = numbers[known]
            values = values if isinstance(values, int) else values[known]
            groups = groups if isinstance(groups, int) else groups[known]
        cells = groups * self.shape[1] + numbers
        for keep, kept in self.kept.items():
            keep.add(kept.reshape(-1), cells, values)

    def include(self, other: _Resolution, groups: Ints) -> None:
        """Add the windows of a level whose windows are not longer; `groups` are its groups here."""
        for keep, kept in other.kept.items():
            rows, columns = np.nonzero(kept != keep.value)
            numbers = (other.first + columns) * other.window_ns // self.window_ns - self.first
            inside = numbers >= 0
            cells = (groups[rows] * self.shape[1] + numbers)[inside]
            keep.add(self.kept[keep].reshape(-1), cells, kept[rows, columns][inside])

    def coarser(self, by: int) -> _Resolution:
        """A level of the same values, with windows that are `by` times as long."""
        found = _Resolution(by * self.window_ns, [*self.kept])
        groups, windows = self.shape
        if windows:
            first, last = self.first * self.window_ns, (self.end - 1) * self.window_ns
            found.extend(found.spanned(first, last), groups)
            found.include(self, np.arange(groups))
        return found


class Series(Model):
    """Numbers over time by group (0, 1, ...), all groups in the same windows."""

    def __init__(
        self,
        *keep: Keep,
        shortest_ns: int = SHORTEST_NS,
        windows: int = WINDOWS,
        levels: int = LEVELS,
    ) -> None:
        """An empty series.

        Args:
            keep: what is kept of the values in a window, by default their total.
            shortest_ns: duration of the shortest windows.
            windows: most windows of a level.
            levels: most levels.
        """
        self._keep = keep or (Keep.TOTAL,)
        self._windows, self._most_levels = windows, levels
        self._levels = [_Resolution(shortest_ns, self._keep)]
        self.first_ns: int | None = None
        """Earliest time, nanoseconds since 1970 UTC; None without any."""
        self.last_ns: int | None = None

    def observe(self, t_ns: Ints, values: Ints | int = 1, group: Ints | int = 0) -> None:
        """Add values, by default 1 each.

        Args:
            t_ns: nanoseconds since 1970 UTC; in one call they may fall.
            values: 64-bit integers.
            group: one group, or that of each value.
        """
        if not len(t_ns):
            return
        if Keep.LAST in self._keep and (t_ns[1:] < t_ns[:-1]).any():
            order = np.argsort(t_ns, kind="stable")
            t_ns = t_ns[order]
            values = values if isinstance(values, int) else values[order]
            group = group if isinstance(group, int) else group[order]
        most = group if isinstance(group, int) else int(group.max())
        self._cover(int(t_ns.min()), int(t_ns.max()), most + 1)
        for level in self._levels:
            level.add(t_ns, values, group)

    def merge(self, later: Self, groups: Sequence[int] | None = None) -> None:
        """Add the values of another series with the same durations and levels.

        `groups` are its groups here, by default the same.
        """
        if later.first_ns is None or later.last_ns is None:
            return
        known = later._levels[0].shape[0]
        own = np.arange(known) if groups is None else np.array(groups[:known])
        while len(self._levels) < len(later._levels):
            self._lengthen()
        while self._levels[-1].window_ns < later._levels[-1].window_ns:
            self._lengthen()
        self._cover(later.first_ns, later.last_ns, int(own.max()) + 1)
        for number, level in enumerate(self._levels):
            level.include(later._levels[min(number, len(later._levels) - 1)], own)

    def _cover(self, first_ns: int, last_ns: int, groups: int) -> None:
        """Make room for values of a span; windows at its start may remain uncovered."""
        self.first_ns = first_ns if self.first_ns is None else min(self.first_ns, first_ns)
        self.last_ns = last_ns if self.last_ns is None else max(self.last_ns, last_ns)
        while len(self._levels[-1].spanned(first_ns, last_ns)) > self._windows:
            self._lengthen()
        for level in self._levels:
            windows = level.spanned(first_ns, last_ns)[-self._windows :]
            level.extend(windows, groups)

    def _lengthen(self) -> None:
        """Add a level of longer windows, or lengthen those of the last level."""
        if len(self._levels) < self._most_levels:
            self._levels.append(self._levels[-1].coarser(_STEP))
        else:
            self._levels[-1] = self._levels[-1].coarser(2)

    def counts(self, group: int = 0) -> Counts:
        """The totals of a group, window by window, over all times."""
        level = self._levels[-1]
        kept = level.kept[Keep.TOTAL]
        values: Any = kept[group] if group < len(kept) else np.zeros(level.shape[1], np.int64)
        return Counts(level.first * level.window_ns, level.window_ns, values.tolist())

    def totals(self, group: int, span: tuple[int, int], columns: int) -> Ints:
        """The totals of a group in columns of a span; the arguments are those of `envelope`."""
        found: Ints = np.zeros(columns, np.int64)
        level, numbers, cells = self._columns(span, columns)
        kept = level.kept[Keep.TOTAL]
        if group < len(kept):
            np.add.at(found, cells, kept[group, numbers - level.first])
        return found

    def envelope(self, group: int, span: tuple[int, int], columns: int) -> EnvelopeColumns:
        """The values of a group in columns of a span, from the shortest windows that reach back.

        `span` are a start and an exclusive end. A window belongs to the column of its middle; at
        the ends to the first or last column.
        """
        level, numbers, cells = self._columns(span, columns)
        found = []
        for keep in (Keep.LOW, Keep.HIGH, Keep.LAST):
            column = keep.empty(columns)
            if group < len(level.kept[keep]):
                kept = level.kept[keep][group, numbers - level.first]
                known = kept != keep.value
                keep.add(column, cells[known], kept[known])
            found.append(np.where(column == keep.value, np.nan, column))
        return EnvelopeColumns(*found)

    def _columns(self, span: tuple[int, int], columns: int) -> tuple[_Resolution, Ints, Ints]:
        """The shortest windows that cover a span: their level, numbers and columns."""
        start, end = span
        level = next(filter(lambda one: self._reaches(one, start), self._levels))
        first = max(level.first, start // level.window_ns)
        numbers = np.arange(first, max(first, min(level.end, -(-end // level.window_ns))))
        middles = numbers * level.window_ns + level.window_ns // 2
        at = (middles - start) / max(1, end - start) * columns
        return level, numbers, np.clip(at.astype(np.int64), 0, columns - 1)

    def _reaches(self, level: _Resolution, start_ns: int) -> bool:
        """Whether a level has all values since a time."""
        oldest = max(start_ns, start_ns if self.first_ns is None else self.first_ns)
        return level is self._levels[-1] or level.first <= oldest // level.window_ns

    def before(self, group: int, t_ns: int) -> tuple[int, int] | None:
        """The last value of a group before the window of a time, after its approximate time."""
        for level in self._levels:
            kept = level.kept[Keep.LAST]
            early = kept[group : group + 1, : max(0, t_ns // level.window_ns - level.first)]
            known = np.flatnonzero(early != Keep.LAST.value)
            if len(known):
                return (level.first + int(known[-1])) * level.window_ns, int(early[0, known[-1]])
        return None
