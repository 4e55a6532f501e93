"""Reading of batches by several threads.

Threads unpack and decode chunks ahead, with the definitions known at the time; zstd, CRC and numpy
release the interpreter lock. A chunk that cannot be decoded so, or that changes the definitions, is
read record by record when its turn comes. So the result is always that of `SequentialReader`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import groupby

import numpy as np
from mcap.opcode import Opcode

from fte_sniff.protocol import PortEvent, Row
from fte_sniff.recording.mcap.reader import RawRecord, RecordStream
from fte_sniff.recording.mcap.records import (
    HEAD,
    LARGEST,
    cores,
    keep_freed_memory,
    records_in,
    unpack,
    unpacked_size,
)
from fte_sniff.recording.messages.columns import DecodedColumns, Readers, decode_columns
from fte_sniff.recording.messages.index import (
    MESSAGE_HEAD,
    index_messages,
    indexed_starts,
    message_count,
)
from fte_sniff.recording.row_ranges import ByteRange, RowRange, TimeRange, merged
from fte_sniff.recording.sequential import SequentialReader
from fte_sniff.row_batch import Array, Codebook, RowBatch, RowBuffer

JOB = 8 * 1024 * 1024
"""Unpacked bytes of one batch, about: at least 64 thousand rows."""

_FIRST_JOB = 512 * 1024
"""The same for the first batch, so that the first rows come soon."""

_PIECE = 1024 * 1024
"""Unpacked bytes that are decoded at once, at least: enough rows for numpy, and few enough for a
core's cache."""

_SEQUENTIAL_ROWS = 65_536
"""Rows of one batch that is read record by record."""

_MOST_RESERVED = 2 * JOB // MESSAGE_HEAD
"""Rows that memory is reserved for at most, whatever a message index says."""

_DEFINITIONS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.HEADER})


@dataclass(slots=True)
class _Section:
    """A chunk with its message indexes, or consecutive records outside of chunks."""

    chunk: RawRecord | None
    indexes: list[bytes] = field(default_factory=list)
    loose: bytearray = field(default_factory=bytearray)
    """The records outside of chunks."""
    ranges: list[ByteRange] = field(default_factory=list)
    """The records in the file."""
    after_loss: bool = False
    """Whether the file could not be read directly before this section."""

    @property
    def size(self) -> int:
        return len(self.loose) if self.chunk is None else unpacked_size(self.chunk.body)

    def read(self, reader: SequentialReader) -> Iterator[Row | PortEvent]:
        if self.chunk is not None:
            yield from reader.read_chunk(self.chunk)
            return
        for opcode, body in records_in(bytes(self.loose)):
            yield from reader.read_record(opcode, body)


@dataclass(slots=True)
class _Decoded:
    version: int
    pieces: list[DecodedColumns]
    rows: RowBatch
    definitions: list[tuple[int, bytes]]
    """Opcode and body of each record other than messages."""


@dataclass(slots=True)
class _Job:
    sections: list[_Section]
    size: int
    result: Future[_Decoded | None]


