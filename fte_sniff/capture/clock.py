"""Owns the time of a capture: one clock that never falls, tied to UTC once.

It must not know what is stamped with it. When the system's clock is set meanwhile, this one goes
on evenly; a watch tells of it.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

_CLOCK_NAME = "CLOCK_BOOTTIME" if hasattr(time, "CLOCK_BOOTTIME") else "CLOCK_MONOTONIC"
_CLOCK: int = getattr(time, _CLOCK_NAME)

_TRIES = 16

LEAST_STEP_NS = 1_000_000_000
"""The least jump of the system's clock that is told of; what is drawn evenly is none."""


@dataclass(frozen=True, slots=True)
class Clock:
    """Nanoseconds since 1970 UTC that go on evenly, whatever is done to the system's clock.

    All ports of a capture share one, so that their times compare. On Linux it goes on through a
    suspended machine.
    """

    utc_at_tie_ns: int
    """What the system's clock said when the two were tied, nanoseconds since 1970 UTC."""
    steady_at_tie_ns: int
    """What the steady clock said at that moment."""
    uncertainty_ns: int
    """How far the two readings can be apart, either way."""

    @classmethod
    def tied(cls) -> Clock:
        """Tie the steady clock to UTC now, as closely as the machine allows."""
        return min((_tie() for _ in range(_TRIES)), key=lambda clock: clock.uncertainty_ns)

    def now_ns(self) -> int:
        """The time now, nanoseconds since 1970 UTC; never falls."""
        return self.utc_at_tie_ns + time.clock_gettime_ns(_CLOCK) - self.steady_at_tie_ns

    def system_ahead_ns(self) -> int:
        """How far the system's clock has run, or was set, ahead of this one since the tie."""
        return time.time_ns() - self.now_ns()

    def facts(self) -> dict[str, str]:
        """How the clock was tied, for a recording's metadata."""
        return {
            "clock": _CLOCK_NAME,
            "clock_utc_at_tie_ns": str(self.utc_at_tie_ns),
            "clock_steady_at_tie_ns": str(self.steady_at_tie_ns),
            "clock_tie_uncertainty_ns": str(self.uncertainty_ns),
        }


class ClockWatch:
    """Notices when the system's clock is set."""

    def __init__(self, ahead_ns: int) -> None:
        """Begin with how far the system's clock is ahead, as `Clock.system_ahead_ns` tells it."""
        self._ahead_ns = ahead_ns

    def step(self, ahead_ns: int) -> int:
        """How far the system's clock was set forth since the last look, nanoseconds.

        Below 0 where it was set back; 0 where it goes as it did. Look every second or so.
        """
        step_ns, self._ahead_ns = ahead_ns - self._ahead_ns, ahead_ns
        return step_ns if abs(step_ns) >= LEAST_STEP_NS else 0


def _tie() -> Clock:
    before_ns = time.clock_gettime_ns(_CLOCK)
    utc_ns = time.time_ns()
    after_ns = time.clock_gettime_ns(_CLOCK)
    half_ns = (after_ns - before_ns + 1) // 2
    return Clock(utc_ns, before_ns + half_ns, half_ns)
