"""Counters over rows: durations, recent values, rates.

The histogram of durations has logarithmic bins, 1024 in an octave:

octave -1    0 ns                        its last bin
octave 0     1 ns                        one bin for each ns: exact, up to 1,024 ns
octave 10    1,024 ns ... 2,047 ns       the last octave that is exact
octave 22    4.2 ms ... 8.4 ms           bins of 4,096 ns
"""

from __future__ import annotations

from collections import deque
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from fte_sniff.analysis.model import Model
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
        """Count durations, each with the time of its end."""
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

RATE_WINDOW_NS: Final = 2_000_000_000
"""Window of a rate, nanoseconds."""


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


class Rate:
    """Rate per second in a sliding window."""

    def __init__(self, window_ns: int = RATE_WINDOW_NS) -> None:
        """`window_ns` is more than 0."""
        self._window_ns = window_ns
        self._counts: deque[tuple[int, int]] = deque()
        self._sum = 0
        self._since_ns: int | None = None

    def observe(self, count: int, t_ns: int) -> None:
        """Add a count at a time; times must not fall."""
        if self._since_ns is None:
            self._since_ns = t_ns
        self._counts.append((t_ns, count))
        self._sum += count
        self._expire(t_ns)

    def per_second(self, now_ns: int) -> float:
        """The rate in the window that ends now; at first, since the first update."""
        self._expire(now_ns)
        if self._since_ns is None:
            return 0.0
        span_ns = min(self._window_ns, now_ns - self._since_ns)
        return self._sum * 1e9 / span_ns if span_ns > 0 else 0.0

    def _expire(self, now_ns: int) -> None:
        while self._counts and self._counts[0][0] <= now_ns - self._window_ns:
            self._sum -= self._counts.popleft()[1]
