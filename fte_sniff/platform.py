"""What this system has: Windows lacks modules, functions, signals and open flags of POSIX.

All other code uses them only where `POSIX` is true; `.ci/windows.ini` lets mypy check this.
"""

from __future__ import annotations

import os
import signal
from threading import Lock
from typing import Final

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
