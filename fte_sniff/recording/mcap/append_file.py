"""A file that is valid MCAP after every flush.

New data overwrites the old tail (data end, summary, footer) and ends with a new tail. A write is
not atomic: after a kill the first pages are written, after a power cut any of them. So a guard, a
second copy of the old summary, is written after the end of the new tail first, and is cut off when
the write is done:

    1   data | tail |           . . .           | footer
    2   data | tail |           . . . | guard . . footer
    3   data | 80 ........ new .......| guard . . footer
    4   data | new data | new tail |  | guard . . footer
    5   data | new data | new tail |

In 1 the footer points at the old summary, from 2 to 4 at the guard's copy, in 5 at the new summary.
In 3 a record of a private opcode, which readers skip, covers the bytes being written, so the file
is also valid for readers that read from the start.

Each step from state to state is atomic: a footer is within one sector, the head of a record is nine
bytes, a length is one number. A barrier (fdatasync) separates steps that a power cut could reorder.
"""

from __future__ import annotations

import errno
import os
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import DataEnd, Footer, McapRecord, SummaryOffset
from zlib_ng.zlib_ng import crc32

from fte_sniff.platform import POSIX, open_flags, read_at, sync_data, write_at
from fte_sniff.recording.mcap.records import DATA_END_LENGTH, END_LENGTH, HEAD, MAGIC

_SECTOR = 512
_PRIVATE = 0x80

LARGEST_BARRED = 1024 * 1024
"""Bytes of the largest guard that is synced to the disk; a larger one protects from a kill only.

By default a capture begins its next file at half of that.
"""


_FOOTER = struct.Struct("<BQQQ")
_FOOTER_LENGTH = _FOOTER.size - HEAD.size + 4
_OFFSET_LENGTH = HEAD.size + 1 + 8 + 8


@dataclass(frozen=True, slots=True)
class Tail:
    """The end of a file: definitions, data end, summary, footer, magic."""

    definitions: bytes
    """The schema and channel records that no chunk holds."""
    data_crc: int
    """The checksum of all bytes up to the data end; 0 if unknown."""
    groups: tuple[tuple[Opcode, bytes], ...]
    """The summary's records by opcode; no group is empty."""
    indexed: bool = True
    """Whether the tail has the summary; without, tools scan the file."""

    @property
    def index_length(self) -> int:
        """Bytes from the summary to the end."""
        records = sum(len(records) for _, records in self.groups)
        return records + _OFFSET_LENGTH * len(self.groups) + END_LENGTH

    def summary_at(self, start: int) -> int:
        """Where the summary begins if the tail begins at `start`."""
        return start + len(self.definitions) + DATA_END_LENGTH

    def at(self, start: int) -> bytes:
        """The bytes of the tail for data that ends at `start`."""
        before = self.definitions + bytes_of(DataEnd(self.data_crc))
        if not self.indexed:
            return before + _end_without_summary()
        return before + self._summary(self.summary_at(start))

    def end_for(self, start: int) -> bytes:
        """Footer and magic for this tail at `start`, if other bytes follow its summary.

        They have no checksum, because it would cover those bytes.
        """
        return _end(self.summary_at(start), 0, 0) if self.indexed else _end_without_summary()

    def _summary(self, start: int) -> bytes:
        offsets, at = [], start
        for opcode, records in self.groups:
            offsets.append(SummaryOffset(opcode, at, len(records)))
            at += len(records)
        summary = b"".join([*(records for _, records in self.groups), bytes_of(*offsets)])
        guarded = _FOOTER.pack(Opcode.FOOTER, _FOOTER_LENGTH, start, at)
        return summary + _end(start, at, crc32(guarded, crc32(summary)))


def _end_without_summary() -> bytes:
    return _end(0, 0, crc32(_FOOTER.pack(Opcode.FOOTER, _FOOTER_LENGTH, 0, 0)))


def _end(summary: int, offsets: int, crc: int) -> bytes:
    return bytes_of(Footer(summary, offsets, crc)) + MAGIC


