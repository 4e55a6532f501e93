"""Simulated byte stream with exact times, its faults and its parameters.

Nothing here reads a clock or sleeps; `sim://` delivers the bytes in real time.

The wire is a half-duplex bus with time slots of 1/rate seconds. Five slots are a round:

    host | motor 1 | motor 2 | motor 3 | motor 4 | host | motor 1 | ...

A slot is silent if its owner sends nothing, or if its direction is not captured.
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

MOST_DROPPED = 4  # adjacent bytes lost in one fault, at most
MOST_NOISE = 8  # random bytes between two frames, at most


class Faults:
    """Damages frames with given probabilities."""

    def __init__(self, seed: int, drop: float, flip: float, noise: float) -> None:
        self._drop, self._flip, self._noise = drop, flip, noise
        self._drop_dice = Random(f"{seed}/drop")
        self._flip_dice = Random(f"{seed}/flip")
        self._noise_dice = Random(f"{seed}/noise")

    def damaged(self, raw: bytes) -> bytes:
        """The frame as received; at least one byte is left."""
        if self._flip_dice.random() < self._flip:
            offset, bit = divmod(_below(self._flip_dice, len(raw) * 8), 8)
            raw = raw[:offset] + bytes([raw[offset] ^ 1 << bit]) + raw[offset + 1 :]
        if self._drop_dice.random() < self._drop:
            count = 1 + _below(self._drop_dice, min(MOST_DROPPED, len(raw) - 1))
            first = _below(self._drop_dice, len(raw) - count + 1)
            raw = raw[:first] + raw[first + count :]
        return raw

    def noise(self) -> bytes:
        """Noise before the next frame; mostly none."""
        dice = self._noise_dice
        if dice.random() >= self._noise:
            return b""
        return bytes(_below(dice, 256) for _ in range(1 + _below(dice, MOST_NOISE)))


def _below(dice: Random, end: int) -> int:
    """A random integer in 0..end-1; only `random()` is the same in every version of Python."""
    return int(dice.random() * end)


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a simulation."""

    name: str
    default: int | float | str
    meaning: str
    low: float = 0
    high: float = math.inf
    words: tuple[str, ...] = ()

    @property
    def range_text(self) -> str:
        """The legal values for messages and help: `0..1`, `on|off`."""
        if self.words:
            return "|".join(self.words)
        whole = "a whole number " if isinstance(self.default, int) else ""
        low, high = (f"{bound:.15g}" for bound in (self.low, self.high))
        return f"{whole}>= {low}" if math.isinf(self.high) else f"{whole}{low}..{high}"

    def read(self, text: str) -> int | float | str:
        """Parse `text`; raises PortError if it is not a legal value."""
        try:
            value = type(self.default)(text)
        except ValueError:
            raise self._refusal(text) from None
        self.check(value)
        return value

    def check(self, value: object) -> None:
        """Raise PortError with the legal range if `value` is not legal."""
        if self.words:
            legal = value in self.words
        else:
            types = int if isinstance(self.default, int) else (int, float)
            legal = isinstance(value, types) and self.low <= value <= self.high
        if not legal:
            raise self._refusal(value)

    def _refusal(self, value: object) -> PortError:
        return PortError(f"sim:// cannot take {self.name}={value!s:.40}: it is {self.range_text}")


def _parameter(default: float | str, meaning: str, **limits: Any) -> Any:
    metadata = {"default": default, "meaning": meaning, **limits}
    return dataclasses.field(default=default, metadata=metadata)


