"""The recordings that paths name: files, folders and patterns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import Final, TypeAlias

from fte_sniff.errors import FileError, unreadable

Paths: TypeAlias = str | PathLike[str] | Sequence[str | PathLike[str]]
"""A path, or several of them."""

_SUFFIX: Final = ".mcap"
_PATTERN: Final = frozenset("*?[")


def recordings_in(paths: Paths) -> list[Path]:
    """The files of paths, each once: see `files_of`."""
    listed = [paths] if isinstance(paths, str | PathLike) else paths
    return list(dict.fromkeys(found for path in listed for found in files_of(Path(path))))


def files_of(path: Path) -> Iterator[Path]:
    """The file itself, the recordings in a folder, or the matches of a pattern, sorted by name.

    Raises FileError if the folder holds no recording, nothing matches the pattern, or the names
    cannot be read.
    """
    try:
        yield from _found(path)
    except OSError as error:
        raise unreadable(path, error) from error


def _found(path: Path) -> Iterator[Path]:
    if path.is_dir():
        start, pattern = path, f"*{_SUFFIX}"
    elif _PATTERN.intersection(str(path)) and not path.exists():
        start, pattern = Path(path.anchor), str(path.relative_to(path.anchor))
    else:
        yield path
        return
    found = sorted(one for one in start.glob(pattern) if one.is_file())
    if not found:
        raise FileError(f"{path}: no file matches {pattern}; check the name and the folder")
    yield from found
