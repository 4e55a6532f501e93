"""Durations counted by bin, so that percentiles of parts add up; a bin has 0.05 % to 0.1 %.

The number of a bin is the start of a float: its exponent and the next ten bits.

    1,048,576 ns   0 10000010011 0000000000 000000...  the first of 1024 bins of an octave
    1,049,601 ns   0 10000010011 0000000001 000000...  the next one, 1,024 ns wide
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import Final

import numpy as np
import polars as pl

from fte_sniff.analysis.segments import Counts, added
from fte_sniff.protocol.rows import Floats, Ints

FINE: Final = 10
"""Bits of a mantissa in the number of a bin: 1024 bins an octave."""

COARSE: Final = 6
"""As `FINE`, where the bins of many spans of time are kept: 64 an octave, of 1.1 %."""

JITTER: Final = (5.0, 95.0)
"""The percentiles of the shortest and the longest periods of jitter."""

_MANTISSA: Final = 52


def bins_of(durations_ns: Ints, bits: int = FINE) -> Ints:
    """The bins of durations, 0 ns or longer."""
    return durations_ns.astype(np.float64).view(np.int64) >> (_MANTISSA - bits)


def middles(bins: Ints, bits: int = FINE) -> Floats:
    """The middles of bins, nanoseconds."""
    low = (bins << (_MANTISSA - bits)).view(np.float64)
    high = ((bins + 1) << (_MANTISSA - bits)).view(np.float64)
    return np.where(high - low > 1, (np.ceil(low) + np.ceil(high) - 1) / 2, np.ceil(low))


def binned(name: str, frame: pl.DataFrame, keys: Sequence[str], ns: str, until: str) -> Counts:
    """The durations of a column, of which negative ones are left out, by keys and bin.

    `until` are the times of their ends. The counts are `NAME bins`, beside those of other analyses.
    """
    own = frame.select(*keys, ns=ns, until=until).filter(pl.col("ns") >= 0)
    own = own.with_columns(bin=pl.Series(bins_of(own["ns"].to_numpy()), dtype=pl.Int64))
    return {
        f"{name} bins": own.group_by(*keys, "bin").agg(
            pl.len().cast(pl.Int64).alias("sum count"),
            pl.col("ns").min().alias("least ns"),
            pl.col("until").get(pl.col("ns").arg_max()).alias("until ns"),
            pl.col("ns").max().alias("greatest ns"),
        )
    }


@dataclass(frozen=True, slots=True)
class Durations:
    """Durations that were counted."""

    bins: Ints
    """The bins that are not empty, rising."""
    counts: Ints
    """The number of durations in each of them."""
    least_ns: int | None = None
    longest_ns: int | None = None
    longest_until_ns: int | None = None
    """The end of the longest one; the first of several."""

    @classmethod
    def of(cls, counts: Counts, name: str, **keys: object) -> Durations:
        """Those with some keys."""
        names = ("sum count", "least ns", "greatest ns", "until ns")
        found = added([chosen(counts[f"{name} bins"], **keys).select("bin", *names)]).sort("bin")
        own = cls(found["bin"].to_numpy(), found["sum count"].to_numpy())
        if not len(found):
            return own
        last = found.row(-1, named=True)
        ends = (found["least ns"][0], last["greatest ns"], last["until ns"])
        return cls(own.bins, own.counts, *ends)

    @property
    def count(self) -> int:
        """The number of durations."""
        return int(self.counts.sum())

    @property
    def lengths_ns(self) -> Floats:
        """The middles of the bins."""
        return middles(self.bins)

    def percentile_ns(self, percent: float) -> float | None:
        """A percentile, above 0 to 100, within 0.05 %; None without durations."""
        totals = np.cumsum(self.counts)
        if not self.count:
            return None
        middle = float(self.lengths_ns[np.searchsorted(totals, totals[-1] * percent / 100)])
        return min(max(middle, self.least_ns or 0), self.longest_ns or inf)

    @property
    def jitter_ns(self) -> float | None:
        """From the 5 % shortest to the 5 % longest; None for less than two."""
        low, high = (self.percentile_ns(one) for one in JITTER)
        return None if self.count < 2 or low is None or high is None else high - low

    def up_to(self, ns: float) -> Durations:
        """Those that are not longer."""
        kept = self.lengths_ns <= ns
        return replace(self, bins=self.bins[kept], counts=self.counts[kept])


def chosen(frame: pl.DataFrame, **keys: object) -> pl.DataFrame:
    """The rows with these keys, of which None is null."""
    if not keys:
        return frame
    return frame.filter(pl.col(name).eq_missing(pl.lit(value)) for name, value in keys.items())