@dataclass(frozen=True, slots=True)
class SimulationParameters:
    """The parameters of a simulation; values out of range raise PortError."""

    seed: int = _parameter(0, "the same seed gives the same bytes")
    rate: float = _parameter(
        200.0, "frames per second on the wire, both directions together", low=0.01, high=1e6
    )
    drop: float = _parameter(0.0, "share of the frames that lose adjacent bytes", high=1)
    flip: float = _parameter(0.0, "share of the frames that have one bit flipped", high=1)
    noise: float = _parameter(0.0, "share of the frames with random bytes before them", high=1)
    wire: str = _parameter("both", "which frames are received", words=("both", *Direction))
    host: str = _parameter("on", "whether a host sends commands", words=("on", "off"))
    frames: int = _parameter(0, "the port is unplugged after this many frames; 0 is never")

    def __post_init__(self) -> None:
        for parameter in PARAMETERS:
            parameter.check(getattr(self, parameter.name))

    @property
    def is_silent(self) -> bool:
        """True if no byte is ever sent: only the host is captured, and there is none."""
        return self.wire == Direction.CONTROL and self.host == "off"

    def check_against(self, baud: int) -> None:
        """Raise PortError if a line of `baud` bits per second cannot carry the rate."""
        most = max_frames_per_s(baud)
        if self.rate > most:
            raise PortError(
                f"sim:// cannot take rate={self.rate:g}: a line of {baud} baud carries at most "
                f"{most} frames/s; ask for less, or for more with --baud"
            )


def max_frames_per_s(baud: int) -> int:
    """Capacity of one wire of `baud` bits per second, frames per second."""
    return round(1_000_000_000 / (FRAME_LENGTH * byte_time_ns(baud)))


PARAMETERS: tuple[Parameter, ...] = tuple(
    Parameter(field.name, **field.metadata) for field in dataclasses.fields(SimulationParameters)
)
"""Every parameter, in the order of the help."""


def parse_parameters(query: str) -> SimulationParameters:
    """Parse the query of a URL, `seed=1&drop=0.01`; raises PortError if it is not legal."""
    by_name = {parameter.name: parameter for parameter in PARAMETERS}
    values: dict[str, Any] = {}
    for name, text in parse_qsl(query, keep_blank_values=True):
        if name not in by_name:
            near = difflib.get_close_matches(name, by_name, 1)
            hint = f"did you mean {near[0]}? " if near else ""
            known = ", ".join(by_name)
            raise PortError(f"sim:// knows no parameter {name!r:.40}: {hint}it knows {known}")
        if name in values:
            raise PortError(f"sim:// is given {name} twice: give it once")
        values[name] = by_name[name].read(text)
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
    """Iterator of TimedBytes without overlap; between items, `controller.obey` is allowed."""

    def __init__(self, parameters: SimulationParameters, baud: int = DEFAULT_BAUD) -> None:
        """Start at time 0; raises PortError if a line of `baud` cannot carry the rate."""
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
        if self.parameters.is_silent:
            return
        slot = received = 0
        slot_ns = 1_000_000_000 / self.parameters.rate
        jitter_ns = min(max(0.0, slot_ns - FRAME_LENGTH * self._byte_ns), _MOST_JITTER_NS)
        while True:
            sent = self._frame_in(slot)
            begins_ns = int(slot * slot_ns + self._jitter_dice.random() * jitter_ns)
            slot += 1
            if not sent:
                continue
            yield from self._received(sent, begins_ns)
            received += 1
            if received == self.parameters.frames:
                return

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
        # Faults affect only the listener: the controller receives every command.
        self.controller.obey(*command)
        return encode(*command) if self.parameters.wire != Direction.FEEDBACK else None

    def _received(self, sent: bytes, begins_ns: int) -> Iterator[TimedBytes]:
        noise = self._faults.noise()
        if noise:
            duration_ns = len(noise) * self._byte_ns
            yield self._timed(max(0, begins_ns - 2 * duration_ns), noise, duration_ns, b"")
        duration_ns = len(sent) * self._byte_ns
        yield self._timed(begins_ns, self._faults.damaged(sent), duration_ns, sent)

    def _timed(self, begins_ns: int, data: bytes, duration_ns: int, sent: bytes) -> TimedBytes:
        begins_ns = max(begins_ns, self._free_at_ns)
        self._free_at_ns = begins_ns + duration_ns
        return TimedBytes(begins_ns, self._free_at_ns, data, sent)


def simulate(parameters: SimulationParameters, baud: int = DEFAULT_BAUD) -> Iterator[TimedBytes]:
    """The received bytes with exact times; infinite unless `parameters.frames` is set.

    Raises PortError if a line of `baud` bits per second cannot carry the rate.
    """
    return Simulation(parameters, baud)
