"""Owns the settings file: where it lies, how it is read and checked, and what is kept in it.

It must not know what a setting does: commands and the screen take the values from here.

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

The file is TOML, in the platform's folder for settings (`FTE_SNIFF_CONFIG` or `--config` name
another). What the user wrote into it, comments too, stays when something is kept in it.
"""

from __future__ import annotations

import os
import tempfile
import tomllib
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, TypeAlias

from fte_sniff.errors import FileError, reason_of, unreadable
from fte_sniff.tui.language import AUTO, LANGUAGES
from fte_sniff.tui.table.columns import LEAST, MOST, ORDER, VALUES
from fte_sniff.tui.theme_names import THEMES

VARIABLE: Final = "FTE_SNIFF_CONFIG"
"""The environment's word for another settings file."""

_COLUMNS: Final = (*ORDER, VALUES)
_WAY_OUT = "mend the file, or move it away"


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

    def of_port(self, port: str) -> PortDefaults:
        """What is said of a port by this name, or by another that leads to the same device."""
        found = self.by_port.get(port)
        if found is None and "://" not in port:
            device = Path(port).resolve()
            same = (name for name in self.by_port if Path(name).resolve() == device)
            found = self.by_port.get(next(same, ""))
        return found or PortDefaults()


def settings_path() -> Path:
    """Where the settings lie when nobody says otherwise."""
    named = os.environ.get(VARIABLE)
    if named:
        return Path(named)
    from platformdirs import user_config_path

    return user_config_path("fte-sniff", appauthor=False) / "config.toml"


def read_settings(path: Path) -> Settings:
    """What the file says; nothing where there is no such file.

    Raises:
        FileError: it cannot be read, or says what cannot be.
    """
    try:
        content = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return Settings()
    except OSError as error:
        raise unreadable(path, error) from error
    try:
        told = tomllib.loads(content.decode())
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise FileError(f"{path} is not TOML: {error}; {_WAY_OUT}") from error
    except RecursionError as error:
        raise FileError(f"{path} is nested too deeply; {_WAY_OUT}") from error
    return _Check(path).settings(told)


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


_SCREEN: Mapping[str, _Convert] = {
    "theme": _word(THEMES),
    "columns": _columns,
    "widths": _widths,
    "language": _word((*LANGUAGES, AUTO)),
}
_LIVE: Mapping[str, _Convert] = {"ports": _ports}
_PORT: Mapping[str, _Convert] = {"baud": _whole, "resolution": _ratio, "gear-ratio": _ratio}
_TABLES = ("screen", "live", "port")


class _Check:
    """Takes a file's tables apart, and says where one is not what it should be."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def settings(self, told: Mapping[str, Any]) -> Settings:
        self._known(told, _TABLES, "")
        ports = self._table(told.get("port", {}), "port")
        return Settings(
            ScreenSettings(**self._values(told.get("screen", {}), "screen", _SCREEN)),
            self._values(told.get("live", {}), "live", _LIVE).get("ports", ()),
            MappingProxyType(
                {
                    name: PortDefaults(**self._values(table, f"port.{name}", _PORT))
                    for name, table in ports.items()
                }
            ),
        )

    def _table(self, value: Any, name: str) -> Mapping[str, Any]:
        if not isinstance(value, dict):
            raise FileError(f"{self._path}: [{name}] must be a table; {_WAY_OUT}")
        return value

    def _known(self, table: Mapping[str, Any], names: tuple[str, ...], where: str) -> None:
        for name in table:
            if name not in names:
                near = get_close_matches(name, names, 1)
                hint = f"did you mean {near[0]}?" if near else f"it knows {', '.join(names)}"
                place = f" in [{where}]" if where else ""
                raise FileError(f"{self._path}: unknown name {name!r}{place}; {hint}")

    def _values(self, table: Any, where: str, converts: Mapping[str, _Convert]) -> dict[str, Any]:
        self._known(self._table(table, where), tuple(converts), where)
        found = {}
        for name, value in table.items():
            try:
                found[name.replace("-", "_")] = converts[name](value)
            except ValueError as error:
                raise FileError(
                    f"{self._path}: {name} in [{where}] must be {error}, not {value!r:.60}"
                ) from error
        return found


def keep_screen(path: Path, settings: ScreenSettings) -> None:
    """Write what is said of the screen into the file, and leave the rest as it is.

    The new file takes the place of the old one at once, so that no half of it is ever there.

    Raises:
        FileError: the file there cannot be read or written.
    """
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    try:
        document = tomlkit.parse(path.read_text("utf-8")) if path.exists() else tomlkit.document()
        screen = document.setdefault("screen", tomlkit.table())
        for name in _SCREEN:
            value = getattr(settings, name)
            if value is not None:
                screen[name] = _toml(value)
            elif name in screen:
                del screen[name]
        _replace(path, tomlkit.dumps(document))
    except (TOMLKitError, UnicodeDecodeError, TypeError) as error:
        raise FileError(f"{path} is not TOML: {error}; {_WAY_OUT}") from error
    except OSError as error:
        raise FileError(f"{path} cannot be written: {reason_of(error)}") from error


def _toml(value: Any) -> Any:
    """The value as the file holds it."""
    import tomlkit

    if isinstance(value, Mapping):
        table = tomlkit.inline_table()
        table.update(value)
        return table
    return list(value) if isinstance(value, tuple) else value


def _replace(path: Path, text: str) -> None:
    # A link stays one: people keep such files elsewhere and link to them.
    path = path.resolve()
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(
        "w", encoding="utf-8", dir=path.parent, prefix=f".{path.name}.", delete=False
    ) as new:
        new.write(text)
    try:
        Path(new.name).replace(path)
    except OSError:
        Path(new.name).unlink(missing_ok=True)
        raise
