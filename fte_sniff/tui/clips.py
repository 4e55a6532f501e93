"""Owns what was copied, kept in a file for terminals that do not take it.

It must not know what is in the text, nor the screen.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import Final

from platformdirs import user_cache_path

NAME: Final = "copied.txt"
"""The file's name; each copy replaces the one before."""


def keep_copy(text: str) -> Path | None:
    """Keep the text in the user's cache folder, for the user alone; None where it cannot be."""
    path = user_cache_path("fte-sniff", appauthor=False) / NAME
    part = path.with_name(f"{NAME}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w") as file:
            file.write(text)
        part.replace(path)
    except (OSError, UnicodeError):
        with suppress(OSError):
            part.unlink(missing_ok=True)
        return None
    return path


def short_path(path: Path) -> str:
    """The path with `~` for the home folder."""
    with suppress(ValueError, RuntimeError):
        return f"~/{path.relative_to(Path.home())}"
    return str(path)
