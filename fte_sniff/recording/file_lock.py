"""Locks that keep a second program from replacing a recording that is being written.

POSIX has `flock`. Windows locks ranges of bytes, and a locked byte cannot be read: there it is one
far behind the end of any file. A small module of its own: exports lock what they replace without
loading the mcap package.
"""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic, sleep
from typing import Final

from fte_sniff.errors import FileError
from fte_sniff.platform import POSIX, open_flags

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
