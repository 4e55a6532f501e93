"""The simulation behind `sim://` and `simulate`: motors, controller, host, and the bytes of a line.

Nothing here reads a clock or sleeps; `sim://` delivers the bytes in real time.

The wire is a half-duplex bus with time slots of 1/rate seconds. Five slots are a round:

    host | motor 1 | motor 2 | motor 3 | motor 4 | host | motor 1 | ...

A slot is silent if its owner sends nothing, or if its direction is not captured. The controller
receives every command; faults affect only the listener.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count, cycle
from random import Random
from typing import Any, Final, TypeAlias
from urllib.parse import parse_qsl

import click

from fte_sniff.errors import PortError
from fte_sniff.protocol import (
    DEFAULT_BAUD,
    FRAME_LENGTH,
    KINDS,
    MOTORS,
    Direction,
    Field,
    FrameKind,
    byte_time_ns,
    encode,
)
from fte_sniff.protocol.spec import Role, motor_bit

# Motors

PULSES_PER_TURN = 500
"""Encoder pulses in one turn of a simulated motor; the protocol does not define it."""

TOP_SPEED_RPM = 3000.0
"""Highest speed of a simulated motor."""

ACCELERATION_RPM_S = 10_000.0
"""Change of its speed, RPM per second: speeds are ramps."""

POSITION_GAIN = 3.0
"""Speed per remaining distance, 1/s: a position is approached like a system of first order."""

_PULSES_PER_S_PER_RPM = PULSES_PER_TURN / 60


def clamp(value: float, bound: float) -> float:
    """Limit `value` to `-bound`..`bound`."""
    return max(-bound, min(bound, value))


@dataclass(slots=True)
class Motor:
    """One motor; `step` advances its time."""

    rpm: float = 0.0
    pulses: float = 0.0
    _target_rpm: float = 0.0
    """Of a speed, or the limit of a move."""
    _target_pulses: float | None = None

    def turn(self, rpm: float) -> None:
        """Accelerate to a speed, and keep it."""
        self._target_rpm, self._target_pulses = clamp(rpm, TOP_SPEED_RPM), None

    def move(self, pulses: float, limit_rpm: float) -> None:
        """Move to a position at `limit_rpm` at most (its sign is ignored), and hold it."""
        self._target_rpm, self._target_pulses = min(abs(limit_rpm), TOP_SPEED_RPM), pulses

    def reset(self) -> None:
        """Stop, and make the position zero."""
        self.rpm = self.pulses = self._target_rpm = 0.0
        self._target_pulses = None

    def step(self, dt_s: float) -> None:
        """Advance by `dt_s` seconds, which must be much shorter than 1 / `POSITION_GAIN`."""
        self.rpm += clamp(self._target_speed() - self.rpm, ACCELERATION_RPM_S * dt_s)
        self.pulses += self.rpm * _PULSES_PER_S_PER_RPM * dt_s

    def _target_speed(self) -> float:
        if self._target_pulses is None:
            return self._target_rpm
        distance = self._target_pulses - self.pulses
        return clamp(POSITION_GAIN * distance / _PULSES_PER_S_PER_RPM, self._target_rpm)


WHEEL_RADIUS_CM = 7.6
GEAR_RATIO = 20
"""Turns of the motor in one turn of its wheel."""

HALF_TRACK_PLUS_HALF_BASE_CM = 38.0
"""Half the track plus half the wheelbase: the lever of a rotation."""

STILL_RPM = 20
"""Up to this speed, what is measured is exact; above, it is one more or less."""

STEP_S = 0.002
"""Time step of the simulated physics, seconds."""

_RPM_PER_CM_S = 60 * GEAR_RATIO / (2 * math.pi * WHEEL_RADIUS_CM)
_FEEDBACK_KIND_BY_CMD = {
    cmd: kind for kind in KINDS if kind.direction is Direction.FEEDBACK for cmd in kind.cmds
}


def _control(*roles: Role) -> FrameKind:
    """The command whose fields have these roles."""
    return next(
        kind
        for kind in KINDS
        if kind.direction is Direction.CONTROL and {f.role for f in kind.fields} == {*roles}
    )


_RESET = _control()
_SPEED = _control(Role.MOTOR, Role.SPEED)
_POSITION = _control(Role.MOTOR, Role.SPEED, Role.POSITION)
_DRIVE = _control(Role.FORWARD, Role.LEFT, Role.ROTATION)


def wheel_speeds(vx_cm_s: float, vy_cm_s: float, wz_mrad_s: float) -> tuple[float, ...]:
    """The RPM of motors 1 to 4 for a motion of the mecanum chassis.

    Positive is forward, left and counter-clockwise. The protocol does not define where the motors
    are; here: front left, front right, rear left, rear right, all forward with a positive speed.
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
    """Four motors and their modes."""

    def __init__(self, dice: Random) -> None:
        self.motors = {number: Motor() for number in MOTORS}
        self._modes = dict.fromkeys(MOTORS, _SPEED)
        self._dice, self._steps = dice, 0

    def obey(self, kind: FrameKind, values: Mapping[str, int]) -> None:
        """Execute a control frame; ignore one for an unknown motor."""
        if kind.direction is not Direction.CONTROL:
            return
        given = {field.role: values[field.name] for field in kind.fields}
        if kind is _RESET:
            for number, motor in self.motors.items():
                motor.reset()
                self._modes[number] = _SPEED
        elif kind is _DRIVE:
            speeds = wheel_speeds(given[Role.FORWARD], given[Role.LEFT], given[Role.ROTATION])
            for number, rpm in zip(MOTORS, speeds, strict=True):
                self.motors[number].turn(rpm)
                self._modes[number] = kind
        elif given[Role.MOTOR] in self.motors:
            motor = self.motors[given[Role.MOTOR]]
            self._modes[given[Role.MOTOR]] = kind
            if kind is _POSITION:
                motor.move(given[Role.POSITION], given[Role.SPEED])
            else:
                motor.turn(given[Role.SPEED])

    def advance_to(self, t_s: float) -> None:
        """Advance to `t_s`, seconds since the start."""
        while self._steps * STEP_S < t_s:
            self._steps += 1
            for motor in self.motors.values():
                motor.step(STEP_S)

    def feedback(self, number: int) -> bytes:
        """The feedback frame of one motor in its present mode."""
        motor, cmd = self.motors[number], self._modes[number].cmds[0]
        kind = _FEEDBACK_KIND_BY_CMD[cmd]
        jitter = self._dice.randint(-1, 1) if abs(motor.rpm) > STILL_RPM else 0
        readings = {
            Role.MOTOR: number,
            Role.ERRORS: 0,
            Role.ONLINE: sum(1 << motor_bit(one) for one in MOTORS),
            Role.SPEED: round(motor.rpm) + jitter,
            Role.POSITION: round(motor.pulses),
        }
        values = {
            field.name: _wrapped(readings[field.role], field)
            for field in kind.fields
            if field.role in readings
        }
        return encode(kind, values, cmd)


