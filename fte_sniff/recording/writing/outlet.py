"""Owns recordings to what cannot seek: standard output, a pipe, a device.

It must not know what is written. Nothing is made, replaced, locked or missed there; the recording
is whole once its end was written.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path

from fte_sniff.errors import FileError, unwritable
from fte_sniff.recording.container.growing import Growing, GrowingFile, Stream
from fte_sniff.recording.writing.place import Existing, Place

STDOUT = Path("-")
"""Stands for standard output."""


class Outlet:
    """One output that is written in sequence, with the ways of a `Place`."""

    left = deleted = False
    """Whether it is gone; an output that is shows by refusing what is written."""

    def __init__(self, path: Path) -> None:
        """Open it, which waits for whoever reads a named pipe.

        Raises:
            FileError: it cannot be opened, or is a terminal.
        """
        self.path = path
        try:
            standard = path == STDOUT
            self.descriptor = os.dup(1) if standard else os.open(path, os.O_WRONLY | os.O_NOCTTY)
        except OSError as error:
            raise unwritable(path, error) from error
        if os.isatty(self.descriptor):
            os.close(self.descriptor)
            raise FileError(
                f"{path} is a terminal, and a recording is nothing to look at; name a file with "
                "-o, or put a program or a file behind standard output"
            )

    def settle(self) -> None:
        """There is nothing to do."""

    def discard(self) -> None:
        """Close it; what was written cannot be taken back."""
        os.close(self.descriptor)

    def close(self) -> None:
        """Close it."""
        os.close(self.descriptor)


def is_outlet(path: Path) -> bool:
    """Whether what lies at `path` can only be written in sequence."""
    if path == STDOUT:
        return True
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return stat.S_ISFIFO(mode) or stat.S_ISCHR(mode)


def opened(path: Path, existing: Existing) -> tuple[Place | Outlet, Growing]:
    """Where a recording goes, and what its bytes are handed to.

    Raises:
        FileError: as `Place` and `Outlet`.
    """
    if is_outlet(path):
        outlet = Outlet(path)
        return outlet, Stream(outlet.descriptor)
    place = Place(path, existing)
    return place, GrowingFile(place.descriptor)
