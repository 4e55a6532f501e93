"""Locks (flock) that keep a second program from replacing a recording that is being written.

A small module of its own: exports lock what they replace without loading the mcap package.
"""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from fte_sniff.errors import FileError


def _in_use(path: object) -> FileError:
    return FileError("{path} is being recorded to by another program; name another file", path=path)


def lock_replaced(path: Path) -> int | None:
    """A descriptor that keeps the lock of a file that is to be replaced; None if there is no file.

    Raises FileError if another program records to it.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return None
    lock(descriptor, path, fcntl.LOCK_SH)  # an exclusive lock needs write permission on NFS
    return descriptor


def locked(path: Path) -> int:
    """A locked descriptor of the recording that is to be replaced."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
    lock(descriptor, path)
    # Another program may have replaced it between the opening and the lock.
    if not os.path.samestat(os.fstat(descriptor), path.stat()):
        os.close(descriptor)
        raise _in_use(path)
    return descriptor


def lock(descriptor: int, path: Path, kind: int = fcntl.LOCK_EX) -> None:
    """Lock the file; if another program has it locked, close it and raise FileError."""
    try:
        fcntl.flock(descriptor, kind | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(descriptor)
        raise _in_use(path) from error
    except OSError:
        pass  # a file system without locks


def is_locked(descriptor: int) -> bool:
    """Whether another program has a file locked; False where locks do not work."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False  # a file system without locks
    fcntl.flock(descriptor, fcntl.LOCK_UN)
    return False
