"""Path choice, existing files, pipes, refusals.

A lock (flock) keeps a second program from replacing a file that is being written. A file gets its
name once its head is written (O_TMPFILE), so none is ever empty; what it replaces stays until then.
On file systems without O_TMPFILE (FAT, some network file systems) it has its name at once. So it
has on Windows, where an open file cannot get another name: what it replaces is moved aside.
"""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import suppress
from enum import Enum
from itertools import count
from pathlib import Path
from typing import Final

from fte_sniff.errors import FileError, TranslatableText, reason_of, unwritable
from fte_sniff.platform import POSIX, open_flags
from fte_sniff.recording.file_identity import FileIdentity, delete_own, sync_folder
from fte_sniff.recording.file_lock import in_use, lock, locked
from fte_sniff.recording.mcap.append_file import (
    AppendFile,
    AppendTarget,
    CutOffError,
    LostDataError,
    NamedPipe,
    NoReaderError,
    NotRestoredError,
    Stream,
)


class DeletedError(LostDataError):
    """The file was deleted while it was being written."""


class MovedError(LostDataError):
    """The file was moved or replaced while it was being written."""


STOPPED: Final[Mapping[type[OSError], str]] = {
    BrokenPipeError: "{path}: its reader is gone; the recording ended after {rows:,} rows",
    NoReaderError: "no program has opened {path} for reading, so its {rows:,} rows are lost; "
    "start the reader, or record to a file",
    CutOffError: "recording stopped: another program cut off {path} while it was being written; "
    "of its {rows:,} rows, those after the cut are lost; do not change the file while it is "
    "written",
    DeletedError: "recording stopped: {path} was deleted while it was being written; its {rows:,} "
    "rows are lost; start again, and do not delete the file",
    MovedError: "recording stopped: {path} was moved or replaced while it was being written; it "
    "had {rows:,} rows; start again, and do not move the file",
    NotRestoredError: "recording stopped: {reason}; {path} has the {rows:,} rows up to there, but "
    "also bytes of the failed write; copy it with `fte-sniff decode {path} -o NAME.mcap`",
    OSError: "recording stopped: {reason}; {path} is complete up to there ({rows:,} rows); free "
    "space, or record elsewhere with -o",
}
"""Forms of the errors of a recording that the system does not let go on."""


def stopped_by_error(path: object, error: OSError, rows: int) -> FileError:
    """The error for a recording that the system does not let go on."""
    form = next(form for kind, form in STOPPED.items() if isinstance(error, kind))
    if isinstance(error, BrokenPipeError) and str(path) == "-":
        path = TranslatableText("standard output")
    return FileError(form, path=path, rows=rows, reason=reason_of(error))


def stopped_by_limit(
    path: object, limit: str, rows: int, *, deletes_oldest: bool, undeleted: str = ""
) -> FileError:
    """The error for a recording that reached a limit, and that had no older file to delete.

    `undeleted` names an older file that could not be deleted, and why.
    """
    if undeleted:
        return FileError(
            "recording stopped: {limit}; {path} is complete up to there ({rows:,} rows), and "
            "{undeleted}; free space, or change the limit",
            limit=limit,
            path=path,
            rows=rows,
            undeleted=undeleted,
        )
    if deletes_oldest:
        return FileError(
            "recording stopped: {limit}; {path} is complete up to there ({rows:,} rows), and no "
            "older file of this capture is left to delete; free space, or change the limit",
            limit=limit,
            path=path,
            rows=rows,
        )
    return FileError(
        "recording stopped: {limit}; {path} is complete up to there ({rows:,} rows); free space, "
        "change the limit, or delete the oldest files with --on-full rotate-oldest",
        limit=limit,
        path=path,
        rows=rows,
    )


class Existing(Enum):
    """What to do if the file of a new recording exists."""

    REFUSE = "refuse"
    REPLACE = "replace"
    NUMBER = "number"
    """Use the next free name: `x.mcap`, `x-2.mcap`, `x-3.mcap`..."""


class OutputPath:
    """The file of one recording."""

    waits_for_reader = False
    path: Path
    """The file's name once `commit` was called."""
    descriptor: int
    """The file, empty at first, open for reading and writing."""

    def __init__(self, path: Path, existing: Existing) -> None:
        """Make the file and lock it.

        Raises FileError if another file has the name, it is in use, or the system refuses it.
        """
        self.path = path
        self._existing = existing
        self._replaced: int | None = None
        self._aside: Path | None = None
        self._made: Path | None = None
        try:
            if path.is_dir():
                raise IsADirectoryError
            # Not followed: a link's target would stay, or be a pipe that /dev/stdout leads to.
            if os.path.lexists(path) and not stat.S_ISREG(path.lstat().st_mode):
                raise FileError(
                    "{path} is not a regular file, which a recording must be; name another",
                    path=path,
                )
            if existing is Existing.REPLACE and path.exists():
                if POSIX:
                    self._replaced = locked(path)
                    self.descriptor, self._made = _temporary(path, self._replaced)
                else:
                    self._aside = _moved_aside(path)
                    self.descriptor, self._made = _new(path, Existing.REFUSE)
            else:
                self.descriptor, self._made = _new(path, existing)
                self.path = self._made or path
        except OSError as error:
            self._restore_replaced()
            raise unwritable(path, error) from error

    def commit(self) -> None:
        """Give the file its name; may raise OSError."""
        if self._made is None:
            self.path = _link(self.descriptor, self.path, self._existing)
        elif self._made != self.path:
            self._made.replace(self.path)
        self._made = self.path
        self._unlock_replaced()
        if self._aside is not None:
            with suppress(OSError):
                self._aside.unlink()
            self._aside = None
        sync_folder(self.path.parent)

    def discard(self) -> None:
        """Delete the file; a file that it was to replace is kept."""
        own = os.fstat(self.descriptor)
        if not POSIX:
            os.close(self.descriptor)  # an open file cannot be deleted there
        if self._made is not None:
            delete_own(self._made, own)
        self._restore_replaced()
        if POSIX:
            os.close(self.descriptor)

    def close(self) -> None:
        """Close the file, which also unlocks it."""
        self._unlock_replaced()
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

    def _restore_replaced(self) -> None:
        self._unlock_replaced()
        if self._aside is not None:
            self._aside.replace(self.path)

    def _unlock_replaced(self) -> None:
        if self._replaced is not None:
            os.close(self._replaced)
            self._replaced = None


