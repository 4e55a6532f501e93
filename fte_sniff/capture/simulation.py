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
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from itertools import count, cycle, islice
from random import Random
from typing import Any, Final, NamedTuple, TypeAlias
from urllib.parse import parse_qsl

import click

from fte_sniff.errors import PortError
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import (
    DEFAULT_BAUD,
    FRAME_LENGTH,
    KINDS,
    MOTORS,
    TAIL,
    Direction,
    FrameKind,
    Role,
    byte_time_ns,
    encode,
)
from fte_sniff.real_number import RealNumber

# Motors

PULSES_PER_TURN = 500
"""Encoder pulses in one turn of a simulated motor; the protocol does not define it."""

TOP_SPEED_RPM = 3000.0
"""Highest speed of a simulated motor."""

ACCELERATION_RPM_S = 10_000.0
"""Change of its speed, RPM per second: speeds are ramps."""

POSITION_GAIN = 3.0
"""Speed per remaining distance, 1/s: a position is approached like a system of first order."""

STEP_S = 0.002
"""Time step of the simulated physics, seconds; much shorter than 1 / `POSITION_GAIN`."""

STILL_RPM = 20
"""Up to this speed, what is measured is exact; above, it is one more or less."""

_PULSES_PER_S_PER_RPM = PULSES_PER_TURN / 60


def clamp(value: float, bound: float) -> float:
    """Limit `value` to `-bound`..`bound`."""
    return max(-bound, min(bound, value))


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
_FEEDBACK_KIND_BY_CMD = {
    cmd: kind for kind in KINDS if kind.direction is Direction.FEEDBACK for cmd in kind.cmds
}


@dataclass(slots=True)
class Motor:
    """One motor, and the command that it follows."""

    rpm: float = 0.0
    pulses: float = 0.0
    mode: FrameKind = _SPEED
    target_rpm: float = 0.0
    """Of a speed, or the limit of a move; its sign is then ignored."""
    target_pulses: float = 0.0
    """Of a move."""

    def step(self) -> None:
        """Advance by `STEP_S`."""
        wanted = clamp(self.target_rpm, TOP_SPEED_RPM)
        if self.mode is _POSITION:
            distance = self.target_pulses - self.pulses
            wanted = clamp(POSITION_GAIN * distance / _PULSES_PER_S_PER_RPM, abs(wanted))
        self.rpm += clamp(wanted - self.rpm, ACCELERATION_RPM_S * STEP_S)
        self.pulses += self.rpm * _PULSES_PER_S_PER_RPM * STEP_S


WHEEL_RADIUS_CM = 7.6
GEAR_RATIO = 20
"""Turns of the motor in one turn of its wheel."""

HALF_TRACK_PLUS_HALF_BASE_CM = 38.0
"""Half the track plus half the wheelbase: the lever of a rotation."""

_RPM_PER_CM_S = 60 * GEAR_RATIO / (2 * math.pi * WHEEL_RADIUS_CM)
_WHEELS = dict(zip(MOTORS, ((-1, -1), (1, 1), (1, -1), (-1, 1)), strict=True))
"""By motor: how its wheel turns when the chassis moves left, and rotates; forward is always 1.

The protocol does not define where the motors are; here: front left, front right, rear left, rear
right, all forward with a positive speed. Positive is forward, left and counter-clockwise.
"""


class Controller:
    """Four motors of a mecanum chassis."""

    def __init__(self, dice: Random) -> None:
        self.motors = {number: Motor() for number in MOTORS}
        self._dice, self._steps = dice, 0

    def obey(self, frame: bytes) -> bool:
        """Execute a command; whether the bytes are a whole frame, be it a command or not."""
        row = Row("", 0, frame, None)
        if row.kind is None or frame[-1] != TAIL:
            return False
        given = {field.role: row.values[field.name] for field in row.kind.fields}
        if row.kind is _RESET:
            self.motors = {number: Motor() for number in MOTORS}
        elif row.kind is _DRIVE:
            turn_cm_s = given[Role.ROTATION] / 1000 * HALF_TRACK_PLUS_HALF_BASE_CM
            for number, (left, rotation) in _WHEELS.items():
                cm_s = given[Role.FORWARD] + left * given[Role.LEFT] + rotation * turn_cm_s
                motor = self.motors[number]
                motor.mode, motor.target_rpm = _DRIVE, cm_s * _RPM_PER_CM_S
        elif row.kind in (_SPEED, _POSITION) and given[Role.MOTOR] in self.motors:
            motor = self.motors[given[Role.MOTOR]]
            motor.mode, motor.target_rpm = row.kind, given[Role.SPEED]
            motor.target_pulses = given.get(Role.POSITION, 0)
        return True

    def advance_to(self, t_s: float) -> None:
        """Advance to `t_s`, seconds since the start."""
        while self._steps * STEP_S < t_s:
            self._steps += 1
            for motor in self.motors.values():
                motor.step()

    def feedback(self, number: int) -> bytes:
        """The feedback frame of one motor in its present mode."""
        motor = self.motors[number]
        cmd = motor.mode.cmds[0]
        jitter = self._dice.randint(-1, 1) if abs(motor.rpm) > STILL_RPM else 0
        readings: dict[Role | None, int] = {
            Role.MOTOR: number,
            Role.SPEED: round(motor.rpm) + jitter,
            Role.POSITION: (round(motor.pulses) + 2**31) % 2**32 - 2**31,  # a counter wraps
        }
        kind = _FEEDBACK_KIND_BY_CMD[cmd]
        fields = (field for field in kind.fields if field.role in readings)
        return encode(kind, {field.name: readings[field.role] for field in fields}, cmd)


