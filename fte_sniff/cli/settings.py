"""The settings file, which is the user's, and the choices of the screen, which the program stores.

[screen]
language = "zh"                 # or en, or auto: that of the locale

[port."/dev/ttyUSB0"]           # or its stable name, /dev/serial/by-id/...
baud = 115200
resolution = 500
gear-ratio = 30.0

[live]                          # of bridge too
ports = ["/dev/ttyUSB0"]        # what `fte-sniff live` opens without a PORT
zone = "Asia/Shanghai"          # of times in lines, CSV, and on the screen
reconnect = false               # end when a port is lost
network = true                  # --udp and --serve may use a network: anyone there can read

What is chosen on the screen is stored in the state folder.
"""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from datetime import tzinfo
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from fte_sniff.analysis.time_text import zone_of
from fte_sniff.cli.streams import print_err
from fte_sniff.errors import FileError, UsageError, reason_of, unreadable
from fte_sniff.i18n import AUTO, LANGUAGES, THEMES, language_of
from fte_sniff.real_number import RealNumber

if TYPE_CHECKING:
    from fte_sniff.tui.options import Choices


def _zone(value: Any) -> tzinfo:
    try:
        return zone_of(str(value))
    except UsageError:
        raise click.BadParameter(
            f"{value!r:.60} is not a time zone, such as Asia/Shanghai, +08:00 or local"
        ) from None


def _list_of(kind: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """The type of a list of different values of a type; one without any counts as absent."""

    def convert(value: Any) -> tuple[Any, ...] | None:
        if not isinstance(value, list):
            raise click.BadParameter(f"{value!r:.60} is not a list")
        return tuple(dict.fromkeys(kind(str(one)) for one in value)) or None

    return convert


def _column(name: str) -> Any:
    from fte_sniff.tui.cells import ORDER

    return click.Choice(ORDER)(name)


_RATIO: Final = RealNumber(0, min_open=True)

_ANY_NAME: Final = ""

_LANGUAGE: Final = click.Choice([*LANGUAGES, AUTO])

_CHOICES: Final[Mapping[str, Any]] = {
    "theme": click.Choice(THEMES),
    "columns": _list_of(_column),
    "language": _LANGUAGE,
    "filters": {_ANY_NAME: click.STRING},
}
"""Fields of `Choices`."""

_TABLES: Final[Mapping[str, Any]] = {
    "screen": {"language": _LANGUAGE},
    "live": {
        "ports": _list_of(click.STRING),
        "zone": _zone,
        "reconnect": click.BOOL,
        "network": click.BOOL,
    },
    "port": {_ANY_NAME: {"baud": click.IntRange(1), "resolution": _RATIO, "gear-ratio": _RATIO}},
}
"""What a settings file may have: of each name the type of its value, or such a table."""


def _valid(table: Any, known: Mapping[str, Any], faults: list[str], *path: str) -> dict[str, Any]:
    """The valid entries of a table, converted. The others go to `faults`, a line each."""
    found: dict[str, Any] = {}
    if not isinstance(table, dict):
        faults.append(f"{'.'.join(path)} must be a table, not {table!r:.60}")
        return found
    place = f" in [{'.'.join(path)}]" if path else ""
    for name, value in table.items():
        kind = known.get(name, known.get(_ANY_NAME))
        if kind is None:
            faults.append(f"unknown name {name!r:.60}{place}; use one of {', '.join(known)}")
        elif isinstance(kind, Mapping):
            found[name] = _valid(value, kind, faults, *path, name)
        else:
            try:
                found[name] = kind(value if isinstance(value, list) else str(value))
            except (click.BadParameter, TypeError, AttributeError) as error:  # as of a list
                faults.append(f"{name}{place}: {' '.join(str(error).split()).rstrip('.')}")
    return found


@dataclass(frozen=True, slots=True)
class Settings:
    """The valid contents of a settings file; a table lacks the names that the file lacks."""

    screen: Mapping[str, Any] = field(default_factory=dict)
    live: Mapping[str, Any] = field(default_factory=dict)
    port: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """By the name of a port: `baud`, `resolution` and `gear-ratio`."""
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

    def pulses_per_turn(self, ports: Sequence[str]) -> float | None:
        """Encoder pulses per turn of an output shaft; raises UsageError if their settings differ.

        See docs/reference/protocol.md, "Pulses and turns".
        """
        resolution, ratio = (self.default(ports, one) for one in ("resolution", "gear-ratio"))
        return None if resolution is None else float(resolution * (ratio or 1.0))

    def language(self, lang: str | None = None) -> str:
        """The language of the screen; `lang` is the value of `--lang`."""
        wanted = lang or _stored().get("language") or self.screen.get("language")
        return language_of(wanted, os.environ)

    @property
    def choices(self) -> Choices:
        """What was chosen on the screen; what is invalid is ignored."""
        from fte_sniff.tui.options import Choices

        stored = _stored()
        filters = tuple(stored.pop("filters", {}).items())
        return Choices(**stored, filters=filters)

    def keep(self, choices: Choices) -> None:
        """Store the choices for the next start; a failure is only reported."""
        from fte_sniff.session.save import replace_text

        path, chosen = _choices_path(), asdict(choices) | {"filters": dict(choices.filters)}
        try:
            replace_text(path, json.dumps(chosen, ensure_ascii=False, indent=1))
        except OSError as error:
            print_err(f"the choices of the screen are not saved: {path}: {reason_of(error)}")


def _stored() -> dict[str, Any]:
    """The valid ones of the stored choices."""
    stored: Any = {}
    with suppress(OSError, ValueError, RecursionError):  # absent, or of another version
        stored = json.loads(_choices_path().read_text("utf-8"))
    return _valid(stored, _CHOICES, [])


def _choices_path() -> Path:
    from platformdirs import user_state_path

    return user_state_path("fte-sniff", appauthor=False) / "screen.json"


CONFIG_VARIABLE: Final = "FTE_SNIFF_CONFIG"


def settings_path() -> Path:
    """Path of the settings file: `$FTE_SNIFF_CONFIG`, or `config.toml` in the user's folder."""
    if named := os.environ.get(CONFIG_VARIABLE):
        return Path(named)
    from platformdirs import user_config_path

    return user_config_path("fte-sniff", appauthor=False) / "config.toml"


def read_toml(path: Path) -> str:
    """The text of a TOML file, without a byte order mark; raises FileError."""
    try:
        return path.read_text("utf-8-sig")
    except OSError as error:
        raise unreadable(path, error) from error
    except UnicodeDecodeError:
        raise FileError(f"{path} is not UTF-8; save the file as UTF-8") from None


def read_settings(path: Path) -> Settings:
    """The settings of a file; one that is missing, or cannot be read, has none."""
    if not os.path.exists(path):  # noqa: PTH110 - False, and no error, where a folder is closed
        return Settings(path=path)
    faults: list[str] = []
    try:
        tables = _valid(tomllib.loads(read_toml(path)), _TABLES, faults)
    except (FileError, tomllib.TOMLDecodeError, RecursionError) as error:
        what = error if isinstance(error, FileError) else f"{path} is not TOML: {error}"
        return Settings(path=path, trouble=(f"{what}; starting without settings",))
    reported = (f"{path}: {fault}; it is ignored" for fault in faults)
    return Settings(**tables, path=path, trouble=tuple(reported))


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
