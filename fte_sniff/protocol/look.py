"""The look of a status: its signs and colours, in plain text, on the screen and in pages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import NamedTuple

from fte_sniff.protocol.spec import Status


class Ground(StrEnum):
    """What text is shown on."""

    DARK = "dark"
    LIGHT = "light"
    DARK_16 = "dark, 16 colours"
    LIGHT_16 = "light, 16 colours"


class Ink(NamedTuple):
    """Colours on one ground, as `#rrggbb`."""

    text: str
    sign: str
    """Colour of a sign that has its own background."""
    sign_ground: str


@dataclass(frozen=True, slots=True)
class Look:
    """How a status is shown."""

    mark: str
    """Sign in front of a row; colour must never be the only difference."""
    color: str = "green"
    """Colour on a terminal whose ground is unknown, by its ANSI name."""
    bold: bool = False
    plot: str = "#3a7bd5"
    """Colour in plots, on light and dark ground."""
    inks: Mapping[Ground, Ink] = field(default_factory=dict)
    """The colours by ground; empty for those of plain text."""

    @property
    def style(self) -> str:
        """Style on a terminal whose ground is unknown, as rich writes it."""
        return f"bold {self.color}" if self.bold else self.color


LOOKS: Mapping[Status, Look] = MappingProxyType(
    {
        Status.OK: Look(" "),
        Status.SUSPECT: Look(
            "?",
            "yellow",
            plot="#d9822b",
            inks={
                Ground.DARK: Ink("#f0e442", "#101010", "#f0e442"),
                Ground.LIGHT: Ink("#6b5e00", "#101010", "#e0d030"),
                Ground.DARK_16: Ink("#ffff55", "#000000", "#ffff55"),
                # The nearest of the 16 to the colour of a light theme is not seen on white.
                Ground.LIGHT_16: Ink("#aa00aa", "#000000", "#ffff55"),
            },
        ),
        Status.MALFORMED: Look(
            "!",
            "red",
            bold=True,
            plot="#d03b3b",
            inks={
                Ground.DARK: Ink("#ff8f50", "#ffffff", "#b84a00"),
                Ground.LIGHT: Ink("#a33c00", "#ffffff", "#b84a00"),
                Ground.DARK_16: Ink("#ff5555", "#ffffff", "#aa0000"),
                Ground.LIGHT_16: Ink("#aa0000", "#ffffff", "#aa0000"),
            },
        ),
    }
)
"""The look of each status, its only definition."""