# The host

Step: TypeAlias = tuple[float, Sequence[bytes]]
"""Seconds, and the frames that are sent in turn meanwhile, each at least once; b"": a pause."""


def _command(kind: FrameKind, *values: int) -> bytes:
    """A command; the values are in the order of the frame's fields."""
    return encode(kind, dict(zip((field.name for field in kind.fields), values, strict=True)))


_TOP_SPEEDS = dict(zip(MOTORS, (1500, -1200, 900, -600), strict=True))
_GOALS = dict(zip(MOTORS, (15_000, -12_000, 6_000, -3_000), strict=True))
_DRIVES = (40, 0, 0), (0, 30, 0), (0, 0, 900), (-40, 0, 0), (0, -30, 0), (20, 20, 0), (30, 0, -600)


def _script() -> Iterator[Step]:
    """Resets, drives, speed ramps and position moves."""
    yield 0.0, [_command(_RESET)]
    yield 0.3, [b""]
    # First, as each of its many commands asks all motors: what is wrong shows at once.
    for tops in _DRIVES:
        for tenths in range(2, 11, 2):
            yield 0.1, [_command(_DRIVE, *(top * tenths // 10 for top in tops))]
        yield 1.0, [_command(_DRIVE, *tops)]
    yield 0.4, [_command(_DRIVE, 0, 0, 0)]
    yield 0.5, [b""]
    for tenths in (*range(1, 11), 10, 10, 10, *range(9, -1, -1)):
        rpms = {motor: top * tenths // 10 for motor, top in _TOP_SPEEDS.items()}
        yield 0.15, [_command(_SPEED, motor, rpm) for motor, rpm in rpms.items()]
    yield 0.5, [b""]
    for goals in (_GOALS, dict.fromkeys(MOTORS, 0)):
        yield 0.1, [_command(_POSITION, motor, 1000, at) for motor, at in goals.items()]
        yield 3.0, [b""]


def _commands(slot_s: float) -> Iterator[bytes]:
    """The frame in each slot of the host, without an end."""
    for duration_s, commands in cycle(_script()):
        yield from islice(cycle(commands), max(len(commands), round(duration_s / slot_s)))


# The line: parameters, faults, bytes with times

_ROUND = 1 + len(MOTORS)
"""Slots of the host and of each motor."""

WEAK_DROP = WEAK_LATE = 0.2
"""Share of the weak motor's answers that are lost, and that are late."""

LATE_S = 0.06
"""How much later than usual a late answer of the weak motor is sent, seconds."""

MOST_DROPPED = 4  # adjacent bytes lost in one fault, at most
MOST_NOISE = 8  # random bytes between two frames, at most
_MOST_JITTER_NS = 400_000


def _parameter(default: Any, kind: click.ParamType[Any], meaning: str) -> Any:
    return field(default=default, metadata={"kind": kind, "meaning": meaning})


_SHARE: Final = RealNumber(0, 1)


@dataclass(frozen=True, slots=True)
class SimulationParameters:
    """The parameters of a simulation, each with its default, type and meaning."""

    seed: int = _parameter(0, click.IntRange(0), "The same seed gives the same bytes.")
    rate: float = _parameter(
        200.0, RealNumber(0.01, 1e6), "Frames a second, both directions together."
    )
    drop: float = _parameter(0.0, _SHARE, "Share of the frames that lose adjacent bytes.")
    flip: float = _parameter(0.0, _SHARE, "Share of the frames that have one bit flipped.")
    noise: float = _parameter(0.0, _SHARE, "Share of the frames with random bytes before them.")
    wire: str = _parameter(
        "both", click.Choice(["both", *map(str, Direction)]), "Which frames are received."
    )
    host: str = _parameter("on", click.Choice(["on", "off"]), "Whether a host sends commands.")
    frames: int = _parameter(
        0, click.IntRange(0), "The port is unplugged after this many frames; 0 is never."
    )
    weak_motor: int = _parameter(
        0, click.IntRange(0, max(MOTORS)), "The motor that loses and delays answers; 0 is none."
    )


def parse_parameters(query: str) -> SimulationParameters:
    """Parse the query of a URL, `seed=1&drop=0.01`; raises PortError if it is not legal."""
    kinds = {one.name: one.metadata["kind"] for one in fields(SimulationParameters)}
    values = dict[str, Any]()
    for name, text in parse_qsl(query, keep_blank_values=True):
        if name not in kinds:
            names = ", ".join(kinds)
            raise PortError(f"sim://: {name!r:.40} is not one of its parameters; it has {names}")
        try:
            values[name] = kinds[name].convert(text, None, None)
        except click.BadParameter as error:
            reason = error.message.removesuffix(".")
            raise PortError(f"sim:// cannot take {name}={text:.40}: {reason}") from error
    return SimulationParameters(**values)


class TimedBytes(NamedTuple):
    """The received bytes of one frame, or of one run of noise."""

    t_ns: int
    """End of the last byte, when a read can return it, nanoseconds since the start."""
    data: bytes
    """The bytes as received, faults applied; empty for a slot in which nothing comes."""
    sent: bytes = b""
    """The frame as sent, before faults; empty for noise."""


class Simulation:
    """The received bytes with exact times, without overlap; infinite unless `frames` is set.

    Between two items, `controller.obey` is allowed.
    """

    def __init__(self, parameters: SimulationParameters, baud: int = DEFAULT_BAUD) -> None:
        """Start at time 0; raises PortError if a line of `baud` cannot carry the rate."""
        most = round(1_000_000_000 / (FRAME_LENGTH * byte_time_ns(baud)))
        if parameters.rate > most:
            raise PortError(
                f"sim:// cannot take rate={parameters.rate:g}: a line of {baud} baud carries at "
                f"most {most} frames/s; ask for less, or for more with --baud"
            )
        self._asked, self._dice = parameters, Random(parameters.seed)
        self.controller = Controller(Random(parameters.seed))
        self._commands = _commands(_ROUND / parameters.rate)
        self._late = deque[tuple[int, bytes]]()
        """When the late answers begin, and their frames."""
        self._byte_ns = byte_time_ns(baud)
        self._free_at_ns = 0

    def __iter__(self) -> Iterator[TimedBytes]:
        """The received bytes; an item without bytes for each slot in which nothing comes."""
        received, slot_ns = 0, 1_000_000_000 / self._asked.rate
        jitter_ns = min(max(0.0, slot_ns - FRAME_LENGTH * self._byte_ns), _MOST_JITTER_NS)
        for slot in count():
            sent = self._frame_in(slot)
            begins_ns = int(slot * slot_ns + self._dice.random() * jitter_ns)
            frames = [*self._on_wire(slot, begins_ns, sent)]
            if not frames:
                yield TimedBytes(begins_ns, b"")
            for frame_ns, frame in frames:
                yield from self._received(frame, frame_ns)
                received += 1
                if received == self._asked.frames:
                    return

    def _frame_in(self, slot: int) -> bytes:
        """The frame of the owner of a slot, if its direction is received."""
        self.controller.advance_to(slot / self._asked.rate)
        if motor := slot % _ROUND:
            sent, direction = self.controller.feedback(motor), Direction.FEEDBACK
        else:
            sent = next(self._commands) if self._asked.host == "on" else b""
            direction = Direction.CONTROL
            if sent:
                self.controller.obey(sent)
        return sent if self._asked.wire in ("both", direction) else b""

    def _on_wire(self, slot: int, begins_ns: int, sent: bytes) -> Iterator[tuple[int, bytes]]:
        """The frames that begin in a slot, with their times: its own, and late ones before it."""
        while self._late and self._late[0][0] <= begins_ns:
            yield self._late.popleft()
        weak = self._asked.weak_motor
        if sent and weak and slot % _ROUND == weak:
            fate = self._dice.random()
            if WEAK_DROP <= fate < WEAK_DROP + WEAK_LATE:
                self._late.append((begins_ns + int(LATE_S * 1e9), sent))
            if fate < WEAK_DROP + WEAK_LATE:
                return
        if sent:
            yield begins_ns, sent

    def _received(self, sent: bytes, begins_ns: int) -> Iterator[TimedBytes]:
        if self._dice.random() < self._asked.noise:
            noise = self._dice.randbytes(self._dice.randint(1, MOST_NOISE))
            size = len(noise)
            yield self._timed(max(0, begins_ns - 2 * size * self._byte_ns), size, noise, b"")
        yield self._timed(begins_ns, len(sent), self._damaged(sent), sent)

    def _damaged(self, raw: bytes) -> bytes:
        """The frame as received; at least one byte is left."""
        dice = self._dice
        if dice.random() < self._asked.flip:
            offset, bit = divmod(dice.randrange(len(raw) * 8), 8)
            raw = raw[:offset] + bytes([raw[offset] ^ 1 << bit]) + raw[offset + 1 :]
        if dice.random() < self._asked.drop:
            size = dice.randint(1, MOST_DROPPED)
            first = dice.randrange(len(raw) - size + 1)
            raw = raw[:first] + raw[first + size :]
        return raw

    def _timed(self, begins_ns: int, size: int, data: bytes, sent: bytes) -> TimedBytes:
        self._free_at_ns = max(begins_ns, self._free_at_ns) + size * self._byte_ns
        return TimedBytes(self._free_at_ns, data, sent)
