"""Search for intact chunks in a damaged file.

A chunk is found by the name of its compression, and counts if it unpacks with the right checksum:

    06 length | start  end  size crc  04 00 00 00 z s t d  length | records ...
              |  8      8    8    4        the mark           8
"""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, Metadata, Schema, Statistics

from fte_sniff.recording.mcap.records import (
    CHUNK_HEAD,
    HEAD,
    LARGEST,
    LENGTH,
    MAGIC,
    RecordError,
    parse,
    records_in,
    unpack,
)

_MARKS = re.compile(rb"\x04\0\0\0zstd|\x03\0\0\0lz4")
_BEFORE_MARK = HEAD.size + CHUNK_HEAD.size - 4
_LONGEST_MARK = 8
_BLOCK = 1024 * 1024
_LARGEST_DEFINITION = 16 * 1024 * 1024
_FIRST_PRIVATE = 0x80


@dataclass(frozen=True, slots=True)
class FoundChunk:
    """An intact chunk."""

    position: int
    """Offset of its record in the file."""
    length: int
    """Bytes of its record, including the head."""
    chunk: Chunk
    """The record; no checksum covers its times."""
    records: bytes
    """The unpacked records."""

    @property
    def stop(self) -> int:
        """The end of its record."""
        return self.position + self.length


@dataclass(slots=True)
class Descriptions:
    """Definitions and metadata, in the order in which they were found."""

    schemas: list[Schema] = field(default_factory=list)
    channels: list[Channel] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    statistics: Statistics | None = None
    header: Header | None = None

    def update(self, opcode: int, body: bytes) -> None:
        """Add a definition or metadata, ignore others; raises RecordError if it is damaged."""
        if opcode == Opcode.SCHEMA:
            self.schemas.append(parse(Schema, body))
        elif opcode == Opcode.CHANNEL:
            self.channels.append(parse(Channel, body))
        elif opcode == Opcode.METADATA:
            self.metadata.append(parse(Metadata, body))
        elif opcode == Opcode.STATISTICS:
            self.statistics = parse(Statistics, body)
        elif opcode == Opcode.HEADER:
            self.header = parse(Header, body)


class Salvage:
    """Search in one file."""

    def __init__(self, stream: BinaryIO) -> None:
        """Take a seekable file; bytes that are appended later are ignored."""
        self._stream = stream
        self.size = stream.seek(0, os.SEEK_END)
        """Bytes in the file."""

    def chunks(self, start: int = 0) -> Iterator[FoundChunk]:
        """Every intact chunk from an offset on, in order, without overlap."""
        position = start
        while (mark := self._next_mark(position)) is not None:
            found = self._chunk_at(mark)
            if found is None or found.position < position:
                position = mark + 1
            else:
                yield found
                position = found.stop

    def why_empty(self) -> str:
        """The message for a file without intact chunk."""
        if not self.size:
            return "it is empty: nothing was recorded into it, and there is nothing to repair"
        ends = self._read(0, len(MAGIC)), self._read(max(0, self.size - len(MAGIC)), len(MAGIC))
        if MAGIC not in ends and not MAGIC.startswith(ends[0]):
            return "this is no MCAP recording, so there is nothing to repair"
        return "no whole chunk is left in it, so there is nothing to repair"

    def between(self, start: int, stop: int, found: Descriptions) -> list[tuple[int, int]]:
        """Read the records from `start` to the next chunk, or the end of the file, at `stop`.

        `found` receives definitions and metadata. Returns start and stop of the bytes that could
        not be read.
        """
        lost: list[tuple[int, int]] = []
        position = start
        if not position:
            if self._read(0, len(MAGIC)) != MAGIC[:stop]:
                lost.append((0, min(len(MAGIC), stop)))
            position = len(MAGIC)
        while position < stop:
            length = self._record(position, stop, found)
            if length is None:
                lost.append((position, stop))
                break
            opcode = self._read(position, 1)[0]
            if opcode == Opcode.CHUNK:
                lost.append((position, position + length))
            position += length
            if opcode == Opcode.FOOTER:
                end = min(position + len(MAGIC), stop)
                if self._read(position, len(MAGIC)) != MAGIC or end < stop:
                    lost.append((end if self._read(position, 8) == MAGIC else position, stop))
                break
        return lost

    def _record(self, position: int, stop: int, found: Descriptions) -> int | None:
        """The length of the record at `position` with its head; None if there is no record."""
        head = self._read(position, HEAD.size)
        if len(head) < HEAD.size:
            return None
        opcode, length = HEAD.unpack(head)
        known = Opcode.HEADER <= opcode <= Opcode.DATA_END or opcode >= _FIRST_PRIVATE
        if not known or length > stop - position - HEAD.size:
            return None
        if length <= _LARGEST_DEFINITION:
            try:
                found.update(opcode, self._read(position + HEAD.size, length))
            except RecordError:
                return None
        return HEAD.size + int(length)

    def _next_mark(self, position: int) -> int | None:
        while position < self.size:
            block = self._read(position, _BLOCK)
            found = _MARKS.search(block)
            if found is not None:
                return position + found.start()
            if len(block) < _BLOCK:
                return None
            position += _BLOCK - _LONGEST_MARK + 1
        return None

    def _chunk_at(self, mark: int) -> FoundChunk | None:
        """The intact chunk with this mark; the head of its record is not needed."""
        position = mark - _BEFORE_MARK
        if position < 0:
            return None
        head = self._read(position, _BEFORE_MARK + _LONGEST_MARK + LENGTH.size)
        body = head[HEAD.size :]
        try:
            start, end, size, crc, name = CHUNK_HEAD.unpack_from(body)
            records_at = CHUNK_HEAD.size + name + LENGTH.size
            (length,) = LENGTH.unpack_from(body, records_at - LENGTH.size)
        except struct.error:
            return None
        record_length = HEAD.size + records_at + length
        if not crc or max(size, record_length) > LARGEST or position + record_length > self.size:
            return None
        whole = self._read(position + HEAD.size, record_length - HEAD.size)
        try:
            records = unpack(whole)
            for _ in records_in(records):
                pass
        except RecordError:
            return None
        compression = whole[CHUNK_HEAD.size : CHUNK_HEAD.size + name].decode()
        chunk = Chunk(compression, whole[records_at:], end, start, crc, size)
        return FoundChunk(position, record_length, chunk, records)

    def _read(self, position: int, length: int) -> bytes:
        self._stream.seek(position)
        return self._stream.read(max(0, min(length, self.size - position)))


def next_chunk(stream: BinaryIO, position: int = 0) -> FoundChunk | None:
    """The first intact chunk at `position` or after it in a seekable file."""
    return next(Salvage(stream).chunks(position), None)
