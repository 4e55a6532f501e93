"""Owns an MCAP file that grows by whole chunks and is complete after each of them.

It must not know rows, topics or protobuf: it takes schemas, channels and messages as bytes.

Behind the newest chunk always stands the file's tail: data end, summary, footer, magic. A new chunk
goes where the old tail began, and a new tail behind it, in one write. So the file opens in every
tool, indexed, whenever its writer is killed, and a write that fails can be taken back: the old tail
is put where it was, into space that it had already.

      old   ... chunk | tail |
      new   ... chunk | chunk  indexes | tail  (longer than the old one) |

The summary grows with each chunk. Once it is long it is written out only when as much data has come
as the summary is long; in between a tail without summary stands there, which is legal and makes
tools scan the file.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass

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
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

LONG_SUMMARY = 256 * 1024
"""Bytes of summary that are written with every chunk; longer ones wait for as much data."""

_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_HEAD = _MESSAGE.size - 9
_FOOTER = struct.Struct("<BQQQ")


@dataclass(frozen=True, slots=True)
class Entry:
    """One message on its way into a chunk."""

    channel_id: int
    sequence: int
    log_time: int
    """Nanoseconds since 1970 UTC; also the publish time."""
    data: bytes


def _bytes_of(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


class McapFile:
    """A growing MCAP file.

    Every method that writes may raise OSError. The file on the disk is then as complete as it was
    before, and nothing more can be added to it.
    """

    def __init__(
        self,
        descriptor: int,
        library: str,
        metadata: Metadata,
        schemas: Iterable[Schema],
        channels: Iterable[Channel],
    ) -> None:
        """Begin the file with everything that an empty capture needs to explain itself.

        Args:
            descriptor: an empty regular file, open for writing; owned by the caller.
            library: who writes, for the header.
            metadata: the file's one metadata record.
            schemas: all that are known now; ids from 1.
            channels: all that are known now; ids from 1.
        """
        self._descriptor = descriptor
        self._schemas = {schema.id: schema for schema in schemas}
        self._channels = {channel.id: channel for channel in channels}
        self._defined: set[tuple[type[McapRecord], int]] = set()
        self._chunk_indexes: list[ChunkIndex] = []
        self._counts: dict[int, int] = {}
        self._first_time = self._last_time = 0
        self._end = 0
        self._crc = 0
        self._tail = b""
        self._indexed_end = 0
        start = MCAP0_MAGIC + _bytes_of(Header("", library))
        record = _bytes_of(metadata)
        self._metadata_index = MetadataIndex(len(start), len(record), metadata.name)
        definitions = _bytes_of(*self._schemas.values(), *self._channels.values())
        self._extend(start + record + definitions)

    @property
    def size(self) -> int:
        """Bytes in the file, its tail included."""
        return self._end + len(self._tail)

    def add_channel(self, channel: Channel) -> None:
        """Take one more channel; it stands in the file from the first chunk that uses it."""
        self._channels[channel.id] = channel

    def add_chunk(self, entries: list[Entry]) -> None:
        """Write one chunk of entries, one at least, in their order, and push it to the disk."""
        new = self._undefined(entries)
        definitions = _bytes_of(*new)
        packed, offsets = _pack(entries, len(definitions))
        records = definitions + packed
        chunk = _chunk_of(records, entries)
        data = _bytes_of(chunk)
        indexes = _MessageIndexes(offsets, self._end + len(data))
        self._chunk_indexes.append(_chunk_index(chunk, self._end, len(data), indexes))
        times = [entry.log_time for entry in entries]
        self._first_time = min(self._first_time, *times) if self._counts else min(times)
        self._last_time = max(self._last_time, *times)
        for channel_id, places in offsets.items():
            self._counts[channel_id] = self._counts.get(channel_id, 0) + len(places)
        self._extend(data + indexes.data)
        self._defined.update((type(record), record.id) for record in new)

    def finish(self) -> None:
        """Write the whole summary, if the file does not end with it already."""
        if self._indexed_end != self._end:
            self._extend(b"", whole=True)

    def _undefined(self, entries: list[Entry]) -> list[Schema | Channel]:
        """The schemas and channels that stand in no chunk yet and that these entries use."""
        channels = [self._channels[id_] for id_ in sorted({e.channel_id for e in entries})]
        schemas = [self._schemas[id_] for id_ in sorted({c.schema_id for c in channels})]
        wanted: list[Schema | Channel] = [*schemas, *channels]
        return [record for record in wanted if (type(record), record.id) not in self._defined]

    def _extend(self, data: bytes, *, whole: bool = False) -> None:
        """Write `data` over the old tail and a new tail behind it; on failure undo it."""
        end, crc = self._end + len(data), zlib.crc32(data, self._crc)
        tail = self._summary_tail(end, crc)
        indexed = whole or len(tail) <= max(LONG_SUMMARY, end - self._indexed_end)
        if not indexed:
            tail = _bytes_of(DataEnd(crc)) + _footer(b"", 0, 0) + MCAP0_MAGIC
        try:
            _write_at(self._descriptor, data + tail, self._end)
            if end + len(tail) < self.size:
                os.ftruncate(self._descriptor, end + len(tail))
            os.fdatasync(self._descriptor)
        except OSError:
            with suppress(OSError):
                _write_at(self._descriptor, self._tail, self._end)
                os.ftruncate(self._descriptor, self.size)
            raise
        self._end, self._crc, self._tail = end, crc, tail
        if indexed:
            self._indexed_end = end

    def _summary_tail(self, end: int, crc: int) -> bytes:
        data_end = _bytes_of(DataEnd(crc))
        start = end + len(data_end)
        groups: list[tuple[Opcode, Iterable[McapRecord]]] = [
            (Opcode.SCHEMA, self._schemas.values()),
            (Opcode.CHANNEL, self._channels.values()),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self._chunk_indexes),
            (Opcode.METADATA_INDEX, [self._metadata_index]),
        ]
        summary, offsets = bytearray(), []
        for opcode, records in groups:
            group = _bytes_of(*records)
            if group:
                offsets.append(SummaryOffset(opcode, start + len(summary), len(group)))
            summary += group
        offset_start = start + len(summary)
        summary += _bytes_of(*offsets)
        return data_end + summary + _footer(bytes(summary), start, offset_start) + MCAP0_MAGIC

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunk_indexes),
            message_count=sum(self._counts.values()),
            message_end_time=self._last_time,
            message_start_time=self._first_time,
            metadata_count=1,
            schema_count=len(self._schemas),
        )


class _MessageIndexes:
    """The message index records of one chunk, and where each will stand."""

    def __init__(self, offsets: Mapping[int, list[tuple[int, int]]], start: int) -> None:
        self.data = b""
        self.places: dict[int, int] = {}
        for channel_id, places in offsets.items():
            self.places[channel_id] = start + len(self.data)
            self.data += _bytes_of(MessageIndex(channel_id, places))


def _pack(entries: list[Entry], start: int) -> tuple[bytes, dict[int, list[tuple[int, int]]]]:
    """The message records of a chunk, and for each channel the (time, offset) of its messages."""
    packed = bytearray()
    offsets: dict[int, list[tuple[int, int]]] = {}
    for entry in entries:
        place = (entry.log_time, start + len(packed))
        offsets.setdefault(entry.channel_id, []).append(place)
        packed += _MESSAGE.pack(
            Opcode.MESSAGE,
            _MESSAGE_HEAD + len(entry.data),
            entry.channel_id,
            entry.sequence,
            entry.log_time,
            entry.log_time,
        )
        packed += entry.data
    return bytes(packed), offsets


def _chunk_of(records: bytes, entries: list[Entry]) -> Chunk:
    times = [entry.log_time for entry in entries]
    return Chunk(
        compression="zstd",
        data=zstandard.compress(records),
        message_start_time=min(times),
        message_end_time=max(times),
        uncompressed_crc=zlib.crc32(records),
        uncompressed_size=len(records),
    )


def _chunk_index(chunk: Chunk, start: int, length: int, indexes: _MessageIndexes) -> ChunkIndex:
    return ChunkIndex(
        message_start_time=chunk.message_start_time,
        message_end_time=chunk.message_end_time,
        chunk_start_offset=start,
        chunk_length=length,
        message_index_offsets=indexes.places,
        message_index_length=len(indexes.data),
        compression=chunk.compression,
        compressed_size=len(chunk.data),
        uncompressed_size=chunk.uncompressed_size,
    )


def _footer(summary: bytes, start: int, offset_start: int) -> bytes:
    """The footer record, with the checksum over the summary and the footer's own beginning."""
    length = 8 + 8 + 4
    crc = zlib.crc32(_FOOTER.pack(Opcode.FOOTER, length, start, offset_start), zlib.crc32(summary))
    return _bytes_of(Footer(start, offset_start, crc))


def _write_at(descriptor: int, data: bytes, offset: int) -> None:
    """Write all of `data` at `offset`; a disk that fills takes part of it before it says so."""
    view = memoryview(data)
    while view:
        written = os.pwrite(descriptor, view, offset)
        view, offset = view[written:], offset + written
