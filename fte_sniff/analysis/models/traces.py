"""Owns the speeds and positions of every motor over time, as commands asked and as feedback told.

It must not know a clock, a screen or where rows are kept. Decoded rows come in batch by batch; each
motor and kind of frame has an envelope of its own, so that spikes survive at any zoom.
"""

from __future__ import annotations

from typing import Final, TypeAlias

import numpy as np

from fte_sniff.analysis.accumulators.envelope import Envelope, Spans, Told
from fte_sniff.analysis.columns.fields import Bools, Decoded, subject
from fte_sniff.protocol import KINDS, MOTORS, Direction

_Key: TypeAlias = tuple[int, Direction, str]

_TRACED: Final = [
    (code, kind, name)
    for code, kind in enumerate(KINDS)
    if kind.names_motor and (name := subject(kind)) is not None
]

_ALL_MOTORS: Final = 0
_TO_ALL: Final = [
    code
    for code, kind in enumerate(KINDS)
    if kind.direction is Direction.CONTROL and not kind.names_motor
]

QUANTITIES: Final = tuple(dict.fromkeys(name for _, _, name in _TRACED))
"""The row names of what is traced: `rpm` and `pulses`."""


class Traces:
    """What every motor was asked and what it told, over time; rows without a time are left out."""

    def __init__(self) -> None:
        self._traces: dict[_Key, Envelope] = {}
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
                    trace = self._trace(motor, kind.direction, name)
                    trace.add(rows.t_ns[places], rows.values(name, places))
        to_all = np.flatnonzero(np.isin(rows.kinds, _TO_ALL) & rows.has_time)
        if len(to_all):
            trace = self._trace(_ALL_MOTORS, Direction.CONTROL, "")
            trace.add(rows.t_ns[to_all], np.zeros(len(to_all), np.int64))

    def _trace(self, motor: int, direction: Direction, name: str) -> Envelope:
        return self._traces.setdefault((motor, direction, name), Envelope())

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

    def otherwise(self, motor: int, name: str, window: tuple[int, int], columns: int) -> Bools:
        """In which columns a motor was asked for something else than this quantity."""
        found = np.zeros(columns, np.bool_)
        for key in _others(motor, name):
            found |= ~np.isnan(self.spans(*key, window, columns).last)
        return found

    def standing(self, motor: int, name: str, t_ns: int) -> int | None:
        """What a motor was asked last before a time, if that was a value of this quantity.

        None where it was something else, or where it is not known.
        """
        own = self._before((motor, Direction.CONTROL, name), t_ns)
        others = [self._before(key, t_ns) for key in _others(motor, name)]
        if own is None or any(other is not None and other.t_ns > own.t_ns for other in others):
            return None
        return own.value

    def _before(self, key: _Key, t_ns: int) -> Told | None:
        trace = self._traces.get(key)
        return None if trace is None else trace.before(t_ns)


def _others(motor: int, name: str) -> list[_Key]:
    """Where commands to a motor are traced that are not about a quantity."""
    others = [other for other in QUANTITIES if other != name]
    return [
        *((motor, Direction.CONTROL, other) for other in others),
        (_ALL_MOTORS, Direction.CONTROL, ""),
    ]
