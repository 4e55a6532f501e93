"""The data of plots: values over time as minimum, maximum and last value in columns of a span."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fte_sniff.analysis.relations import values_at
from fte_sniff.protocol.rows import Floats, Ints, Rows
from fte_sniff.protocol.spec import KINDS, Direction


class Envelope(NamedTuple):
    """Minimum, maximum and last value in columns of equal duration; NaN without values."""

    low: Floats
    high: Floats
    last: Floats


def envelope(t_ns: Ints, values: Ints, span: tuple[int, int], columns: int) -> Envelope:
    """The values in columns of a span, a start and an exclusive end; times do not fall.

    A plot of a motor takes the rows of its span, and a column for each dot:

        series = motor_values(rows, motor, Direction.FEEDBACK, "rpm")
        low, high, last = envelope(*series, span, columns)
    """
    start, stop = span
    edges = start + np.arange(columns + 1) * (stop - start) // columns
    starts, ends = np.searchsorted(t_ns, edges[:-1]), np.searchsorted(t_ns, edges[1:])
    filled = np.flatnonzero(ends > starts)
    found = np.full((3, columns), np.nan)
    if len(filled):
        own = values[: ends[-1]]
        found[0, filled] = np.minimum.reduceat(own, starts[filled])
        found[1, filled] = np.maximum.reduceat(own, starts[filled])
        found[2, filled] = own[ends[filled] - 1]
    return Envelope(*found)


def motor_values(rows: Rows, motor: int, direction: Direction, name: str) -> tuple[Ints, Ints]:
    """The times and values of a quantity of a motor (`rpm`): its targets, or its feedback.

    Times rise; a row that is earlier than the one before it counts as of the time of that one.
    """
    codes = [
        code
        for code, kind in enumerate(KINDS)
        if kind.direction is direction and kind.names_motor and kind.subject == name
    ]
    at = np.flatnonzero(np.isin(rows.kinds, codes) & (rows.nums == motor) & rows.timed)
    return np.maximum.accumulate(rows.t_ns[at]), values_at(rows, name, at)
