"""The chunks of an MCAP file.

A chunk is all that is needed to read its rows, so a file is a list of chunks. A summary with the
right checksum lists them. Without one the records are walked; where a record makes no sense, the
search resumes behind the start of the last one that does, with the bytes that every chunk has:

    06 length | start  end  size crc  04 00 00 00 z s t d  packed length | records ...
       8      |  8      8    8    4   the mark             8

Both lengths must agree, and `unpack` checks the checksum. So damage costs the chunks that it hits.
No size from a file is trusted before it is compared with the size of the file.
"""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any, BinaryIO, Final, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Metadata, MetadataIndex, Schema, Statistics
from zlib_ng.zlib_ng import crc32
from zstandard import ZstdDecompressor, ZstdError, frame_content_size

from fte_sniff.errors import TranslatableText
from fte_sniff.platform import read_at

MAGIC: Final = b"\x89MCAP0\r\n"
HEAD: Final = struct.Struct("<BQ")
"""Opcode and length of a record."""
LARGEST: Final = 64 * 1024 * 1024
"""Bytes of the largest unpacked chunk that is read."""

_CHUNK_HEAD: Final = struct.Struct("<QQQII")
_INDEX: Final = struct.Struct("<QQQQ")
"""The times, the offset and the length of a chunk, with which its index begins."""
_FOOTER: Final = struct.Struct("<BQQQI")
_MARK: Final = re.compile(rb"\x03\0\0\0lz4|\x04\0\0\0zstd")
_MARK_OFFSET: Final = HEAD.size + _CHUNK_HEAD.size - 4
_CHUNK_START: Final = HEAD.size + _CHUNK_HEAD.size + 16
"""Bytes of a chunk record up to the packed records, at most."""
_INDEX_HEAD: Final = struct.Struct("<BQHI")
"""The head of a message index: its channel, and the bytes of its entries."""
_SAMPLE: Final = 256
"""Chunks that are compared with a summary, about."""
_BLOCK: Final = 64 * 1024
_FIRST_PRIVATE: Final = 0x80
_OPCODES: Final = frozenset(map(int, Opcode))


class DamagedError(ValueError):
    """Bytes that are not what they claim to be; the only argument is a `TranslatableText`."""


class ChunkRef(NamedTuple):
    """A chunk of a file; offsets from its beginning."""

    start: int
    stop: int
    """The end of its record."""
    first_ns: int
    """The first and the last log time of its messages, nanoseconds since 1970 UTC."""
    last_ns: int
    size: int
    """Unpacked bytes, as the file claims."""


class LostBytes(NamedTuple):
    """Bytes of a file that could not be read."""

    start: int
    stop: int
    why: str


@dataclass(slots=True)
class Contents:
    """What a file, or the part of it that was walked, has besides rows."""

    chunks: list[ChunkRef] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    messages: list[tuple[int, int]] = field(default_factory=list)
    """Where the messages outside of chunks are, which only other programs write."""
    lost: set[LostBytes] = field(default_factory=set)
    library: str = ""
    """The library of the header."""
    statistics: Statistics | None = None
    listed: list[int] = field(default_factory=list)
    """Where the metadata records are that a summary lists."""
    is_indexed: bool = False
    """Whether a summary with the right checksum listed the chunks."""

    def define(self, opcode: int, body: bytes) -> bool:
        """Apply a record; False if it is damaged. A summary lists metadata, too."""
        is_listed = self.is_indexed and opcode == Opcode.METADATA_INDEX
        kind = MetadataIndex if is_listed else _RECORDS.get(opcode)
        if kind is None:
            return True
        try:
            stream = BytesIO(body)
            record = kind.read(ReadDataStream(stream))
        except (McapError, struct.error, ValueError, OverflowError, MemoryError):
            return False
        # Bytes that were removed leave lengths that agree by chance.
        if stream.tell() != len(body) or not getattr(record, "library", "").isprintable():
            return False
        match record:
            case Header(library=library):
                self.library = library
            case Schema(id=id_):
                self.schemas[id_] = record
            case Channel(id=id_):
                self.channels[id_] = record
            case Metadata():
                self.metadata.append(record)
            case Statistics():
                self.statistics = record
            case MetadataIndex(offset=offset):
                self.listed.append(offset)
        return True


_RECORDS: Final[dict[int, Any]] = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.STATISTICS: Statistics,
}


def contents_of(stream: BinaryIO) -> Contents:
    """What a file has, by its summary, or by walking over its records."""
    return _indexed(stream) or walk(stream)


