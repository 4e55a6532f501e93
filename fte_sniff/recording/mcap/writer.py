"""Write chunks, indexes, summary.

The summary grows with each chunk. Once it is long it is written out only when as much data has come
as the summary is long; in between a tail without summary stands there, which is legal and makes
tools scan the file. Who wants an index at every moment ends the file before, by `index_length`.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from fte_sniff.recording.mcap.append_file import AppendTarget
from fte_sniff.recording.mcap.records import Tail, bytes_of, crc32, groups_of


@dataclass(frozen=True, slots=True)
class McapBatch:
    """The messages of one chunk, packed, and what its index needs; a value for each message."""

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
    """A chunk that only needs to be written."""

    data: bytes
    """Its record and those of its message indexes."""
    index: ChunkIndex
    """What the summary is to tell of it, if it stood at the very beginning."""
    counts: Mapping[int, int]
    """How many messages each channel has, by rising id."""

    def index_at(self, start: int) -> ChunkIndex:
        """What the summary is to tell of it, if it begins at `start`."""
        places = {id_: start + at for id_, at in self.index.message_index_offsets.items()}
        return replace(self.index, chunk_start_offset=start, message_index_offsets=places)


def packed(definitions: bytes, batch: McapBatch) -> PackedChunk:
    """A chunk of definitions and of messages, one at least, in their order."""
    records = b"".join([definitions, batch.data]) if definitions else batch.data
    chunk = Chunk(
        compression="zstd",
        data=zstandard.ZstdCompressor(level=_LEVEL).compress(records),
        message_start_time=int(batch.times.min()),
        message_end_time=int(batch.times.max()),
        uncompressed_crc=crc32(records),
        uncompressed_size=len(records),
    )
    return indexed(chunk, replace(batch, starts=batch.starts + len(definitions)))


def indexed(chunk: Chunk, batch: McapBatch) -> PackedChunk:
    """A chunk that is compressed already.

    Args:
        chunk: the chunk.
        batch: its messages, one at least, with their places in the unpacked chunk.
    """
    record = bytes_of(chunk)
    counts = counts_of(batch)
    indexes, places = _message_indexes(batch, counts, len(record))
    index = ChunkIndex(
        message_start_time=chunk.message_start_time,
        message_end_time=chunk.message_end_time,
        chunk_start_offset=0,
        chunk_length=len(record),
        message_index_offsets=places,
        message_index_length=len(indexes),
        compression=chunk.compression,
        compressed_size=len(chunk.data),
        uncompressed_size=chunk.uncompressed_size,
    )
    return PackedChunk(record + indexes, index, counts)


def counts_of(batch: McapBatch) -> dict[int, int]:
    """How many messages each channel has, by rising id."""
    counts = np.bincount(batch.channels)
    return {channel: int(counts[channel]) for channel in np.flatnonzero(counts).tolist()}


def _message_indexes(
    batch: McapBatch, counts: Mapping[int, int], position: int
) -> tuple[bytes, dict[int, int]]:
    """The message index records of a chunk, and where each of them will stand.

    Args:
        batch: the messages.
        counts: how many each channel has, by rising id.
        position: where the first index record goes.
    """
    # Numbers of two bytes, as all channels are, numpy sorts in one pass.
    order = np.argsort(batch.channels.astype(np.uint16), kind="stable")
    entries = np.empty((len(order), 2), "<u8")
    entries[:, 0] = batch.times.take(order)
    entries[:, 1] = batch.starts.take(order)
    found, places, first = bytearray(), {}, 0
    for channel_id, count in counts.items():
        places[channel_id] = position + len(found)
        own = entries[first : first + count]
        found += _MESSAGE_INDEX.pack(
            Opcode.MESSAGE_INDEX, _MESSAGE_INDEX_HEAD + own.nbytes, channel_id, own.nbytes
        )
        found += own.data.cast("B")
        first += count
    return bytes(found), places


LONG_SUMMARY = 1536 * 1024
"""Bytes of summary that are written with every chunk; longer ones wait for as much data.

