"""MCAP records: parse, decompress, CRC.

File:

    magic | opcode, length, body | opcode, length, body | ... | footer | magic
      8        1      8
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from functools import cache
from io import BytesIO
from typing import Protocol, TypeVar

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.writer import MCAP0_MAGIC
from zlib_ng.zlib_ng import crc32

from fte_sniff.errors import TranslatableText

MAGIC = MCAP0_MAGIC
"""The eight bytes that begin and end every MCAP file."""

LARGEST = 256 * 1024 * 1024
"""Bytes of the largest record that is read, and of the largest unpacked chunk."""

_ALWAYS_UNPACKED = 40 * 1024 * 1024
"""Bytes to which every chunk may unpack: 32 thousand rows of 1024 bytes of noise."""
_MOST_RATIO = 16
"""A chunk that unpacks to more may have this compression ratio; rows have about 10."""

HEAD = struct.Struct("<BQ")


class RecordError(ValueError):
    """A damaged record or message; its text is a noun phrase that can be part of another text."""

    def __init__(self, form: str, **values: object) -> None:
        """Make the text, which can be translated, of a form with the names of these values."""
        self.message = TranslatableText(form, **values)
        super().__init__(self.message)


BEYOND_CHUNK = TranslatableText("records that go beyond their chunk")
NO_RECORD = TranslatableText("there is no MCAP record")

_Record = TypeVar("_Record", covariant=True)


class _Readable(Protocol[_Record]):
    @staticmethod
    def read(stream: ReadDataStream) -> _Record: ...


def parse(record: _Readable[_Record], body: bytes) -> _Record:
    """Parse a record of a class of the mcap package; raises RecordError if that fails."""
    try:
        return record.read(ReadDataStream(BytesIO(body)))
    except (McapError, struct.error, ValueError) as error:
        raise RecordError("a record that contradicts itself") from error


def records_in(records: bytes) -> Iterator[tuple[int, bytes]]:
    """Opcode and body of each record in a chunk or summary; raises RecordError if one is cut."""
    at, end = 0, len(records)
    while at < end:
        if end - at < HEAD.size:
            raise RecordError(BEYOND_CHUNK)
        opcode, length = HEAD.unpack_from(records, at)
        at += HEAD.size
        if length > end - at:
            raise RecordError(BEYOND_CHUNK)
        yield opcode, records[at : at + length]
        at += length


_LARGE = 64 * 1024
_MOST_PENDING = 512 * 1024


class RunningChecksum:
    """The CRC-32 of data that arrives in pieces.

    Small pieces are collected: `crc32` releases the interpreter lock, and while other threads run,
    to get it back takes longer than the checksum of a small piece.
    """

    def __init__(self) -> None:
        self._value = 0
        self._pending: list[bytes] = []
        self._size = 0

    def update(self, piece: bytes) -> None:
        """Add the next bytes."""
        if len(piece) >= _LARGE:
            self._value = crc32(piece, self.value())
            return
        self._pending.append(piece)
        self._size += len(piece)
        if self._size >= _MOST_PENDING:
            self.value()

    def value(self) -> int:
        """The checksum of all bytes so far."""
        if self._pending:
            self._value = crc32(b"".join(self._pending), self._value)
            self._pending.clear()
            self._size = 0
        return self._value


CHUNK_HEAD = struct.Struct("<QQQII")
"""Start of a chunk's body: first and last time, unpacked size, CRC, length of the name of the
compression; the name, `LENGTH` and the compressed records follow."""

LENGTH = struct.Struct("<Q")
"""Length of the compressed records."""

_UNKNOWN_SIZE = 2**64 - 1


def claimed(body: bytes) -> tuple[int, int]:
    """Unpacked bytes and CRC of a chunk according to its head."""
    _, _, size, crc, _ = CHUNK_HEAD.unpack_from(body)
    return size, crc


def unpack(body: bytes) -> bytes:
    """The records of a chunk; checks the checksum if it has one.

    Raises RecordError if the chunk is damaged, or its compression is unknown.
    """
    packed, compression = compressed_records(body)
    size, crc = claimed(body)
    if size > min(LARGEST, max(_ALWAYS_UNPACKED, _MOST_RATIO * len(body))):
        raise RecordError("a chunk that claims to unpack to {size} bytes", size=size)
    records = _unpacked(compression, packed, size)
    if len(records) != size:
        raise RecordError("a chunk that does not unpack to what it claims")
    if crc and crc32(records) != crc:
        raise RecordError("a chunk whose checksum does not match")
    return records


def compressed_records(body: bytes) -> tuple[memoryview, bytes]:
    """The compressed records of a chunk, and the name of the compression.

    Raises RecordError if the lengths contradict each other.
    """
    try:
        *_, name_length = CHUNK_HEAD.unpack_from(body)
        name_end = CHUNK_HEAD.size + name_length
        (length,) = LENGTH.unpack_from(body, name_end)
    except struct.error as error:
        raise RecordError("a chunk without its header") from error
    packed = memoryview(body)[name_end + LENGTH.size :]
    if len(packed) != length:
        raise RecordError("a chunk whose lengths contradict each other")
    return packed, body[CHUNK_HEAD.size : name_end]


def _unpacked(compression: bytes, packed: memoryview, size: int) -> bytes:
    match compression:
        case b"":
            return bytes(packed)
        case b"zstd":
            return _unpacked_zstd(packed, size)
        case b"lz4":
            return _unpacked_lz4(packed, size)
    raise RecordError("a chunk that is packed neither with zstd nor with lz4")


def _unpacked_zstd(packed: memoryview, size: int) -> bytes:
    try:
        if zstandard.get_frame_parameters(packed).content_size not in (size, _UNKNOWN_SIZE):
            raise RecordError("a chunk that does not unpack to what it claims")
        return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    except zstandard.ZstdError as error:
        raise RecordError("a chunk that does not unpack") from error


def _unpacked_lz4(packed: memoryview, size: int) -> bytes:
    try:
        with lz4.frame.LZ4FrameDecompressor() as unpacker:
            return bytes(unpacker.decompress(packed, max_length=size + 1))
    except RuntimeError as error:
        raise RecordError("a chunk that does not unpack") from error


_BLOCK = 31 * 1024 * 1024
"""Bytes; glibc adapts to freed blocks of up to 32 MiB."""


@cache
def keep_freed_memory() -> None:
    """Make glibc keep freed memory for the next chunk.

    Otherwise it returns the memory to the system, and the page faults of the next chunk cost half
    as much as unpacking. glibc keeps up to twice the largest block that was ever freed, so freeing
    one large block is enough; it is never touched and takes no memory. Other C libraries ignore it.
    """
    np.empty(_BLOCK, np.uint8)


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


END_LENGTH = HEAD.size + 8 + 8 + 4 + len(MAGIC)
"""Bytes of the footer and the final magic."""

DATA_END_LENGTH = HEAD.size + 4
"""Bytes of the record that ends the data."""
