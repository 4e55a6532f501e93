"""Owns unpacking a chunk: its records as bytes, checked, and never more than may be believed.

It must not know what the records are, nor where the chunk stood. No size that stands in the chunk
is given memory before it is there.

    start, end, size, crc | compression | length | packed records
      8     8    8     4      4 + name       8
"""

from __future__ import annotations

import struct

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from fte_sniff.errors import Said
from fte_sniff.recording.container.checksum import crc32
from fte_sniff.recording.container.records import LARGEST, RecordError

_CHUNK_HEAD = struct.Struct("<QQQII")
_LENGTH = struct.Struct("<Q")
_UNKNOWN_SIZE = 2**64 - 1


def unpacked_size(body: bytes) -> int:
    """Bytes that a chunk takes once unpacked, as it claims, but never more than `LARGEST`."""
    if len(body) < _CHUNK_HEAD.size:
        return 0
    _, _, size, _, _ = _CHUNK_HEAD.unpack_from(body)
    return min(int(size), LARGEST)


def unpack(body: bytes) -> bytes:
    """The records of a chunk as bytes, its checksum checked where it has one.

    Raises:
        RecordError: the chunk is damaged, or packed in a way that is not MCAP's.
    """
    packed, compression = packed_part(body)
    _, _, size, crc, _ = _CHUNK_HEAD.unpack_from(body)
    if size > LARGEST:
        raise RecordError(Said("a chunk that claims to unpack to {size} bytes", size=size))
    records = _unpacked(compression, packed, size)
    if len(records) != size:
        raise RecordError(Said("a chunk that does not unpack to what it claims"))
    if crc and crc32(records) != crc:
        raise RecordError(Said("a chunk whose checksum does not match"))
    return records


def packed_part(body: bytes) -> tuple[memoryview, bytes]:
    """What is packed in a chunk, and how.

    Raises:
        RecordError: its lengths contradict each other.
    """
    try:
        *_, name_length = _CHUNK_HEAD.unpack_from(body)
        place = _CHUNK_HEAD.size + name_length
        (length,) = _LENGTH.unpack_from(body, place)
    except struct.error as error:
        raise RecordError(Said("a chunk without its head")) from error
    packed = memoryview(body)[place + _LENGTH.size :]
    if len(packed) != length:
        raise RecordError(Said("a chunk whose lengths contradict each other"))
    return packed, body[_CHUNK_HEAD.size : place]


def _unpacked(compression: bytes, packed: memoryview, size: int) -> bytes:
    match compression:
        case b"":
            return bytes(packed)
        case b"zstd":
            return _unpacked_zstd(packed, size)
        case b"lz4":
            return _unpacked_lz4(packed, size)
    raise RecordError(Said("a chunk that is packed neither with zstd nor with lz4"))


def _unpacked_zstd(packed: memoryview, size: int) -> bytes:
    try:
        if zstandard.get_frame_parameters(packed).content_size not in (size, _UNKNOWN_SIZE):
            raise RecordError(Said("a chunk that does not unpack to what it claims"))
        return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    except zstandard.ZstdError as error:
        raise RecordError(Said("a chunk that does not unpack")) from error


def _unpacked_lz4(packed: memoryview, size: int) -> bytes:
    try:
        with lz4.frame.LZ4FrameDecompressor() as unpacker:
            return bytes(unpacker.decompress(packed, max_length=size + 1))
    except RuntimeError as error:
        raise RecordError(Said("a chunk that does not unpack")) from error
