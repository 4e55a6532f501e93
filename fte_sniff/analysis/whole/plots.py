"""The data of plots: a quantity of the motors over time, in columns of a span."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fte_sniff.analysis.counters import Floats
from fte_sniff.protocol import KINDS, MOTORS, Direction
from fte_sniff.protocol.rows import Ints, Rows


class Envelope(NamedTuple):
    """Minimum, maximum and last value in columns of equal duration; NaN without values."""

    low: Floats
    high: Floats
    last: Floats


def envelope(t_ns: Ints, values: Ints, span: tuple[int, int], columns: int) -> Envelope:
    """The values in columns of a span, a start and an exclusive end; times do not fall."""
    edges = np.linspace(*span, columns + 1).astype(np.int64)
    starts, ends = np.searchsorted(t_ns, edges[:-1]), np.searchsorted(t_ns, edges[1:])
    filled = np.flatnonzero(ends > starts)
    found = np.full((3, columns), np.nan)
    if len(filled):
        own = values[: ends[-1]]
        found[0, filled] = np.minimum.reduceat(own, starts[filled])
        found[1, filled] = np.maximum.reduceat(own, starts[filled])
        found[2, filled] = own[ends[filled] - 1]
    return Envelope(*found)


def motor_values(
    rows: Rows, direction: Direction, name: str
) -> dict[int, tuple[Ints, Ints]]:
    """By motor, the times and values of a quantity: its targets, or its feedback."""
    codes = [
        code
        for code, kind in enumerate(KINDS)
        if kind.direction is direction and kind.names_motor and kind.subject == name
    ]
    at = np.flatnonzero(np.isin(rows.kinds, codes) & rows.timed)
    values, t_ns, nums = rows.values(name, at), rows.t_ns[at], rows.nums[at]
    return {motor: (t_ns[nums == motor], values[nums == motor]) for motor in MOTORS}
