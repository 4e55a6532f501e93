"""Reader of an MCAP file: records, whole or damaged, the summary, and the messages of a chunk.

    magic | opcode, length, body | opcode, length, body | ... | footer | magic
      8        1      8

Every command reads a file through `RecordStream`, so all of them trust the same records:

- A record is trusted if it does not reach over the start of a chunk. Starts come from the summary,
  where the head of the chunk agrees with it, or from intact chunks that are found by their bytes.
- A chunk is intact if it unpacks with the right checksum. It is found by the name of its
  compression; the head of its record is not needed:

    06 length | start  end  size crc  04 00 00 00 z s t d  length | records ...
              |  8      8    8    4        the mark           8

- After a damaged record, reading resumes at the next such start.
- A chunk is skipped only if the summary has a checksum and the chunk's head agrees with it.

The messages of a chunk are found with its message indexes, or by walking over its records:

    opcode u8 | length u64 | channel u16 | sequence u32 | log time u64 | publish time u64 | message

An index is a hint: it is used only if the records between the messages that it names are whole, and
none of them is a message.
"""

from __future__ import annotations

import os
import re
import struct
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache
from io import BytesIO
from itertools import pairwise
from typing import Any, BinaryIO, NamedTuple, Protocol, TypeVar

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, MetadataIndex, Schema, Statistics
from mcap.writer import MCAP0_MAGIC
from zlib_ng.zlib_ng import crc32

from fte_sniff.errors import TranslatableText
from fte_sniff.platform import read_at
from fte_sniff.protocol.rows import Array

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


_FREED = 31 * 1024 * 1024
"""Bytes; glibc adapts to freed blocks of up to 32 MiB."""


@cache
def keep_freed_memory() -> None:
    """Make glibc keep freed memory for the next chunk.

    Otherwise it returns the memory to the system, and the page faults of the next chunk cost half
    as much as unpacking. glibc keeps up to twice the largest block that was ever freed, so freeing
    one large block is enough; it is never touched and takes no memory. Other C libraries ignore it.
    """
    np.empty(_FREED, np.uint8)


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


END_LENGTH = HEAD.size + 8 + 8 + 4 + len(MAGIC)
"""Bytes of the footer and the final magic."""

DATA_END_LENGTH = HEAD.size + 4
"""Bytes of the record that ends the data."""


MESSAGE_HEAD = HEAD.size + 2 + 4 + 8 + 8
"""Bytes of a message record before the message."""

PREFIX = 64
"""Bytes copied of each message record: the head, and every field of the common layout. Numpy copies
64 bytes hardly slower than one number."""

LENGTH_OFFSET, CHANNEL_OFFSET, SEQUENCE_OFFSET, LOG_TIME_OFFSET = 1, 9, 11, 15
"""Offsets in a message record."""

_ENTRY = np.dtype("<u8")
_INDEX_HEAD = 2 + 4

Definition = tuple[int, bytes]
"""Opcode and body of a schema or channel record."""

DEFINITIONS = frozenset({int(Opcode.SCHEMA), int(Opcode.CHANNEL)})


@dataclass(frozen=True, slots=True)
class MessageIndex:
    """The messages of an unpacked chunk, or of several concatenated ones."""

    records: bytes
    starts: Array
    """Where each message record begins, rising."""
    lengths: Array
    """Of the messages, without their heads."""
    prefixes: Array
    """The first bytes of each record as opaque values; those of a short record run into the next.
    """
    definitions: list[Definition] = field(default_factory=list)
    without_head: int = 0
    """Number of messages that are too short to be one; they are not in the index."""

    def __len__(self) -> int:
        return len(self.starts)

    def slices(self, most: int, size: int) -> Iterator[MessageIndex]:
        """The messages; if they have more than `most` bytes, in slices of about `size` bytes."""
        cuts = [0, len(self)]
        if len(self.records) > most:
            bounds = np.arange(size, len(self.records), size)
            cuts[1:1] = np.searchsorted(self.starts, bounds).tolist()
        for first, end in pairwise(cuts):
            lengths, prefixes = self.lengths[first:end], self.prefixes[first:end]
            if first < end:
                starts = self.starts[first:end]
                yield MessageIndex(self.records, starts, lengths, prefixes)

    def field(self, offset: int, kind: str | np.dtype[Any]) -> Array:
        """The numbers at an offset of the records."""
        return field_view(self.prefixes, offset, kind)


