"""Writer of an MCAP file that is valid after every flush: chunks, indexes, summary.

The first chunk begins with all definitions (schemas and channels), a later one with those that are
new. So each exists once in the data, protected by the chunk's checksum, and once in the summary.
Until a chunk holds them, they are part of the tail: a file without messages explains itself.

What a reader needs to know if the first chunk and the summary are damaged is repeated in a metadata
record: after the first chunk with new definitions, and then at twice the distance each time, up to
4 MB. Readers skip it; they would warn about a definition that is in the data twice.

The summary grows with each chunk. A long summary is written only after as much new data; between,
the file ends without summary, which is legal and makes tools scan the file. A caller that needs a
summary at every moment ends the file before, by `index_length`.

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

import os
import struct
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray
from zlib_ng.zlib_ng import crc32

from fte_sniff.platform import read_at, sync_data, write_at
from fte_sniff.recording.mcap.reader import DATA_END_LENGTH, END_LENGTH, HEAD, MAGIC
from fte_sniff.recording.output_file import CutOffError, NotRestoredError, Stream

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


AppendTarget: TypeAlias = AppendFile | Stream
"""A file that grows. Methods may raise OSError."""


def _write_at(descriptor: int, data: bytes, offset: int) -> None:
    """Write all of `data` at `offset`; `pwrite` writes a part of it when the disk fills."""
    view = memoryview(data)
    while view:
        written = write_at(descriptor, view, offset)
        view, offset = view[written:], offset + written


@dataclass(frozen=True, slots=True)
class McapBatch:
    """The messages of one chunk, with a value for each message."""

    data: bytes | memoryview
    channels: NDArray[np.int64]
    times: NDArray[np.int64]
    """Log times, nanoseconds since 1970 UTC."""
    starts: NDArray[np.int64]
    """Where each message record begins in `data`."""


_LEVEL = 1
_MESSAGE_INDEX = struct.Struct("<BQHI")
_MESSAGE_INDEX_HEAD = _MESSAGE_INDEX.size - 9


@dataclass(frozen=True, slots=True)
class PackedChunk:
    """A compressed chunk with its indexes."""

    data: bytes
    """The chunk record and its message index records."""
    index: ChunkIndex
    """The chunk's index in the summary, for a chunk at offset 0."""
    counts: Mapping[int, int]
    """Number of messages by channel id, in rising order."""

    def index_at(self, start: int) -> ChunkIndex:
        """The chunk's index in the summary, for a chunk at `start`."""
        offsets = {id_: start + at for id_, at in self.index.message_index_offsets.items()}
        return replace(self.index, chunk_start_offset=start, message_index_offsets=offsets)


def packed(definitions: bytes, batch: McapBatch) -> PackedChunk:
    """Compress and index a chunk of definitions and at least one message."""
    records = b"".join([definitions, batch.data]) if definitions else batch.data
    chunk = Chunk(
        compression="zstd",
        data=zstandard.ZstdCompressor(level=_LEVEL).compress(records),
        message_start_time=int(batch.times.min()),
        message_end_time=int(batch.times.max()),
        uncompressed_crc=crc32(records),
        uncompressed_size=len(records),
    )
    record = bytes_of(chunk)
    numbers = np.bincount(batch.channels)
    counts = {channel: int(numbers[channel]) for channel in np.flatnonzero(numbers).tolist()}
    indexes, offsets = _message_indexes(batch, counts, len(definitions), len(record))
    index = ChunkIndex(
        message_start_time=chunk.message_start_time,
        message_end_time=chunk.message_end_time,
        chunk_start_offset=0,
        chunk_length=len(record),
        message_index_offsets=offsets,
        message_index_length=len(indexes),
        compression=chunk.compression,
        compressed_size=len(chunk.data),
        uncompressed_size=chunk.uncompressed_size,
    )
    return PackedChunk(record + indexes, index, counts)


def _message_indexes(
    batch: McapBatch, counts: Mapping[int, int], first_start: int, position: int
) -> tuple[bytes, dict[int, int]]:
    """The message index records of a chunk, and their offsets by channel id from `position` on."""
    # Numpy sorts 16-bit numbers, which channel ids are, in one pass.
    order = np.argsort(batch.channels.astype(np.uint16), kind="stable")
    entries = np.empty((len(order), 2), "<u8")
    entries[:, 0] = batch.times.take(order)
    entries[:, 1] = batch.starts.take(order) + first_start
    found, offsets, first = bytearray(), {}, 0
    for channel_id, count in counts.items():
        offsets[channel_id] = position + len(found)
        own = entries[first : first + count]
        found += _MESSAGE_INDEX.pack(
            Opcode.MESSAGE_INDEX, _MESSAGE_INDEX_HEAD + own.nbytes, channel_id, own.nbytes
        )
        found += own.data.cast("B")
        first += count
    return bytes(found), offsets


LONG_SUMMARY = 1536 * 1024
"""Bytes of the longest summary that is written with every chunk.

A chunk with messages of ten channels adds 173 bytes: with a flush a second, this is enough for two
and a half hours.
"""


MOST_BETWEEN_COPIES = 4 * 1024 * 1024
"""Bytes between two copies of the repeated record, about: a reader of a file whose end is cut off
finds one in the last bytes."""


