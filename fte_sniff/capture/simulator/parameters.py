"""Owns what can be asked of a simulation: names, ranges, defaults, and how they are read from text.

It must not know how a simulation runs. The fields of `SimulationParameters` are the one table from
which parsing, checking and help are derived.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qsl

from fte_sniff.errors import PortError
from fte_sniff.protocol import DEFAULT_BAUD, FRAME_LENGTH, Direction, byte_time_ns

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
