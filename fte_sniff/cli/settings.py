"""The settings file, which is the user's, and the choices of the screen, which the program stores.

[screen]
theme = "textual-light"
columns = ["time", "kind", "values", "faults"]
language = "zh"                 # or en, or auto: that of the locale

[filters]                       # listed by the key f, with those that ^s there adds
stalled = "abs(rpm) < 10 AND motor IS NOT NULL"

[port."/dev/ttyUSB0"]           # or its stable name, /dev/serial/by-id/...
baud = 115200
resolution = 500
gear-ratio = 30.0

[live]                          # of bridge too
ports = ["/dev/ttyUSB0"]        # what `fte-sniff live` opens without a PORT
zone = "Asia/Shanghai"          # of times in lines, CSV, and on the screen
reconnect = false               # end when a port is lost
network = true                  # --udp and --serve may use a network: anyone there can read

What is chosen on the screen is stored in the state folder, where it differs from this file.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import click

from fte_sniff.cli.streams import print_err
from fte_sniff.errors import FileError, FteSniffError, UsageError, unreadable
from fte_sniff.i18n import AUTO, LANGUAGES, THEMES, language_of
from fte_sniff.tui.cells import ORDER

if TYPE_CHECKING:
    from fte_sniff.analysis.line_setup import LineSetup
    from fte_sniff.tui.options import Choices


class _Kind(NamedTuple):
    """What a setting may be; `wanted` completes "must be ..."."""

    wanted: str
    holds: Callable[[Any], bool]


def _is_zone(value: Any) -> bool:
    from fte_sniff.analysis.time_text import zone_of

    try:
        return zone_of(value if isinstance(value, str) else "") is not None
    except UsageError:
        return False


def _are_columns(value: Any) -> bool:
    columns = [name for name in ORDER if isinstance(value, list) and value.count(name) == 1]
    return bool(columns) and len(columns) == len(value)


def _is_number(value: Any, *types: type) -> bool:
    return type(value) in types and 0 < value < 2**31


_TABLE: Final = _Kind("a table", lambda value: isinstance(value, dict))
_TEXT: Final = _Kind("a text", lambda value: isinstance(value, str) and bool(value))
_YES_OR_NO: Final = _Kind("true or false", lambda value: isinstance(value, bool))
_RATIO: Final = _Kind("a number above 0", lambda value: _is_number(value, int, float))

_LANGUAGES: Final = (*LANGUAGES, AUTO)
_SCREEN: Final[Mapping[str, _Kind]] = {
    "theme": _Kind(f"one of {', '.join(THEMES)}", lambda value: value in THEMES),
    "columns": _Kind(
        f"a list of different names out of {', '.join(ORDER)}",
        _are_columns,
    ),
    "language": _Kind(f"one of {', '.join(_LANGUAGES)}", lambda value: value in _LANGUAGES),
}
"""What the table of the screen may have: fields of `Choices`."""

_LIVE: Final[Mapping[str, _Kind]] = {
    "ports": _Kind(
        "a list of one or two ports",
        lambda value: (
            isinstance(value, list) and len(value) in (1, 2) and all(map(_TEXT.holds, value))
        ),
    ),
    "zone": _Kind("a time zone, such as Asia/Shanghai, +08:00 or local", _is_zone),
    "reconnect": _YES_OR_NO,
    "network": _YES_OR_NO,
}

_PORT: Final[Mapping[str, _Kind]] = {
    "baud": _Kind("a whole number from 1", lambda value: _is_number(value, int)),
    "resolution": _RATIO,
    "gear-ratio": _RATIO,
}


@dataclass(frozen=True, slots=True)
class Settings:
    """The valid contents of a settings file; a table lacks the names that the file lacks."""

    screen: Mapping[str, Any] = field(default_factory=dict)
    live: Mapping[str, Any] = field(default_factory=dict)
    port: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """By the name of a port: `baud`, `resolution` and `gear-ratio`."""
    filters: Mapping[str, str] = field(default_factory=dict)
    faults: tuple[str, ...] = ()
    """Invalid entries of the file, one line each."""
    path: Path = Path()
    trouble: tuple[str, ...] = ()
    """Problems with the file that were reported, one line each."""

    def of_port(self, port: str) -> Mapping[str, Any]:
        """Settings of a port, by this name or another name of the same device."""
        found = self.port.get(port)
        if found is None and "://" not in port:
            device = Path(port).resolve()
            same = (name for name in self.port if Path(name).resolve() == device)
            found = self.port.get(next(same, ""))
        return found or {}

    def default(self, ports: Sequence[str], name: str) -> Any:
        """The setting of this name for these ports; None without one.

        Raises UsageError if it differs between the ports.
        """
        values = {self.of_port(port).get(name) for port in ports} - {None}
        if len(values) > 1:
            fix = "give one with --baud" if name == "baud" else "correct the file"
            raise UsageError(f"{self.path} has another {name} for each port; {fix}")
        return next(iter(values), None)

    def line_setup(self, ports: Sequence[str], baud: int) -> LineSetup:
        """The line setup of these ports; raises UsageError if their settings differ."""
        from fte_sniff.analysis.line_setup import LineSetup

        ratio = self.default(ports, "gear-ratio")
        return LineSetup(baud, self.default(ports, "resolution"), ratio or 1.0)

    def language(self, lang: str | None = None) -> str:
        """The language of the screen; `lang` is the value of `--lang`."""
        return language_of(lang or self.screen.get("language"), os.environ)

    @property
    def _written(self) -> Choices:
        """Theme, columns, language and filters of the file."""
        from fte_sniff.tui.options import Choices

        return Choices(**self.screen, filters=tuple(self.filters.items()))

    @property
    def choices(self) -> Choices:
        """Those of the file, with what was chosen on the screen; what is invalid is ignored."""
        from fte_sniff.session.user_state import read_choices

        stored = read_choices()
        filters = stored.pop("filters", {})
        filters = _values(filters if isinstance(filters, dict) else {}, "filters", _TEXT, [])
        chosen = _values(stored, "screen", _SCREEN, [])
        return replace(self._written, **chosen, filters=tuple({**self.filters, **filters}.items()))

    def keep(self, choices: Choices) -> None:
        """Store what differs from the file for the next start; a failure is only reported."""
        from fte_sniff.session.user_state import save_choices

        written = asdict(self._written)
        chosen = {
            name: value
            for name, value in asdict(choices).items()
            if value != written[name] and value is not None
        }
        own = {name: text for name, text in choices.filters if self.filters.get(name) != text}
        try:
            save_choices(chosen | {"filters": own})
        except FteSniffError as error:
            print_err(f"the choices of the screen are not saved: {error}")


def _values(
    table: Any, where: str, kinds: Mapping[str, _Kind] | _Kind, faults: list[str]
) -> dict[str, Any]:
    """The valid values of a table, by name; one kind is that of any name. Lists become tuples."""
    found = {}
    place = f" in [{where}]" if where else ""
    for name, value in table.items():
        kind = kinds if isinstance(kinds, _Kind) else kinds.get(name)
        if kind is None:
            known = ", ".join(map(str, kinds))
            faults.append(f"unknown name {name!r:.60}{place}; use one of {known}")
        elif kind.holds(value):
            found[name] = tuple(value) if isinstance(value, list) else value
        else:
            faults.append(f"{name}{place} must be {kind.wanted}, not {value!r:.60}")
    return found


_TABLES: Final = dict.fromkeys(("screen", "live", "port", "filters"), _TABLE)


def parse_settings(content: Mapping[str, Any]) -> Settings:
    """Settings from the tables of a file; invalid entries go to `faults`."""
    faults: list[str] = []
    tables = {name: {} for name in _TABLES} | _values(content, "", _TABLES, faults)
    ports = _values(tables["port"], "port", _TABLE, faults)
    return Settings(
        _values(tables["screen"], "screen", _SCREEN, faults),
        _values(tables["live"], "live", _LIVE, faults),
        {name: _values(table, f"port.{name}", _PORT, faults) for name, table in ports.items()},
        _values(tables["filters"], "filters", _TEXT, faults),
        tuple(faults),
    )


CONFIG_VARIABLE: Final = "FTE_SNIFF_CONFIG"

_MOST_BYTES = 1_000_000
_FIX = "correct the file, or move it away"


def settings_path() -> Path:
    """Path of the settings file: `$FTE_SNIFF_CONFIG`, or `config.toml` in the user's folder."""
    named = os.environ.get(CONFIG_VARIABLE)
    if named:
        return Path(named)
    from platformdirs import user_config_path

    return user_config_path("fte-sniff", appauthor=False) / "config.toml"


