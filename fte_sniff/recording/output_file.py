"""Path choice, existing files, pipes, refusals.

Whoever records holds a lock on the file (flock), so that no second program replaces what the first
still writes. A file has no name until it has a head, so whoever looks at the folder, or kills the
recording, finds none that is empty. One that is to be replaced stays until then: the head is
written to a file beside it, which then takes the name. On file systems that know no files without
names (FAT, some network file systems) a new file has its name from the beginning.
"""

from __future__ import annotations

import fcntl
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from enum import Enum
from itertools import count
from pathlib import Path

from fte_sniff.errors import FileError, TranslatableText, reason_of, unwritable
from fte_sniff.recording.mcap.append_file import AppendFile, AppendTarget, Stream


def no_regular_file(path: object) -> FileError:
    """What to tell the user when something that is no file stands where a recording should."""
    return FileError(
        "{path} is not a regular file, which a recording must be; name another", path=path
    )


def recorded_to(path: object) -> FileError:
    """What to tell the user when two programs would record to one file."""
    return FileError("{path} is being recorded to by another program; name another file", path=path)


def stopped(path: object, error: OSError, rows: int) -> FileError:
    """What to tell the user when a recording that was under way cannot go on."""
    if isinstance(error, BrokenPipeError):
        where = TranslatableText("standard output") if str(path) == "-" else path
        return FileError(
            "{where}: its reader is gone; the recording ended after {rows:,} rows",
            where=where,
            rows=rows,
        )
    return FileError(
        "recording stopped: {reason}; {path} is complete up to there "
        "({rows} rows); make room, or record elsewhere with -o",
        reason=reason_of(error),
        path=path,
        rows=rows,
    )


def taken_away(path: object, rows: int, *, deleted: bool) -> FileError:
    """What to tell the user when the file of a recording under way is not where it was."""
    if deleted:
        return FileError(
            "recording stopped: {path} was deleted while it was being written; the {rows} rows "
            "in it are lost; start again, and leave the file in its place",
            path=path,
            rows=rows,
        )
    return FileError(
        "recording stopped: {path} was moved or replaced while it was being written; "
        "the {rows} rows in it went with it; start again, and leave the file in its place",
        path=path,
        rows=rows,
    )


def bound_reached(path: object, bound: str, rows: int) -> FileError:
    """What to tell the user when a recording would take more of the disk than it may."""
    return FileError(
        "recording stopped: {bound}; {path} is complete up to there "
        "({rows} rows); make room, raise the bound, or let the oldest go "
        "with --on-full rotate-oldest",
        bound=bound,
        path=path,
        rows=rows,
    )


def not_recorded(what: str, reason: str) -> FileError:
    """What to tell the user at the end of a capture whose recording had gaps."""
    return FileError("{what} were not recorded: {reason}", what=what, reason=reason)


class Existing(Enum):
    """What to do with a file that is in the way of a new recording."""

    REFUSE = "refuse"
    REPLACE = "replace"
    NUMBER = "number"
    """Take the next free name: `x.mcap`, `x-2.mcap`, `x-3.mcap`..."""


class OutputPath:
    """The file of one recording, from its making to its close."""

    path: Path
    """Where the recording lies once `settle` was called."""
    descriptor: int
    """The file, empty at first, open for writing."""

    def __init__(self, path: Path, existing: Existing) -> None:
        """Make the file and lock it.

        Raises:
            FileError: the file is in the way or in use, or the system refuses it.
        """
        self.path = path
        self._existing = existing
        self._replaced: int | None = None
        self._made: Path | None = None
        try:
            if path.is_dir():
                raise IsADirectoryError
            # Not followed: a link's target would stay, or be a pipe that /dev/stdout leads to.
            if os.path.lexists(path) and not stat.S_ISREG(path.lstat().st_mode):
                raise no_regular_file(path)
            if existing is Existing.REPLACE and path.exists():
                self._replaced = _held(path)
                self.descriptor, self._made = _beside(path, self._replaced)
            else:
                self.descriptor, self._made = _new(path, existing)
                self.path = self._made or path
        except OSError as error:
            self._let_go()
            raise unwritable(path, error) from error

    def settle(self) -> None:
        """Give the file its name, now that it is worth having; may raise OSError."""
        if self._made is None:
            self.path = _named(self.descriptor, self.path, self._existing)
        elif self._made != self.path:
            self._made.replace(self.path)
        self._made = self.path
        self._let_go()

    def discard(self) -> None:
        """Take the file away again; what it was to replace is still there."""
        if self._made is not None:
            with suppress(OSError):
                self._made.unlink()
        self.close()

    def close(self) -> None:
        """Close the file, and with it let go of the lock."""
        self._let_go()
        os.close(self.descriptor)

    @property
    def deleted(self) -> bool:
        """Whether the file has no name any more, so that its bytes go when it is closed."""
        return os.fstat(self.descriptor).st_nlink == 0

    @property
    def left(self) -> bool:
        """Whether the file is no longer to be found where it should lie."""
        try:
            there = self.path.stat()
        except (FileNotFoundError, NotADirectoryError):
            return True
        except OSError:
            return self.deleted
        return not os.path.samestat(there, os.fstat(self.descriptor))

    def _let_go(self) -> None:
        if self._replaced is not None:
            os.close(self._replaced)
            self._replaced = None


