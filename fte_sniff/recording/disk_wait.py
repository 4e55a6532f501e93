"""Time that writing waits for the disk, and not for a processor.

Of the time that a system call takes, the thread runs, waits until a processor is free, or waits for
the disk. Linux counts the first two:

    /proc/self/task/ID/schedstat   nanoseconds run | nanoseconds waited for a processor | times
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class _Call:
    """A system call under way."""

    thread: int
    began_s: float
    busy_s: float
    """Seconds that the thread had run or waited for a processor at the beginning."""

    def waited_s(self) -> float:
        busy_s = _busy_s(self.thread) - self.busy_s
        return max(0.0, time.monotonic() - self.began_s - busy_s)


class DiskWait:
    """The sum of the waits of one thread's calls; another thread may read it at any time."""

    def __init__(self) -> None:
        self._ended_s = 0.0
        self._call: _Call | None = None

    @property
    def seconds(self) -> float:
        """Seconds since the beginning, with those of a call that is under way."""
        ended_s, call = self._ended_s, self._call
        return ended_s + (0.0 if call is None else call.waited_s())

    @contextmanager
    def call(self) -> Iterator[None]:
        """Count the system call in this context."""
        thread = threading.get_native_id()
        self._call = call = _Call(thread, time.monotonic(), _busy_s(thread))
        try:
            yield
        finally:
            self._call = None
            self._ended_s += call.waited_s()


def _busy_s(thread: int) -> float:
    """Seconds that a thread of this process ran or waited for a processor; 0 if unknown."""
    try:
        ran, queued, _ = Path(f"/proc/self/task/{thread}/schedstat").read_bytes().split()
    except (OSError, ValueError):  # another system
        return 0.0
    return (int(ran) + int(queued)) / 1e9
