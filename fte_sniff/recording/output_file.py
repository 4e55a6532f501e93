"""The file of a recording: its name, lock and identity; why a recording stopped.

A file gets its name once its head is written, so none is ever empty; what it replaces stays until
then. On Windows, where an open file cannot get another name, it has its name at once.

Another program may put its own file on the name at any time, or overwrite ours. So a file that is
to be deleted is known by device and inode, its size, and its last bytes, which hold the checksum of
the summary, for inodes are used again:

    compare | rename to a private name | compare | delete
                                                 | or give the name back
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from itertools import count
from pathlib import Path
from secrets import token_hex
from typing import Final

from fte_sniff.errors import FileError, reason_of, unwritable
from fte_sniff.platform import POSIX, open_flags, read_at, sync_folder, try_to_lock


class Existing(Enum):
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


def in_use(path: object) -> FileError:
    """The error for a recording that another program writes."""
    return FileError("{path} is being recorded to by another program; name another file", path=path)


def lock_replaced(path: Path) -> int | None:
    """A descriptor that keeps the lock of a file that is to be replaced.

    None without a file, and on Windows, which does not replace an open file. Raises FileError
    if another program records to it.
    """
    if not POSIX:
        return None
    try:
        descriptor = os.open(path, open_flags("O_RDONLY", "O_CLOEXEC", "O_NOFOLLOW", "O_NONBLOCK"))
    except OSError:
        return None
    _lock(descriptor, path, exclusive=False)  # an exclusive lock needs write permission on NFS
    return descriptor


def _lock(descriptor: int, path: Path, *, exclusive: bool) -> None:
    """Lock the file; if another program has it locked, close it and raise FileError."""
    try:
        try_to_lock(descriptor, exclusive=exclusive)
    except BlockingIOError as error:
        os.close(descriptor)
        raise in_use(path) from error
    except OSError:
        pass  # a file system without locks


class OutputFile:
    """The file of one recording: new, locked, and named by `commit`."""

    def __init__(self, path: Path, existing: Existing) -> None:
        """Make the file, empty, under a private name.

        Raises FileError if another file has the name, it is in use, or the system refuses it.
        """
        self.path = path
        """The file's name once `commit` was called."""
        self._existing = existing
        self._replaced: int | None = None
        try:
            self._check()
            if existing is Existing.REPLACE and path.exists():
                self._replaced = lock_replaced(path)
            self._made = self._new()
        except OSError as error:
            self._unlock()
            raise unwritable(path, error) from error

    def _check(self) -> None:
        if self.path.is_dir():
            raise IsADirectoryError
        if not os.path.lexists(self.path):
            return
        # A link is not followed: its target would stay, or be a device.
        if not stat.S_ISREG(self.path.lstat().st_mode):
            raise FileError(
                "{path} is not a regular file, which a recording must be; name another",
                path=self.path,
            )
        if self._existing is Existing.REFUSE:
            raise FileExistsError

    def _new(self) -> Path:
        """Make the file, and return its name."""
        flags = open_flags("O_RDWR", "O_CREAT", "O_EXCL", "O_CLOEXEC")
        for path in file_names(self.path, self._existing):
            made = path.with_name(f".fte-sniff-{token_hex(8)}.part") if POSIX else path
            with suppress(FileExistsError):
                if not POSIX and self._existing is Existing.REPLACE:
                    path.unlink(missing_ok=True)
                self.descriptor = os.open(made, flags, 0o666)
                _lock(self.descriptor, path, exclusive=True)
                return made
        raise FileExistsError

    def commit(self) -> None:
        """Give the file its name; may raise OSError."""
        if not POSIX:
            self.path = self._made
        elif self._replaced is not None:
            with suppress(OSError):  # some file systems have no modes
                os.fchmod(self.descriptor, stat.S_IMODE(os.fstat(self._replaced).st_mode))
            self._made.replace(self.path)
        else:
            self.path = self._link()
        self._made = self.path
        self._unlock()
        sync_folder(self.path.parent)

    def _link(self) -> Path:
        for path in file_names(self.path, self._existing):
            with suppress(FileExistsError):
                try:
                    os.link(self._made, path, follow_symlinks=False)
                    self._made.unlink()
                except FileExistsError:
                    raise
                except OSError:  # a file system without hard links
                    if os.path.lexists(path):
                        continue
                    self._made.rename(path)
                return path
        raise FileExistsError

    def discard(self) -> None:
        """Delete the file; a file that it was to replace is kept."""
        self._unlock()
        os.close(self.descriptor)
        with suppress(OSError):
            self._made.unlink()

    def close(self) -> None:
        """Close the file, which also unlocks it."""
        os.close(self.descriptor)

    @property
    def identity(self) -> FileIdentity | None:
        """What the file is; None if it was deleted, or cannot be read."""
        with suppress(OSError):
            is_deleted = os.fstat(self.descriptor).st_nlink == 0
            return None if is_deleted else FileIdentity.of(self.descriptor)
        return None

    def check(self) -> None:
        """Raise DeletedError or MovedError if the path leads to the file no longer."""
        own = os.fstat(self.descriptor)
        if own.st_nlink == 0:
            raise DeletedError
        try:
            is_there = os.path.samestat(self.path.stat(), own)
        except OSError as error:
            is_there = not isinstance(error, FileNotFoundError | NotADirectoryError)
        if not is_there:
            raise MovedError

    def _unlock(self) -> None:
        if self._replaced is not None:
            os.close(self._replaced)
            self._replaced = None