def _indexed(stream: BinaryIO) -> Contents | None:
    """What the summary lists; None without one with the right checksum, or if the file differs."""
    file = _Bytes(stream.fileno(), os.fstat(stream.fileno()).st_size)
    end = file.size - _FOOTER.size - len(MAGIC)
    footer = file.read(max(end, 0), file.size)
    if end < len(MAGIC) or len(footer) < _FOOTER.size or file.read(0, len(MAGIC)) != MAGIC:
        return None
    *_, start, _, crc = _FOOTER.unpack_from(footer)
    if not len(MAGIC) <= start < end:
        return None
    summary = file.read(start, end)
    if crc32(footer[: _FOOTER.size - 4], crc32(summary)) != crc:
        return None
    found = Contents(is_indexed=True)
    try:
        for opcode, at, to in records_in(summary):
            if opcode == Opcode.CHUNK_INDEX:  # one for each flush, so it is read in one step
                first_ns, last_ns, offset, length = _INDEX.unpack_from(summary, at + HEAD.size)
                size = int.from_bytes(summary[to - 8 : to], "little")
                found.chunks.append(ChunkRef(offset, offset + length, first_ns, last_ns, size))
            elif not found.define(opcode, summary[at + HEAD.size : to]):
                return None
        return found if _fits(file, found) else None
    except (DamagedError, struct.error):
        return None


