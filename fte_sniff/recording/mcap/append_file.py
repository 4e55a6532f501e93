"""A file that is valid MCAP after every flush.

One write of both would be the end of the matter if a write were one thing. It is not: a process
that is killed within it leaves the pages before, a power cut leaves any of them, and either leaves
a file that ends in the middle. So a guard is put behind the place of the write first, a second copy
of the old tail's index, and cut off when the write is done:

    1   data | tail |           . . .           | footer
    2   data | tail |           . . . | guard . . footer
    3   data | 80 ........ new .......| guard . . footer
    4   data | new data | new tail |  | guard . . footer
    5   data | new data | new tail |

In 1 the footer points at the old tail's summary, from 2 to 4 at the guard's, in 5 at the new one.
In 3 a record of a private opcode, which readers skip, covers what is being written: so the file is
whole for those too who read it from its beginning.

The steps from state to state are too small to be left half done: a footer lies within one sector,
a record's head is nine bytes, a length is one number. A barrier stands where a power cut could put
them in another order.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Protocol

from fte_sniff.recording.mcap.records import DATA_END_LENGTH, END_LENGTH, HEAD, Tail

_SECTOR = 512
_PRIVATE = 0x80

LARGEST_BARRED = 1024 * 1024
"""Bytes of guard that are pushed to the disk; a larger one guards against a kill alone.

A capture begins its next file at half of that, if nobody says otherwise.
"""


class AppendTarget(Protocol):
    """Takes what a file grows by. Methods may raise OSError."""

    @property
    def size(self) -> int:
        """Bytes in the file."""
        ...

    def grow(self, data: bytes, tail: Callable[[], Tail]) -> None:
        """Put `data` behind the data that is there, and behind it what `tail` gives, if asked."""
        ...

    def end(self, tail: Tail) -> None:
        """Let the file end with `tail`, if it does not."""
        ...


class AppendFile:
    """A regular file, which is whole after each step.

    If growing fails the file is as it was before, as far as the disk still obeys.
    """

    def __init__(self, descriptor: int) -> None:
        """Take an empty file, open for writing; it stays the caller's."""
        self._descriptor = descriptor
        self._end = 0
        self._tail: Tail | None = None
        self._tail_length = 0

    @property
    def size(self) -> int:
        """Bytes in the file, its tail included."""
        return self._end + self._tail_length

    def grow(self, data: bytes, tail: Callable[[], Tail]) -> None:
        """Put `data` where the old tail began, `tail` behind it, and push both to the disk."""
        end, new_tail = self._end + len(data), tail()
        tail_bytes = new_tail.at(end)
        stop = end + len(tail_bytes)
        try:
            guarded = self._guard(self._tail, stop) if self._tail else 0
            try:
                self._put(data + tail_bytes, guarded)
                os.fdatasync(self._descriptor)
                if guarded:
                    # Not waited for: until then the file is whole, but its index is the old one.
                    os.ftruncate(self._descriptor, stop)
            except OSError:
                self._restore(self._tail, guarded)
                raise
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._descriptor, self.size)
            raise
        self._end, self._tail, self._tail_length = end, new_tail, len(tail_bytes)

    def end(self, tail: Tail) -> None:
        """Let the file end with `tail`, and push that to the disk too."""
        if self._tail != tail:
            self.grow(b"", lambda: tail)
        os.fdatasync(self._descriptor)

    def _guard(self, tail: Tail, stop: int) -> int:
        """Put the old index behind `stop` and behind the file's end; returns where it begins."""
        start = max(stop, self.size)
        start += _room_for_footer(start + DATA_END_LENGTH + tail.index_length)
        guard = replace(tail, data_crc=0, indexed=True).at(start)
        footer_at = start + len(guard) - END_LENGTH
        _write_at(self._descriptor, tail.end_for(self._end), footer_at)
        _write_at(self._descriptor, guard[:-END_LENGTH], start)
        _write_at(self._descriptor, guard[-END_LENGTH:], footer_at)
        if len(guard) <= LARGEST_BARRED:
            os.fdatasync(self._descriptor)
        return start

    def _put(self, new: bytes, guard: int) -> None:
        """Write `new` over the old tail; its first bytes last, where a guard stands behind."""
        if not guard:
            _write_at(self._descriptor, new, self._end)
            return
        behind = self._end + HEAD.size
        _write_at(self._descriptor, HEAD.pack(_PRIVATE, guard - behind), self._end)
        _write_at(self._descriptor, new[HEAD.size :], behind)
        _write_at(self._descriptor, new[: HEAD.size], self._end)

    def _restore(self, tail: Tail | None, guard: int) -> None:
        with suppress(OSError):
            self._put(tail.at(self._end) if tail else b"", guard)


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

    def grow(self, data: bytes, tail: Callable[[], Tail]) -> None:
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