def at_every_byte(records: bytes, size: int) -> Array:
    """Overlapping opaque values of `size` bytes, one for every byte."""
    count = max(0, len(records) - size + 1)
    found: Array = np.ndarray((count,), f"V{size}", records, 0, (1,))
    return found


def field_view(packed: Array, offset: int, kind: str | np.dtype[Any]) -> Array:
    """A view of the numbers at an offset of opaque values."""
    if not len(packed):
        return np.empty(0, kind)
    found: Array = np.ndarray((len(packed),), kind, packed, offset, (packed.dtype.itemsize,))
    return found


def indexed_starts(indexes: Sequence[bytes], size: int) -> Array | None:
    """The starts in the message index records of a chunk, rising; None if they are impossible.

    index record:  channel u16 | bytes u32 | (log time u64, start u64) for each message

    `indexes` are the bodies of the records, `size` the bytes of the unpacked chunk.
    """
    entry = 2 * _ENTRY.itemsize
    if any(len(body) < _INDEX_HEAD or (len(body) - _INDEX_HEAD) % entry for body in indexes):
        return None
    named = [np.frombuffer(body, _ENTRY, offset=_INDEX_HEAD)[1::2] for body in indexes]
    # Chunks are smaller than 4 GiB, and numpy sorts short numbers much faster.
    starts = np.concatenate(named, dtype=np.uint32, casting="unsafe") if named else np.empty(0)
    if not len(starts) or starts.max() >= size:
        return None
    starts.sort()
    return starts.astype(np.int64)


def index_messages(records: bytes, starts: Array | None, most: int) -> MessageIndex:
    """The messages of an unpacked chunk, or of several concatenated ones.

    `starts` are those of a message index, rising; they are ignored if they are wrong. `most` is the
    largest number of records.

    Raises RecordError if the records exceed the chunk, are none, or are too many.
    """
    found = None if starts is None else _confirmed(records, starts, most)
    if found is None:
        walked, definitions, _ = _walked(records, 0, len(records), most)
        found = _messages(records, np.array(walked, np.int64))
        found.definitions.extend(definitions)
    if len(found) and found.lengths.min() < 0:
        whole = found.lengths >= 0
        starts = found.starts[whole]
        short = len(found) - len(starts)
        definitions = found.definitions
        found = replace(_messages(records, starts), definitions=definitions)
        found = replace(found, without_head=short)
    return found


def _messages(records: bytes, starts: Array) -> MessageIndex:
    prefixes = _prefixes(records, starts)
    lengths = field_view(prefixes, LENGTH_OFFSET, "<i8") - (MESSAGE_HEAD - HEAD.size)
    return MessageIndex(records, starts, lengths, prefixes)


def _prefixes(records: bytes, starts: Array) -> Array:
    """The bytes from each start on, padded with zeros at the end of the records."""
    last = len(records) - PREFIX
    if last < 0:
        return _prefixes(records.ljust(PREFIX, b"\0"), starts)
    whole = int(np.searchsorted(starts, last, "right"))
    if whole == len(starts):
        return at_every_byte(records, PREFIX)[starts]
    found = at_every_byte(records, PREFIX)[np.minimum(starts, last)]
    for row in range(whole, len(starts)):
        found[row] = np.void(records[int(starts[row]) :].ljust(PREFIX, b"\0"))
    return found


def _confirmed(records: bytes, starts: Array, most: int) -> MessageIndex | None:
    """The index if the records are contiguous and messages begin at these starts only."""
    if not len(starts) or starts[0] < 0 or starts[-1] > len(records) - MESSAGE_HEAD:
        return None
    found = _messages(records, starts)
    if (found.field(0, "u1") != Opcode.MESSAGE).any():
        return None
    ends = starts + found.lengths
    ends += MESSAGE_HEAD
    gaps = [(0, int(starts[0])), (int(ends[-1]), len(records))]
    between = np.flatnonzero(ends[:-1] != starts[1:])
    gaps[1:1] = zip(ends[between].tolist(), starts[between + 1].tolist(), strict=True)
    for start, end in gaps:
        try:
            messages, definitions, count = _walked(records, start, end, most)
        except RecordError:
            return None
        if messages:
            return None
        most -= count
        found.definitions.extend(definitions)
    return found


