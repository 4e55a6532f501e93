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
from dataclasses import dataclass, field
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


def _are_ports(value: Any) -> bool:
    return isinstance(value, list) and len(value) in (1, 2) and all(map(_TEXT.holds, value))


def _is_number(value: Any, *types: type) -> bool:
    return type(value) in types and 0 < value < 2**31


def _one_of(*words: str) -> _Kind:
    return _Kind(f"one of {', '.join(words)}", lambda value: value in words)


_TEXT: Final = _Kind("a text", lambda value: isinstance(value, str) and bool(value))
_YES_OR_NO: Final = _Kind("true or false", lambda value: isinstance(value, bool))
_RATIO: Final = _Kind("a number above 0", lambda value: _is_number(value, int, float))

_ANY_NAME: Final = ""

_SCREEN: Final = {
    "theme": _one_of(*THEMES),
    "columns": _Kind(f"a list of different names out of {', '.join(ORDER)}", _are_columns),
    "language": _one_of(*LANGUAGES, AUTO),
}
_FILTERS: Final = {_ANY_NAME: _TEXT}
_CHOICES: Final[Mapping[str, Any]] = {**_SCREEN, "filters": _FILTERS}
"""What is chosen on the screen: fields of `Choices`."""

_TABLES: Final[Mapping[str, Any]] = {
    "screen": _SCREEN,
    "live": {
        "ports": _Kind("a list of one or two ports", _are_ports),
        "zone": _Kind("a time zone, such as Asia/Shanghai, +08:00 or local", _is_zone),
        "reconnect": _YES_OR_NO,
        "network": _YES_OR_NO,
    },
    "port": {
        _ANY_NAME: {
            "baud": _Kind("a whole number from 1", lambda value: _is_number(value, int)),
            "resolution": _RATIO,
            "gear-ratio": _RATIO,
        }
    },
    "filters": _FILTERS,
}
"""What a settings file may have: of each name a kind, or such a table."""


def _valid(
    table: Mapping[str, Any], known: Mapping[str, Any], faults: list[str], *path: str
) -> dict[str, Any]:
    """The valid entries of a table; lists become tuples. The others go to `faults`, a line each."""
    found: dict[str, Any] = {}
    place = f" in [{'.'.join(path)}]" if path else ""
    for name, value in table.items():
        kind = known.get(name, known.get(_ANY_NAME))
        if kind is None:
            faults.append(f"unknown name {name!r:.60}{place}; use one of {', '.join(known)}")
        elif isinstance(kind, dict) and isinstance(value, dict):
            found[name] = _valid(value, kind, faults, *path, name)
        elif isinstance(kind, _Kind) and kind.holds(value):
            found[name] = tuple(value) if isinstance(value, list) else value
        else:
            wanted = kind.wanted if isinstance(kind, _Kind) else "a table"
            faults.append(f"{name}{place} must be {wanted}, not {value!r:.60}")
    return found


@dataclass(frozen=True, slots=True)
class Settings:
    """The valid contents of a settings file; a table lacks the names that the file lacks."""

    screen: Mapping[str, Any] = field(default_factory=dict)
    live: Mapping[str, Any] = field(default_factory=dict)
    port: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """By the name of a port: `baud`, `resolution` and `gear-ratio`."""
    filters: Mapping[str, str] = field(default_factory=dict)
    path: Path = Path()
    trouble: tuple[str, ...] = ()
    """What is wrong with the file, one line each."""

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
    def choices(self) -> Choices:
        """Those of the file, with what was chosen on the screen; what is invalid is ignored."""
        from fte_sniff.session.user_state import read_choices
        from fte_sniff.tui.options import Choices

        stored = _valid(read_choices(), _CHOICES, [])
        filters = {**self.filters, **stored.pop("filters", {})}
        return Choices(**{**self.screen, **stored}, filters=tuple(filters.items()))

    def keep(self, choices: Choices) -> None:
        """Store what differs from the file for the next start; a failure is only reported."""
        from fte_sniff.session.user_state import save_choices

        chosen = {name: getattr(choices, name) for name in _SCREEN}
        own = {
            name: value
            for name, value in chosen.items()
            if value not in (None, self.screen.get(name))
        }
        filters = {name: text for name, text in choices.filters if self.filters.get(name) != text}
        try:
            save_choices(own | {"filters": filters})
        except FteSniffError as error:
            print_err(f"the choices of the screen are not saved: {error}")


CONFIG_VARIABLE: Final = "FTE_SNIFF_CONFIG"

_MOST_BYTES = 1_000_000


def settings_path() -> Path:
    """Path of the settings file: `$FTE_SNIFF_CONFIG`, or `config.toml` in the user's folder."""
    if named := os.environ.get(CONFIG_VARIABLE):
        return Path(named)
    from platformdirs import user_config_path

    return user_config_path("fte-sniff", appauthor=False) / "config.toml"


def read_toml(path: Path, fix: str) -> str:
    """The text of a TOML file, without a byte order mark.

    Raises FileError, with the fix if the file is too large, or if it is not a text.
    """
    try:
        with path.open("rb") as file:
            content = file.read(_MOST_BYTES + 1)
    except OSError as error:
        raise unreadable(path, error) from error
    if len(content) > _MOST_BYTES:
        raise FileError(f"{path} is larger than 1 MB; {fix}")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise FileError(f"{path}:{line} is not UTF-8; save the file as UTF-8") from None


def read_settings(path: Path) -> Settings:
    """The settings of a file; one that is missing, or cannot be read, has none."""
    if not os.path.exists(path):  # noqa: PTH110 - False, and no error, where a folder is closed
        return Settings(path=path)
    faults: list[str] = []
    fix = "correct the file, or move it away"
    try:
        tables = _valid(tomllib.loads(read_toml(path, fix)), _TABLES, faults)
    except FteSniffError as error:
        trouble = f"{error}"
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        trouble = f"{path} is not TOML: {error}; {fix}"
    else:
        reported = (f"{path}: {fault}; it is ignored" for fault in faults)
        return Settings(**tables, path=path, trouble=tuple(reported))
    return Settings(path=path, trouble=(f"{trouble}; starting without settings",))


lang_option = click.option(
    "--lang",
    type=click.Choice([*LANGUAGES, AUTO]),
    help="Language of the screen or the report; by default that of the settings or the locale.",
)
"""The `--lang` option; its value goes to `Settings.language`."""


def load_settings() -> Settings:
    """Load the settings; what is wrong with the file is printed."""
    settings = read_settings(settings_path())
    for line in settings.trouble:
        print_err(f"fte-sniff: {line}")
    return settings
