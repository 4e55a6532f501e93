"""Owns the speeds and positions of every motor over time, as commands asked and as feedback told.

It must not know a clock, a screen or where rows are kept. Decoded rows come in batch by batch; each
motor and kind of frame has an envelope of its own, so that spikes survive at any zoom.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from fte_sniff.analysis.envelope import Envelope, Spans
from fte_sniff.analysis.fields import Decoded, subject
from fte_sniff.protocol import KINDS, MOTORS, Direction

_TRACED: Final = [
    (code, kind, name)
    for code, kind in enumerate(KINDS)
    if kind.names_motor and (name := subject(kind)) is not None
]

QUANTITIES: Final = tuple(dict.fromkeys(name for _, _, name in _TRACED))
"""The row names of what is traced: `rpm` and `pulses`."""


class Traces:
    """What every motor was asked and what it told, over time; rows without a time are left out."""

    def __init__(self) -> None:
        self._traces: dict[tuple[int, Direction, str], Envelope] = {}
        self.first_ns: int | None = None
        """The earliest time of a row, nanoseconds since 1970 UTC; None while there is none."""
        self.last_ns: int | None = None
        """The latest."""

    def add(self, rows: Decoded) -> None:
        """The next rows."""
        if not rows.has_time.any():
            return
        known = rows.t_ns[rows.has_time]
        self._stretch(int(known.min()), int(known.max()))
        for code, kind, name in _TRACED:
            own = np.flatnonzero((rows.kinds == code) & rows.has_time)
            for motor in MOTORS if len(own) else ():
                places = own[rows.nums[own] == motor]
                if len(places):
                    trace = self._traces.setdefault((motor, kind.direction, name), Envelope())
                    trace.add(rows.t_ns[places], rows.values(name, places))

    def _stretch(self, first_ns: int, last_ns: int) -> None:
        self.first_ns = first_ns if self.first_ns is None else min(self.first_ns, first_ns)
        self.last_ns = last_ns if self.last_ns is None else max(self.last_ns, last_ns)

    def spans(
        self, motor: int, direction: Direction, name: str, window: tuple[int, int], columns: int
    ) -> Spans:
        """One quantity of a motor between two times, in so many columns; NaN where none was told.

        `direction` chooses what was asked (control) or what was told (feedback).
        """
        trace = self._traces.get((motor, direction, name))
        if trace is None:
            return Spans(*(np.full(columns, np.nan) for _ in range(3)))
        return trace.spans(*window, columns)