class McapFile:
    """An MCAP file that grows.

    Every method that writes may raise OSError; the file must not be written after that.
    """

    def __init__(
        self,
        target: AppendTarget,
        library: str,
        metadata: Metadata,
        schemas: Iterable[Schema],
        channels: Iterable[Channel],
        repeated: Callable[[], Metadata],
    ) -> None:
        """Begin the empty file `target` with these definitions; the caller closes it.

        `repeated` makes the record whose copies stand between the chunks.
        """
        self._target, self._repeated = target, repeated
        self._defined_at = self._copied_at = 0
        """Where the latest definitions and the latest copy are in the file, about."""
        self._schemas = {schema.id: schema for schema in schemas}
        self._channels = {channel.id: channel for channel in channels}
        self._undefined = bytes_of(*self._schemas.values(), *self._channels.values())
        self._metadata_indexes: list[MetadataIndex] = []
        self._chunk_indexes = bytearray()
        self._chunks = 0
        self._counts: dict[int, int] = {}
        self._first_time = self._last_time = 0
        self._end = 0
        self._crc = 0
        self._indexed_end = 0
        self.index_length = 0
        """Bytes of the summary, whether it is written or not."""
        start = MCAP0_MAGIC + bytes_of(Header("", library))
        record = bytes_of(metadata)
        self._metadata_indexes.append(MetadataIndex(len(start), len(record), metadata.name))
        self._extend(start + record)

    @property
    def size(self) -> int:
        """Bytes in the file, including its tail."""
        return self._target.size

    def add_channel(self, channel: Channel) -> None:
        """Add a channel; its schema is one of the file's."""
        self._channels[channel.id] = channel
        self._undefined += bytes_of(channel)
        self._defined_at = self._copied_at = self._end

    def write_batch(self, batch: McapBatch, metadata: Iterable[Metadata] = ()) -> None:
        """Write metadata records and a chunk of at least one message, and sync them to the disk."""
        self.write_chunk(packed(self.next_definitions(), batch), metadata)

    def next_definitions(self) -> bytes:
        """The definitions that the next chunk must begin with: those of no previous call."""
        found, self._undefined = self._undefined, b""
        return found

    def write_chunk(self, chunk: PackedChunk, metadata: Iterable[Metadata] = ()) -> None:
        """Write metadata records and a compressed chunk, in the order of `next_definitions`."""
        before = self._metadata_records(metadata, self._end)
        start = self._end + len(before)
        self._chunk_indexes += bytes_of(chunk.index_at(start))
        self._count(chunk)
        copy = self._copy_at(start + len(chunk.data))
        self._extend(b"".join([before, chunk.data, copy]))

    def _copy_at(self, position: int) -> bytes:
        """The next copy of the repeated record, if it is due at a position; else nothing."""
        distance = position - self._copied_at
        if distance < min(self._copied_at - self._defined_at, MOST_BETWEEN_COPIES):
            return b""
        copy = self._repeated()
        if len(bytes_of(copy)) > distance:  # of very many ports
            return b""
        self._copied_at = position
        return self._metadata_records([copy], position)

    def write_metadata(self, metadata: Iterable[Metadata]) -> None:
        """Write metadata records, if there are any."""
        if records := self._metadata_records(metadata, self._end):
            self._extend(records)

    def close(self) -> None:
        """Write the summary, if the file does not end with it already."""
        self._target.close(self._tail(self._crc))

    def _metadata_records(self, metadata: Iterable[Metadata], position: int) -> bytes:
        found = bytearray()
        for one in metadata:
            record = bytes_of(one)
            start = position + len(found)
            self._metadata_indexes.append(MetadataIndex(start, len(record), one.name))
            found += record
        return bytes(found)

    def _count(self, chunk: PackedChunk) -> None:
        first = chunk.index.message_start_time
        self._first_time = min(self._first_time, first) if self._counts else first
        self._last_time = max(self._last_time, chunk.index.message_end_time)
        for channel_id, count in chunk.counts.items():
            self._counts[channel_id] = self._counts.get(channel_id, 0) + count
        self._chunks += 1

    def _extend(self, data: bytes) -> None:
        end, crc = self._end + len(data), crc32(data, self._crc)
        self._target.append(data, lambda: self._next_tail(end, crc))
        self._end, self._crc = end, crc

    def _next_tail(self, end: int, crc: int) -> Tail:
        """The tail after the next data, without summary if that is too long."""
        tail = self._tail(crc)
        self.index_length = tail.index_length
        if tail.index_length > max(LONG_SUMMARY, end - self._indexed_end):
            return replace(tail, indexed=False)
        self._indexed_end = end
        return tail

    def _tail(self, crc: int) -> Tail:
        groups = (
            (Opcode.SCHEMA, bytes_of(*self._schemas.values())),
            (Opcode.CHANNEL, bytes_of(*self._channels.values())),
            (Opcode.STATISTICS, bytes_of(self._statistics())),
            (Opcode.CHUNK_INDEX, bytes(self._chunk_indexes)),
            (Opcode.METADATA_INDEX, bytes_of(*self._metadata_indexes)),
        )
        found = tuple((opcode, records) for opcode, records in groups if records)
        return Tail(self._undefined, crc32(self._undefined, crc), found)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=self._chunks,
            message_count=sum(self._counts.values()),
            message_end_time=self._last_time,
            message_start_time=self._first_time,
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self._schemas),
        )