def _walked(
    records: bytes, start: int, end: int, most: int
) -> tuple[list[int], list[Definition], int]:
    """Message starts, definitions and the number of all records from `start` to `end`."""
    starts: list[int] = []
    definitions: list[Definition] = []
    at, count, message = start, 0, int(Opcode.MESSAGE)
    unpack = HEAD.unpack_from
    for _ in range(most + 1):
        if not 0 <= at <= end - HEAD.size:
            break
        opcode, length = unpack(records, at)
        after = at + HEAD.size + length
        if opcode == 0:
            raise RecordError(NO_RECORD)
        if after > end:
            break
        if opcode == message:
            starts.append(at)
        elif opcode in DEFINITIONS:
            definitions.append((opcode, records[at + HEAD.size : after]))
        at, count = after, count + 1
    else:
        raise RecordError("a chunk of more records than its size can hold")
    if at != end:
        raise RecordError(BEYOND_CHUNK)
    return starts, definitions, count


_SKIPPED = 0
"""Pseudo opcode of a record that was not read; no record of a file has it."""
_WITH_CHECKSUM = frozenset({int(Opcode.DATA_END), int(Opcode.FOOTER)})
_CHUNK_CLAIMS = struct.Struct("<QQQ")
"""First and last time and unpacked size, at the start of a chunk's body."""
_CRC_LENGTH = 4
_BLOCK = 1024 * 1024
_FIRST_BLOCK = 4096
"""Bytes that a search for a chunk reads first, because most are close."""
_MARKS = re.compile(rb"[\x03\x04]\0\0\0(?:lz4|zstd)")
_NAMES = b"\0\0\0zstd", b"\0\0\0lz4"
_MARK_OFFSET = CHUNK_HEAD.size - 4
"""Offset of the mark in a chunk's body."""
_LONGEST_MARK = 8
_FIRST_PACKED = HEAD.size + _MARK_OFFSET + _LONGEST_MARK
"""Offset of the first byte after the mark in a chunk's record."""
_SEARCH_FACTOR = 512
"""Bytes that the search may unpack, as a multiple of the file's size."""

_REACHING = TranslatableText("a record overlaps the next one")
_WRONG_DATA = TranslatableText("the checksum over the data outside the chunks does not match")
_WRONG_SUMMARY = TranslatableText("the checksum over the summary outside the chunks does not match")


class RawRecord(NamedTuple):
    """One record; a tuple, because there are very many."""

    position: int
    opcode: int
    body: bytes

    @property
    def stop(self) -> int:
        """The end of the record in the file."""
        return self.position + HEAD.size + len(self.body)


@dataclass(frozen=True, slots=True)
class LostBytes:
    """Bytes of a file that could not be read; none if only the head of a chunk is damaged."""

    start: int
    stop: int
    text: TranslatableText
    """What was found there."""


@dataclass(slots=True)
class Summary:
    """The records of a summary that the reader uses."""

    schemas: list[Schema] = field(default_factory=list)
    channels: list[Channel] = field(default_factory=list)
    statistics: Statistics | None = None
    metadata: set[str] = field(default_factory=set)
    """The names of the metadata records in its index."""
    heads: dict[int, bytes] = field(default_factory=dict)
    """By offset in the file, the first bytes of each chunk and of the data end."""
    guarded: bool = False

    def update(self, opcode: int, body: bytes) -> None:
        """Apply a record; raises RecordError if it is damaged."""
        if opcode == Opcode.SCHEMA:
            self.schemas.append(parse(Schema, body))
        elif opcode == Opcode.CHANNEL:
            self.channels.append(parse(Channel, body))
        elif opcode == Opcode.STATISTICS:
            self.statistics = parse(Statistics, body)
        elif opcode == Opcode.METADATA_INDEX:
            self.metadata.add(parse(MetadataIndex, body).name)
        elif opcode == Opcode.CHUNK_INDEX:
            index = parse(ChunkIndex, body)
            times = index.message_start_time, index.message_end_time
            self.heads[index.chunk_start_offset] = HEAD.pack(
                Opcode.CHUNK, max(0, index.chunk_length - HEAD.size)
            ) + _CHUNK_CLAIMS.pack(*times, index.uncompressed_size)


