"""A file that is written: its name, lock and identity; why a recording stopped.

A file gets its name once it is complete, a recording once its head is written, so none is ever
empty; what it replaces stays until then. On Windows, an open file cannot get another name: there
a recording is closed for that moment.

Another program may put its own file on the name at any time, or overwrite ours. So a file that is
to be deleted is known by its identity, of which the time of the last change is a part.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from enum import StrEnum
from itertools import count
from pathlib import Path
from secrets import token_hex
from typing import Final, NamedTuple

from fte_sniff.errors import FileError, TranslatableText, unwritable
from fte_sniff.platform import POSIX, is_locked, open_flags, sync_folder, try_to_lock

_CLOSED: Final = -1
"""The descriptor of a closed file."""


class Existing(StrEnum):
    """What to do if the file of a new recording exists."""

    REFUSE = "refuse"
    REPLACE = "replace"
    NUMBER = "number"
    """Use the next free name: `x.mcap`, `x-2.mcap`, `x-3.mcap`..."""


def file_names(wanted: Path, existing: Existing = Existing.NUMBER) -> Iterator[Path]:
    """The names to try: `x.mcap`, and with `NUMBER` also `x-2.mcap`, `x-3.mcap` and so on."""
    yield wanted
    if existing is Existing.NUMBER:
        for number in count(2):
            yield wanted.with_stem(f"{wanted.stem}-{number}")


class OutputFile:
    """A new file, which is locked, with a private name until it is complete: see `created`."""

    def __init__(self, path: Path, existing: Existing, mode: int) -> None:
        """A file that `create` makes."""
        self.path = path
        """The file's name once it is complete."""
        self._existing, self._mode = existing, mode
        self.descriptor = _CLOSED
        self.made = path.parent / f".fte-sniff-{token_hex(8)}.part"
        """The name that the file has before; nobody else has it."""
        self.identity: KnownFile | None = None
        """What the file is, once it is closed."""

    def create(self) -> None:
        """Make the file, empty.

        Raises OSError if another file has the name, or the system refuses it; FileError if another
        program records to the file, or it is not a regular file.
        """
        self._check()
        self._open(self.made, "O_CREAT", "O_EXCL")

    def _check(self) -> None:
        """Check that the file may have its name: that no other program records to it."""
        if self.path.is_dir():
            raise IsADirectoryError
        if not os.path.lexists(self.path):
            return
        # A link is not followed: its target would stay, or be a device.
        if self.path.is_symlink():
            link = "{path} is a link; name the file itself, or remove the link"
            raise FileError(link, path=self.path)
        if not self.path.is_file():
            raise FileError("{path} is not a regular file; name another", path=self.path)
        if self._existing is Existing.REFUSE:
            raise FileExistsError
        if self._existing is Existing.REPLACE:
            with suppress(OSError), self.path.open("rb") as file:
                if is_locked(file.fileno()):
                    raise FileError(
                        "{path} is being recorded to by another program; name another file",
                        path=self.path,
                    )

    def _open(self, path: Path, *flags: str) -> None:
        flags = ("O_RDWR", "O_CLOEXEC", "O_NOFOLLOW", *flags)
        self.descriptor = os.open(path, open_flags(*flags), self._mode)
        with suppress(OSError):  # a file system without locks
            try_to_lock(self.descriptor)

    def commit(self) -> None:
        """Give the file its name; raises OSError, and FileError if another program has the name."""
        if not POSIX:  # an open file cannot get another name
            self.close()
        if self._existing is Existing.REPLACE:
            self._check()  # another file may have the name by now
            self.made.replace(self.path)
        else:
            self.path = self._link()
        if not POSIX:
            self._open(self.path)
            self.identity = None
        sync_folder(self.path.parent)

    def _link(self) -> Path:
        """Give the file the first name that is free, and return it."""
        for path in file_names(self.path, self._existing):
            with suppress(FileExistsError):
                try:
                    os.link(self.made, path, follow_symlinks=False)
                except PermissionError:  # a file system without hard links
                    if os.path.lexists(path):
                        continue
                    self.made.rename(path)
                else:
                    self.made.unlink()
                return path
        raise FileExistsError

    def close(self) -> None:
        """Close the file, which also unlocks it. Closing again does nothing."""
        if self.descriptor != _CLOSED:
            self.identity = KnownFile.of(self.path, os.fstat(self.descriptor))
            os.close(self.descriptor)
            self.descriptor = _CLOSED

    def check(self, least: int) -> None:
        """Raise LostDataError unless the path leads to the file, with this size at least."""
        own = os.fstat(self.descriptor)
        try:
            is_there = os.path.samestat(self.path.stat(), own)
        except OSError as error:
            is_there = not isinstance(error, FileNotFoundError | NotADirectoryError)
        if not is_there or own.st_size < least:
            raise LostDataError


@contextmanager
def created(path: Path, existing: Existing, mode: int = 0o666) -> Iterator[OutputFile]:
    """A new file, which gets its name at the end of the block, and stays open.

    If the block fails or is interrupted, no new file remains, and an existing one is kept.
    Raises FileError if the system refuses the file, or anything in the block.
    """
    file = OutputFile(path, existing, mode)
    try:
        file.create()
        yield file
        file.commit()
    except BaseException as error:
        file.close()
        with suppress(OSError):
            file.made.unlink()
        if isinstance(error, OSError):
            raise unwritable(path, error) from error
        raise


class KnownFile(NamedTuple):
    """A closed file, with what distinguishes it from any other."""

    path: Path
    device: int
    inode: int
    size: int
    changed_ns: int

    @classmethod
    def of(cls, path: Path, found: os.stat_result) -> KnownFile:
        """The file at a path, which has this status."""
        return cls(path, found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns)

    def delete(self) -> None:
        """Delete the file if that is possible; another file at its path, or a link, stays."""
        with suppress(OSError):
            if KnownFile.of(self.path, self.path.lstat()) == self:
                self.path.unlink()
                sync_folder(self.path.parent)


class LostDataError(OSError):
    """Another program deleted, moved, replaced or cut off the file."""

    def __init__(self) -> None:
        super().__init__(TranslatableText("the file was deleted, moved, replaced or cut off"))


STOPPED: Final[Mapping[type[OSError], str]] = {
    LostDataError: "recording stopped: {path} was deleted, moved, replaced or cut off while it was "
    "being written, and its {rows:,} rows may be lost; leave the file as it is until the end",
    OSError: "recording stopped: {reason}; {path} is complete up to there ({rows:,} rows); free "
    "space, or record elsewhere with -o",
}
"""Forms of the errors of a recording that the system does not let go on."""
