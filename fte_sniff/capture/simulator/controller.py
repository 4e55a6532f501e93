"""Owns the simulated controller: four motors that obey control frames and tell feedback frames.

It must not know who sends the commands, nor what becomes of its frames on the wire.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from random import Random

from fte_sniff.capture.simulator.motor import Motor
from fte_sniff.protocol import KIND_BY_NAME, KINDS, MOTORS, Direction, FrameKind, encode

WHEEL_RADIUS_CM = 7.6
GEAR_RATIO = 20
"""Turns of the motor in one turn of its wheel."""

HALF_TRACK_PLUS_HALF_BASE_CM = 38.0
"""Half the distance of the wheels sideways plus half of it lengthways: the lever of a rotation."""

STEP_S = 0.002
"""The step of the simulated physics, seconds."""

OFFLINE_EVERY_S = (12.0, 90.0)
"""The least and the greatest time between two spells in which one motor is offline."""

OFFLINE_FOR_S = (0.4, 1.6)

_RPM_PER_CM_S = 60 * GEAR_RATIO / (2 * math.pi * WHEEL_RADIUS_CM)
_FEEDBACK_KIND_BY_CMD = {
    cmd: kind for kind in KINDS if kind.direction is Direction.FEEDBACK for cmd in kind.cmds
}


def wheel_speeds(vx_cm_s: float, vy_cm_s: float, wz_mrad_s: float) -> tuple[float, ...]:
    """The RPM of motors 1 to 4 for a motion of the mecanum chassis.

    + is forward, left and counter-clockwise. The protocol does not say which motor sits where; here
    1 to 4 are front left, front right, rear left, rear right, and + turns every wheel forward.
    """
    turn_cm_s = wz_mrad_s / 1000 * HALF_TRACK_PLUS_HALF_BASE_CM
    wheels_cm_s = (
        vx_cm_s - vy_cm_s - turn_cm_s,
        vx_cm_s + vy_cm_s + turn_cm_s,
        vx_cm_s + vy_cm_s - turn_cm_s,
        vx_cm_s - vy_cm_s + turn_cm_s,
    )
    return tuple(cm_s * _RPM_PER_CM_S for cm_s in wheels_cm_s)


class Controller:
    """Four motors, their modes, and the flags that the feedback carries."""

    def __init__(self, rng: Random) -> None:
        self.motors = {number: Motor() for number in MOTORS}
        self._modes = dict.fromkeys(MOTORS, KIND_BY_NAME["speed"])
        self._rng = rng
        self._steps = 0
        self._offline = 0
        self._change_at_s = self._between(*OFFLINE_EVERY_S)

    def obey(self, kind: FrameKind, values: Mapping[str, int]) -> None:
        """Do what a control frame says; a frame for no motor of ours changes nothing."""
        if kind.direction is not Direction.CONTROL:
            return
        if kind.name == "reset":
            for number, motor in self.motors.items():
                motor.reset()
                self._modes[number] = KIND_BY_NAME["speed"]
        elif kind.name == "mecanum":
            speeds = wheel_speeds(values["vx_cm_s"], values["vy_cm_s"], values["wz_mrad_s"])
            for number, rpm in zip(MOTORS, speeds, strict=True):
                self.motors[number].turn(rpm)
                self._modes[number] = kind
        elif values["motor"] in self.motors:
            motor = self.motors[values["motor"]]
            self._modes[values["motor"]] = kind
            if kind.name == "position":
                motor.move(values["pulses"], values["rpm"])
            else:
                motor.turn(values["rpm"])

    def advance_to(self, t_s: float) -> None:
        """Let time pass until `t_s`, seconds since the start."""
        while self._steps * STEP_S < t_s:
            self._steps += 1
            for motor in self.motors.values():
                motor.step(STEP_S)
        while t_s >= self._change_at_s:
            self._change_who_is_online()

    def feedback(self, number: int) -> bytes | None:
        """The feedback frame of one motor in its present mode; None while it is offline."""
        motor, cmd = self.motors[number], self._modes[number].cmds[0]
        if not motor.online:
            return None
        kind = _FEEDBACK_KIND_BY_CMD[cmd]
        values = {"motor": number, "error": self._error, "online": self._online}
        for field in kind.fields:
            if field.name == "rpm":
                values["rpm"] = self._measured(motor.rpm)
            elif field.name == "pulses":
                span = field.high - field.low + 1
                values["pulses"] = (round(motor.pulses) - field.low) % span + field.low
        return encode(kind, values, cmd)

    @property
    def _online(self) -> int:
        return sum(1 << (number - 1) for number, motor in self.motors.items() if motor.online)

    @property
    def _error(self) -> int:
        return 1 << (self._offline - 1) if self._offline else 0

    def _measured(self, rpm: float) -> int:
        jitter = int(self._rng.random() * 3) - 1
        return round(rpm) + (jitter if abs(rpm) > 20 else 0)

    def _between(self, low: float, high: float) -> float:
        return low + self._rng.random() * (high - low)

    def _change_who_is_online(self) -> None:
        if self._offline:
            self.motors[self._offline].online = True
            self._offline = 0
            self._change_at_s += self._between(*OFFLINE_EVERY_S)
        else:
            self._offline = MOTORS[int(self._rng.random() * len(MOTORS))]
            self.motors[self._offline].online = False
            self._change_at_s += self._between(*OFFLINE_FOR_S)
