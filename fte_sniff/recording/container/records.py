"""Owns the records of any MCAP file, cut, damaged or hostile as it may be.

It must not know what the records mean to fte-sniff, nor rows. Nothing here believes a size that
stands in the file: a record is read only up to `LARGEST`, a chunk unpacked only up to `LARGEST`,
and neither is given memory before it is there.

    magic | opcode, length, body | opcode, length, body | ... | footer | magic
      8        1      8
"""

from __future__ import annotations

import os
import struct
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from io import BytesIO
from typing import BinaryIO, NamedTuple, Protocol, TypeVar

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from fte_sniff.recording.container.checksum import RunningChecksum, crc32
from fte_sniff.said import Said

MAGIC = MCAP0_MAGIC
"""The eight bytes that begin and end every MCAP file."""

LARGEST = 256 * 1024 * 1024
"""Bytes of the largest record that is read, and of the largest chunk that is unpacked."""

HEAD = struct.Struct("<BQ")
"""What stands before the body of each record: opcode and length."""

_PASSED_OVER = 0
"""In place of the opcode of a record that was not read; no record of a file has it."""
_TELL_CHECKSUM = frozenset({int(Opcode.DATA_END), int(Opcode.FOOTER)})
_CHUNK_TIMES = struct.Struct("<QQ")
_CHUNK_HEAD = struct.Struct("<QQQII")
_LENGTH = struct.Struct("<Q")
_CRC_LENGTH = 4
_BLOCK = 1024 * 1024
_UNKNOWN_SIZE = 2**64 - 1

_WRONG_DATA = Said("the checksum over the data outside the chunks does not match")
_WRONG_SUMMARY = Said("the checksum over the summary outside the chunks does not match")


class RecordError(ValueError):
    """A record that cannot be what it claims to be; the text says why, in few words."""

    @property
    def said(self) -> Said:
        """The text."""
        text = self.args[0]
        return text if isinstance(text, Said) else Said("{text}", text=text)


class RawRecord(NamedTuple):
    """One record as it stands in the file; a tuple, because there are very many."""

    position: int
    """Of its opcode in the file."""
    opcode: int
    body: bytes


Place = tuple[int, int]
"""Where a record begins in a file, and its length, head included."""

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
        raise RecordError(Said("a record that contradicts itself")) from error


