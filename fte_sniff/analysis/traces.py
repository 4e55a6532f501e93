"""Targets and feedback of the motors over time, as min/max envelopes for plots."""

from __future__ import annotations

from typing import Final, TypeAlias

import numpy as np

from fte_sniff.analysis.model import Model
from fte_sniff.analysis.series import EnvelopeColumns, Keep, Series
from fte_sniff.protocol import KINDS, MOTORS, Direction
from fte_sniff.protocol.rows import Bools, Rows

FINEST_NS: Final = 1 << 22
"""Duration of the shortest windows, nanoseconds: about 4 ms."""

LEVELS: Final = 6
"""Levels of windows; those of the last one are at least two minutes long."""

WINDOWS: Final = 2048
"""Windows of a level."""

_TRACED: Final = [
    (code, kind, name)
    for code, kind in enumerate(KINDS)
    if kind.names_motor and (name := kind.subject) is not None
]

QUANTITIES: Final = tuple(dict.fromkeys(name for _, _, name in _TRACED))
"""Column names of what is traced: `rpm` and `pulses`."""

_Key: TypeAlias = tuple[int, Direction, str]

_TO_ALL: Final = (0, Direction.CONTROL, "")
_GROUPS: Final[dict[_Key, int]] = {
    key: group
    for group, key in enumerate(
        [
            *((motor, way, name) for way in Direction for name in QUANTITIES for motor in MOTORS),
            _TO_ALL,
        ]
    )
}
"""By motor, direction and quantity, the group in the series; the last is commands to all motors."""

_KINDS_TO_ALL: Final = [
    code
    for code, kind in enumerate(KINDS)
    if kind.direction is Direction.CONTROL and not kind.names_motor
]


class Traces(Model):
    """Commands and feedback of every motor over time; rows without a time are ignored."""

    def __init__(self) -> None:
        self._series = Series(
            Keep.LOW, Keep.HIGH, Keep.LAST, shortest_ns=FINEST_NS, windows=WINDOWS, levels=LEVELS
        )
        self._window: tuple[int, int] | None = None
        self._resampled: dict[tuple[_Key, int], EnvelopeColumns] = {}
        """Results for that window, since a command is the target of one curve and ends another."""
        self.last_ns: int | None = None
        """Latest time of a row, nanoseconds since 1970 UTC."""

    def observe(self, rows: Rows) -> None:
        """Add the next rows."""
        if (times := rows.extent) is None:
            return
        self._window = None
        self.last_ns = times[1] if self.last_ns is None else max(self.last_ns, times[1])
        groups = np.full(len(rows), -1)
        values = np.zeros(len(rows), np.int64)
        for code, kind, name in _TRACED:
            at = np.flatnonzero(rows.kinds == code)
            at = at[np.isin(rows.nums[at], MOTORS)]
            groups[at] = _GROUPS[MOTORS[0], kind.direction, name] + rows.nums[at] - MOTORS[0]
            values[at] = rows.values(name, at)
        groups[np.isin(rows.kinds, _KINDS_TO_ALL)] = _GROUPS[_TO_ALL]
        traced = rows.timed & (groups >= 0)
        self._series.observe(rows.t_ns[traced], values[traced], groups[traced])

    def resample(
        self, motor: int, direction: Direction, name: str, window: tuple[int, int], columns: int
    ) -> EnvelopeColumns:
        """One quantity of a motor in a time window: its target (control) or feedback.

        The result is shared: never change it.
        """
        if window != self._window:
            self._window, self._resampled = window, {}
        key = motor, direction, name
        if (key, columns) not in self._resampled:
            self._resampled[key, columns] = self._series.envelope(_GROUPS[key], window, columns)
        return self._resampled[key, columns]

    def other_commands(self, motor: int, name: str, window: tuple[int, int], columns: int) -> Bools:
        """In which columns a motor got a command that does not set this quantity."""
        found = np.zeros(columns, np.bool_)
        for key in _other_commands(motor, name):
            found |= ~np.isnan(self.resample(*key, window, columns).last)
        return found

    def target_before(self, motor: int, name: str, t_ns: int) -> int | None:
        """The target of a quantity just before a time.

        None if it is unknown, or the last command does not set this quantity.
        """
        own = self._series.before(_GROUPS[motor, Direction.CONTROL, name], t_ns)
        others = [self._series.before(_GROUPS[key], t_ns) for key in _other_commands(motor, name)]
        if own is None or any(other is not None and other[0] > own[0] for other in others):
            return None
        return own[1]


def _other_commands(motor: int, name: str) -> list[_Key]:
    others = [other for other in QUANTITIES if other != name]
    return [*((motor, Direction.CONTROL, other) for other in others), _TO_ALL]