def read_summary(stream: BinaryIO) -> Summary | None:
    """The summary of a seekable file; None if there is none, or if it is damaged.

    During a write, the last footer may point at the previous summary, which has its own footer.
    """
    size = stream.seek(0, os.SEEK_END)
    if size < len(MAGIC) + END_LENGTH:
        return None
    stream.seek(size - END_LENGTH)
    end = stream.read(END_LENGTH)
    body = end[HEAD.size : -len(MAGIC)]
    if not end.endswith(MAGIC) or HEAD.unpack_from(end) != (Opcode.FOOTER, len(body)):
        return None
    start = parse(Footer, body).summary_start
    if not start or not 0 < size - END_LENGTH - start <= LARGEST:
        return None
    stream.seek(start)
    try:
        return _summary_of(stream.read(size - len(MAGIC) - start), start)
    except RecordError:
        return None


def _summary_of(records: bytes, start: int) -> Summary | None:
    summary = Summary()
    summary.heads[start - DATA_END_LENGTH] = HEAD.pack(Opcode.DATA_END, _CRC_LENGTH)
    stop = 0
    for opcode, body in records_in(records):
        stop += HEAD.size + len(body)
        if opcode == Opcode.FOOTER:
            crc = parse(Footer, body).summary_crc
            if crc not in (0, crc32(records[: stop - _CRC_LENGTH])):
                return None
            summary.guarded = bool(crc)
            return summary
        summary.update(opcode, body)
    return None


