"""Owns one motor of the simulated controller: how its speed and position go over time.

It must not know of frames or of other motors. Plain sums, products and square roots only: they
round alike on every machine, so that the same commands give the same motion everywhere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

PULSES_PER_TURN = 500
"""Encoder pulses in one turn of a simulated motor. The protocol leaves this to the motor."""

TOP_SPEED_RPM = 3000.0
"""What a simulated motor reaches at most, however much is asked."""

ACCELERATION_RPM_S = 4000.0
"""How fast its speed can change, RPM per second."""

SPEED_LAG_S = 0.04
"""Time constant with which the speed follows what is wanted, seconds."""

POSITION_GAIN = 5.0
"""RPM-equivalent speed per remaining distance near the target, 1/s."""

_PULSES_PER_S_PER_RPM = PULSES_PER_TURN / 60
_BRAKING_PULSES_S2 = 0.6 * ACCELERATION_RPM_S * _PULSES_PER_S_PER_RPM


def clamp(value: float, bound: float) -> float:
    """`value`, or the nearest of `-bound` and `bound` where it lies outside."""
    return max(-bound, min(bound, value))


@dataclass(slots=True)
class Motor:
    """One motor; `step` lets time pass."""

    rpm: float = 0.0
    """Present speed."""
    pulses: float = 0.0
    """Present position."""
    online: bool = True
    """Whether its driver answers; where not, the motor runs down."""
    _wanted_rpm: float = 0.0
    _target_pulses: float | None = None
    _limit_rpm: float = 0.0
    _holds_zero: bool = False

    def turn(self, rpm: float) -> None:
        """Go to a speed, and keep it."""
        self._target_pulses = None
        self._holds_zero = False
        self._wanted_rpm = clamp(rpm, TOP_SPEED_RPM)

    def move(self, pulses: float, limit_rpm: float) -> None:
        """Go to a position, no faster than `limit_rpm` (its sign means nothing), and hold it."""
        self._holds_zero = False
        self._target_pulses = pulses
        self._limit_rpm = min(abs(limit_rpm), TOP_SPEED_RPM)

    def reset(self) -> None:
        """Stop, and call the place where the motor stops zero."""
        self.turn(0)
        self._holds_zero = True

    def step(self, dt_s: float) -> None:
        """Let `dt_s` seconds pass, which must be short against `SPEED_LAG_S`."""
        wanted = self._speed_wanted()
        change = clamp((wanted - self.rpm) * dt_s / SPEED_LAG_S, ACCELERATION_RPM_S * dt_s)
        self.rpm += change
        if wanted == 0 and abs(self.rpm) < 0.5:
            self.rpm = 0.0
        self.pulses += self.rpm * _PULSES_PER_S_PER_RPM * dt_s
        if self._holds_zero:
            self.pulses = 0.0

    def _speed_wanted(self) -> float:
        if not self.online:
            return 0.0
        if self._target_pulses is None:
            return self._wanted_rpm
        ahead = self._target_pulses - self.pulses
        if abs(ahead) < 0.25:
            return 0.0
        braking = math.sqrt(2 * _BRAKING_PULSES_S2 * abs(ahead))
        pulses_s = min(braking, POSITION_GAIN * abs(ahead))
        return math.copysign(min(pulses_s / _PULSES_PER_S_PER_RPM, self._limit_rpm), ahead)