def _new(wanted: Path, existing: Existing) -> tuple[int, Path | None]:
    """A locked descriptor of a new file, and its name if it has one yet."""
    if existing is not Existing.NUMBER and wanted.exists():
        raise FileExistsError
    with suppress(OSError):  # other errors appear again below
        descriptor = os.open(wanted.parent, open_flags("O_TMPFILE", "O_RDWR", "O_CLOEXEC"), 0o666)
        lock(descriptor, wanted)
        return descriptor, None
    for path in file_names(wanted, existing):
        with suppress(FileExistsError):
            flags = open_flags("O_RDWR", "O_CREAT", "O_EXCL", "O_CLOEXEC")
            descriptor = os.open(path, flags, 0o666)
            # Not removed if another program locked it first: that one replaces it.
            lock(descriptor, path)
            return descriptor, path
    raise FileExistsError


def _link(descriptor: int, wanted: Path, existing: Existing) -> Path:
    for path in file_names(wanted, existing):
        with suppress(FileExistsError):
            # `dst_dir_fd` makes Python call linkat, which follows the link in /proc.
            folder = os.open(path.parent, open_flags("O_DIRECTORY", "O_CLOEXEC"))
            try:
                os.link(f"/proc/self/fd/{descriptor}", path.name, dst_dir_fd=folder)
            finally:
                os.close(folder)
            return path
    raise FileExistsError


def _moved_aside(path: Path) -> Path:
    """The new name of a file that is to be replaced, which fails while a program has it open."""
    aside = path.with_name(f".fte-sniff-{path.name}.old")
    try:
        path.replace(aside)
    except PermissionError as error:
        raise in_use(path) from error
    return aside


def _temporary(path: Path, replaced: int) -> tuple[int, Path]:
    """A locked descriptor of a new file in the same folder, and its name."""
    descriptor, name = tempfile.mkstemp(".part", ".fte-sniff-", path.parent)
    with suppress(OSError):  # some file systems have no modes
        Path(name).chmod(stat.S_IMODE(os.fstat(replaced).st_mode))
    lock(descriptor, path)
    return descriptor, Path(name)


def file_names(wanted: Path, existing: Existing = Existing.NUMBER) -> Iterator[Path]:
    """The names to try: `x.mcap`, and with `NUMBER` also `x-2.mcap`, `x-3.mcap` and so on."""
    yield wanted
    if existing is Existing.NUMBER:
        for number in count(2):
            yield wanted.with_stem(f"{wanted.stem}-{number}")


STDOUT = Path("-")


class StreamOutput:
    """Standard output, a pipe or a device, with the interface of `OutputPath`."""

    identity = None

    def __init__(self, path: Path) -> None:
        """Open it; raises FileError if it cannot be opened, or is a terminal."""
        self.path = path
        self._pipe = NamedPipe(path) if path != STDOUT and path.is_fifo() else None
        self._descriptor = -1
        if self._pipe is not None:
            self.target: Stream = self._pipe
            return
        try:
            is_stdout = path == STDOUT
            flags = open_flags("O_WRONLY", "O_NOCTTY")
            self._descriptor = os.dup(1) if is_stdout else os.open(path, flags)
        except OSError as error:
            raise unwritable(path, error) from error
        if os.isatty(self._descriptor):
            os.close(self._descriptor)
            raise FileError(
                f"{path} is a terminal, which cannot show a recording; name a file with -o, or "
                "redirect standard output to a program or a file"
            )
        self.target = Stream(self._descriptor)

    @property
    def waits_for_reader(self) -> bool:
        """Whether it is a named pipe that nobody has opened for reading."""
        return self._pipe is not None and not self._pipe.is_open

    def commit(self) -> None:
        """Do nothing."""

    check = commit
    """Writing to a stream without a reader fails."""

    def close(self) -> None:
        """Close it."""
        if self._pipe is not None:
            self._pipe.release()
        else:
            os.close(self._descriptor)

    discard = close


def is_stream(path: Path) -> bool:
    """Whether the output can only be written in sequence."""
    if path == STDOUT:
        return True
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return stat.S_ISFIFO(mode) or stat.S_ISCHR(mode)


def open_output(path: Path, existing: Existing) -> tuple[OutputPath | StreamOutput, AppendTarget]:
    """Open the output of a recording, and the target of its bytes.

    Raises FileError as `OutputPath` and `StreamOutput`.
    """
    if is_stream(path):
        stream = StreamOutput(path)
        return stream, stream.target
    output = OutputPath(path, existing)
    return output, AppendFile(output.descriptor)
