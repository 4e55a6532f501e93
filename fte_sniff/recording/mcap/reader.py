"""Reader of an MCAP file's records and of its summary."""

from __future__ import annotations

import os
import struct
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, Schema, Statistics
from zlib_ng.zlib_ng import crc32

from fte_sniff.errors import TranslatableText
from fte_sniff.recording.mcap.records import (
    DATA_END_LENGTH,
    END_LENGTH,
    HEAD,
    LARGEST,
    MAGIC,
    RecordError,
    RunningChecksum,
    compressed_records,
    parse,
    records_in,
)

_SKIPPED = 0
"""Pseudo opcode of a record that was not read; no record of a file has it."""
_WITH_CHECKSUM = frozenset({int(Opcode.DATA_END), int(Opcode.FOOTER)})
_CHUNK_TIMES = struct.Struct("<QQ")
_CRC_LENGTH = 4
_BLOCK = 1024 * 1024

_WRONG_DATA = TranslatableText("the checksum over the data outside the chunks does not match")
_WRONG_SUMMARY = TranslatableText("the checksum over the summary outside the chunks does not match")


class RawRecord(NamedTuple):
    """One record; a tuple, because there are very many."""

    position: int
    """Offset of the record in the file."""
    opcode: int
    body: bytes


Location = tuple[int, int]
"""Offset of a record in a file, and its length including the head."""


class RecordStream:
    """The records of a file, one by one, as far as it can be read."""

    def __init__(
        self,
        stream: BinaryIO,
        starts: Sequence[int] = (),
        wanted: Callable[[int, int], bool] | None = None,
        search: Callable[[int], Location | None] | None = None,
        begin: Location | None = None,
    ) -> None:
        """Take the file.

        Args:
            stream: the file, at its start; seekable if `starts` or `wanted` are given.
            starts: known offsets of records, rising, where reading can resume after a damaged
                record.
            wanted: whether to read a chunk with this first and last log time; by default all.
            search: finds the next whole chunk from an offset on, for files without known starts.
            begin: the chunk to begin with, if nothing before it can be read.
        """
        self._stream = stream
        self._starts = starts
        self._wanted = wanted
        self._search = search
        self._begin = self._found = begin
        self._position = 0
        self._checksum: RunningChecksum | None = RunningChecksum()
        self._before: int | None = None
        """The checksum before the last record with a checksum; None if something was skipped."""
        self.ending: str = ""
        """What is wrong with the end of the file; valid after the last record."""
        self.losses: list[str] = []

    @property
    def cut(self) -> bool:
        """Whether something may be missing at its start or end."""
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
                if self._skip_to_next_start(position, error.message):
                    continue
                self.ending = TranslatableText(
                    "{error} at byte {position}; it ends at byte {end}",
                    error=error.message,
                    position=position,
                    end=self._position,
                )
                return
            if record is None:
                self.ending = TranslatableText(
                    "it was never closed, its last byte is {position}", position=position
                )
                return
            if record.opcode == _SKIPPED:
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
        if head[0] in _WITH_CHECKSUM:
            self._before = None if self._checksum is None else self._checksum.value()
        self._sum(head)
        if len(head) < HEAD.size:
            raise RecordError(TranslatableText("it is cut in the record"))
        opcode, length = HEAD.unpack(head)
        if self._found is not None and self._found[0] == position:
            # The search does not need an intact head.
            opcode, length = int(Opcode.CHUNK), self._found[1] - HEAD.size
        if opcode == 0:
            raise RecordError(TranslatableText("there is no MCAP record"))
        if length > LARGEST:
            raise RecordError(
                TranslatableText("there is a record that claims {length} bytes", length=length)
            )
        start = self._next_start(position) if self._starts else None
        if start is not None and start < self._position + length:
            raise RecordError(TranslatableText("there is a record that reaches into the next"))
        times = b""
        if self._wanted is not None and opcode == Opcode.CHUNK and length >= _CHUNK_TIMES.size:
            times = self._read(_CHUNK_TIMES.size)
            if len(times) == _CHUNK_TIMES.size and not self._wanted(*_CHUNK_TIMES.unpack(times)):
                return self._skip(position, length - len(times))
        body = times + self._read(length - len(times))
        if len(body) < length:
            raise RecordError(TranslatableText("it is cut in the record"))
        if opcode == Opcode.CHUNK and self._search is not None:
            # A chunk with a wrong length would hide the next ones.
            compressed_records(body)
        return RawRecord(position, opcode, body)

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
        after = bisect_right(self._starts, position)
        return self._starts[after] if after < len(self._starts) else None

    def _skip_to_next_start(self, position: int, reason: TranslatableText) -> bool:
        start = self._next_start(position)
        if start is None and self._search is not None:
            self._found = self._search(position)
            start = None if self._found is None else self._found[0]
        if start is None:
            return False
        self._go_to(start)
        loss = TranslatableText(
            "the head of the chunk at byte {position} is damaged", position=position
        )
        if start > position:
            loss = TranslatableText(
                "bytes {position} to {start} were skipped: {reason}",
                position=position,
                start=start,
                reason=reason,
            )
        self.losses.append(loss)
        return True

    def _go_to(self, start: int) -> None:
        self._stream.seek(start)
        self._position, self._checksum = start, None

    def _check_crc(self, body: bytes, found: int | None, what: TranslatableText) -> None:
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
            self.ending = TranslatableText(
                "its last {count} bytes are damaged or missing", count=len(MAGIC)
            )
        elif self._stream.read(1) and not _is_interrupted(self._stream, footer, self._position):
            self.ending = TranslatableText(
                "bytes that do not belong to it follow its end at byte {position}",
                position=self._position,
            )


