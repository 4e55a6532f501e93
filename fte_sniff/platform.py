"""What this system has: Windows lacks modules, functions, signals and open flags of POSIX.

All other code uses them only where `POSIX` is true; `.ci/windows.ini` lets mypy check this.
"""

from __future__ import annotations

import errno
import os
import select
import signal
import sys
from contextlib import suppress
from pathlib import Path
from threading import Lock
from typing import BinaryIO, Final

try:
    import termios
except ImportError:
    POSIX = False
    """Whether there are terminals with job control, `fcntl`, and signals between processes."""
    TerminalError: type[Exception] = OSError
    """What a terminal raises besides OSError."""
else:
    POSIX = True
    TerminalError = termios.error


def signals(*names: str) -> tuple[signal.Signals, ...]:
    """The signals with these names, as far as this system has them."""
    return tuple(getattr(signal, name) for name in names if hasattr(signal, name))


HANG_UP: Final = signals("SIGHUP", "SIGBREAK")
"""Signals of a closed terminal or console."""

ENDING_SIGNALS: Final = (*signals("SIGINT", "SIGTERM"), *HANG_UP)
"""Signals that end a capture or a screen: Ctrl-C, `kill`, and a closed terminal."""


def open_flags(*names: str) -> int:
    """The flags of `os.open` with these names, as far as this system has them; binary mode."""
    return sum(getattr(os, name, 0) for name in {*names, "O_BINARY"})


_position = Lock()


def read_at(descriptor: int, length: int, offset: int) -> bytes:
    """Read up to `length` bytes at `offset`; the position of the file does not change."""
    if POSIX:
        return os.pread(descriptor, length, offset)
    with _position:
        before = os.lseek(descriptor, 0, os.SEEK_CUR)
        os.lseek(descriptor, offset, os.SEEK_SET)
        try:
            return os.read(descriptor, length)
        finally:
            os.lseek(descriptor, before, os.SEEK_SET)


def write_at(descriptor: int, data: bytes | memoryview, offset: int) -> int:
    """Write at `offset`, and return the number of bytes written."""
    if POSIX:
        return os.pwrite(descriptor, data, offset)
    with _position:
        os.lseek(descriptor, offset, os.SEEK_SET)
        return os.write(descriptor, data)


def sync_data(descriptor: int) -> None:
    """Wait until the bytes of a file are on the disk."""
    if POSIX:
        os.fdatasync(descriptor)
    else:
        os.fsync(descriptor)


def is_silent(stream: BinaryIO | None, seconds: float = 1.0) -> bool:
    """Whether a pipe has nothing more to read for some time; False where that is unknown."""
    if stream is None or not POSIX:
        return False
    with suppress(OSError, ValueError):  # bytes in memory
        return not select.select([stream], [], [], seconds)[0]
    return False


def sync_folder(folder: Path) -> None:
    """Push a new, changed or deleted name to the disk, where the file system can do that."""
    with suppress(OSError):
        descriptor = os.open(folder, open_flags("O_CLOEXEC"))
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


# Locks: POSIX has `flock`. Windows locks ranges of bytes for one program, and a locked byte cannot
# be read: there it is one far behind the end of any file.

if POSIX:
    import fcntl
elif sys.platform == "win32":
    import msvcrt

    def _lock_byte(descriptor: int, mode: int) -> None:
        with _position:
            before = os.lseek(descriptor, 0, os.SEEK_CUR)
            os.lseek(descriptor, 1 << 30, os.SEEK_SET)
            try:
                msvcrt.locking(descriptor, mode, 1)
            except PermissionError as error:
                raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN)) from error
            finally:
                os.lseek(descriptor, before, os.SEEK_SET)


def try_to_lock(descriptor: int, *, exclusive: bool = True) -> None:
    """Lock a file until it is closed; returns at once. On Windows each lock is exclusive.

    Raises BlockingIOError if another program has it locked, and OSError on a file system without
    locks.
    """
    if POSIX:
        fcntl.flock(descriptor, (fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH) | fcntl.LOCK_NB)
    elif sys.platform == "win32":
        _lock_byte(descriptor, msvcrt.LK_NBLCK)
    else:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))


def is_locked(descriptor: int) -> bool:
    """Whether another program has a file locked; False where locks do not work."""
    try:
        try_to_lock(descriptor, exclusive=False)
    except BlockingIOError:
        return True
    except OSError:
        return False  # a file system without locks
    if POSIX:
        fcntl.flock(descriptor, fcntl.LOCK_UN)
    elif sys.platform == "win32":
        _lock_byte(descriptor, msvcrt.LK_UNLCK)
    return False