class RecordStream:
    """The trusted records of a file, one by one."""

    def __init__(
        self,
        stream: BinaryIO,
        summary: Summary | None = None,
        wanted: Callable[[int, int], bool] | None = None,
        found: dict[int, int] | None = None,
        *,
        chunks: bool = True,
        first: int = 0,
        stop: int | None = None,
    ) -> None:
        """Take the file, at its start; only a seekable one is read further after damage.

        Args:
            stream: the file.
            summary: its summary; ignored without checksum.
            wanted: whether to read a chunk with this first and last log time; by default all.
            found: receives position and body length of chunks whose head is damaged.
            chunks: whether to read chunks at all.
            first: offset of the first record that is read; 0 for the start of the file.
            stop: offset of the first record that is not read; None for the end of the file.
        """
        self._stream = stream
        self._size = stream.seek(0, os.SEEK_END) if stream.seekable() else None
        self._stop = stop
        if self._size is not None and stop is not None:
            self._size = min(self._size, stop)
        self._summary = summary if summary is not None and summary.guarded else None
        self._starts = sorted(self._summary.heads) if self._summary else []
        self._wanted, self._chunks = wanted, chunks
        self._found = {} if found is None else found
        self._budget = _SEARCH_FACTOR * (self._size or 0)
        self._agreed: set[int] = set()
        self._position = first
        self._last = first - 1
        """Offset of the last record."""
        self._in_data = True
        self._inner: int | None = None
        """The chunk over which the last record reached."""
        self._checksum: RunningChecksum | None = None if first else RunningChecksum()
        self._before: int | None = None
        """The checksum before the last record with a checksum; None if something was skipped."""
        self.ending: LostBytes | None = None
        """What is wrong with the end of the file; valid after the last record."""
        self.losses: list[LostBytes] = []
        self.has_lost_data = False
        """Whether bytes before the summary could not be read."""

    def __iter__(self) -> Iterator[RawRecord]:
        if self._size is not None:
            self._stream.seek(self._position)
        at_record = self._position > 0 or self._read(len(MAGIC)) == MAGIC
        readable = at_record or self._resume(0, RecordError(NO_RECORD))
        while readable and (self._stop is None or self._position < self._stop):
            position = self._position
            try:
                record = self._record()
            except RecordError as error:
                readable = self._resume(position, error)
                continue
            if record is None:
                text = TranslatableText(
                    "it was never closed, its last byte is {position}", position=position
                )
                self._end(position, text)
                return
            self._last = position
            if record.opcode == _SKIPPED:
                continue
            if record.opcode == Opcode.DATA_END:
                self._in_data = False
                self._check_crc(record.body, self._before, _WRONG_DATA)
                self._checksum = RunningChecksum()
            yield record
            if record.opcode == Opcode.FOOTER:
                self._check_end(record.body)
                return

    def _record(self) -> RawRecord | None:
        position = self._position
        head = self._unsummed(HEAD.size)
        if not head:
            return None
        if head[0] in _WITH_CHECKSUM:
            self._before = None if self._checksum is None else self._checksum.value()
        self._sum(head)
        if len(head) < HEAD.size:
            raise RecordError("it is cut off in the record")
        opcode, length = HEAD.unpack(head)
        if position in self._found:
            opcode, length = int(Opcode.CHUNK), self._found[position]
        elif self._summary and self._summary.heads.get(position, head)[0] != opcode:
            raise RecordError("the header of a record is damaged")
        if opcode == 0:
            raise RecordError(NO_RECORD)
        if length > LARGEST:
            raise RecordError("there is a record that claims {length} bytes", length=length)
        start = self._next_start(position)
        if start is not None and start < self._position + length:
            raise RecordError(_REACHING)
        if opcode == Opcode.CHUNK and self._is_unwanted(position, length):
            return self._skip(position, length)
        body = self._read(length)
        if len(body) < length:
            raise RecordError("it is cut off in the record")
        if opcode == Opcode.CHUNK:
            # A chunk with a wrong length would hide the next ones.
            compressed_records(body)
        record = RawRecord(position, opcode, body)
        if start is None and self._in_data and self._reaches_over_chunk(record):
            raise RecordError(_REACHING)
        return record

    def _is_unwanted(self, position: int, length: int) -> bool:
        if not self._chunks:
            return self._size is not None and position + HEAD.size + length <= self._size
        if self._wanted is None or self._summary is None or not self._agrees(position):
            return False
        first_ns, last_ns, _ = _CHUNK_CLAIMS.unpack_from(self._summary.heads[position], HEAD.size)
        return not self._wanted(first_ns, last_ns)

    def _skip(self, position: int, length: int) -> RawRecord:
        """Go to the end of a record; its checksum is then unknown."""
        self._stream.seek(length, os.SEEK_CUR)
        self._position, self._checksum = self._position + length, None
        return RawRecord(position, _SKIPPED, b"")

    def _read(self, length: int) -> bytes:
        """Up to `length` bytes, by blocks, so that a wrong length takes no memory."""
        if length <= _BLOCK:
            return self._block(length)
        blocks = [self._block(_BLOCK)]
        while len(blocks[-1]) == _BLOCK and (length := length - _BLOCK):
            blocks.append(self._block(min(length, _BLOCK)))
        return b"".join(blocks)

    def _block(self, length: int) -> bytes:
        block = self._unsummed(length)
        self._sum(block)
        return block

    def _unsummed(self, length: int) -> bytes:
        block = self._stream.read(length)
        self._position += len(block)
        return block

    def _sum(self, block: bytes) -> None:
        if self._checksum is not None:
            self._checksum.update(block)

    def _next_start(self, position: int) -> int | None:
        """The next start in the summary after `position` with which the file agrees."""
        after = bisect_right(self._starts, position)
        while after < len(self._starts) and not self._agrees(self._starts[after]):
            del self._starts[after]
        return self._starts[after] if after < len(self._starts) else None

    def _agrees(self, start: int) -> bool:
        """Whether the record at `start` has the head that the summary names."""
        head = self._summary.heads.get(start) if self._summary else None
        if head is None:
            return False
        if start not in self._agreed and self._bytes_at(start, len(head)) == head:
            self._agreed.add(start)
        return start in self._agreed

    def _bytes_at(self, position: int, length: int) -> bytes:
        return read_at(self._stream.fileno(), length, position)

    def _reaches_over_chunk(self, record: RawRecord) -> bool:
        """Whether an intact chunk is within a record, so that its length is wrong."""
        position, opcode, body = record
        first = _MARK_OFFSET + _LONGEST_MARK if opcode == Opcode.CHUNK else 0
        if position in self._found or all(body.find(name, first) < 0 for name in _NAMES):
            return False
        if opcode == Opcode.CHUNK and self._intact_length(position, record.stop) == len(body):
            return False
        if opcode == Opcode.ATTACHMENT and crc32(body[:-_CRC_LENGTH]) == _crc_in(body):
            return False
        self._inner = self._search(position + 1, record.stop, self._size or 0)
        return self._inner is not None

    def _resume(self, position: int, error: RecordError) -> bool:
        """Go to the next start after a damaged record; False if there is none."""
        start = self._next_start(position)
        found, self._inner = self._inner, None
        if found is None:
            stop = self._size or 0 if start is None else start
            # The length of a chunk that was searched for may be too large.
            first = self._last + _FIRST_PACKED if self._last in self._found else position
            found = self._search(first, stop, stop)
        start = start if found is None else found
        self.has_lost_data |= self._in_data and start != position
        if start is None:
            text = TranslatableText(
                "{error} at byte {position}; the file ends at byte {end}",
                error=error.message,
                position=position,
                end=self._size or self._position,
            )
            self._end(position, text)
            return False
        self._stream.seek(start)
        self._position, self._checksum = start, None
        if start > position:
            text = TranslatableText(
                "bytes {position} to {start} were skipped: {reason}",
                position=position,
                start=start,
                reason=error.message,
            )
        else:
            text = TranslatableText(
                "the header of the chunk at byte {position} is damaged", position=start
            )
        self.losses.append(LostBytes(min(position, start), start, text))
        return True

    def _search(self, start: int, stop: int, limit: int) -> int | None:
        """The first intact chunk whose mark is from `start` to `stop`, and that ends by `limit`."""
        for mark in self._marks(start, stop):
            position = mark - _MARK_OFFSET - HEAD.size
            if position in self._found and position > self._last:
                return position  # an earlier pass found it
            length = self._intact_length(position, limit)
            if length is not None:
                self._found[position] = length
                return position
        return None

    def _marks(self, start: int, stop: int) -> Iterator[int]:
        size = _FIRST_BLOCK
        while start < stop:
            block = self._bytes_at(start, min(size, stop - start + _LONGEST_MARK))
            yield from (start + mark.start() for mark in _MARKS.finditer(block))
            if len(block) <= _LONGEST_MARK:
                return
            start += len(block) - _LONGEST_MARK + 1
            size = _BLOCK

    def _intact_length(self, position: int, limit: int) -> int | None:
        """Bytes of the body of the chunk at `position` if it is intact; needs no record head."""
        if position <= self._last:
            return None
        start = position + HEAD.size
        head = self._bytes_at(start, _MARK_OFFSET + _LONGEST_MARK + LENGTH.size)
        try:
            name_length = CHUNK_HEAD.unpack_from(head)[-1]
            (packed,) = LENGTH.unpack_from(head, CHUNK_HEAD.size + name_length)
        except struct.error:
            return None
        size, crc = claimed(head)
        length = CHUNK_HEAD.size + name_length + LENGTH.size + packed
        if not crc or length > LARGEST or start + length > limit or length + size > self._budget:
            return None
        self._budget -= length + size
        with suppress(RecordError):
            unpack(self._bytes_at(start, length))
            return int(length)
        return None

    def _check_crc(self, body: bytes, found: int | None, what: TranslatableText) -> None:
        expected = _crc_in(body)
        if expected and found is not None and expected != found:
            self.ending = LostBytes(self._position, self._position, what)

    def _check_end(self, footer: bytes) -> None:
        if self._before is not None:
            length = len(footer)
            guarded = HEAD.pack(Opcode.FOOTER, length) + footer[:-_CRC_LENGTH]
            self._check_crc(footer, crc32(guarded, self._before), _WRONG_SUMMARY)
        self._checksum = None
        position = self._position
        if self._read(len(MAGIC)) != MAGIC:
            text = TranslatableText(
                "its last {count} bytes are damaged or missing", count=len(MAGIC)
            )
            self._end(position, text)
        elif self._stream.read(1) and not self._is_interrupted(footer):
            text = TranslatableText(
                "other bytes follow its end at byte {position}",
                position=self._position,
            )
            self._end(self._position, text)

    def _is_interrupted(self, footer: bytes) -> bool:
        """Whether the bytes after the end are those that `AppendFile` leaves if it is killed.

        Then the last footer has a summary with a checksum, or is a copy of the one without summary.
        """
        if self._summary is not None or self._size is None:
            return self._summary is not None
        end = HEAD.pack(Opcode.FOOTER, len(footer)) + footer + MAGIC
        return self._bytes_at(self._size - len(end), len(end)) == end

    def _end(self, position: int, text: TranslatableText) -> None:
        self.ending = LostBytes(position, max(position, self._size or 0), text)


def _crc_in(body: bytes) -> int:
    """The checksum at the end of a record's body."""
    return int.from_bytes(body[-_CRC_LENGTH:], "little")