A chunk that holds messages of ten channels takes 173 of them, so two and a half hours have room,
flushed once a second.
"""


class McapFile:
    """A growing MCAP file.

    Every method that writes may raise OSError; nothing more can be added to the file then.
    """

    def __init__(
        self,
        growing: AppendTarget,
        library: str,
        metadata: Metadata,
        schemas: Iterable[Schema],
        channels: Iterable[Channel],
    ) -> None:
        """Begin the file with everything that an empty capture needs to explain itself.

        Args:
            growing: the file, empty so far; owned by the caller.
            library: who writes, for the header.
            metadata: the file's first metadata record.
            schemas: all that are known now; ids from 1.
            channels: all that are known now; ids from 1.
        """
        self._growing = growing
        self._schemas = {schema.id: schema for schema in schemas}
        self._channels = {channel.id: channel for channel in channels}
        self._defined: set[tuple[type[McapRecord], int]] = set()
        self._metadata_indexes: list[MetadataIndex] = []
        self._chunk_indexes = bytearray()
        self._chunks = 0
        self._counts: dict[int, int] = {}
        self._first_time = self._last_time = 0
        self._end = 0
        self._crc = 0
        self._indexed_end = 0
        self._index_length = 0
        start = MCAP0_MAGIC + bytes_of(Header("", library))
        record = bytes_of(metadata)
        self._metadata_indexes.append(MetadataIndex(len(start), len(record), metadata.name))
        definitions = bytes_of(*self._schemas.values(), *self._channels.values())
        self._extend(start + record + definitions)

    @property
    def size(self) -> int:
        """Bytes in the file, its tail included."""
        return self._growing.size

    @property
    def index_length(self) -> int:
        """Bytes of the index behind the data, whether it is written out or not."""
        return self._index_length

    def add_channel(self, channel: Channel) -> None:
        """Take one more channel; it stands in the file from the first chunk that uses it."""
        self._channels[channel.id] = channel

    def add_chunk(self, batch: McapBatch, metadata: Iterable[Metadata] = ()) -> None:
        """Write one chunk of messages, one at least, in their order, and push it to the disk.

        Args:
            batch: the messages.
            metadata: records that come before the chunk, in the same step.
        """
        self.add(packed(self.definitions_for(batch), batch), metadata)

    def definitions_for(self, batch: McapBatch) -> bytes:
        """The schemas and channels that a chunk of this batch must begin with.

        They are those that no chunk has yet; each is asked for once, so chunks must be added in the
        order in which this was called for them.
        """
        channels = [self._channels[id_] for id_ in counts_of(batch)]
        schemas = [self._schemas[id_] for id_ in sorted({c.schema_id for c in channels})]
        wanted: list[Schema | Channel] = [*schemas, *channels]
        new = [record for record in wanted if (type(record), record.id) not in self._defined]
        self._defined.update((type(record), record.id) for record in new)
        return bytes_of(*new)

    def add(self, chunk: PackedChunk, metadata: Iterable[Metadata] = ()) -> None:
        """Write a chunk that is packed already.

        Args:
            chunk: the chunk; what it defines must be known to the file.
            metadata: records that come before the chunk.
        """
        before = self._metadata_records(metadata)
        self._chunk_indexes += bytes_of(chunk.index_at(self._end + len(before)))
        self._count(chunk)
        self._extend(before + chunk.data if before else chunk.data)

    def add_metadata(self, metadata: Iterable[Metadata]) -> None:
        """Write more metadata records, if there are any."""
        if records := self._metadata_records(metadata):
            self._extend(records)

    def finish(self) -> None:
        """Write the whole summary, if the file does not end with it already."""
        self._growing.end(self._tail(self._crc))

    def _metadata_records(self, metadata: Iterable[Metadata]) -> bytes:
        """The records at the end of the data, noted for the summary."""
        found = bytearray()
        for one in metadata:
            record = bytes_of(one)
            place = self._end + len(found)
            self._metadata_indexes.append(MetadataIndex(place, len(record), one.name))
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
        """Let the file grow by `data`, and end with all that is known then."""
        end, crc = self._end + len(data), crc32(data, self._crc)
        self._growing.grow(data, lambda: self._next_tail(end, crc))
        self._end, self._crc = end, crc

    def _next_tail(self, end: int, crc: int) -> Tail:
        """The tail behind the next data, without summary where that is too long to be written."""
        tail = self._tail(crc)
        self._index_length = tail.index_length
        if tail.index_length > max(LONG_SUMMARY, end - self._indexed_end):
            return replace(tail, indexed=False)
        self._indexed_end = end
        return tail

    def _tail(self, crc: int) -> Tail:
        groups = groups_of(
            (Opcode.SCHEMA, bytes_of(*self._schemas.values())),
            (Opcode.CHANNEL, bytes_of(*self._channels.values())),
            (Opcode.STATISTICS, bytes_of(self._statistics())),
            (Opcode.CHUNK_INDEX, bytes(self._chunk_indexes)),
            (Opcode.METADATA_INDEX, bytes_of(*self._metadata_indexes)),
        )
        return Tail(crc, groups)

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
