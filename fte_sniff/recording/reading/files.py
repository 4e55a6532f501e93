"""Owns which recordings a user means by a name, a folder or a pattern, and their order.

It must not know what is read from them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from fte_sniff.errors import FileError
from fte_sniff.recording.reading.reader import RecordingReader

SUFFIX = ".mcap"
"""How the names of recordings end."""

_PATTERN = frozenset("*?[")
_LATEST = 2**64


def recordings_in(paths: Iterable[Path]) -> list[Path]:
    """The files that paths mean: each file itself, a folder's recordings, a pattern's matches.

    Raises:
        FileError: a folder holds no recording, or nothing matches a pattern.
    """
    return list(dict.fromkeys(found for path in paths for found in files_of(path)))


def files_of(path: Path) -> Iterator[Path]:
    """The files that one path means, sorted by name; raises as `recordings_in`."""
    if path.is_dir():
        found = sorted(entry for entry in path.glob(f"*{SUFFIX}") if entry.is_file())
        if not found:
            raise FileError(f"{path} is a directory, and there is no recording (*{SUFFIX}) in it")
        yield from found
    elif _PATTERN.intersection(str(path)) and not path.exists():
        start = Path(path.anchor)
        found = sorted(start.glob(str(path.relative_to(start))))
        if not found:
            raise FileError(f"{path}: no file matches this pattern; check the name and the folder")
        yield from found
    else:
        yield path


def start_of(reader: RecordingReader) -> tuple[int, str]:
    """By what recordings are put in order: their first time, then their name."""
    return reader.times[0] if reader.times else _LATEST, str(reader.path)
