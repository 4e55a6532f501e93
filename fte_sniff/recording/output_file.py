"""The file of a recording: its path, lock and identity; pipes; why a recording stopped.

A lock keeps a second program from replacing a file that is being written. POSIX has `flock`.
Windows locks ranges of bytes, and a locked byte cannot be read: there it is one far behind the end
of any file.

A file gets its name once its head is written (O_TMPFILE), so none is ever empty; what it replaces
stays until then. On file systems without O_TMPFILE (FAT, some network file systems) it has its name
at once. So it has on Windows, where an open file cannot get another name: what it replaces is moved
aside.

Another program may put its own file on the name at any time, or overwrite ours. So a file that is
to be deleted is known by its descriptor: device and inode, its size, and its last bytes, which hold
the checksum of the summary, for inodes are used again. Times do not count: `touch` does not make a
file another one.

    compare | rename to a private name | compare | delete
                                                 | or give the name back

Between the first comparison and the rename another file may get the name; the second comparison
finds it, because nobody else uses the private name.

The mcap package is not imported: text exports lock what they replace too.
"""

from __future__ import annotations

import errno
import os
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import Enum
from itertools import count
from pathlib import Path
from secrets import token_hex
from time import monotonic, sleep
from typing import Final, Protocol

from fte_sniff.errors import FileError, TranslatableText, reason_of, unwritable
from fte_sniff.platform import POSIX, open_flags, read_at

_RETRY_S: Final = 0.01

if POSIX:
    import fcntl
elif sys.platform == "win32":
    import ctypes
    import msvcrt
    from ctypes import wintypes

    class _Overlapped(ctypes.Structure):
        """`OVERLAPPED` of the Windows API: where a range begins."""

        _fields_ = (
            ("internal", ctypes.c_void_p),
            ("internal_high", ctypes.c_void_p),
            ("offset", wintypes.DWORD),
            ("offset_high", wintypes.DWORD),
            ("event", wintypes.HANDLE),
        )

    _FAIL_AT_ONCE, _EXCLUSIVE = 1, 2
    _ERROR_LOCK_VIOLATION = 33

    def _locked_byte(descriptor: int) -> tuple[wintypes.HANDLE, _Overlapped]:
        return wintypes.HANDLE(msvcrt.get_osfhandle(descriptor)), _Overlapped(offset_high=1 << 30)


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
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return None
    lock(descriptor, path, exclusive=False)  # an exclusive lock needs write permission on NFS
    return descriptor


def locked(path: Path) -> int:
    """A locked descriptor of the recording that is to be replaced."""
    descriptor = os.open(path, open_flags("O_WRONLY", "O_CLOEXEC", "O_NOFOLLOW"))
    lock(descriptor, path)
    # Another program may have replaced it between the opening and the lock.
    if not os.path.samestat(os.fstat(descriptor), path.stat()):
        os.close(descriptor)
        raise in_use(path)
    return descriptor


def lock(descriptor: int, path: Path, *, exclusive: bool = True) -> None:
    """Lock the file; if another program has it locked, close it and raise FileError."""
    try:
        _try_to_lock(descriptor, exclusive=exclusive)
    except BlockingIOError as error:
        os.close(descriptor)
        raise in_use(path) from error
    except OSError:
        pass  # a file system without locks


def is_locked(descriptor: int) -> bool:
    """Whether another program has a file locked; False where locks do not work."""
    try:
        _try_to_lock(descriptor, exclusive=False)
    except BlockingIOError:
        return True
    except OSError:
        return False  # a file system without locks
    _unlock(descriptor)
    return False


@contextmanager
def locked_folder(folder: Path, patience_s: float) -> Iterator[None]:
    """Context in which no other program has the folder locked, if the system can do that.

    Raises BlockingIOError if another program has it locked for longer than the patience.
    """
    try:
        descriptor = os.open(folder, open_flags("O_RDONLY", "O_CLOEXEC", "O_DIRECTORY"))
    except OSError:  # Windows opens no folders
        yield
        return
    try:
        deadline = monotonic() + patience_s
        while True:
            try:
                _try_to_lock(descriptor, exclusive=True)
            except BlockingIOError:
                if monotonic() >= deadline:
                    raise
                sleep(_RETRY_S)
            except OSError:
                break  # a file system without locks
            else:
                break
        yield
    finally:
        os.close(descriptor)