def _wrapped(value: int, field: Field) -> int:
    return (value - field.low) % (field.high - field.low + 1) + field.low


Command: TypeAlias = tuple[FrameKind, dict[str, int]]
"""A kind of control frame and its values by row name."""

Step: TypeAlias = tuple[float, Sequence[Command]]
"""Seconds, and the commands that are sent in turn meanwhile, each at least once; none: a pause."""


class SimulatedHost:
    """Sends a script of resets, drives, speed ramps and position moves, again and again."""

    def __init__(self) -> None:
        self._script = cycle(_script())
        self._until_s, self._commands = next(self._script)
        self._sent = 0

    def command_at(self, t_s: float) -> Command | None:
        """The command sent at `t_s`, seconds since the start, monotonic; None for silence."""
        while t_s >= self._until_s and self._sent >= len(self._commands):
            duration_s, self._commands = next(self._script)
            self._until_s, self._sent = t_s + duration_s, 0
        if not self._commands:
            return None
        self._sent += 1
        return self._commands[(self._sent - 1) % len(self._commands)]


def _command(kind: FrameKind, *values: int) -> Command:
    """A command; the values are in the order of the frame's fields."""
    return kind, dict(zip((field.name for field in kind.fields), values, strict=True))


_TOP_SPEEDS = dict(zip(MOTORS, (1500, -1200, 900, -600), strict=True))
_GOALS = dict(zip(MOTORS, (15_000, -12_000, 6_000, -3_000), strict=True))
_DRIVES = (40, 0, 0), (0, 30, 0), (0, 0, 900), (-40, 0, 0), (0, -30, 0), (20, 20, 0), (30, 0, -600)


