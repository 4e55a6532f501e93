"""Usual range of a quantity: an outlier, such as a flipped bit, must not flatten its plot."""

from __future__ import annotations

from typing import Final

import numpy as np

from fte_sniff.analysis.series import Floats
from fte_sniff.protocol.rows import Ints

MEDIAN_POINTS: Final = 5
"""Points of the running median whose range is the usual one."""

MARGIN: Final = 0.5
"""How far a value may be outside the range of the medians, as a share of it."""

LEAST_MARGIN: Final = 0.05
"""The least margin, as a share of the greatest median; it matters where the range is narrow."""

MOST_OUTLIERS: Final = 0.25
"""Share of the commands that are outliers at most; a target that often changes has none."""


def points_of_median(count: int) -> int:
    """Points of the running median over `count` single points.

    Four more for each tenfold above 200: among many points, some outliers are close together.
    """
    return MEDIAN_POINTS + 4 * max(0, int(np.log10(max(1, count / 200))))


def medians(values: Floats, points: int = MEDIAN_POINTS) -> Floats:
    """The running median of the values that are known; all of them where there are few."""
    known = values[~np.isnan(values)]
    if len(known) < points:
        return known
    windows = np.lib.stride_tricks.sliding_window_view(known, points)
    found: Floats = np.median(windows, axis=1)
    return found


def usual_targets(
    targets: Floats,
    lengths: Ints,
    *,
    points: int = MEDIAN_POINTS,
    begins: bool = True,
    holds: bool = True,
) -> Floats:
    """The running median of the commands, so that one with a flipped bit is an outlier.

    A command that is held longer than others counts more, since it may be sent only once; so do
    the first of all, if these are all (`begins`), and the one that holds at the end (`holds`),
    which have commands only at one side.

    Args:
        targets: What each command sets.
        lengths: How long each is held, in any unit.
    """
    if not len(targets):
        return targets
    repeats = np.clip(lengths // max(1, int(np.median(lengths))), 1, points).astype(np.int64)
    repeats[0] += points // 2 if begins else 0
    repeats[-1] += points // 2 if holds else 0
    found = medians(np.repeat(targets, repeats), points)
    low, high = limits(found)
    outliers = (targets < low) | (targets > high)
    return found if outliers.mean() <= MOST_OUTLIERS else targets


def limits(usual: Floats) -> tuple[float, float]:
    """The range outside which a value is an outlier; `usual` values must not be empty."""
    low, high = float(usual.min()), float(usual.max())
    margin = max(MARGIN * (high - low), LEAST_MARGIN * max(abs(low), abs(high)), 1.0)
    return low - margin, high + margin


def inside(values: Floats, usual: Floats) -> Floats:
    """The values that are not outliers; all of them where none is usual."""
    if not len(usual):
        return values
    low, high = limits(usual)
    found = values[(values >= low) & (values <= high)]
    return found if len(found) else values


def usual_range(values: Floats) -> tuple[float, float] | None:
    """The least and the greatest value without outliers; None without values."""
    known = inside(values[~np.isnan(values)], medians(values))
    return (float(known.min()), float(known.max())) if len(known) else None
