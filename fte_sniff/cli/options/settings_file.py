"""Owns the settings file: where it lies, how it is read, and what is kept in it.

It must not know which settings there are. The file is TOML, in the platform's folder for settings
(`FTE_SNIFF_CONFIG` or `--config` name another). What the user wrote into it, comments too, stays
when something is kept in it.
"""

from __future__ import annotations

import os
import tempfile
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from fte_sniff.cli.options.settings import SCREEN, ScreenSettings, Settings, settings_of
from fte_sniff.errors import FileError, reason_of, unreadable

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