class ParallelReader:
    """One pass over a recording, in batches."""

    def __init__(self, reader: SequentialReader, codebook: Codebook, span: TimeRange) -> None:
        keep_freed_memory()
        self._reader, self._codebook, self._span = reader, codebook, span
        self._readers: tuple[int, Readers] = (-1, {})
        self._jobs: deque[_Job] = deque()
        self._most_jobs = cores() + 1

    def read(self, records: RecordStream) -> Iterator[tuple[RowRange, RowBatch]]:
        """The rows and events of the records, in their order, with the range of each batch.

        Raises FileError if the file has none of fte-sniff's topics, or none that can be read.
        """
        first = True
        with ThreadPoolExecutor(cores(), "unpacks chunks") as threads:
            try:
                for sections in self._sections_of_jobs(records):
                    size = sum(section.size for section in sections)
                    while self._jobs and not self._has_room(size):
                        yield from self._next_batches()
                    result = threads.submit(self._decode, sections, *self._known())
                    self._jobs.append(_Job(sections, size, result))
                    if first:
                        # The first rows come sooner if the next job does not share the cores.
                        first = False
                        yield from self._next_batches()
                while self._jobs:
                    yield from self._next_batches()
            finally:
                for job in self._jobs:
                    job.result.cancel()
        self._reader.check_topics(cut=records.cut)

    def read_again(self, records: Iterable[RawRecord]) -> Iterator[RowBatch]:
        """The rows and events of a few records, in their order, without threads."""
        for sections in self._sections_of_jobs(records):
            result = self._decode(sections, *self._known())
            yield from (rows for rows, _ in self._batches(sections, result))

    def _next_batches(self) -> Iterator[tuple[RowRange, RowBatch]]:
        job = self._jobs.popleft()
        definitions, skipped = self._reader.definitions, 0
        ranges = merged(one for section in job.sections for one in section.ranges)
        for rows, after_loss in self._batches(job.sections, job.result.result()):
            count = len(rows)
            yield RowRange(definitions, ranges, self._span, skipped, count, after_loss), rows
            skipped += count

    def _has_room(self, size: int) -> bool:
        under_way = sum(job.size for job in self._jobs)
        return len(self._jobs) < self._most_jobs and under_way + size <= LARGEST

    def _known(self) -> tuple[int, Readers]:
        version = self._reader.version
        if self._readers[0] != version:
            self._readers = version, self._reader.readers()
        return self._readers

    def _sections_of_jobs(self, records: Iterable[RawRecord]) -> Iterator[list[_Section]]:
        """The sections of each job; after a loss a new job begins."""
        sections: list[_Section] = []
        size, enough, losses = 0, _FIRST_JOB, 0
        for record in records:
            if record.opcode == Opcode.MESSAGE_INDEX:
                if sections:
                    sections[-1].indexes.append(record.body)
                    sections[-1].ranges.append(_range_of(record))
                continue
            has_rows = record.opcode in (Opcode.CHUNK, Opcode.MESSAGE)
            after_loss = _losses(records) > losses
            if has_rows and sections and (after_loss or size >= enough):
                yield sections
                sections, size, enough = [], 0, JOB
            if record.opcode == Opcode.CHUNK:
                sections.append(_Section(record, ranges=[_range_of(record)]))
                size += sections[-1].size
            elif record.opcode == Opcode.MESSAGE or record.opcode in _DEFINITIONS:
                size += self._append_loose(record, sections)
            if has_rows:
                sections[-1].after_loss |= after_loss
                losses = _losses(records)
        if sections:
            yield sections

    def _append_loose(self, record: RawRecord, sections: list[_Section]) -> int:
        """Append a record outside of chunks; returns its bytes in the job."""
        if record.opcode != Opcode.MESSAGE and not sections and not self._jobs:
            for _ in self._reader.read_record(record.opcode, record.body):
                raise AssertionError("a definition is no row")
            return 0
        if not sections or sections[-1].chunk is not None:
            sections.append(_Section(None))
        sections[-1].ranges.append(_range_of(record))
        sections[-1].loose += HEAD.pack(record.opcode, len(record.body)) + record.body
        return HEAD.size + len(record.body)

    def _batches(
        self, sections: list[_Section], result: _Decoded | None
    ) -> Iterator[tuple[RowBatch, bool]]:
        """Batches of rows, and whether something was lost directly before them."""
        if result is not None and result.version != self._reader.version:
            result = self._decode(sections, *self._known())
        if result is None or not all(
            self._reader.changes_nothing(*definition) for definition in result.definitions
        ):
            yield from self._read_sequentially(sections)
            return
        for piece in result.pieces:
            self._reader.count(piece.messages, piece.times)
        yield result.rows, sections[0].after_loss

    def _read_sequentially(self, sections: list[_Section]) -> Iterator[tuple[RowBatch, bool]]:
        batch: list[Row | PortEvent] = []
        after_loss = False
        for lost, entry in self._entries(sections):
            if lost or len(batch) == _SEQUENTIAL_ROWS:
                if batch or after_loss:
                    yield self._batch_of(batch), after_loss
                batch, after_loss = [], lost
            if entry is not None:
                batch.append(entry)
        if batch or after_loss:
            yield self._batch_of(batch), after_loss

    def _entries(self, sections: list[_Section]) -> Iterator[tuple[bool, Row | PortEvent | None]]:
        """Rows and events, and whether something was lost before each; None at the end."""
        losses = self._reader.loss_count
        for section in sections:
            after_loss = section.after_loss
            for entry in section.read(self._reader):
                yield after_loss or self._reader.loss_count > losses, entry
                losses, after_loss = self._reader.loss_count, False
            if after_loss:
                yield True, None
        yield self._reader.loss_count > losses, None

    def _batch_of(self, entries: list[Row | PortEvent]) -> RowBatch:
        events = [entry for entry in entries if isinstance(entry, PortEvent)]
        rows = [entry for entry in entries if not isinstance(entry, PortEvent)]
        return self._span.select(RowBatch.from_rows(rows, self._codebook, events))

    def _decode(self, sections: list[_Section], version: int, readers: Readers) -> _Decoded | None:
        """Decode sections, in a thread; None if they must be read record by record."""
        pieces: list[DecodedColumns] = []
        definitions: list[tuple[int, bytes]] = []
        reserved = sum(message_count(section.indexes) for section in sections)
        buffer = RowBuffer(self._codebook, min(reserved, _MOST_RESERVED))
        try:
            for records, starts in _unpacked(sections):
                messages = index_messages(records, starts)
                definitions += messages.others
                pieces.append(decode_columns(messages, readers, buffer.reserve(len(messages))))
                # Free this piece first: the next is then unpacked into cached memory.
                del records, starts, messages
        except (ValueError, KeyError):
            return None
        rows = buffer.filled() if all(piece.in_place for piece in pieces) else None
        if rows is None:
            rows = RowBatch.concat([piece.columns for piece in pieces])
        return _Decoded(version, pieces, self._span.select(rows), definitions)


