"""Owns how long things took, over any number of them: a histogram of durations, in bounded memory.

It must not know what took so long. Bins are sixteen to an octave, so that what is read out of them
is right to some 4 percent, from nanoseconds to years.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from fte_sniff.analysis.fields import Ints

PER_OCTAVE: Final = 16
_BINS: Final = 63 * PER_OCTAVE


class Durations:
    """Durations of 0 nanoseconds and more."""

    def __init__(self) -> None:
        self.count = 0
        self.longest_ns: int | None = None
        self.longest_at_ns: int | None = None
        """When the longest of them ended, nanoseconds since 1970 UTC; of several, the first."""
        self._bins: Ints = np.zeros(_BINS, np.int64)

    def add(self, durations_ns: Ints, ends_ns: Ints) -> None:
        """These came, each with the time at which it ended."""
        if not len(durations_ns):
            return
        self.count += len(durations_ns)
        octaves = np.log2(np.maximum(durations_ns, 1)) * PER_OCTAVE
        bins = np.minimum(octaves.astype(np.int64), _BINS - 1)
        self._bins += np.bincount(bins, minlength=_BINS)
        longest = int(durations_ns.argmax())
        if self.longest_ns is None or durations_ns[longest] > self.longest_ns:
            self.longest_ns = int(durations_ns[longest])
            self.longest_at_ns = int(ends_ns[longest])

    def percentile_ns(self, percent: float) -> float | None:
        """What so many percent (above 0, to 100) do not exceed, to 4 percent; None without any."""
        if not self.count:
            return None
        rank = np.ceil(self.count * percent / 100)
        place = int(np.searchsorted(np.cumsum(self._bins), rank))
        return min(float(2 ** ((place + 0.5) / PER_OCTAVE)), float(self.longest_ns or 0))

    def between(self, low_ns: float, high_ns: float) -> int:
        """How many lasted `low_ns` to `high_ns`, by the bins whose middle lies there."""
        middles = 2 ** ((np.arange(_BINS) + 0.5) / PER_OCTAVE)
        return int(self._bins[(middles >= low_ns) & (middles < high_ns)].sum())
