"""MCAP records: parse, decompress, CRC, end of file.

magic | opcode, length, body | opcode, length, body | ... | footer | magic
  8        1      8
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from typing import Protocol, TypeVar

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import DataEnd, Footer, McapRecord, SummaryOffset
from mcap.writer import MCAP0_MAGIC
from zlib_ng.zlib_ng import crc32

from fte_sniff.errors import TranslatableText

MAGIC = MCAP0_MAGIC
"""The eight bytes that begin and end every MCAP file."""

LARGEST = 256 * 1024 * 1024
"""Bytes of the largest record that is read, and of the largest chunk that is unpacked."""

HEAD = struct.Struct("<BQ")
"""What stands before the body of each record: opcode and length."""


class RecordError(ValueError):
    """A record that cannot be what it claims to be; the text says why, in few words."""

    @property
    def message(self) -> TranslatableText:
        """The text."""
        text = self.args[0]
        return text if isinstance(text, TranslatableText) else TranslatableText("{text}", text=text)


_Record = TypeVar("_Record", covariant=True)


class _Readable(Protocol[_Record]):
    @staticmethod
    def read(stream: ReadDataStream) -> _Record: ...


def parse(record: _Readable[_Record], body: bytes) -> _Record:
    """The mcap package's `record` in `body`.

    Raises:
        RecordError: the body is no such record.
    """
    try:
        return record.read(ReadDataStream(BytesIO(body)))
    except (McapError, struct.error, ValueError) as error:
        raise RecordError(TranslatableText("a record that contradicts itself")) from error


def records_in(records: bytes) -> Iterator[tuple[int, bytes]]:
    """Opcode and body of each record in an unpacked chunk, or in a summary.

    Raises:
        RecordError: the last of them goes beyond the end.
    """
    place, end = 0, len(records)
    while place < end:
        if end - place < HEAD.size:
            raise RecordError(TranslatableText("records that go beyond their chunk"))
        opcode, length = HEAD.unpack_from(records, place)
        place += HEAD.size
        if length > end - place:
            raise RecordError(TranslatableText("records that go beyond their chunk"))
        yield opcode, records[place : place + length]
        place += length


__all__ = ["RunningChecksum", "crc32"]

_LARGE = 64 * 1024
_MOST_WAITING = 512 * 1024


class RunningChecksum:
    """The checksum of all that was added, in its order.

    Small pieces wait until they are worth it: to reckon lets go of the interpreter, and where other
    threads want it, to get it back takes longer than the checksum of a small piece.
    """

    def __init__(self) -> None:
        self._value = 0
        self._waiting: list[bytes] = []
        self._size = 0

    def add(self, piece: bytes) -> None:
        """Take more bytes."""
        if len(piece) >= _LARGE:
            self._value = crc32(piece, self.value())
            return
        self._waiting.append(piece)
        self._size += len(piece)
        if self._size >= _MOST_WAITING:
            self.value()

    def value(self) -> int:
        """That of all so far."""
        if self._waiting:
            self._value = crc32(b"".join(self._waiting), self._value)
            self._waiting.clear()
            self._size = 0
        return self._value


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
        raise RecordError(
            TranslatableText("a chunk that claims to unpack to {size} bytes", size=size)
        )
    records = _unpacked(compression, packed, size)
    if len(records) != size:
        raise RecordError(TranslatableText("a chunk that does not unpack to what it claims"))
    if crc and crc32(records) != crc:
        raise RecordError(TranslatableText("a chunk whose checksum does not match"))
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
        raise RecordError(TranslatableText("a chunk without its head")) from error
    packed = memoryview(body)[place + _LENGTH.size :]
    if len(packed) != length:
        raise RecordError(TranslatableText("a chunk whose lengths contradict each other"))
    return packed, body[_CHUNK_HEAD.size : place]


def _unpacked(compression: bytes, packed: memoryview, size: int) -> bytes:
    match compression:
        case b"":
            return bytes(packed)
        case b"zstd":
            return _unpacked_zstd(packed, size)
        case b"lz4":
            return _unpacked_lz4(packed, size)
    raise RecordError(TranslatableText("a chunk that is packed neither with zstd nor with lz4"))


def _unpacked_zstd(packed: memoryview, size: int) -> bytes:
    try:
        if zstandard.get_frame_parameters(packed).content_size not in (size, _UNKNOWN_SIZE):
            raise RecordError(TranslatableText("a chunk that does not unpack to what it claims"))
        return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    except zstandard.ZstdError as error:
        raise RecordError(TranslatableText("a chunk that does not unpack")) from error


def _unpacked_lz4(packed: memoryview, size: int) -> bytes:
    try:
        with lz4.frame.LZ4FrameDecompressor() as unpacker:
            return bytes(unpacker.decompress(packed, max_length=size + 1))
    except RuntimeError as error:
        raise RecordError(TranslatableText("a chunk that does not unpack")) from error


_BLOCK = 31 * 1024 * 1024
"""Bytes; the most that glibc learns from are 32 MiB."""


@cache
def keep_freed_memory() -> None:
    """Have what is freed kept for the next chunk, instead of given back and faulted in anew.

    Taking it anew costs as much as half the unpacking does. glibc keeps free memory of up to twice
    the largest block that was ever freed, and learns that from a block that is never touched, and
    so takes no memory. For other C libraries this does nothing. Once is enough for
    the process.
    """
    np.empty(_BLOCK, np.uint8)


def cores() -> int:
    """How many cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