def _try_to_lock(descriptor: int, *, exclusive: bool) -> None:
    """Raises BlockingIOError if another program has it locked; returns at once."""
    if POSIX:
        fcntl.flock(descriptor, (fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH) | fcntl.LOCK_NB)
    elif sys.platform == "win32":
        kernel = ctypes.WinDLL("kernel32", use_last_error=True)
        handle, where = _locked_byte(descriptor)
        flags = _FAIL_AT_ONCE | (_EXCLUSIVE if exclusive else 0)
        if not kernel.LockFileEx(handle, flags, 0, 1, 0, ctypes.byref(where)):
            code = ctypes.get_last_error()
            kind = BlockingIOError if code == _ERROR_LOCK_VIOLATION else OSError
            raise kind(errno.EAGAIN, ctypes.FormatError(code))
    else:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))


def _unlock(descriptor: int) -> None:
    if POSIX:
        fcntl.flock(descriptor, fcntl.LOCK_UN)
    elif sys.platform == "win32":
        handle, where = _locked_byte(descriptor)
        ctypes.WinDLL("kernel32").UnlockFileEx(handle, 0, 1, 0, ctypes.byref(where))


_END = 64
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
        except (FileNotFoundError, NotADirectoryError):
            return False
        if not stat.S_ISREG(found.st_mode) or found.st_size != self.size:
            return False
        if (found.st_dev, found.st_ino) != (self.device, self.inode):
            return False
        try:
            descriptor = os.open(path, open_flags("O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC"))
        except FileNotFoundError:
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


def delete_own(path: Path, own: os.stat_result) -> None:
    """Delete the file of a descriptor if the path still leads to it; errors are ignored."""
    with suppress(OSError):
        if os.path.samestat(path.lstat(), own):
            path.unlink()
            sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Push a new, changed or deleted name to the disk, where the file system can do that."""
    with suppress(OSError):
        descriptor = os.open(folder, open_flags("O_CLOEXEC"))
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


class LostDataError(OSError):
    """Data that was appended earlier is lost."""


class CutOffError(LostDataError):
    """Another program has cut off the file: data after the cut is lost."""


class NoReaderError(LostDataError):
    """No program has opened the pipe for reading."""


class NotRestoredError(OSError):
    """A write failed, and so did restoring the file; it is valid, but holds unused bytes."""


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


class FileEnd(Protocol):
    """What a file ends with."""

    def at(self, start: int) -> bytes:
        """Its bytes for data that ends at `start`."""


class Stream:
    """A pipe, or another file that is written in sequence: the tail is written at the end."""

    def __init__(self, descriptor: int) -> None:
        """Take a descriptor, open for writing; the caller closes it."""
        self._descriptor = descriptor
        self._size = 0

    @property
    def size(self) -> int:
        """Bytes written so far."""
        return self._size

    def append(self, data: bytes, tail: Callable[[], FileEnd]) -> None:
        """Write data."""
        self._write(data)

    def close(self, tail: FileEnd) -> None:
        """Write the tail."""
        self._write(tail.at(self._size))

    def _write(self, data: bytes) -> None:
        view = memoryview(data)
        while view:
            written = os.write(self._descriptor, view)
            self._size += written
            view = view[written:]


MAX_UNREAD = 64 * 1024 * 1024
"""Bytes that wait for the reader of a named pipe, at most: hours of a fully used wire."""


class NamedPipe(Stream):
    """A named pipe; appended data stays in memory until a program opens the pipe for reading."""

    def __init__(self, path: Path) -> None:
        """Take an existing named pipe."""
        super().__init__(-1)
        self._path = path
        self._unread = bytearray()

    @property
    def size(self) -> int:
        """Bytes appended so far."""
        return self._size + len(self._unread)

    @property
    def is_open(self) -> bool:
        """True if the pipe has had a reader; otherwise this checks for one."""
        if self._descriptor < 0:
            try:
                flags = open_flags("O_WRONLY", "O_NONBLOCK", "O_CLOEXEC")
                self._descriptor = os.open(self._path, flags)
            except OSError as error:
                if error.errno != errno.ENXIO:
                    raise
                return False
            if POSIX:
                os.set_blocking(self._descriptor, True)
        return True

    def close(self, tail: FileEnd) -> None:
        """Write the tail; raises NoReaderError if nobody has opened the pipe."""
        self._write(tail.at(self.size))
        if self._unread:
            raise NoReaderError

    def release(self) -> None:
        """Close the pipe."""
        if self._descriptor >= 0:
            os.close(self._descriptor)

    def _write(self, data: bytes) -> None:
        self._unread += data
        if self.is_open:
            unread, self._unread = bytes(self._unread), bytearray()
            super()._write(unread)
        elif len(self._unread) > MAX_UNREAD:
            raise NoReaderError


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
