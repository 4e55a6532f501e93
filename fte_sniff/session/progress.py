"""Progress: how far the reading of files has come."""

from __future__ import annotations

import stat
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(slots=True)
class Progress:
    """How far the reading of files has come; another thread may read it at any time."""

    step: str = ""
    """What happens before rows are read; empty then. May hold text from outside."""
    files: int = 0
    """Number of files; 0 before they are known."""
    files_done: int = 0
    size: int = 0
    """Bytes of all files; 0 if unknown."""
    position: int = 0
    """Bytes of them that were read."""
    rows: int = 0
    """Rows that were read."""

    def expect(self, sizes: Sequence[int | None]) -> None:
        """Set the files by their bytes; None if unknown."""
        self.files = len(sizes)
        self.size = 0 if None in sizes else sum(size or 0 for size in sizes)

    def advance(self, bytes_: int, rows: int = 0) -> None:
        """Add bytes and rows that were read."""
        self.position += bytes_
        self.rows += rows


def size_of(path: Path) -> int | None:
    """The bytes of a regular file; None if it is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_size if stat.S_ISREG(found.st_mode) else None