_END: Final = 64
"""Bytes at the end of a recording that are compared: footer, checksum and magic."""


@dataclass(frozen=True, slots=True)
class FileIdentity:
    """A file that is closed."""

    device: int
    inode: int
    size: int
    end: bytes
    """Its last bytes."""

    @classmethod
    def of(cls, descriptor: int) -> FileIdentity:
        """The file of an open descriptor; raises OSError if it cannot be read."""
        found = os.fstat(descriptor)
        end = read_at(descriptor, _END, max(0, found.st_size - _END))
        return cls(found.st_dev, found.st_ino, found.st_size, end)

    def is_at(self, path: Path) -> bool:
        """Whether a path leads to this file; a symbolic link does not.

        Raises OSError if the file there cannot be read.
        """
        try:
            found = path.lstat()
            if (found.st_dev, found.st_ino, found.st_size) != (
                self.device,
                self.inode,
                self.size,
            ) or not stat.S_ISREG(found.st_mode):
                return False
            descriptor = os.open(path, open_flags("O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC"))
        except (FileNotFoundError, NotADirectoryError):
            return False
        try:
            return FileIdentity.of(descriptor) == self
        finally:
            os.close(descriptor)

    def delete(self, path: Path) -> bool:
        """Delete the file; False if another one, or none, is there, which is left alone.

        Raises OSError if it cannot be deleted.
        """
        if not self.is_at(path):
            return False
        private = path.with_name(f".fte-sniff-{token_hex(8)}{path.suffix}")
        try:
            path.rename(private)
        except FileNotFoundError:
            return False
        if not self.is_at(private):
            _give_back(private, path)
            return False
        try:
            private.unlink()
        except OSError:
            _give_back(private, path)
            raise
        sync_folder(path.parent)
        return True


def _give_back(private: Path, path: Path) -> None:
    """Rename a file back; if its name is taken already, it keeps the private one."""
    with suppress(OSError):
        os.link(private, path, follow_symlinks=False)
        private.unlink()
        return
    if not os.path.lexists(path):  # a file system without hard links
        with suppress(OSError):
            private.rename(path)


class LostDataError(OSError):
    """Data that was appended earlier is lost."""


class CutOffError(LostDataError):
    """Another program has cut off the file: data after the cut is lost."""


class DeletedError(LostDataError):
    """The file was deleted while it was being written."""


class MovedError(LostDataError):
    """The file was moved or replaced while it was being written."""


STOPPED: Final[Mapping[type[OSError], str]] = {
    CutOffError: "recording stopped: another program cut off {path} while it was being written; "
    "of its {rows:,} rows, those after the cut are lost; do not change the file while it is "
    "written",
    DeletedError: "recording stopped: {path} was deleted while it was being written; its {rows:,} "
    "rows are lost; start again, and do not delete the file",
    MovedError: "recording stopped: {path} was moved or replaced while it was being written; it "
    "had {rows:,} rows; start again, and do not move the file",
    OSError: "recording stopped: {reason}; {path} is complete up to there ({rows:,} rows); free "
    "space, or record elsewhere with -o",
}
"""Forms of the errors of a recording that the system does not let go on."""


def stopped_by_error(path: object, error: OSError, rows: int) -> FileError:
    """The error for a recording that the system does not let go on."""
    form = next(form for kind, form in STOPPED.items() if isinstance(error, kind))
    return FileError(form, path=path, rows=rows, reason=reason_of(error))
