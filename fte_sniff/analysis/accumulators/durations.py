"""Owns how long things took, over any number of them: a histogram of durations, in bounded memory.

It must not know what took so long. Every octave has the same number of bins, so that what is read
out of them is right to half a thousandth, which three digits do not show, from nanoseconds to
years; only octaves between the shortest and the longest of all durations take memory, 8 KiB each.

    octave 0     1 ns                        one bin for each ns: exact, up to 1,024 ns
    octave 10    1,024 ns ... 2,047 ns       the last for which that holds
    octave 22    4.2 ms ... 8.4 ms           bins of 4,096 ns
"""

from __future__ import annotations

from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from fte_sniff.analysis.columns.fields import Ints

PER_OCTAVE: Final = 1024
"""Bins in an octave."""

_Floats: TypeAlias = npt.NDArray[np.float64]


class Durations:
    """Durations of 0 nanoseconds and more; one of 0 counts as one of 1."""

    def __init__(self) -> None:
        self.count = 0
        self.longest_ns: int | None = None
        self.longest_at_ns: int | None = None
        """When the longest of them ended, nanoseconds since 1970 UTC; of several, the first."""
        self._shortest_ns = 0
        self._bins: Ints = np.zeros(0, np.int64)
        self._first = 0
        """The bin that `_bins` begins with; the first of an octave."""

    def add(self, durations_ns: Ints, ends_ns: Ints) -> None:
        """These came, each with the time at which it ended."""
        if not len(durations_ns):
            return
        longest, shortest = int(durations_ns.argmax()), int(durations_ns.min())
        self._shortest_ns = min(self._shortest_ns, shortest) if self.count else shortest
        self.count += len(durations_ns)
        if self.longest_ns is None or durations_ns[longest] > self.longest_ns:
            self.longest_ns = int(durations_ns[longest])
            self.longest_at_ns = int(ends_ns[longest])
        bins = _bins_of(durations_ns)
        self._make_room(int(bins.min()), int(bins.max()))
        np.add.at(self._bins, bins - self._first, 1)

    def _make_room(self, low: int, high: int) -> None:
        """Let there be bins from one to another."""
        end = self._first + len(self._bins)
        first = min(low, self._first if len(self._bins) else low) // PER_OCTAVE * PER_OCTAVE
        last = max(high + 1, end)
        if first == self._first and last == end:
            return
        last += -last % PER_OCTAVE
        kept, at = self._bins, self._first - first
        self._bins = np.zeros(last - first, np.int64)
        if len(kept):
            self._bins[at : at + len(kept)] = kept
        self._first = first

    def percentile_ns(self, percent: float) -> float | None:
        """What so many percent (above 0, to 100) do not exceed, to 0.05 %; None without any."""
        if self.longest_ns is None:
            return None
        rank = np.ceil(self.count * percent / 100)
        place = int(np.searchsorted(np.cumsum(self._bins), rank))
        middle = float(_middles(np.array([self._first + place]))[0])
        return min(max(middle, float(self._shortest_ns)), float(self.longest_ns))

    def between(self, low_ns: float, high_ns: float) -> int:
        """How many lasted `low_ns` to `high_ns`, by the bins whose middle lies there."""
        middles = _middles(np.arange(self._first, self._first + len(self._bins)))
        return int(self._bins[(middles >= low_ns) & (middles < high_ns)].sum())


def _bins_of(durations_ns: Ints) -> Ints:
    fractions, exponents = np.frexp(np.maximum(durations_ns, 1).astype(np.float64))
    within = ((2 * fractions - 1) * PER_OCTAVE).astype(np.int64)
    return (exponents.astype(np.int64) - 1) * PER_OCTAVE + within


def _middles(bins: Ints) -> _Floats:
    """The middle of the whole nanoseconds that fall into each bin."""
    octaves, within = np.divmod(bins, PER_OCTAVE)
    low = np.ldexp(1 + within / PER_OCTAVE, octaves)
    wide = np.ldexp(1.0, octaves) / PER_OCTAVE
    return np.asarray(np.where(wide > 1, low + (wide - 1) / 2, np.ceil(low)), np.float64)