def read_toml(path: Path, fix: str) -> str:
    """The text of a TOML file, without a byte order mark.

    Raises FileError with the fix if it is too large or not a text, and OSError.
    """
    with path.open("rb") as file:
        content = file.read(_MOST_BYTES + 1)
    if len(content) > _MOST_BYTES:
        raise FileError(f"{path} is larger than 1 MB; {fix}")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise FileError(f"{path}:{line} is not UTF-8; save the file as UTF-8") from None


def read_settings(path: Path) -> Settings:
    """Read a settings file; a missing file has no settings.

    Raises FileError if it cannot be read, or is not TOML.
    """
    try:
        if not (path.is_dir() or path.is_file()) and path.exists():
            raise FileError(f"{path} is not a regular file; {_FIX}")
        tables = tomllib.loads(read_toml(path, _FIX))
    except (FileNotFoundError, NotADirectoryError):
        return Settings()
    except OSError as error:
        raise unreadable(path, error) from error
    except tomllib.TOMLDecodeError as error:
        raise FileError(f"{path} is not TOML: {error}; {_FIX}") from error
    except RecursionError as error:
        raise FileError(f"{path} is nested too deeply; {_FIX}") from error
    return parse_settings(tables)


lang_option = click.option(
    "--lang",
    type=click.Choice([*LANGUAGES, AUTO]),
    help="Language of the screen or the report; by default that of the settings or the locale.",
)
"""The `--lang` option; its value goes to `Settings.language`."""


def load_settings() -> Settings:
    """Load the settings; problems are reported."""
    path = settings_path()
    try:
        settings = read_settings(path)
        trouble = [f"{path}: {fault}; it is ignored" for fault in settings.faults]
    except FteSniffError as error:
        settings, trouble = Settings(), [f"{error}; starting without settings"]
    for line in trouble:
        print_err(f"fte-sniff: {line}")
    return replace(settings, path=path, trouble=tuple(trouble))
