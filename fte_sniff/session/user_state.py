"""The choices of the screen that differ from the settings, as JSON in the user's state folder.

A file that another version or a damage made unreadable counts as empty.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from platformdirs import user_state_path

from fte_sniff.errors import FileError, reason_of
from fte_sniff.session.save import replace_text

_MOST_BYTES: Final = 10_000_000


def _path() -> Path:
    return user_state_path("fte-sniff", appauthor=False) / "screen.json"


def read_choices() -> dict[str, Any]:
    """The choices of the screen by name, as they were stored; `filters` are texts by name."""
    with suppress(OSError, ValueError, RecursionError):
        path = _path()
        if path.is_file() and path.stat().st_size <= _MOST_BYTES:
            found = json.loads(path.read_text("utf-8"))
            return found if isinstance(found, dict) else {}
    return {}


def save_choices(choices: Mapping[str, Any]) -> None:
    """Store the choices of the screen; raises FileError if they cannot be written."""
    path = _path()
    try:
        replace_text(path, json.dumps(choices, ensure_ascii=False, indent=1))
    except OSError as error:
        raise FileError(f"{path} cannot be written: {reason_of(error)}") from error
