"""Owns one chunk as it stands in a file: its messages packed, and the message indexes behind it.

It must not know where in the file that will be, nor what else the file holds: so chunks can be
packed by several threads at once.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.records import Chunk, ChunkIndex

from fte_sniff.recording.container.checksum import crc32
from fte_sniff.recording.container.tail import bytes_of
from fte_sniff.recording.encoding.batch import Batch

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


def packed(definitions: bytes, batch: Batch) -> PackedChunk:
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
    return indexed(chunk, replace(batch, places=batch.places + len(definitions)))


def indexed(chunk: Chunk, batch: Batch) -> PackedChunk:
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


def counts_of(batch: Batch) -> dict[int, int]:
    """How many messages each channel has, by rising id."""
    counts = np.bincount(batch.channels)
    return {channel: int(counts[channel]) for channel in np.flatnonzero(counts).tolist()}


def _message_indexes(
    batch: Batch, counts: Mapping[int, int], position: int
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
    entries[:, 1] = batch.places.take(order)
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
