"""Owns `--config` and `--lang`: which settings hold, and how a screen's choices go back there.

It must not know how the file is read, nor what a setting does. What is wrong in a settings file
never stops a command: it is told, and the command goes on without.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fte_sniff.cli.options.settings import PortDefaults, Settings
from fte_sniff.cli.options.settings_file import keep_screen, read_settings, settings_path
from fte_sniff.cli.streams.telling import tell
from fte_sniff.errors import FteSniffError, UsageError, unreadable
from fte_sniff.tui.language import AUTO, LANGUAGES, language_of

if TYPE_CHECKING:
    from fte_sniff.tui.opening import Choices

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
        from fte_sniff.tui.opening import Choices
        from fte_sniff.tui.table.look import ColumnChoice

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