def _script() -> Iterator[Step]:
    yield 0.0, [_command(_RESET)]
    yield 0.3, []
    # First, as each of its many commands asks all motors: what is wrong shows at once.
    for tops in _DRIVES:
        for tenths in range(2, 11, 2):
            yield 0.1, [_command(_DRIVE, *(top * tenths // 10 for top in tops))]
        yield 1.0, [_command(_DRIVE, *tops)]
    yield 0.4, [_command(_DRIVE, 0, 0, 0)]
    yield 0.5, []
    for tenths in (*range(1, 11), 10, 10, 10, *range(9, -1, -1)):
        rpms = {motor: top * tenths // 10 for motor, top in _TOP_SPEEDS.items()}
        yield 0.15, [_command(_SPEED, motor, rpm) for motor, rpm in rpms.items()]
    yield 0.5, []
    for goals in (_GOALS, dict.fromkeys(MOTORS, 0)):
        yield 0.1, [_command(_POSITION, motor, 1000, at) for motor, at in goals.items()]
        yield 3.0, []


# The line: faults, parameters, bytes with times

WEAK_DROP = WEAK_LATE = 0.2
"""Share of the weak motor's answers that are lost, and that are late."""

LATE_S = 0.06
"""How much later than usual a late answer of the weak motor is sent, seconds."""

MOST_DROPPED = 4  # adjacent bytes lost in one fault, at most
MOST_NOISE = 8  # random bytes between two frames, at most


@dataclass(frozen=True, slots=True)
class SimulationParameters:
    """The parameters of a simulation; `PARAMETERS` has their meanings and ranges."""

    seed: int = 0
    rate: float = 200.0
    drop: float = 0.0
    flip: float = 0.0
    noise: float = 0.0
    wire: str = "both"
    host: str = "on"
    frames: int = 0
    weak_motor: int = 0

    def check_against(self, baud: int) -> None:
        """Raise PortError if a line of `baud` bits per second cannot carry the rate."""
        most = round(1_000_000_000 / (FRAME_LENGTH * byte_time_ns(baud)))
        if not self.rate <= most:
            raise PortError(
                f"sim:// cannot take rate={self.rate:g}: a line of {baud} baud carries at most "
                f"{most} frames/s; ask for less, or for more with --baud"
            )


_SHARE: Final = click.FloatRange(0, 1)
PARAMETERS: Final[Mapping[str, tuple[click.ParamType[Any], str]]] = {
    "seed": (click.IntRange(0), "The same seed gives the same bytes."),
    "rate": (click.FloatRange(0.01, 1e6), "Frames a second, both directions together."),
    "drop": (_SHARE, "Share of the frames that lose adjacent bytes."),
    "flip": (_SHARE, "Share of the frames that have one bit flipped."),
    "noise": (_SHARE, "Share of the frames with random bytes before them."),
    "wire": (click.Choice(["both", *map(str, Direction)]), "Which frames are received."),
    "host": (click.Choice(["on", "off"]), "Whether a host sends commands."),
    "frames": (click.IntRange(0), "The port is unplugged after this many frames; 0 is never."),
    "weak_motor": (
        click.IntRange(0, max(MOTORS)),
        "The motor that loses and delays answers; 0 is none.",
    ),
}
"""The type and the meaning of every parameter, in the order of the help."""


def parse_parameters(query: str) -> SimulationParameters:
    """Parse the query of a URL, `seed=1&drop=0.01`; raises PortError if it is not legal."""
    values: dict[str, Any] = {}
    for name, text in parse_qsl(query, keep_blank_values=True):
        if name not in PARAMETERS or name in values:
            what = "is given twice" if name in values else "is not one of its parameters"
            raise PortError(f"sim://: {name!r:.40} {what}; it has {', '.join(PARAMETERS)}")
        try:
            values[name] = value = PARAMETERS[name][0].convert(text, None, None)
            if value != value:
                raise click.BadParameter("nan is not a number")
        except click.BadParameter as error:
            reason = error.message.removesuffix(".")
            raise PortError(f"sim:// cannot take {name}={text:.40}: {reason}") from error
    return SimulationParameters(**values)


_MOST_JITTER_NS = 400_000


@dataclass(frozen=True, slots=True)
class TimedBytes:
    """The received bytes of one frame, or of one run of noise, with their times."""

    begins_ns: int
    """Start of the first byte, nanoseconds since the start."""
    t_ns: int
    """End of the last byte, when a read can return it, nanoseconds since the start."""
    data: bytes
    """The bytes as received, faults applied; never empty."""
    sent: bytes
    """The frame as sent, before faults; empty for noise."""


class Simulation:
    """The received bytes with exact times, without overlap; infinite unless `frames` is set.

    Between two items, `controller.obey` is allowed.
    """

    def __init__(self, parameters: SimulationParameters, baud: int = DEFAULT_BAUD) -> None:
        """Start at time 0; raises PortError if a line of `baud` cannot carry the rate."""
        parameters.check_against(baud)
        self.parameters = parameters
        self._dice = Random(parameters.seed)
        self.controller = Controller(Random(parameters.seed))
        self._host = SimulatedHost()
        self._late: deque[tuple[int, bytes]] = deque()
        """When the late answers begin, and their frames."""
        self._byte_ns = byte_time_ns(baud)
        self._free_at_ns = 0

    def __iter__(self) -> Iterator[TimedBytes]:
        return (item for item in self.slots() if item.data)

    def slots(self) -> Iterator[TimedBytes]:
        """The received bytes; an item without bytes for each slot in which nothing comes."""
        received, slot_ns = 0, 1_000_000_000 / self.parameters.rate
        jitter_ns = min(max(0.0, slot_ns - FRAME_LENGTH * self._byte_ns), _MOST_JITTER_NS)
        for slot in count():
            sent = self._frame_in(slot)
            begins_ns = int(slot * slot_ns + self._dice.random() * jitter_ns)
            frames = [*self._on_wire(slot, begins_ns, sent)]
            if not frames:
                yield TimedBytes(begins_ns, begins_ns, b"", b"")
            for frame_ns, frame in frames:
                yield from self._received(frame, frame_ns)
                received += 1
                if received == self.parameters.frames:
                    return

    def _on_wire(
        self, slot: int, begins_ns: int, sent: bytes | None
    ) -> Iterator[tuple[int, bytes]]:
        """The frames that begin in a slot, with their times: its own, and late ones before it."""
        while self._late and self._late[0][0] <= begins_ns:
            yield self._late.popleft()
        weak = self.parameters.weak_motor
        if sent is not None and weak and slot % (1 + len(MOTORS)) == weak:
            fate = self._dice.random()
            if fate < WEAK_DROP:
                return
            if fate < WEAK_DROP + WEAK_LATE:
                self._late.append((begins_ns + int(LATE_S * 1e9), sent))
                return
        if sent is not None:
            yield begins_ns, sent

    def _frame_in(self, slot: int) -> bytes | None:
        t_s = slot / self.parameters.rate
        self.controller.advance_to(t_s)
        motor = slot % (1 + len(MOTORS))
        if motor:
            feedback = self.controller.feedback(motor)
            return feedback if self.parameters.wire != Direction.CONTROL else None
        command = self._host.command_at(t_s) if self.parameters.host == "on" else None
        if command is None:
            return None
        self.controller.obey(*command)
        return encode(*command) if self.parameters.wire != Direction.FEEDBACK else None

    def _received(self, sent: bytes, begins_ns: int) -> Iterator[TimedBytes]:
        if self._dice.random() < self.parameters.noise:
            noise = self._dice.randbytes(self._dice.randint(1, MOST_NOISE))
            duration_ns = len(noise) * self._byte_ns
            yield self._timed(max(0, begins_ns - 2 * duration_ns), noise, duration_ns, b"")
        yield self._timed(begins_ns, self._damaged(sent), len(sent) * self._byte_ns, sent)

    def _damaged(self, raw: bytes) -> bytes:
        """The frame as received; at least one byte is left."""
        dice = self._dice
        if dice.random() < self.parameters.flip:
            offset, bit = divmod(dice.randrange(len(raw) * 8), 8)
            raw = raw[:offset] + bytes([raw[offset] ^ 1 << bit]) + raw[offset + 1 :]
        if dice.random() < self.parameters.drop:
            size = dice.randint(1, MOST_DROPPED)
            first = dice.randrange(len(raw) - size + 1)
            raw = raw[:first] + raw[first + size :]
        return raw

    def _timed(self, begins_ns: int, data: bytes, duration_ns: int, sent: bytes) -> TimedBytes:
        begins_ns = max(begins_ns, self._free_at_ns)
        self._free_at_ns = begins_ns + duration_ns
        return TimedBytes(begins_ns, self._free_at_ns, data, sent)
