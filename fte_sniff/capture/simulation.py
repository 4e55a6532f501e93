"""Simulated byte stream with faults and its parameters.

It must not read a clock or sleep. Who wants real time paces the bytes by their times.

The wire is a half-duplex bus, cut into slots of 1/rate seconds. Five slots are a round:

    host | motor 1 | motor 2 | motor 3 | motor 4 | host | motor 1 | ...

A slot whose owner has nothing to say, or who is not listened to, is silence.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from random import Random
from typing import Any
from urllib.parse import parse_qsl

from fte_sniff.capture.sim_model import Controller, SimulatedHost
from fte_sniff.errors import PortError
from fte_sniff.protocol import DEFAULT_BAUD, FRAME_LENGTH, MOTORS, Direction, byte_time_ns, encode

MOST_DROPPED = 4
"""Adjacent bytes lost at most in one fault."""

MOST_NOISE = 8
"""Random bytes at most between two frames."""


class Faults:
    """Damages frames with the probabilities asked for."""

    def __init__(self, seed: int, drop: float, flip: float, noise: float) -> None:
        self._drop, self._flip, self._noise = drop, flip, noise
        self._drop_dice = Random(f"{seed}/drop")
        self._flip_dice = Random(f"{seed}/flip")
        self._noise_dice = Random(f"{seed}/noise")

    def damaged(self, raw: bytes) -> bytes:
        """The bytes as they are heard; at least one is left."""
        if _below(self._flip_dice, self._flip):
            raw = self._with_a_bit_flipped(raw)
        if _below(self._drop_dice, self._drop):
            raw = self._with_bytes_lost(raw)
        return raw

    def noise(self) -> bytes:
        """What is heard before the next frame; mostly nothing."""
        dice = self._noise_dice
        if not _below(dice, self._noise):
            return b""
        return bytes(_whole(dice, 256) for _ in range(1 + _whole(dice, MOST_NOISE)))

    def _with_a_bit_flipped(self, raw: bytes) -> bytes:
        place, bit = divmod(_whole(self._flip_dice, len(raw) * 8), 8)
        return raw[:place] + bytes([raw[place] ^ 1 << bit]) + raw[place + 1 :]

    def _with_bytes_lost(self, raw: bytes) -> bytes:
        count = 1 + _whole(self._drop_dice, min(MOST_DROPPED, len(raw) - 1))
        first = _whole(self._drop_dice, len(raw) - count + 1)
        return raw[:first] + raw[first + count :]


def _below(dice: Random, probability: float) -> bool:
    return dice.random() < probability


def _whole(dice: Random, end: int) -> int:
    """A whole number from 0 up to but not `end`; `random()` alone is the same in every Python."""
    return int(dice.random() * end)


_TABLE_KEY = "parameter"


@dataclass(frozen=True, slots=True)
class Parameter:
    """One thing that can be asked of a simulation."""

    name: str
    default: int | float | str
    meaning: str
    low: float = 0
    high: float = math.inf
    words: tuple[str, ...] = ()
    """Every legal value, where the parameter is a word rather than a number."""

    @property
    def range_text(self) -> str:
        """The legal values, for messages and help: `0..1`, `on|off`."""
        if self.words:
            return "|".join(self.words)
        whole = "a whole number " if isinstance(self.default, int) else ""
        low, high = (f"{bound:.15g}" for bound in (self.low, self.high))
        return f"{whole}>= {low}" if math.isinf(self.high) else f"{whole}{low}..{high}"

    def read(self, text: str) -> int | float | str:
        """The value that `text` means; raises PortError where it is none or out of range."""
        try:
            value = type(self.default)(text)
        except ValueError:
            raise self._refusal(text) from None
        self.check(value)
        return value

    def check(self, value: object) -> None:
        """Raise PortError, naming the parameter and its range, where `value` is not legal."""
        if self.words:
            legal = value in self.words
        else:
            wanted = int if isinstance(self.default, int) else (int, float)
            legal = isinstance(value, wanted) and self.low <= value <= self.high
        if not legal:
            raise self._refusal(value)

    def _refusal(self, value: object) -> PortError:
        return PortError(f"sim:// cannot take {self.name}={value!s:.40}: it is {self.range_text}")


def _parameter(default: float | str, meaning: str, **limits: Any) -> Any:
    told = {"default": default, "meaning": meaning, **limits}
    return dataclasses.field(default=default, metadata={_TABLE_KEY: told})


@dataclass(frozen=True, slots=True)
class SimulationParameters:
    """What a simulation is to do; values out of range raise PortError."""

    seed: int = _parameter(0, "the same seed gives the same bytes")
    rate: float = _parameter(
        200.0, "frames per second on the wire, both directions together", low=0.01, high=1e6
    )
    drop: float = _parameter(0.0, "share of the frames that lose adjacent bytes", high=1)
    flip: float = _parameter(0.0, "share of the frames that have one bit flipped", high=1)
    noise: float = _parameter(0.0, "share of the frames with random bytes before them", high=1)
    wire: str = _parameter("both", "whose frames are heard", words=("both", *Direction))
    host: str = _parameter("on", "whether a host sends commands", words=("on", "off"))
    frames: int = _parameter(0, "the port is unplugged after so many frames; 0 is never")

    def __post_init__(self) -> None:
        for parameter in PARAMETERS:
            parameter.check(getattr(self, parameter.name))

    @property
    def never_heard(self) -> bool:
        """Whether the line is silent for ever: only the host is heard, and there is none."""
        return self.wire == Direction.CONTROL and self.host == "off"

    def check_against(self, baud: int) -> None:
        """Raise PortError where a line of `baud` bits per second cannot carry the frames."""
        most = most_frames_per_s(baud)
        if self.rate > most:
            raise PortError(
                f"sim:// cannot take rate={self.rate:g}: a line of {baud} baud carries at most "
                f"{most} frames/s; ask for less, or for more with --baud"
            )


def most_frames_per_s(baud: int) -> int:
    """How many frames one wire of `baud` bits per second carries each second."""
    return round(1_000_000_000 / (FRAME_LENGTH * byte_time_ns(baud)))


def _table() -> tuple[Parameter, ...]:
    fields = dataclasses.fields(SimulationParameters)
    return tuple(Parameter(field.name, **field.metadata[_TABLE_KEY]) for field in fields)


PARAMETERS: tuple[Parameter, ...] = _table()
"""Every parameter of a simulation, in the order in which help names them."""


def parse_parameters(query: str) -> SimulationParameters:
    """The parameters in a URL's query, `seed=1&drop=0.01`; those left out have their defaults.

    Raises:
        PortError: a parameter is unknown, given twice, or its value is not legal.
    """
    by_name = {parameter.name: parameter for parameter in PARAMETERS}
    values: dict[str, Any] = {}
    for name, text in parse_qsl(query, keep_blank_values=True):
        if name not in by_name:
            raise PortError(_unknown(name, list(by_name)))
        if name in values:
            raise PortError(f"sim:// is given {name} twice: give it once")
        values[name] = by_name[name].read(text)
    return SimulationParameters(**values)


def _unknown(name: str, known: list[str]) -> str:
    near = difflib.get_close_matches(name, known, 1)
    hint = f"did you mean {near[0]}? " if near else ""
    return f"sim:// knows no parameter {name!r:.40}: {hint}it knows {', '.join(known)}"


def parameters_help(baud: int = DEFAULT_BAUD) -> str:
    """One line a parameter, for help texts: name, meaning, range and default."""
    lines = [
        f"{parameter.name:<7} {parameter.meaning} ({parameter.range_text}; "
        f"default {parameter.default})"
        for parameter in PARAMETERS
    ]
    return "\n".join(
        [*lines, f"A line of {baud} baud carries at most {most_frames_per_s(baud)} frames/s."]
    )


_MOST_JITTER_NS = 400_000


@dataclass(frozen=True, slots=True)
class TimedBytes:
    """What is heard of one frame, or one run of noise, and when."""

    begins_ns: int
    """When its first byte began on the wire, nanoseconds since the start."""
    t_ns: int
    """When its last byte was over: when a read could return it, nanoseconds since the start."""
    data: bytes
    """The bytes as heard, faults applied; never empty."""
    sent: bytes
    """The frame as it was sent, before any fault; empty for noise."""


class Simulation:
    """An iterator of TimedBytes; its times never fall and its bytes never overlap.

    It is empty where nobody is ever heard, rather than to look for a first byte for ever.
    The controller may be given commands of one's own between two items: `controller.obey`.
    """

    def __init__(self, parameters: SimulationParameters, baud: int = DEFAULT_BAUD) -> None:
        """Start at time 0; raises PortError where `baud` cannot carry the parameters' rate."""
        parameters.check_against(baud)
        self.parameters = parameters
        self.controller = Controller(Random(f"{parameters.seed}/controller"))
        self._host = SimulatedHost(Random(f"{parameters.seed}/host"))
        self._jitter_dice = Random(f"{parameters.seed}/jitter")
        self._faults = Faults(parameters.seed, parameters.drop, parameters.flip, parameters.noise)
        self._byte_ns = byte_time_ns(baud)
        self._free_at_ns = 0
        self._items = self._run()

    def __iter__(self) -> Iterator[TimedBytes]:
        return self

    def __next__(self) -> TimedBytes:
        return next(self._items)

    def _run(self) -> Iterator[TimedBytes]:
        if self.parameters.never_heard:
            return
        slot = heard = 0
        while True:
            sent = self._said_in(slot)
            begins_ns = self._begin_of(slot)
            slot += 1
            if not sent:
                continue
            yield from self._heard(sent, begins_ns)
            heard += 1
            if heard == self.parameters.frames:
                return

    def _begin_of(self, slot: int) -> int:
        slot_ns = 1_000_000_000 / self.parameters.rate
        slack_ns = max(0.0, slot_ns - FRAME_LENGTH * self._byte_ns)
        return int(slot * slot_ns + self._jitter_dice.random() * min(slack_ns, _MOST_JITTER_NS))

    def _said_in(self, slot: int) -> bytes | None:
        t_s = slot / self.parameters.rate
        self.controller.advance_to(t_s)
        motor = slot % (1 + len(MOTORS))
        if motor:
            feedback = self.controller.feedback(motor)
            return feedback if self.parameters.wire != Direction.CONTROL else None
        command = self._host.command_at(t_s) if self.parameters.host == "on" else None
        if command is None:
            return None
        # The faults are the listener's: the controller itself hears every command.
        self.controller.obey(*command)
        return encode(*command) if self.parameters.wire != Direction.FEEDBACK else None

    def _heard(self, sent: bytes, begins_ns: int) -> Iterator[TimedBytes]:
        noise = self._faults.noise()
        if noise:
            takes_ns = len(noise) * self._byte_ns
            yield self._on_the_wire(max(0, begins_ns - 2 * takes_ns), noise, takes_ns, b"")
        takes_ns = len(sent) * self._byte_ns
        yield self._on_the_wire(begins_ns, self._faults.damaged(sent), takes_ns, sent)

    def _on_the_wire(self, begins_ns: int, data: bytes, takes_ns: int, sent: bytes) -> TimedBytes:
        begins_ns = max(begins_ns, self._free_at_ns)
        self._free_at_ns = begins_ns + takes_ns
        return TimedBytes(begins_ns, self._free_at_ns, data, sent)


def simulate(parameters: SimulationParameters, baud: int = DEFAULT_BAUD) -> Iterator[TimedBytes]:
    """What a listener hears, with exact times; without end unless `parameters.frames` says so.

    Nothing at all where only a host is listened to, and there is none.

    Raises:
        PortError: a line of `baud` bits per second cannot carry the rate.
    """
    return Simulation(parameters, baud)