def _losses(records: Iterable[RawRecord]) -> int:
    return len(records.losses) if isinstance(records, RecordStream) else 0


def _range_of(record: RawRecord) -> ByteRange:
    return record.position, record.position + HEAD.size + len(record.body)


def _unpacked(sections: list[_Section]) -> Iterator[tuple[bytes, Array | None]]:
    """The records of the sections and the message starts in their indexes; small chunks joined."""
    for loose, group in groupby(sections, lambda section: section.chunk is None):
        if loose:
            yield from ((bytes(section.loose), None) for section in group)
        else:
            yield from _joined_chunks(group)


def _joined_chunks(sections: Iterable[_Section]) -> Iterator[tuple[bytes, Array | None]]:
    records: list[bytes] = []
    starts: list[Array | None] = []
    size = 0
    for section in sections:
        assert section.chunk is not None
        records.append(unpack(section.chunk.body))
        own = indexed_starts(section.indexes, len(records[-1]))
        starts.append(own + size if size and own is not None else own)
        size += len(records[-1])
        if size >= _PIECE:
            yield _joined(records), _concatenated(starts)
            records, starts, size = [], [], 0
    if records:
        yield _joined(records), _concatenated(starts)


def _joined(records: list[bytes]) -> bytes:
    return records[0] if len(records) == 1 else b"".join(records)


def _concatenated(starts: list[Array | None]) -> Array | None:
    """All starts; None if those of a chunk are unknown."""
    known = [own for own in starts if own is not None]
    if len(starts) == 1:
        return starts[0]
    return np.concatenate(known) if len(known) == len(starts) else None
