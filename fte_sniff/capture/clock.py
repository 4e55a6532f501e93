"""Clock of a capture: monotonic time, tied to UTC once; detects steps of the system's clock."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from fte_sniff.platform import POSIX

if POSIX:
    _CLOCK_NAME = "CLOCK_BOOTTIME" if hasattr(time, "CLOCK_BOOTTIME") else "CLOCK_MONOTONIC"
    _steady_ns: Callable[[], int] = partial(time.clock_gettime_ns, getattr(time, _CLOCK_NAME))
    _UTC_STEP_NS = 0
else:
    # Its other clocks advance in steps of 16 ms.
    _CLOCK_NAME, _steady_ns = "QueryPerformanceCounter", time.perf_counter_ns
    _UTC_STEP_NS = round(time.get_clock_info("time").resolution * 1e9)

_TRIES = 16

LEAST_STEP_NS = 1_000_000_000
"""Smallest clock step that is reported; gradual slewing is ignored."""


@dataclass(frozen=True, slots=True)
class Clock:
    """Nanoseconds since 1970 UTC, independent of later changes of the system's clock.

    All ports of a capture share one, so that their times compare. On Linux it includes the time of
    a suspended machine.
    """

    utc_at_tie_ns: int
    """The system's clock at the tie, nanoseconds since 1970 UTC."""
    steady_at_tie_ns: int
    """The monotonic clock at that moment, nanoseconds."""
    uncertainty_ns: int
    """Largest difference between the two moments, in either direction."""

    @classmethod
    def tied(cls) -> Clock:
        """Tie the monotonic clock to UTC now, as exactly as the machine allows."""
        return min((_tie() for _ in range(_TRIES)), key=lambda clock: clock.uncertainty_ns)

    def now_ns(self) -> int:
        """The time now, nanoseconds since 1970 UTC; monotonic."""
        return self.utc_at_tie_ns + _steady_ns() - self.steady_at_tie_ns

    def system_ahead_ns(self) -> int:
        """How far the system's clock is ahead of this one, nanoseconds."""
        return time.time_ns() - self.now_ns()

    def facts(self) -> dict[str, str]:
        """How the clock was tied, for a recording's metadata."""
        return {
            "clock": _CLOCK_NAME,
            "clock_utc_at_tie_ns": str(self.utc_at_tie_ns),
            "clock_steady_at_tie_ns": str(self.steady_at_tie_ns),
            "clock_tie_uncertainty_ns": str(self.uncertainty_ns),
        }


def _tie() -> Clock:
    before_ns = _steady_ns()
    utc_ns = time.time_ns()
    after_ns = _steady_ns()
    half_ns = (after_ns - before_ns + 1) // 2
    return Clock(utc_ns, before_ns + half_ns, half_ns + _UTC_STEP_NS)


class ClockWatch:
    """Detects steps of the system's clock."""

    def __init__(self, ahead_ns: int) -> None:
        self._ahead_ns = ahead_ns

    def step(self, ahead_ns: int) -> int:
        """Nanoseconds that the clock was set forward (back: negative); call it often."""
        step_ns, self._ahead_ns = ahead_ns - self._ahead_ns, ahead_ns
        return step_ns if abs(step_ns) >= LEAST_STEP_NS else 0