_NO_CHECKSUM = HEAD.pack(Opcode.DATA_END, _CRC_LENGTH) + bytes(_CRC_LENGTH)


def _is_interrupted(stream: BinaryIO, footer: bytes, stop: int) -> bool:
    """Whether the bytes after the end are those that `AppendFile` leaves if it is killed.

    `footer` is the body of the footer that ends the file at `stop`. The last footer of the file
    points to the same summary, or to a copy of one after a data end without checksum.
    """
    if not stream.seekable():
        return False
    stream.seek(-END_LENGTH, os.SEEK_END)
    last = stream.read(END_LENGTH)
    body = last[HEAD.size : -len(MAGIC)]
    if not last.endswith(MAGIC) or HEAD.unpack_from(last) != (Opcode.FOOTER, len(body)):
        return False
    start = parse(Footer, body).summary_start
    if start <= stop:
        return body in (footer, footer[:8] + bytes(len(footer) - 8))
    stream.seek(start - DATA_END_LENGTH)
    return stream.read(DATA_END_LENGTH) == _NO_CHECKSUM and read_summary(stream) is not None


@dataclass(slots=True)
class Summary:
    """The records of a summary that the reader uses."""

    schemas: list[Schema] = field(default_factory=list)
    channels: list[Channel] = field(default_factory=list)
    statistics: Statistics | None = None
    starts: list[int] = field(default_factory=list)
    """Offsets of the chunks and of the data end, rising."""
    guarded: bool = False
    """Whether the summary has a checksum."""


def read_summary(stream: BinaryIO) -> Summary | None:
    """The summary of a seekable file; None if there is none, or if it is damaged."""
    size = stream.seek(0, os.SEEK_END)
    if size < len(MAGIC) + END_LENGTH:
        return None
    stream.seek(size - END_LENGTH)
    end = stream.read(END_LENGTH)
    body = end[HEAD.size : -len(MAGIC)]
    if not end.endswith(MAGIC) or HEAD.unpack_from(end) != (Opcode.FOOTER, len(body)):
        return None
    footer = parse(Footer, body)
    length = size - END_LENGTH - footer.summary_start
    if not footer.summary_start or not 0 < length <= LARGEST:
        return None
    stream.seek(footer.summary_start)
    records = stream.read(length)
    if footer.summary_crc not in (0, crc32(end[: HEAD.size + 16], crc32(records))):
        return None
    try:
        summary = _summary_of(records, footer.summary_start)
    except RecordError:
        return None
    summary.guarded = bool(footer.summary_crc)
    return summary


def _summary_of(records: bytes, start: int) -> Summary:
    summary = Summary()
    for opcode, body in records_in(records):
        if opcode == Opcode.SCHEMA:
            summary.schemas.append(parse(Schema, body))
        elif opcode == Opcode.CHANNEL:
            summary.channels.append(parse(Channel, body))
        elif opcode == Opcode.STATISTICS:
            summary.statistics = parse(Statistics, body)
        elif opcode == Opcode.CHUNK_INDEX:
            summary.starts.append(parse(ChunkIndex, body).chunk_start_offset)
    summary.starts.append(start - DATA_END_LENGTH)
    summary.starts.sort()
    return summary