_FOOTER = struct.Struct("<BQQQ")
_FOOTER_LENGTH = 8 + 8 + 4

END_LENGTH = 9 + _FOOTER_LENGTH + len(MCAP0_MAGIC)
"""Bytes of a footer and the magic behind it."""

DATA_END_LENGTH = 9 + 4
"""Bytes of the record that ends the data."""

_OFFSET_LENGTH = 9 + 1 + 8 + 8


@dataclass(frozen=True, slots=True)
class Tail:
    """One tail, wherever it is going to stand."""

    data_crc: int
    """The checksum over all bytes before it."""
    groups: tuple[tuple[Opcode, bytes], ...]
    """The summary's records by opcode; no group is empty."""
    indexed: bool = True
    """Whether the summary is written out; a tail without makes tools scan the file."""

    @property
    def index_length(self) -> int:
        """Bytes of `index_at`."""
        records = sum(len(records) for _, records in self.groups)
        return records + _OFFSET_LENGTH * len(self.groups) + END_LENGTH

    def at(self, start: int) -> bytes:
        """The tail for data that ends at `start`."""
        data_end = bytes_of(DataEnd(self.data_crc))
        if not self.indexed:
            return data_end + bare_end()
        return data_end + self.index_at(start + len(data_end))

    def index_at(self, start: int) -> bytes:
        """The summary, footer and magic for a summary that begins at `start`."""
        parts, offsets, place = [], [], start
        for opcode, records in self.groups:
            offsets.append(SummaryOffset(opcode, place, len(records)))
            parts.append(records)
            place += len(records)
        parts.append(bytes_of(*offsets))
        summary = b"".join(parts)
        guarded = _FOOTER.pack(Opcode.FOOTER, _FOOTER_LENGTH, start, place)
        crc = crc32(guarded, crc32(summary))
        return summary + _end(start, place, crc)

    def end_for(self, start: int) -> bytes:
        """Footer and magic that point back at the summary of this tail, which stands at `start`.

        They hold no checksum: what stands between is not to be read.
        """
        return _end(start + DATA_END_LENGTH, 0, 0) if self.indexed else bare_end()


def bare_end() -> bytes:
    """Footer and magic of a file without summary."""
    return _end(0, 0, crc32(_FOOTER.pack(Opcode.FOOTER, _FOOTER_LENGTH, 0, 0)))


def _end(summary: int, offsets: int, crc: int) -> bytes:
    return bytes_of(Footer(summary, offsets, crc)) + MCAP0_MAGIC


def bytes_of(*records: McapRecord) -> bytes:
    """The records as they stand in a file."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def groups_of(*groups: tuple[Opcode, bytes]) -> tuple[tuple[Opcode, bytes], ...]:
    """The groups that are not empty."""
    return tuple((opcode, records) for opcode, records in groups if records)
