"""The spans of time in which bad windows are more frequent than elsewhere: a scan statistic.

A window is *bad* if its count reaches a threshold. Given C bad windows of n, the number in an
interval with share p of the windows is Binomial(C, p) if nothing is wrong there, so

    P(c or more) <= exp(-C KL(c / C || p))

An interval is a span if that bound, times the number of intervals, thresholds and series, is less
than `ALPHA`: the union bound, so no simulation is needed. Windows are counted, not events, so that
bursts of events, which depend on each other, count once. Several thresholds are tried: a low one
for rare events, a high one where single events are usual.
"""

from __future__ import annotations

from math import log
from typing import Final, NamedTuple

import numpy as np

from fte_sniff.protocol.rows import Bools, Ints

ALPHA: Final = 0.01
"""Bound on the probability of any false finding in a recording."""

SERIES: Final = 100
"""Series for which the bound on false findings holds together."""

MOST_SPANS: Final = 5
"""Spans of one series."""

_LEAST_WINDOWS: Final = 3
"""Bad windows of a span."""

_THRESHOLDS: Final = (1, 2, 3, 5, 8, 13, 21)
"""Events that make a window bad; the one with the highest score counts."""


class BadSpan(NamedTuple):
    """Windows from the first to the last bad one, both included."""

    score: float
    """Minus the logarithm of the bound on the probability of as many bad windows."""
    first: int
    last: int


def divergence(share: float, expected: float) -> float:
    """Kullback-Leibler divergence of two shares of bad windows."""
    inside = share * log(share / expected) if share > 0 else 0.0
    return inside + ((1 - share) * log((1 - share) / (1 - expected)) if share < 1 else 0.0)


def surprise(first: tuple[int, int], second: tuple[int, int]) -> float:
    """Minus the logarithm of the bound on the probability of events being so divided by chance.

    Each is events and rows; 0 without either.
    """
    total, rows = first[0] + second[0], first[1] + second[1]
    expected = second[1] / max(1, rows)
    return total * divergence(second[0] / total, expected) if total and 0 < expected < 1 else 0.0


def _shortest(hits: Ints, windows: int, count: int) -> BadSpan:
    """The shortest span of a number of bad windows; `hits` are all of them."""
    widths = hits[count - 1 :] - hits[: len(hits) - count + 1] + 1
    at = int(widths.argmin())
    share, expected = count / len(hits), int(widths[at]) / windows
    score = len(hits) * divergence(share, expected) if share > expected else 0.0
    return BadSpan(score, int(hits[at]), int(hits[at + count - 1]))


def _best_span(bad: Bools) -> BadSpan | None:
    """The interval of bad windows that is least probable by chance: of any number of them."""
    hits = np.flatnonzero(bad)
    low, high = _LEAST_WINDOWS, len(hits)
    if high < low or high == len(bad):
        return None
    while True:
        counts = np.unique(np.geomspace(low, high, 24).round().astype(np.int64))
        spans = [_shortest(hits, len(bad), count) for count in counts.tolist()]
        best = max(range(len(spans)), key=lambda at: spans[at])
        if len(counts) >= high - low + 1:
            return spans[best]
        low, high = int(counts[max(0, best - 1)]), int(counts[best + 1 :][:1].sum()) or high


def spans_of(counts: Ints, exposed: Bools) -> list[BadSpan]:
    """The spans in which a count is more frequent than usual.

    Args:
        counts: events by window.
        exposed: the windows in which an event could have been.
    """
    at, found = np.flatnonzero(exposed), list[BadSpan]()
    for _ in range(MOST_SPANS):
        own = counts[at]
        spans = [span for one in _THRESHOLDS if (span := _best_span(own >= one)) is not None]
        if not spans or len(at) < 2 * _LEAST_WINDOWS:
            break
        # Intervals of half of the windows at most; lengths that differ by less are one.
        best, lengths = max(spans), 1 + 2 * np.log2(len(at) / 2 / _LEAST_WINDOWS)
        if best.score < log(len(at) * lengths * len(_THRESHOLDS) * SERIES / ALPHA):
            break
        found.append(BadSpan(best.score, int(at[best.first]), int(at[best.last])))
        at = np.delete(at, np.s_[best.first : best.last + 1])
    return found