def _fits(file: _Bytes, found: Contents) -> bool:
    """Whether a file has what its summary lists; reads the header and the metadata.

    Raises struct.error if it lists a chunk of a negative length.
    """
    for at in (len(MAGIC), *found.listed):
        head = _head_at(file, at)
        if head is None or not found.define(head[0], file.read(at, head[1])[HEAD.size :]):
            return False
    # Bytes that were removed and inserted between may have shifted chunks. To look at each takes as
    # long as to read them; a shift that a sample misses costs the few chunks that it hits.
    for one in found.chunks[:: 1 + len(found.chunks) // _SAMPLE]:
        own = HEAD.pack(Opcode.CHUNK, one.stop - one.start - HEAD.size)
        if file.read(one.start, one.start + HEAD.size) != own:
            return False
    if any(one.stop > file.size for one in found.chunks):
        return False
    counted = found.statistics
    if counted is None or counted.chunk_count != len(found.chunks):
        return False
    return bool(found.chunks) or not counted.message_count


def walk(stream: BinaryIO, first: int = 0, *, is_growing: bool = False) -> Contents:
    """What the records from an offset on are.

    Of a growing file: up to the last whole record, because another program writes the next one.
    """
    file = _Bytes(stream.fileno(), os.fstat(stream.fileno()).st_size)
    found = Contents()
    at = first or len(MAGIC)
    if not first and file.read(0, at) != MAGIC:
        at = at if _head_at(file, at) else 0
        found.lost |= {LostBytes(0, at, _RECORDS_LOST)} if at else set()
    before = at - 1
    """The start of the last record whose content agrees with its length, which may be damaged."""
    is_ended = is_growing
    while at < file.size:
        head = _record_at(file, at, found)
        if head is None:
            if is_growing:
                break
            at = _after_damage(file, at, before, found)
            before, is_ended = at - 1, at == file.size
            continue
        opcode, stop = head
        before = at if opcode in _CHECKED else before
        if opcode == Opcode.CHUNK:
            inner = file.read(at + HEAD.size, at + _CHUNK_START)
            first_ns, last_ns, size, *_ = _CHUNK_HEAD.unpack_from(inner)
            found.chunks.append(ChunkRef(at, stop, first_ns, last_ns, size))
            before, stop = _indexes_behind(file, at, stop)
        elif opcode == Opcode.MESSAGE:
            found.messages.append((at, stop))
        at = stop
        if opcode == Opcode.FOOTER:
            is_ended = True
            # Behind the end of a file that is being written may be zeros, and a second end.
            at = file.size if is_growing else _next_chunk(file, stop, file.size)
            behind = stop + len(MAGIC)
            if not is_growing and _JUNK.match(file.read(stop, behind + HEAD.size)):
                found.lost.add(LostBytes(behind, at, _BEHIND_END))
    if not is_ended:
        found.lost.add(LostBytes(file.size, file.size, _END_LOST))
    return found


def _indexes_behind(file: _Bytes, before: int, at: int) -> tuple[int, int]:
    """The start and the end of the last of the small message indexes behind a record, or its own.

    A chunk of 50 ms has dozens of them, so they are read together.
    """
    data, start = file.read(at, at + _BLOCK // 8), 0
    while start + _INDEX_HEAD.size <= len(data):
        opcode, length, _, size = _INDEX_HEAD.unpack_from(data, start)
        stop = start + HEAD.size + length
        if opcode != Opcode.MESSAGE_INDEX or length != size + 6 or stop > len(data):
            break
        before, start = at + start, stop
    return before, at + start


def _record_at(file: _Bytes, at: int, found: Contents) -> tuple[int, int] | None:
    """Opcode and end of the record at an offset, which is applied; None if it makes no sense."""
    head = _head_at(file, at)
    if head is None:
        return None
    opcode, stop = head
    if opcode in _RECORDS and not found.define(opcode, file.read(at, stop)[HEAD.size :]):
        return None
    # A record whose length nothing confirms has no chunk in it.
    if opcode not in _CHECKED and _next_chunk(file, at, stop) < stop:
        return None
    return head


def _after_damage(file: _Bytes, at: int, before: int, found: Contents) -> int:
    """The next chunk after damage at an offset, which is reported; or the end of the file.

    The record that starts at `before` may be damaged too.
    """
    following = _next_chunk(file, before + 1, file.size)
    start = at if at < following else max(before, 0)
    found.lost = {one for one in found.lost if one.stop <= start}
    why = _END_LOST if following == file.size else _RECORDS_LOST
    found.lost.add(LostBytes(start, following, why))
    return following


_CHECKED: Final = frozenset({*_RECORDS, Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.FOOTER})
"""The records whose content shows whether their length is right."""


class _Bytes(NamedTuple):
    """The bytes of a file; not mapped, because another program may cut the file."""

    descriptor: int
    size: int

    def read(self, start: int, stop: int) -> bytes:
        """The bytes from `start` to `stop`, as far as the file has them."""
        start = min(start, self.size)
        return read_at(self.descriptor, max(0, min(stop, self.size) - start), start)


_JUNK: Final = re.compile(re.escape(MAGIC) + rb"(?!\0|\x0f\x04\0{7}|\x03..\0{6}|\Z)", re.DOTALL)
"""An end of a file, and behind it neither the end of the file nor what a capture writes there."""
_BEHIND_END: Final = TranslatableText("they are behind the end of the recording")
_RECORDS_LOST: Final = TranslatableText("damaged records")
_END_LOST: Final = TranslatableText("the file is damaged or cut off there")


def _head_at(file: _Bytes, at: int) -> tuple[int, int] | None:
    """Opcode and end of the record at an offset; None if it makes no sense."""
    start = file.read(at, at + _CHUNK_START)
    if len(start) < HEAD.size:
        return None
    opcode, length = HEAD.unpack_from(start)
    stop = at + HEAD.size + length
    if stop > file.size or not (opcode in _OPCODES or opcode >= _FIRST_PRIVATE):
        return None
    # A chunk whose opcode is damaged looks like another record.
    if (opcode == Opcode.CHUNK) != (_chunk_length(start) == length):
        return None
    if opcode == Opcode.FOOTER and file.read(stop, stop + len(MAGIC)) != MAGIC:
        return None
    size = int.from_bytes(start[HEAD.size + 2 : _INDEX_HEAD.size], "little")
    if opcode == Opcode.MESSAGE_INDEX and length != size + 6:
        return None
    return opcode, stop


def _chunk_length(start: bytes) -> int | None:
    """The length of a chunk by its inner lengths; `start` are the first bytes of its record."""
    try:
        *_, name_size = _CHUNK_HEAD.unpack_from(start, HEAD.size)
        before = _CHUNK_HEAD.size + name_size + 8
        return int(before + struct.unpack_from("<Q", start, HEAD.size + before - 8)[0])
    except struct.error:
        return None


def _next_chunk(file: _Bytes, start: int, end: int) -> int:
    """The next whole chunk that begins at `start` or later, and before `end`; `end` without one."""
    for block in range(start, end, _BLOCK):
        data = file.read(block, min(block + _BLOCK, end) + _CHUNK_START)
        for mark in _MARK.finditer(data):
            at = block + mark.start() - _MARK_OFFSET
            if start <= at < end and (head := _head_at(file, at)) and head[0] == Opcode.CHUNK:
                return at
    return end


def unpack(body: bytes | memoryview, zstd: ZstdDecompressor) -> bytes:
    """The records of a chunk, which must have its checksum; raises DamagedError.

    To make a decompressor takes as long as to read a small chunk, so chunks of a thread share one.
    """
    try:
        _, _, size, crc, name_size = _CHUNK_HEAD.unpack_from(body)
        name = body[_CHUNK_HEAD.size : _CHUNK_HEAD.size + name_size]
        packed = memoryview(body)[_CHUNK_HEAD.size + name_size + 8 :]
        if size > LARGEST or (name == b"zstd" and frame_content_size(packed) not in (size, -1)):
            raise ValueError("a chunk of another size than it claims")
        if name == b"zstd":
            records = zstd.decompress(packed, max_output_size=size)
        elif name == b"lz4":
            records = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size)
        else:
            records = bytes(packed)
    except (struct.error, ValueError, RuntimeError, EOFError, MemoryError, ZstdError) as error:
        raise DamagedError(TranslatableText("a chunk that does not unpack")) from error
    if len(records) != size or (crc and crc32(records) != crc):
        raise DamagedError(TranslatableText("a chunk whose checksum does not match"))
    return records


def records_in(records: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, offset and end of each record; raises DamagedError if one is invalid."""
    at = 0
    while at < len(records):
        is_whole = at + HEAD.size <= len(records)
        opcode, length = HEAD.unpack_from(records, at) if is_whole else (0, 0)
        stop = at + HEAD.size + length
        if not opcode or stop > len(records):
            raise DamagedError(TranslatableText("records that go beyond their chunk"))
        yield opcode, at, stop
        at = stop
