"""The settings file, which is the user's, and the choices of the screen, which the program stores.

[screen]
theme = "textual-light"
pane_height = 40                # percent; wide terminals: pane_beside = false, pane_width = 40
columns = ["time", "kind", "values", "faults"]
delta = "frame"                 # or row, answer: what the column of time differences measures
changes = true                  # highlight bytes that changed
events = false                  # no lines of port events
language = "zh"                 # or en, or auto: that of the locale

[filters]                       # listed by the key f, with those that ^s there adds
stalled = "abs(rpm) < 10 AND motor IS NOT NULL"

[port."/dev/ttyUSB0"]           # or its stable name, /dev/serial/by-id/...
baud = 115200
resolution = 500
gear-ratio = 30.0

[live]
ports = ["/dev/ttyUSB0"]        # what `fte-sniff live` opens without a PORT

What is chosen on the screen is stored in the state folder, where it differs from this file.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import click

from fte_sniff.cli.streams import print_err
from fte_sniff.errors import FileError, FteSniffError, UsageError, unreadable
from fte_sniff.i18n import AUTO, LANGUAGES, THEMES, language_of
from fte_sniff.tui.cells import ORDER

if TYPE_CHECKING:
    from fte_sniff.session.user_state import Place
    from fte_sniff.tui.options import Choices


@dataclass(frozen=True, slots=True)
class Settings:
    """The contents of a settings file."""

    screen: Mapping[str, Any] = field(default_factory=dict)
    """Values of `SCREEN_SETTINGS` by name, without those that the file lacks."""
    ports: tuple[str, ...] = ()
    """Ports to open when none is named; one or two."""
    by_port: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """By port, `baud`, `resolution` and `gear-ratio`, without those that the file lacks."""
    filters: Mapping[str, str] = field(default_factory=dict)
    faults: tuple[str, ...] = ()
    """Invalid entries of the file, one line each."""
    path: Path = Path()
    trouble: tuple[str, ...] = ()
    """Problems with the file that were reported, one line each."""

    def of_port(self, port: str) -> Mapping[str, Any]:
        """Settings of a port, by this name or another name of the same device."""
        found = self.by_port.get(port)
        if found is None and "://" not in port:
            device = Path(port).resolve()
            same = (name for name in self.by_port if Path(name).resolve() == device)
            found = self.by_port.get(next(same, ""))
        return found or {}

    def default(self, ports: Sequence[str], name: str) -> Any:
        """The setting of this name for these ports, which an option overrides; None without one.

        Raises UsageError if it differs between the ports.
        """
        values = {self.of_port(port).get(name) for port in ports} - {None}
        if len(values) > 1:
            raise UsageError(
                f"{self.path} has another {name} for each port; give one with --{name}"
            )
        return next(iter(values), None)

    def language(self, lang: str | None) -> str:
        """The language of the screen; `lang` is the value of `--lang`."""
        return language_of(lang or self.screen.get("language"), os.environ)

    @property
    def _written(self) -> Choices:
        """Theme, view, filters and panes of the file."""
        from fte_sniff.tui.options import Choices

        return Choices(**self.screen, filters=tuple(self.filters.items()))

    @property
    def choices(self) -> Choices:
        """Those of the file, with what was chosen on the screen; what is invalid is ignored."""
        from fte_sniff.session.user_state import read_choices

        stored, check = read_choices(), _Check()
        filters = check.texts(stored.pop("filters", {}), "filters")
        chosen = check.values(stored, "screen", SCREEN_SETTINGS)
        merged = {**self.filters, **filters}
        return replace(self._written, **chosen, filters=tuple(merged.items()))

    def choices_at(self, place: Place) -> Choices:
        """The choices, with the columns of a view that was left."""
        names = place.columns
        if names is None or not set(names) <= set(ORDER):
            return self.choices
        return replace(self.choices, columns=names)

    def keep(self, choices: Choices) -> None:
        """Store what differs from the file for the next start; a failure is only reported."""
        from fte_sniff.session.user_state import save_choices

        written = asdict(self._written)
        chosen = {
            name: value.name.lower() if isinstance(value, Enum) else value
            for name, value in asdict(choices).items()
            if value != written[name] and value is not None
        }
        own = {name: text for name, text in choices.filters if self.filters.get(name) != text}
        try:
            save_choices(chosen | {"filters": own})
        except FteSniffError as error:
            print_err(f"the choices of the screen are not saved: {error}")


_Convert: TypeAlias = Callable[[Any], Any]


def _one(
    kinds: tuple[type, ...], wanted: str, holds: Callable[[Any], bool] = lambda _value: True
) -> _Convert:
    """Check a value of one of these types; the error names what is `wanted`."""

    def convert(value: Any) -> Any:
        if type(value) in kinds and holds(value):
            return value
        raise ValueError(wanted)

    return convert


_text = _one((str,), "a text", bool)
_whole = _one((int,), "a whole number from 1", lambda number: 1 <= number < 2**31)
_yes_or_no = _one((bool,), "true or false")
_ratio = _one((int, float), "a number above 0", lambda number: 0 < number < 1e9)


def _word(words: Collection[str]) -> _Convert:
    return _one((str,), f"one of {', '.join(words)}", lambda word: word in words)


def _share(value: Any) -> int:
    from fte_sniff.tui.options import SHARES

    wanted = f"a whole number from {SHARES.start} to {SHARES.stop - 1}, in percent"
    return int(_one((int, float), wanted, lambda percent: percent in SHARES)(value))


def _ports(value: Any) -> tuple[str, ...]:
    if isinstance(value, list) and 1 <= len(value) <= 2:
        with suppress(ValueError):
            return tuple(_text(port) for port in value)
    raise ValueError("a list of one or two ports")


def _columns(value: Any) -> tuple[str, ...]:
    known = isinstance(value, list) and value and all(name in list(ORDER) for name in value)
    if not known or len(set(value)) < len(value):
        raise ValueError(f"a list of different names out of {', '.join(ORDER)}")
    return tuple(value)


SCREEN_SETTINGS: Final[Mapping[str, _Convert]] = {
    "theme": _word(THEMES),
    "columns": _columns,
    "events": _yes_or_no,
    "language": _word((*LANGUAGES, AUTO)),
    "pane_beside": _yes_or_no,
    "pane_height": _share,
    "pane_width": _share,
}
"""What the table of the screen may have: fields of `Choices`."""

_LIVE: Mapping[str, _Convert] = {"ports": _ports}
_PORT: Mapping[str, _Convert] = {"baud": _whole, "resolution": _ratio, "gear-ratio": _ratio}
_TABLES = ("screen", "live", "port", "filters")


def parse_settings(content: Mapping[str, Any]) -> Settings:
    """Settings from the tables of a file; invalid entries go to `faults`."""
    check = _Check()
    tables = check.known(content, _TABLES, "")
    return Settings(
        check.values(tables.get("screen", {}), "screen", SCREEN_SETTINGS),
        check.values(tables.get("live", {}), "live", _LIVE).get("ports", ()),
        {
            name: check.values(table, f"port.{name}", _PORT)
            for name, table in check.table(tables.get("port", {}), "port").items()
        },
        check.texts(tables.get("filters", {}), "filters"),
        tuple(check.faults),
    )


class _Check:
    """Validates the tables of a file and collects what is wrong with them."""

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
        """The entries with a known name."""
        for name in table:
            if name not in names:
                from fte_sniff.analysis.filter.row_filter import nearest

                hint = nearest(name, names) or f"it knows {', '.join(names)}"
                place = f" in [{where}]" if where else ""
                self.faults.append(f"unknown name {name!r:.60}{place}; {hint}")
        return {name: value for name, value in table.items() if name in names}

    def texts(self, table: Any, where: str) -> Mapping[str, str]:
        """A table of texts by any name."""
        entries = self.table(table, where)
        return self.values(entries, where, dict.fromkeys(entries, _text))

    def values(self, table: Any, where: str, converts: Mapping[str, _Convert]) -> dict[str, Any]:
        """Converted values of a table, by name."""
        found = {}
        for name, value in self.known(self.table(table, where), converts, where).items():
            try:
                found[name] = converts[name](value)
            except ValueError as error:
                self.faults.append(f"{name} in [{where}] must be {error}, not {value!r:.60}")
        return found


CONFIG_VARIABLE: Final = "FTE_SNIFF_CONFIG"

_MOST_BYTES = 1_000_000
_MOST_DOTS = 32

_FIX = "correct the file, or move it away"


def settings_path() -> Path:
    """Default path of the settings file."""
    named = os.environ.get(CONFIG_VARIABLE)
    if named:
        return Path(named)
    from platformdirs import user_config_path

    return user_config_path("fte-sniff", appauthor=False) / "config.toml"


def read_toml(path: Path, fix: str) -> str:
    """The text of a TOML file, which is small enough to be parsed; without a byte order mark.

    Raises FileError with the fix if it is not, and OSError.
    """
    with path.open("rb") as file:
        content = file.read(_MOST_BYTES + 1)
    if len(content) > _MOST_BYTES:
        raise FileError(f"{path} is larger than 1 MB; {fix}")
    # The time that a dotted key takes grows with the square of its length.
    lines = (line for line in content.splitlines() if not line.lstrip().startswith(b"#"))
    if any(line.count(b".") > _MOST_DOTS for line in lines):
        raise FileError(f"{path} is nested too deeply; {fix}")
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
        text = read_toml(path, _FIX)
    except (FileNotFoundError, NotADirectoryError):
        return Settings()
    except OSError as error:
        raise unreadable(path, error) from error
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise FileError(f"{path} is not TOML: {error}; {_FIX}") from error
    except RecursionError as error:
        raise FileError(f"{path} is nested too deeply; {_FIX}") from error
    return parse_settings(tables)


config_option = click.option(
    "--config",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Settings file; by default config.toml in your settings folder.",
)
"""The `--config` option; its value goes to `load_settings`."""

lang_option = click.option(
    "--lang",
    type=click.Choice([*LANGUAGES, AUTO]),
    help="Language of the screen or the report; by default that of the settings or the locale.",
)
"""The `--lang` option; its value goes to `Settings.language`."""


def load_settings(config: Path | None) -> Settings:
    """Load the settings from `config`, or from the default file; problems are reported.

    Raises FileError if the named file is not there.
    """
    if config is not None:
        try:
            config.stat()
        except OSError as error:
            raise unreadable(config, error) from error
    path = config or settings_path()
    try:
        settings = read_settings(path)
        trouble = [f"{path}: {fault}; it is ignored" for fault in settings.faults]
    except FteSniffError as error:
        settings, trouble = Settings(), [f"{error}; starting without settings"]
    for line in trouble:
        print_err(f"fte-sniff: {line}")
    return replace(settings, path=path, trouble=tuple(trouble))