class RecordStream:
    """The records of a file, one by one, to its end or as far as it can be read."""

    def __init__(
        self,
        stream: BinaryIO,
        starts: Sequence[int] = (),
        wanted: Callable[[int, int], bool] | None = None,
        search: Callable[[int], Place | None] | None = None,
        begin: Place | None = None,
    ) -> None:
        """Take the file.

        Args:
            stream: the file, at its beginning; seekable where `starts` or `wanted` are given.
            starts: positions where records are known to begin, rising: where reading can go on
                behind a record that cannot be read.
            wanted: tells from the first and last log time of a chunk whether it is to be read;
                the others are passed over. By default all are.
            search: finds the next whole chunk from a position on, for files of which no starts are
                known.
            begin: the chunk to begin with, where what is before it cannot be read.
        """
        self._stream = stream
        self._starts = starts
        self._wanted = wanted
        self._search = search
        self._begin = self._found = begin
        self._position = 0
        self._checksum: RunningChecksum | None = RunningChecksum()
        self._before: int | None = None
        """The checksum up to the last record that tells one, where all was read that it is of."""
        self.ending: str = ""
        """How the file ends, where it does not end as it should; valid after the last record."""
        self.losses: list[str] = []
        """What was skipped on the way."""

    @property
    def cut(self) -> bool:
        """Whether something may be missing at its beginning or end."""
        return bool(self.ending or self._begin)

    def __iter__(self) -> Iterator[RawRecord]:
        if self._begin:
            self._go_to(self._begin[0])
        else:
            self._read(len(MAGIC))
        while True:
            position = self._position
            try:
                record = self._record()
            except RecordError as error:
                if self._skip_to_next_start(position, error.said):
                    continue
                self.ending = Said(
                    "{error} at byte {position}; it ends at byte {end}",
                    error=error.said,
                    position=position,
                    end=self._position,
                )
                return
            if record is None:
                self.ending = Said(
                    "it was never closed, its last byte is {position}", position=position
                )
                return
            if record.opcode == _PASSED_OVER:
                continue
            if record.opcode == Opcode.DATA_END:
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
        if head[0] in _TELL_CHECKSUM:
            self._before = None if self._checksum is None else self._checksum.value()
        self._sum(head)
        if len(head) < HEAD.size:
            raise RecordError(Said("it is cut in the record"))
        opcode, length = HEAD.unpack(head)
        if self._found is not None and self._found[0] == position:
            # Its head need not be whole.
            opcode, length = int(Opcode.CHUNK), self._found[1] - HEAD.size
        if opcode == 0:
            raise RecordError(Said("there is no MCAP record"))
        if length > LARGEST:
            raise RecordError(Said("there is a record that claims {length} bytes", length=length))
        start = self._next_start(position) if self._starts else None
        if start is not None and start < self._position + length:
            raise RecordError(Said("there is a record that reaches into the next"))
        first = b""
        if self._wanted is not None and opcode == Opcode.CHUNK and length >= _CHUNK_TIMES.size:
            first = self._read(_CHUNK_TIMES.size)
            if len(first) == _CHUNK_TIMES.size and not self._wanted(*_CHUNK_TIMES.unpack(first)):
                return self._pass_over(position, length - len(first))
        body = first + self._read(length - len(first))
        if len(body) < length:
            raise RecordError(Said("it is cut in the record"))
        if opcode == Opcode.CHUNK and self._search is not None:
            # One that claims too much would swallow those behind it.
            _packed(body)
        return RawRecord(position, opcode, body)

    def _pass_over(self, position: int, length: int) -> RawRecord:
        """Go to the end of a record; what is passed over, no checksum can tell anything about."""
        self._stream.seek(length, os.SEEK_CUR)
        self._position, self._checksum = self._position + length, None
        return RawRecord(position, _PASSED_OVER, b"")

    def _read(self, length: int) -> bytes:
        """Up to `length` bytes, by blocks, so that no claimed length takes memory by itself."""
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
            self._checksum.add(block)

    def _next_start(self, position: int) -> int | None:
        place = bisect_right(self._starts, position)
        return self._starts[place] if place < len(self._starts) else None

    def _skip_to_next_start(self, position: int, reason: Said) -> bool:
        start = self._next_start(position)
        if start is None and self._search is not None:
            self._found = self._search(position)
            start = None if self._found is None else self._found[0]
        if start is None:
            return False
        self._go_to(start)
        told = Said("the head of the chunk at byte {position} is damaged", position=position)
        if start > position:
            told = Said(
                "bytes {position} to {start} were skipped: {reason}",
                position=position,
                start=start,
                reason=reason,
            )
        self.losses.append(told)
        return True

    def _go_to(self, start: int) -> None:
        """Go on there; of what is left out, no checksum can tell anything."""
        self._stream.seek(start)
        self._position, self._checksum = start, None

    def _check_crc(self, body: bytes, found: int | None, what: Said) -> None:
        expected = int.from_bytes(body[-_CRC_LENGTH:], "little")
        if expected and found is not None and expected != found:
            self.ending = what

    def _check_end(self, footer: bytes) -> None:
        if self._before is not None:
            length = len(footer)
            guarded = HEAD.pack(Opcode.FOOTER, length) + footer[:-_CRC_LENGTH]
            self._check_crc(footer, crc32(guarded, self._before), _WRONG_SUMMARY)
        self._checksum = None
        if self._read(len(MAGIC)) != MAGIC:
            self.ending = Said("its last {count} bytes are damaged or missing", count=len(MAGIC))
        elif self._stream.read(1):
            self.ending = Said(
                "bytes that do not belong to it follow its end at byte {position}",
                position=self._position,
            )


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
    packed, compression = _packed(body)
    _, _, size, crc, _ = _CHUNK_HEAD.unpack_from(body)
    if size > LARGEST:
        raise RecordError(Said("a chunk that claims to unpack to {size} bytes", size=size))
    records = _unpacked(compression, packed, size)
    if len(records) != size:
        raise RecordError(Said("a chunk that does not unpack to what it claims"))
    if crc and crc32(records) != crc:
        raise RecordError(Said("a chunk whose checksum does not match"))
    return records


def _packed(body: bytes) -> tuple[memoryview, bytes]:
    """What is packed in a chunk, and how."""
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


def records_in(records: bytes) -> Iterator[tuple[int, bytes]]:
    """Opcode and body of each record in an unpacked chunk, or in a summary.

    Raises:
        RecordError: the last of them goes beyond the end.
    """
    place, end = 0, len(records)
    while place < end:
        if end - place < HEAD.size:
            raise RecordError(Said("records that go beyond their chunk"))
        opcode, length = HEAD.unpack_from(records, place)
        place += HEAD.size
        if length > end - place:
            raise RecordError(Said("records that go beyond their chunk"))
        yield opcode, records[place : place + length]
        place += length
