"""Owns what the simulated host sends: phases as a person at a bench would drive them.

It must not know of motors or the wire; it is asked for its next command at a time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from random import Random
from typing import TypeAlias

from fte_sniff.protocol import KIND_BY_NAME, MOTORS, FrameKind

Command: TypeAlias = tuple[FrameKind, dict[str, int]]
"""A kind of control frame and its values by row name."""


@dataclass(frozen=True, slots=True)
class Step:
    """Commands sent in turn, each at least once, until the time is over; none is a pause."""

    duration_s: float
    commands: tuple[Command, ...] = ()


class Host:
    """Tells the next command, or that it is silent."""

    def __init__(self, rng: Random) -> None:
        self._script = _script(rng)
        self._step = next(self._script)
        self._until_s = self._step.duration_s
        self._said = 0

    def command_at(self, t_s: float) -> Command | None:
        """What is sent at `t_s`, seconds since the start, which must not fall; None is silence."""
        while t_s >= self._until_s and self._said >= len(self._step.commands):
            self._step, self._said = next(self._script), 0
            self._until_s = t_s + self._step.duration_s
        if not self._step.commands:
            return None
        command = self._step.commands[self._said % len(self._step.commands)]
        self._said += 1
        return command


def _command(name: str, **values: int) -> Command:
    return KIND_BY_NAME[name], values


def _script(rng: Random) -> Iterator[Step]:
    phases = (_speed_ramps, _position_moves, _drives)
    while True:
        yield Step(0.0, (_command("reset"),))
        yield Step(0.3)
        for phase in phases:
            yield from phase(rng)
            yield Step(_pick(rng, 2, 8) / 10)


def _pick(rng: Random, low: int, high: int) -> int:
    """A whole number from `low` to `high`, both included."""
    return low + int(rng.random() * (high - low + 1))


def _sign(rng: Random) -> int:
    return 1 if rng.random() < 0.5 else -1


def _speed_ramps(rng: Random) -> Iterator[Step]:
    tops = {motor: _sign(rng) * _pick(rng, 4, 30) * 50 for motor in MOTORS}
    levels = [*range(1, 11), 10, 10, 10, *range(9, -1, -1)]
    for level in levels:
        yield Step(
            0.15,
            tuple(_command("speed", motor=m, rpm=top * level // 10) for m, top in tops.items()),
        )


def _position_moves(rng: Random) -> Iterator[Step]:
    goals = [(m, _sign(rng) * _pick(rng, 4, 40) * 500) for m in MOTORS]
    for places in (goals, [(m, 0) for m in MOTORS]):
        limit = _pick(rng, 6, 12) * 100
        yield Step(
            0.1,
            tuple(_command("position", motor=m, rpm=limit, pulses=at) for m, at in places),
        )
        yield Step(_pick(rng, 25, 35) / 10)


def _drives(rng: Random) -> Iterator[Step]:
    directions = ((1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 0), (0, -1, 0), (1, 1, 0), (1, 0, -1))
    for _ in range(_pick(rng, 4, 6)):
        vx, vy, wz = directions[_pick(rng, 0, len(directions) - 1)]
        cm_s, mrad_s = _pick(rng, 2, 10) * 5, _pick(rng, 3, 15) * 100
        for tenths in range(2, 11, 2):
            yield _drive(0.1, vx * cm_s * tenths // 10, vy * cm_s * tenths // 10,
                         wz * mrad_s * tenths // 10)  # fmt: skip
        yield _drive(_pick(rng, 5, 15) / 10, vx * cm_s, vy * cm_s, wz * mrad_s)
    yield _drive(0.4, 0, 0, 0)


def _drive(duration_s: float, vx: int, vy: int, wz: int) -> Step:
    return Step(duration_s, (_command("mecanum", vx_cm_s=vx, vy_cm_s=vy, wz_mrad_s=wz),))