def _new(wanted: Path, existing: Existing) -> tuple[int, Path | None]:
    """A locked descriptor of a file that was not there before, and its name if it has one yet."""
    if existing is not Existing.NUMBER and wanted.exists():
        raise FileExistsError
    with suppress(OSError):  # whatever else it is that does not work is told below
        descriptor = os.open(wanted.parent, os.O_TMPFILE | os.O_WRONLY | os.O_CLOEXEC, 0o666)
        _lock(descriptor, wanted)
        return descriptor, None
    for path in _names(wanted, existing):
        with suppress(FileExistsError):
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
            # Not removed where another program was quicker to lock it: that one replaces it.
            _lock(descriptor, path)
            return descriptor, path
    raise FileExistsError


def _named(descriptor: int, wanted: Path, existing: Existing) -> Path:
    """Name a file that has none; returns the name."""
    for path in _names(wanted, existing):
        with suppress(FileExistsError):
            # A folder is named so that the link in /proc is followed, which `link` alone does not.
            here = os.open(path.parent, os.O_DIRECTORY | os.O_CLOEXEC)
            try:
                os.link(f"/proc/self/fd/{descriptor}", path.name, dst_dir_fd=here)
            finally:
                os.close(here)
            return path
    raise FileExistsError


def _beside(path: Path, replaced: int) -> tuple[int, Path]:
    """A locked descriptor of a new file in the same folder, and its name."""
    descriptor, name = tempfile.mkstemp(".part", ".fte-sniff-", path.parent)
    with suppress(OSError):  # some file systems know no modes
        os.fchmod(descriptor, stat.S_IMODE(os.fstat(replaced).st_mode))
    _lock(descriptor, path)
    return descriptor, Path(name)


def _names(wanted: Path, existing: Existing) -> Iterator[Path]:
    """The names that the file may get, best first."""
    yield wanted
    if existing is Existing.NUMBER:
        for number in count(2):
            yield wanted.with_stem(f"{wanted.stem}-{number}")


def _held(path: Path) -> int:
    """A locked descriptor of the file that is to be replaced."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
    _lock(descriptor, path)
    # Another program may have replaced it between the opening and the lock.
    if not os.path.samestat(os.fstat(descriptor), path.stat()):
        os.close(descriptor)
        raise recorded_to(path)
    return descriptor


def _lock(descriptor: int, path: Path) -> None:
    """Lock the file, or close it and say that another program has it locked."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(descriptor)
        raise recorded_to(path) from error
    except OSError:
        pass  # a file system without locks; recording is worth more than the guard


STDOUT = Path("-")
"""Stands for standard output."""


class StreamOutput:
    """One output that is written in sequence, with the ways of a `OutputPath`."""

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


def opened(path: Path, existing: Existing) -> tuple[OutputPath | StreamOutput, AppendTarget]:
    """Where a recording goes, and what its bytes are handed to.

    Raises:
        FileError: as `OutputPath` and `StreamOutput`.
    """
    if is_outlet(path):
        outlet = StreamOutput(path)
        return outlet, Stream(outlet.descriptor)
    place = OutputPath(path, existing)
    return place, AppendFile(place.descriptor)
