"""Owns what the pane of motors looks at: which rows, back to when, and what is known there.

It must not know Textual, or how anything is drawn.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, tzinfo
from typing import Final

from fte_sniff.analysis.fields import subject
from fte_sniff.analysis.motors import MotorState
from fte_sniff.analysis.statistics import Bench
from fte_sniff.analysis.traces import Traces
from fte_sniff.protocol import Direction
from fte_sniff.tui.motors.plot import Curves

SECOND_NS: Final = 1_000_000_000

WINDOWS_NS: Final = tuple(
    seconds * SECOND_NS for seconds in (1, 2, 5, 10, 30, 60, 120, 300, 600, 1800, 3600, 14_400)
)
"""How far back the plots may look, nanoseconds."""

DEFAULT_WINDOW: Final = 3
"""Place of the window that is looked through first."""


@dataclass(frozen=True, slots=True)
class MotorsLook:
    """The motors as they were at one moment."""

    states: tuple[MotorState, ...]
    traces: Traces
    now_ns: int | None
    """The moment, nanoseconds since 1970 UTC; None where rows have no times."""
    window_ns: int
    """How far back the plots look."""
    bench: Bench
    zone: tzinfo = UTC
    """Of times of day."""

    @property
    def window(self) -> tuple[int, int]:
        """Begin and end of what the plots show, nanoseconds since 1970 UTC; the end is outside."""
        end = (self.now_ns or 0) + 1
        return end - self.window_ns, end

    def curves(self, state: MotorState, name: str, columns: int) -> Curves:
        """One quantity of a motor over the window, in so many columns."""
        motor, window = state.motor, self.window
        asked, told = (
            self.traces.spans(motor, direction, name, window, columns)
            for direction in (Direction.CONTROL, Direction.FEEDBACK)
        )
        otherwise = self.traces.otherwise(motor, name, window, columns)
        standing = self._standing(state, name)
        return Curves(asked, told, otherwise, standing, self.window_ns / columns)

    def _standing(self, state: MotorState, name: str) -> int | None:
        """What was asked before the window, also where that is too long ago for the traces."""
        target, start = state.target, self.window[0]
        if target is not None and target.t_ns is not None and target.t_ns < start:
            return target.values[name] if subject(target.kind) == name else None
        return self.traces.standing(state.motor, name, start)

    def ago_ns(self, t_ns: int | None) -> int | None:
        """How long before the moment something was; None where that is not known."""
        if t_ns is None or self.now_ns is None:
            return None
        return max(0, self.now_ns - t_ns)


def zoomed(place: int, by: int) -> int:
    """The place in `WINDOWS_NS` so many steps on, as far as there are any."""
    return min(max(0, place + by), len(WINDOWS_NS) - 1)
