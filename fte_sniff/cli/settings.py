"""Settings file and environment.

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

import os
import tempfile
import tomllib
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import click

from fte_sniff.cli.streams import tell
from fte_sniff.errors import FileError, FteSniffError, UsageError, reason_of, unreadable
from fte_sniff.tui.i18n import AUTO, LANGUAGES, THEMES, language_of
from fte_sniff.tui.table.columns import LEAST, MOST, ORDER, VALUES

if TYPE_CHECKING:
    from fte_sniff.tui.options import Choices


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


VARIABLE: Final = "FTE_SNIFF_CONFIG"
"""The environment's word for another settings file."""

_WAY_OUT = "mend the file, or move it away"


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
        FileError: it cannot be read, or is not TOML.
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
    return settings_of(told)


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
        for name in SCREEN:
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


OPTION_OF = {"baud": "--baud", "resolution": "--resolution", "gear_ratio": "--gear-ratio"}
"""The option that says the same as a field of `PortDefaults`, and wins."""


def config_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """The `--config` option; the command hands it to `remembered`."""
    return click.option(
        "--config",
        type=click.Path(path_type=Path),
        metavar="FILE",
        help="Settings; by default config.toml in your folder for settings.",
    )(command)


def lang_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """The `--lang` option; the command hands it to `Remembered.language`."""
    return click.option(
        "--lang",
        type=click.Choice([*LANGUAGES, AUTO]),
        help="Language of the screen; by default that of the settings, or of the locale.",
    )(command)


@dataclass(frozen=True, slots=True)
class Remembered:
    """The settings of a command, and where they lie."""

    path: Path
    settings: Settings
    trouble: tuple[str, ...] = ()
    """What is wrong with the file, and was told: a line each."""

    def defaults(self, ports: Sequence[str], *names: str) -> PortDefaults:
        """What the settings say of these ports, as far as it is asked for by name.

        Raises:
            UsageError: they say one thing of one port, and another of another.
        """
        told = [self.settings.of_port(port) for port in ports]
        found = {}
        for name in names:
            said = {getattr(one, name) for one in told} - {None}
            if len(said) > 1:
                raise UsageError(
                    f"{self.path} says another {name.replace('_', '-')} of each port; "
                    f"say one with {OPTION_OF[name]}"
                )
            found[name] = next(iter(said), None)
        return PortDefaults(**found)

    def language(self, lang: str | None) -> str:
        """The language of the screen, given what `--lang` says of it."""
        return language_of(lang or self.settings.screen.language, os.environ)

    @property
    def choices(self) -> Choices:
        """How the screen begins."""
        from fte_sniff.tui.options import Choices
        from fte_sniff.tui.table.columns import ColumnChoice

        screen = self.settings.screen
        widths = tuple((screen.widths or {}).items())
        columns = None if screen.columns is None else ColumnChoice(screen.columns, widths)
        return Choices(screen.theme, columns)

    def keep(self, choices: Choices) -> None:
        """Let the next screen begin as this one ended; that it cannot is told, and no error."""
        columns = choices.columns
        try:
            # Read again: another screen may have been there meanwhile.
            found = read_settings(self.path)
            if found.faults:
                tell(f"the look of the screen is not kept: mend {self.path} first")
                return
            screen = replace(
                found.screen,
                theme=choices.theme,
                columns=None if columns is None else columns.names,
                widths=None if columns is None else dict(columns.widths) or None,
            )
            keep_screen(self.path, screen)
        except FteSniffError as error:
            tell(f"the look of the screen is not kept: {error}")


def remembered(config: Path | None) -> Remembered:
    """The settings in the file that `--config` names, else in the usual one.

    Raises:
        FileError: the named file is not there.
    """
    if config is not None:
        try:
            config.stat()
        except OSError as error:
            raise unreadable(config, error) from error
    path = config or settings_path()
    try:
        settings = read_settings(path)
        trouble = [f"{path}: {fault}; going on without it" for fault in settings.faults]
    except FteSniffError as error:
        settings, trouble = Settings(), [f"{error}; going on without settings"]
    for line in trouble:
        tell(f"fte-sniff: {line}")
    return Remembered(path, settings, tuple(trouble))
