"""Owns what settings are, which values each may have, and what of a file's tables is none.

It must not know where the file lies, nor what a setting does: commands and the screen take the
values from here. What is wrong is left out by itself, and said; all else of the file holds.

    [screen]
    theme = "textual-light"
    columns = ["time", "kind", "values", "faults"]
    widths = { time = 15 }
    language = "zh"                 # or en, or auto: that of the locale

    [port."/dev/ttyUSB0"]           # or under its lasting name, /dev/serial/by-id/...
    baud = 115200
    resolution = 500
    gear-ratio = 30.0

    [live]
    ports = ["/dev/ttyUSB0"]        # what `fte-sniff live` opens when it is given none
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, TypeAlias

from fte_sniff.tui.language import AUTO, LANGUAGES
from fte_sniff.tui.table.columns import LEAST, MOST, ORDER, VALUES
from fte_sniff.tui.theme_names import THEMES

_COLUMNS: Final = (*ORDER, VALUES)


@dataclass(frozen=True, slots=True)
class ScreenSettings:
    """How the screen is to look; None where nothing is said."""

    theme: str | None = None
    columns: tuple[str, ...] | None = None
    """Names of the table's columns, in the order in which they stand; at least one."""
    widths: Mapping[str, int] | None = None
    """Cells of the columns that have another width than their own."""
    language: str | None = None


@dataclass(frozen=True, slots=True)
class PortDefaults:
    """What is known of one port; None where nothing is said."""

    baud: int | None = None
    """Bits per second, at least 1."""
    resolution: float | None = None
    """Pulses for one turn of the motor's shaft, above 0."""
    gear_ratio: float | None = None
    """Turns of the motor's shaft for one of the wheel, above 0."""


@dataclass(frozen=True, slots=True)
class Settings:
    """All that a settings file says."""

    screen: ScreenSettings = ScreenSettings()
    ports: tuple[str, ...] = ()
    """What to watch when no port is named; one or two."""
    by_port: Mapping[str, PortDefaults] = field(default_factory=lambda: MappingProxyType({}))
    faults: tuple[str, ...] = ()
    """What the file says beside, and cannot be: a line each."""

    def of_port(self, port: str) -> PortDefaults:
        """What is said of a port by this name, or by another that leads to the same device."""
        found = self.by_port.get(port)
        if found is None and "://" not in port:
            device = Path(port).resolve()
            same = (name for name in self.by_port if Path(name).resolve() == device)
            found = self.by_port.get(next(same, ""))
        return found or PortDefaults()


_Convert: TypeAlias = Callable[[Any], Any]


def _text(value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise ValueError("a text")
    return value


def _whole(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value < 2**31:
        raise ValueError("a whole number from 1")
    return value


def _ratio(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 1e9:
        raise ValueError("a number above 0")
    return float(value)


def _ports(value: Any) -> tuple[str, ...]:
    if isinstance(value, list) and 1 <= len(value) <= 2:
        with suppress(ValueError):
            return tuple(_text(port) for port in value)
    raise ValueError("a list of one or two ports")


def _columns(value: Any) -> tuple[str, ...]:
    known = isinstance(value, list) and value and all(name in list(_COLUMNS) for name in value)
    if not known or len(set(value)) < len(value):
        raise ValueError(f"a list of different names out of {', '.join(_COLUMNS)}")
    return tuple(value)


def _widths(value: Any) -> Mapping[str, int]:
    if isinstance(value, dict) and all(name in _COLUMNS for name in value):
        with suppress(ValueError):
            cells = {name: _whole(width) for name, width in value.items()}
            if all(LEAST <= width <= MOST for width in cells.values()):
                return MappingProxyType(cells)
    raise ValueError(f"a table of columns with {LEAST} to {MOST} cells each")


def _word(words: Collection[str]) -> _Convert:
    """One of these words."""

    def convert(value: Any) -> str:
        if value not in list(words):
            raise ValueError(f"one of {', '.join(words)}")
        return str(value)

    return convert


SCREEN: Mapping[str, _Convert] = {
    "theme": _word(THEMES),
    "columns": _columns,
    "widths": _widths,
    "language": _word((*LANGUAGES, AUTO)),
}
_LIVE: Mapping[str, _Convert] = {"ports": _ports}
_PORT: Mapping[str, _Convert] = {"baud": _whole, "resolution": _ratio, "gear-ratio": _ratio}
_TABLES = ("screen", "live", "port")


def settings_of(told: Mapping[str, Any]) -> Settings:
    """What the tables of a file say, as far as it can be."""
    check = _Check()
    tables = check.known(told, _TABLES, "")
    return Settings(
        ScreenSettings(**check.values(tables.get("screen", {}), "screen", SCREEN)),
        check.values(tables.get("live", {}), "live", _LIVE).get("ports", ()),
        MappingProxyType(
            {
                name: PortDefaults(**check.values(table, f"port.{name}", _PORT))
                for name, table in check.table(tables.get("port", {}), "port").items()
            }
        ),
        tuple(check.faults),
    )


class _Check:
    """Takes a file's tables apart, and notes where one is not what it should be."""

    def __init__(self) -> None:
        self.faults: list[str] = []

    def table(self, value: Any, name: str) -> Mapping[str, Any]:
        if isinstance(value, dict):
            return value
        self.faults.append(f"[{name}] must be a table")
        return {}

    def known(
        self, table: Mapping[str, Any], names: Collection[str], where: str
    ) -> Mapping[str, Any]:
        """What of the table has a name that there is."""
        for name in table:
            if name not in names:
                near = get_close_matches(name, names, 1)
                hint = f"did you mean {near[0]}?" if near else f"it knows {', '.join(names)}"
                place = f" in [{where}]" if where else ""
                self.faults.append(f"unknown name {name!r:.60}{place}; {hint}")
        return {name: value for name, value in table.items() if name in names}

    def values(
        self, table: Any, where: str, converts: Mapping[str, Callable[[Any], Any]]
    ) -> dict[str, Any]:
        """The values of a table by the names of their fields."""
        found = {}
        for name, value in self.known(self.table(table, where), converts, where).items():
            try:
                found[name.replace("-", "_")] = converts[name](value)
            except ValueError as error:
                self.faults.append(f"{name} in [{where}] must be {error}, not {value!r:.60}")
        return found