def bytes_of(*records: McapRecord) -> bytes:
    """The bytes of records."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


class LostDataError(OSError):
    """Data that was appended earlier is lost."""


class CutOffError(LostDataError):
    """Another program has cut off the file: data after the cut is lost."""


class NoReaderError(LostDataError):
    """No program has opened the pipe for reading."""


class NotRestoredError(OSError):
    """A write failed, and so did restoring the file; it is valid, but holds unused bytes."""


class AppendFile:
    """A regular file, which is valid after each step.

    If an append fails, the file is restored to its previous state where the disk permits.
    """

    def __init__(self, descriptor: int) -> None:
        """Take an empty file, open for reading and writing; the caller closes it."""
        self._descriptor = descriptor
        self._end = 0
        self._tail: Tail | None = None
        self._tail_length = 0

    @property
    def size(self) -> int:
        """Bytes in the file, including its tail."""
        return self._end + self._tail_length

    def append(self, data: bytes, tail: Callable[[], Tail]) -> None:
        """Overwrite the old tail with data and the new tail, and sync them to the disk.

        Raises CutOffError, NotRestoredError, or another OSError after which the file is restored.
        """
        new_tail, end = tail(), self._end + len(data)
        tail_bytes = new_tail.at(end)
        stop = end + len(tail_bytes)
        guard, guard_end = 0, 0
        self._check_end()
        try:
            if self._tail is not None:
                guard, guard_end = self._guard(self._tail, stop)
                # The guard would hide a cut before it.
                self._check_end()
            self._overwrite(data + tail_bytes, guard)
            sync_data(self._descriptor)
            if os.fstat(self._descriptor).st_size < guard_end:
                raise CutOffError
            if guard:
                # Not synced: until it is on the disk, the file is valid with its old index.
                os.ftruncate(self._descriptor, stop)
        except CutOffError:
            raise
        except OSError as error:
            self._restore(guard, error)
            raise
        self._end, self._tail, self._tail_length = end, new_tail, len(tail_bytes)

    def close(self, tail: Tail) -> None:
        """End the file with this tail, and sync it to the disk; raises as `append`."""
        if self._tail != tail:
            self.append(b"", lambda: tail)
        self._check_end()
        sync_data(self._descriptor)

    def _check_end(self) -> None:
        """Raise CutOffError if the tail is not where it was written."""
        if self._tail is not None:
            last = read_at(self._descriptor, len(MAGIC), self.size - len(MAGIC))
            if last != MAGIC:
                raise CutOffError

    def _guard(self, tail: Tail, stop: int) -> tuple[int, int]:
        """Write the guard after `stop` and after the file's end; returns its start and end."""
        start = max(stop, self.size)
        into_sector = (tail.summary_at(start) + tail.index_length) % _SECTOR
        if 0 < into_sector < END_LENGTH:  # the footer must be within one sector
            start += END_LENGTH - into_sector
        guard = replace(tail, data_crc=0, indexed=True).at(start)
        footer_at = start + len(guard) - END_LENGTH
        _write_at(self._descriptor, tail.end_for(self._end), footer_at)
        _write_at(self._descriptor, guard[:-END_LENGTH], start)
        _write_at(self._descriptor, guard[-END_LENGTH:], footer_at)
        if len(guard) <= LARGEST_BARRED:
            sync_data(self._descriptor)
        return start, start + len(guard)

    def _overwrite(self, new: bytes, guard: int) -> None:
        """Write `new` over the old tail; if there is a guard, its first bytes last."""
        if not guard:
            _write_at(self._descriptor, new, self._end)
            return
        after_head = self._end + HEAD.size
        _write_at(self._descriptor, HEAD.pack(_PRIVATE, guard - after_head), self._end)
        _write_at(self._descriptor, new[HEAD.size :], after_head)
        _write_at(self._descriptor, new[: HEAD.size], self._end)

    def _restore(self, guard: int, cause: OSError) -> None:
        """Restore the old tail; only then is the guard, which protects the file, cut off."""
        try:
            if guard and self._tail is not None:
                self._overwrite(self._tail.at(self._end), guard)
                sync_data(self._descriptor)
            if os.fstat(self._descriptor).st_size > self.size:
                os.ftruncate(self._descriptor, self.size)
        except OSError as error:
            raise NotRestoredError(*cause.args) from error


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

    def append(self, data: bytes, tail: Callable[[], Tail]) -> None:
        """Write data."""
        self._write(data)

    def close(self, tail: Tail) -> None:
        """Write the tail."""
        self._write(tail.at(self._size))

    def _write(self, data: bytes) -> None:
        view = memoryview(data)
        while view:
            written = os.write(self._descriptor, view)
            self._size += written
            view = view[written:]


AppendTarget: TypeAlias = AppendFile | Stream
"""A file that grows. Methods may raise OSError."""

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

    def close(self, tail: Tail) -> None:
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


def _write_at(descriptor: int, data: bytes, offset: int) -> None:
    """Write all of `data` at `offset`; `pwrite` writes a part of it when the disk fills."""
    view = memoryview(data)
    while view:
        written = write_at(descriptor, view, offset)
        view, offset = view[written:], offset + written
