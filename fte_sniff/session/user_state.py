"""What the program stores for a user, as JSON in the state folder: places of views, screen choices.

views.json is a list by files, newest last; screen.json has the choices of the screen that differ
from the settings. A file that another version or a damage made unreadable counts as empty.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from platformdirs import user_state_path

from fte_sniff.errors import FileError, reason_of
from fte_sniff.session.notes import RowKey
from fte_sniff.session.save import replace_text

_MOST_BYTES: Final = 10_000_000
MOST_PLACES: Final = 200
"""Views whose place is kept."""


def _path(name: str) -> Path:
    return user_state_path("fte-sniff", appauthor=False) / f"{name}.json"


def _read(name: str) -> dict[str, Any]:
    with suppress(OSError, ValueError, RecursionError):
        path = _path(name)
        if path.is_file() and path.stat().st_size <= _MOST_BYTES:
            found = json.loads(path.read_text("utf-8"))
            return found if isinstance(found, dict) else {}
    return {}


def _write(name: str, content: Mapping[str, Any]) -> None:
    """Replace a file; raises FileError."""
    path = _path(name)
    try:
        replace_text(path, json.dumps(content, ensure_ascii=False, indent=1))
    except OSError as error:
        raise FileError(f"{path} cannot be written: {reason_of(error)}") from error


@dataclass(frozen=True, slots=True)
class Place:
    """Where a view was left."""

    filter: str = ""
    columns: tuple[str, ...] | None = None
    cursor: RowKey | None = None


START: Final = Place()
"""The place of a view that is opened for the first time."""


def _view_key(files: Iterable[Path]) -> str:
    return "\n".join(str(file.resolve()) for file in files)


def read_place(files: Iterable[Path]) -> Place:
    """Where the view of these files was left; the start if that is unknown."""
    match _read("views").get(_view_key(files)):
        case {"filter": str(text), "columns": columns, "cursor": cursor}:
            with suppress(TypeError, ValueError):
                return Place(
                    text,
                    None if columns is None else tuple(map(str, columns)),
                    None if cursor is None else RowKey(str(cursor[0]), *map(int, cursor[1:2])),
                )
    return START


def save_place(files: Iterable[Path], place: Place) -> None:
    """Keep where the view of these files was left; raises FileError if that cannot be written."""
    places, key = _read("views"), _view_key(files)
    places.pop(key, None)
    places[key] = asdict(place)
    _write("views", dict(list(places.items())[-MOST_PLACES:]))


def read_choices() -> dict[str, Any]:
    """The choices of the screen by name, as they were stored; `filters` are texts by name."""
    return _read("screen")


def save_choices(choices: Mapping[str, Any]) -> None:
    """Store the choices of the screen; raises FileError if they cannot be written."""
    _write("screen", choices)
