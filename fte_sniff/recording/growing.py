"""Owns how the bytes of a recording come to the disk, so that the file never ends wrong.

It must not know what chunks are. A file that grows consists of data, and of a tail behind it which
tells where everything stands; new data goes where the old tail began, and a new tail behind it.

One write of both would be the end of the matter if a write were one thing. It is not: a process
that is killed within it leaves the pages before, a power cut leaves any of them, and either leaves
a file that ends in the middle. So a guard is put behind the place of the write first, a second copy
of the old tail's index, and cut off when the write is done:

    1   data | tail |           . . .           | footer
    2   data | tail |           . . . | summary | footer       the guard
    3   data | new data | new tail | .| summary | footer
    4   data | new data | new tail |

In 1 the footer points at the old tail's summary, from 2 to 3 at the guard's, in 4 at the new one.
Each step of 1, 2 and 4 is too small to be left half done: a footer lies within one sector, and a
length is one number. Between the steps that a power cut could put in another order stands a
barrier. Whoever opens the file by its end, as all tools do, finds a whole index in each state.
"""

from __future__ import annotations

import os
from contextlib import suppress
from typing import Protocol

from fte_sniff.recording.tail import END_LENGTH, Tail

_SECTOR = 512

LARGEST_BARRED = 256 * 1024
"""Bytes of guard that are pushed to the disk; a larger one guards against a kill alone."""


class Growing(Protocol):
    """Takes what a file grows by. Methods may raise OSError."""

    @property
    def size(self) -> int:
        """Bytes in the file."""
        ...

    def grow(self, data: bytes, tail: Tail) -> None:
        """Put `data` behind the data that is there, and `tail` behind it."""
        ...

    def end(self, tail: Tail) -> None:
        """Let the file end with `tail`, if it does not."""
        ...


class GrowingFile:
    """A regular file, which is whole after each step.

    If growing fails the file is as it was before, as far as the disk still obeys.
    """

    def __init__(self, descriptor: int) -> None:
        """Take an empty file, open for writing; it stays the caller's."""
        self._descriptor = descriptor
        self._end = 0
        self._tail: Tail | None = None
        self._tail_bytes = b""

    @property
    def size(self) -> int:
        """Bytes in the file, its tail included."""
        return self._end + len(self._tail_bytes)

    def grow(self, data: bytes, tail: Tail) -> None:
        """Put `data` where the old tail began, `tail` behind it, and push both to the disk."""
        end = self._end + len(data)
        tail_bytes = tail.at(end)
        stop = end + len(tail_bytes)
        try:
            guarded = self._guard(stop)
            try:
                _write_at(self._descriptor, data + tail_bytes, self._end)
                if guarded:
                    os.fdatasync(self._descriptor)
                    os.ftruncate(self._descriptor, stop)
                os.fdatasync(self._descriptor)
            except OSError:
                self._restore_tail()
                raise
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._descriptor, self.size)
            raise
        self._end, self._tail, self._tail_bytes = end, tail, tail_bytes

    def end(self, tail: Tail) -> None:
        """Let the file end with `tail`, if it does not."""
        if self._tail != tail:
            self.grow(b"", tail)

    def _guard(self, stop: int) -> bool:
        """Put the old index behind `stop` and behind the file's end; False if there is none yet."""
        if self._tail is None:
            return False
        start = max(stop, self.size)
        start += _room_for_footer(start + self._tail.index_length)
        index = self._tail.index_at(start)
        footer_at = start + len(index) - END_LENGTH
        _write_at(self._descriptor, self._tail.end_for(self._end), footer_at)
        _write_at(self._descriptor, index[:-END_LENGTH], start)
        _write_at(self._descriptor, index[-END_LENGTH:], footer_at)
        if len(index) <= LARGEST_BARRED:
            os.fdatasync(self._descriptor)
        return True

    def _restore_tail(self) -> None:
        with suppress(OSError):
            _write_at(self._descriptor, self._tail_bytes, self._end)


class Stream:
    """A pipe or another thing that is written in sequence: the tail comes when all is there."""

    def __init__(self, descriptor: int) -> None:
        """Take a descriptor that is open for writing; it stays the caller's."""
        self._descriptor = descriptor
        self._size = 0

    @property
    def size(self) -> int:
        """Bytes written so far."""
        return self._size

    def grow(self, data: bytes, tail: Tail) -> None:
        """Write `data`; the tail waits for the end."""
        self._write(data)

    def end(self, tail: Tail) -> None:
        """Write the tail."""
        self._write(tail.at(self._size))

    def _write(self, data: bytes) -> None:
        view = memoryview(data)
        while view:
            written = os.write(self._descriptor, view)
            self._size += written
            view = view[written:]


def _room_for_footer(stop: int) -> int:
    """How far a footer that ends at `stop` must be moved to lie within one sector."""
    into = stop % _SECTOR
    return END_LENGTH - into if 0 < into < END_LENGTH else 0


def _write_at(descriptor: int, data: bytes, offset: int) -> None:
    """Write all of `data` at `offset`; a disk that fills takes part of it before it says so."""
    view = memoryview(data)
    while view:
        written = os.pwrite(descriptor, view, offset)
        view, offset = view[written:], offset + written
