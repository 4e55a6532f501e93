"""ReadingPass: one pass over a recording, decoded by several threads; ranges of time and of rows.

Threads unpack and decode chunks ahead, with the definitions known at the time; zstd, CRC and numpy
release the interpreter lock. A chunk that changes the definitions is decoded again with them when
its turn comes.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Statistics

from fte_sniff.errors import TranslatableText
from fte_sniff.protocol import PortEvent, Row
from fte_sniff.protocol.rows import Array, Codebook, Rows
from fte_sniff.recording.mcap.chunk_index import (
    CHANNEL_OFFSET,
    DEFINITIONS,
    SEQUENCE_OFFSET,
    Definition,
    MessageIndex,
    index_messages,
    indexed_starts,
)
from fte_sniff.recording.mcap.reader import LostBytes, RawRecord, RecordStream
from fte_sniff.recording.mcap.records import (
    HEAD,
    RecordError,
    claimed,
    cores,
    keep_freed_memory,
    parse,
    unpack,
)
from fte_sniff.recording.messages.decode import DecodedColumns, Losses, ParseBudget, decode_columns
from fte_sniff.recording.messages.definitions import ChannelReaders, Definitions

_LATEST = 2**63 - 1


@dataclass(frozen=True, slots=True)
class TimeRange:
    """A range of time, nanoseconds since 1970 UTC, without its end."""

    first_ns: int = 0
    end_ns: int = _LATEST

    @property
    def everything(self) -> bool:
        """Whether the range covers all of time."""
        return self.first_ns <= 0 and self.end_ns >= _LATEST

    def overlaps(self, first_ns: int, last_ns: int) -> bool:
        """Whether the range overlaps the time from `first_ns` to `last_ns`, both included."""
        return self.first_ns <= last_ns and first_ns < self.end_ns

    def contains(self, entry: Row | PortEvent) -> bool:
        """Whether a row or event is in the range; one without time is not."""
        return entry.t_ns is not None and self.first_ns <= entry.t_ns < self.end_ns

    def mask(self, t_ns: Array) -> Array:
        """A mask of the times in the range."""
        found: Array = (t_ns >= self.first_ns) & (t_ns < self.end_ns)
        return found

    def select(self, rows: Rows) -> Rows:
        """The rows and events in the range."""
        if self.everything:
            return rows
        inside = self.mask(rows.t_ns)
        events = tuple(filter(self.contains, rows.events))
        if inside.all() and len(events) == len(rows.events):
            return rows
        return rows.select(inside, events)


EVERYTHING = TimeRange()

ByteRange = tuple[int, int]


@dataclass(frozen=True, slots=True)
class RowRange:
    """Some rows of a recording, by their records in the file."""

    definitions: Definitions
    """What is defined before the first record."""
    records: tuple[ByteRange, ...]
    """The records that hold the rows, rising."""
    span: TimeRange
    """The range that the rows were read with."""
    skipped: int
    """Number of rows in the records before the first of these."""
    count: int
    after_loss: bool = False
    """Whether something could not be read between the previous rows and these."""

    @property
    def stop(self) -> int:
        """Where its records end in the file; 0 if none could be read."""
        return self.records[-1][1] if self.records else 0


def _merged(ranges: Iterable[ByteRange]) -> tuple[ByteRange, ...]:
    """The ranges with contiguous ones merged."""
    found: list[ByteRange] = []
    for start, end in ranges:
        if found and found[-1][1] == start:
            start = found.pop()[0]
        found.append((start, end))
    return tuple(found)


JOB = 8 * 1024 * 1024
"""Unpacked bytes of one batch, about: at least 64 thousand rows."""

_FIRST_JOB = 512 * 1024
"""Unpacked bytes of the first batch, which is small, so that the first rows come soon."""

_MOST_UNDER_WAY = 64 * 1024 * 1024
"""Unpacked bytes that are decoded ahead, unless one chunk has more."""

_PIECE = 1024 * 1024
"""Unpacked bytes that are decoded at once, at least: enough rows for numpy, and few enough for a
core's cache."""

_MOST_SPLITS = 500
"""Batches that end at a loss; after more losses, rows before and after one share a batch."""

_MOST_RATIO = 96
"""Unpacked bytes of a chunk for each byte that it and its message indexes have in the file; rows
have at most about 60."""
_USUAL_RATIO = 20
_LEAST_RECORD = 4
"""Bytes that each record of a chunk has in the file, at least."""


@dataclass(slots=True)
class _Section:
    """A chunk with its message indexes, or consecutive records outside of chunks."""

    chunk: RawRecord | None
    indexes: list[bytes] = field(default_factory=list)
    loose: bytearray = field(default_factory=bytearray)
    ranges: list[ByteRange] = field(default_factory=list)
    after_loss: bool = False
    """Whether the file could not be read directly before this section."""

    @property
    def size(self) -> int:
        return len(self.loose) if self.chunk is None else claimed(self.chunk.body)[0]

    @property
    def load(self) -> int:
        """The size; more for a highly compressed chunk, whose rows take much memory."""
        if self.chunk is None:
            return self.size
        return self.size * max(1, self.size // (_USUAL_RATIO * len(self.chunk.body)))

    @property
    def trusted(self) -> bool:
        """Whether a checksum protects its definitions."""
        return self.chunk is not None and claimed(self.chunk.body)[1] > 0

    @property
    def most_records(self) -> int:
        if self.chunk is None:
            return len(self.loose)
        return self._stored // _LEAST_RECORD

    @property
    def _stored(self) -> int:
        assert self.chunk is not None
        return len(self.chunk.body) + sum(map(len, self.indexes))

    def unpack(self) -> tuple[bytes, Array | None]:
        """The records, and the message starts in the indexes; raises RecordError."""
        if self.chunk is None:
            return bytes(self.loose), None
        if self.size > _MOST_RATIO * self._stored:
            raise RecordError("a chunk that claims to unpack to {size} bytes", size=self.size)
        records = unpack(self.chunk.body)
        return records, indexed_starts(self.indexes, len(records))

    def lost(self, error: RecordError) -> LostBytes:
        """The bytes of a section that cannot be read."""
        start, stop = self.ranges[0]
        text = TranslatableText(
            "{error} at byte {position} ({size} bytes)",
            error=error.message,
            position=start,
            size=stop - start - HEAD.size,
        )
        return LostBytes(start, stop, text)


@dataclass(slots=True)
class _SectionRun:
    """The rows of consecutive sections, without a loss between them."""

    after_loss: bool
    ranges: list[ByteRange] = field(default_factory=list)
    pieces: list[Rows] = field(default_factory=list)
    """Rows of the next batch."""
    batches: list[Rows] = field(default_factory=list)

    def end_batch(self, span: TimeRange) -> None:
        if self.pieces:
            self.batches.append(span.select(Rows.concat(self.pieces)))
            self.pieces = []


@dataclass(slots=True)
class PassCounts:
    """What was found in a file or a part of it, besides the rows."""

    lost: list[LostBytes] = field(default_factory=list)
    """Chunks that could not be read."""
    losses: Losses = field(default_factory=Losses)
    """Messages and definitions that could not be read."""
    messages: int = 0
    """Number of messages of any topic."""
    unreadable: int = 0
    """Number of messages that could not be read."""
    chunks: int = 0
    """Number of chunks that could be read."""
    rows: int = 0
    """Number of rows that were read, within the span."""
    times: tuple[int, int] | None = None
    """First and last log time of fte-sniff's messages."""
    sequences: dict[int, tuple[int, int]] = field(default_factory=dict)
    """By channel id: the sequence number after the last message, and the number of messages."""

    def count(self, piece: DecodedColumns) -> None:
        """Add decoded messages."""
        self.messages += piece.messages
        self.times = _both(self.times, piece.times)
        self.losses.merge(piece.losses)
        self.unreadable += piece.losses.total()

    def count_sequences(self, sequences: Mapping[int, tuple[int, int]]) -> None:
        """Add sequence numbers of messages."""
        for channel, (end, count) in sequences.items():
            known, counted = self.sequences.get(channel, (0, 0))
            self.sequences[channel] = max(end, known), count + counted

    def include(self, other: PassCounts) -> None:
        """Add what was found in another part."""
        self.lost += other.lost
        self.losses.merge(other.losses)
        self.messages += other.messages
        self.unreadable += other.unreadable
        self.chunks += other.chunks
        self.times = _both(self.times, other.times)
        self.count_sequences(other.sequences)


@dataclass(slots=True)
class _Decoded:
    version: int
    runs: list[_SectionRun]
    definitions: list[tuple[Definition, bool]] = field(default_factory=list)
    """Definitions in the sections, and whether a checksum protects them."""
    found: PassCounts = field(default_factory=PassCounts)


@dataclass(slots=True)
class _Job:
    sections: list[_Section]
    size: int
    result: Future[_Decoded]


@cache
def _threads() -> ThreadPoolExecutor:
    """Threads that all passes share.

    With its own threads, each pass would take more memory: glibc may give a new thread a new heap
    before the last thread has returned its own, and keeps all of them.
    """
    return ThreadPoolExecutor(cores(), "unpacks chunks")


if hasattr(os, "register_at_fork"):  # not on Windows
    # A forked process has the pool without its threads: what it submits would never be done.
    os.register_at_fork(after_in_child=_threads.cache_clear)


class ReadingPass:
    """One pass over a recording, in batches; over a growing file it goes on as the file grows."""

    def __init__(
        self,
        channels: ChannelReaders,
        codebook: Codebook,
        span: TimeRange,
        *,
        count_sequences: bool = False,
        share: int = 1,
    ) -> None:
        """Begin a pass over the rows in a span.

        The definitions that are read are added to `channels`. `share` divides the size of batches,
        and what is decoded ahead.
        """
        keep_freed_memory()
        self.channels, self.span, self._codebook = channels, span, codebook
        self._count_sequences = count_sequences
        self._definitions: tuple[int, Definitions] = -1, {}
        self._jobs: deque[_Job] = deque()
        self._most_jobs, self._most_under_way = cores() + 1, _MOST_UNDER_WAY // share
        self._enough = max(JOB // share, _FIRST_JOB)
        self._split_count = 0
        self.found = PassCounts()
        """What was found so far; `sequences` only if they are counted."""
        self.statistics: Statistics | None = None
        """Those at the end of the file, checked by no checksum."""
        self.position = 0
        """Offset of the first record that was not read."""

    def read(self, records: Iterable[RawRecord]) -> Iterator[tuple[RowRange, Rows]]:
        """The rows and events of the records, in their order, with the range of each batch."""
        first = True
        try:
            for sections in self._sections_of_jobs(records):
                if first:
                    # The first rows come sooner if the next job does not share the cores.
                    first = False
                    yield from self._finished(
                        sections, self._decode(sections, self.channels.version)
                    )
                    continue
                size = sum(section.load for section in sections)
                while self._jobs and not self._has_room(size):
                    yield from self._next_batches()
                result = _threads().submit(self._decode, sections, self.channels.version)
                self._jobs.append(_Job(sections, size, result))
            while self._jobs:
                yield from self._next_batches()
        finally:
            for job in self._jobs:
                job.result.cancel()

    def _next_batches(self) -> Iterator[tuple[RowRange, Rows]]:
        job = self._jobs.popleft()
        return self._finished(job.sections, job.result.result())

    def _has_room(self, size: int) -> bool:
        under_way = sum(job.size for job in self._jobs)
        return len(self._jobs) < self._most_jobs and under_way + size <= self._most_under_way

    def _sections_of_jobs(self, records: Iterable[RawRecord]) -> Iterator[list[_Section]]:
        """The sections of each job; after a loss a new job begins."""
        sections: list[_Section] = []
        size, enough, losses = 0, _FIRST_JOB, 0
        has_messages, in_data = False, True
        for record in records:
            opcode = record.opcode
            if opcode == Opcode.MESSAGE_INDEX and sections:
                sections[-1].indexes.append(record.body)
                sections[-1].ranges.append((record.position, record.stop))
            in_data = in_data and opcode != Opcode.DATA_END
            if opcode == Opcode.STATISTICS:
                with suppress(RecordError):
                    self.statistics = parse(Statistics, record.body)
            has_rows = opcode in (Opcode.CHUNK, Opcode.MESSAGE)
            defines = in_data and opcode in DEFINITIONS
            if not has_rows and not defines:
                continue
            lost = len(records.losses) if isinstance(records, RecordStream) else 0
            after_loss = has_rows and lost > losses
            # A definition outside of chunks describes no earlier messages.
            if has_messages and (size >= enough or ((after_loss or defines) and self._splits())):
                yield sections
                sections, size, enough, has_messages = [], 0, self._enough, False
            if opcode == Opcode.CHUNK:
                sections.append(_Section(record, ranges=[(record.position, record.stop)]))
                size += sections[-1].load
            else:
                size += self._append_loose(record, sections)
            if has_rows:
                has_messages, losses = True, lost
                sections[-1].after_loss |= after_loss
        if sections:
            yield sections

    def _splits(self) -> bool:
        """Whether a batch ends at a loss, or before a definition."""
        self._split_count += 1
        return self._split_count <= _MOST_SPLITS

    def _append_loose(self, record: RawRecord, sections: list[_Section]) -> int:
        """Append a record outside of chunks; returns its bytes in the job."""
        if not sections or sections[-1].chunk is not None:
            sections.append(_Section(None))
        sections[-1].ranges.append((record.position, record.stop))
        sections[-1].loose += HEAD.pack(record.opcode, len(record.body)) + record.body
        return HEAD.size + len(record.body)

    def _define(self, definition: Definition, *, trusted: bool) -> None:
        try:
            self.channels.update(*definition, trusted=trusted)
        except RecordError as error:
            self.found.losses.append(error.message)

    def _finished(
        self, sections: list[_Section], decoded: _Decoded
    ) -> Iterator[tuple[RowRange, Rows]]:
        for definition, trusted in decoded.definitions:
            self._define(definition, trusted=trusted)
        if decoded.version != self.channels.version:
            decoded = self._decode(sections, self.channels.version)
        self.found.include(decoded.found)
        if self._definitions[0] != self.channels.version:
            self._definitions = self.channels.version, self.channels.definitions
        for run in decoded.runs:
            skipped, ranges = 0, _merged(run.ranges)
            for rows in run.batches:
                count, after_loss = len(rows), run.after_loss and not skipped
                self.found.rows += count
                definitions = self._definitions[1]
                yield RowRange(definitions, ranges, self.span, skipped, count, after_loss), rows
                skipped += count

    def _decode(self, sections: list[_Section], version: int) -> _Decoded:
        """Decode sections, in a thread."""
        run = _SectionRun(sections[0].after_loss)
        decoded = _Decoded(version, [run])
        counts = decoded.found
        for found in _indexed(sections):
            if isinstance(found, LostBytes):
                counts.lost.append(found)
                if not (run.batches or run.pieces) or not self._splits():
                    run.after_loss = True
                    continue
                run.end_batch(self.span)
                run = _SectionRun(after_loss=True)
                decoded.runs.append(run)
                continue
            run.ranges += [one for section in found.sections for one in section.ranges]
            counts.chunks += sum(section.chunk is not None for section in found.sections)
            for definition in found.messages.definitions:
                decoded.definitions.append((definition, found.sections[0].trusted))
            slices = list(found.messages.slices(2 * JOB, JOB // 4))
            for messages in slices:
                columns = Rows.allocate(self._codebook, len(messages))
                piece = decode_columns(messages, self.channels.get, columns, found.budget)
                run.pieces.append(piece.columns)
                counts.count(piece)
                run.after_loss |= bool(piece.losses)
                if self._count_sequences:
                    counts.count_sequences(_sequences(messages))
                if len(slices) > 1:
                    run.end_batch(self.span)
            if found.messages.without_head:
                text = TranslatableText("a message without its header")
                counts.losses.append(text, found.messages.without_head)
                counts.unreadable += found.messages.without_head
            # Free this piece first: the next is then unpacked into cached memory.
            del found, slices
        run.end_batch(self.span)
        if run.after_loss and not run.batches:
            run.batches.append(Rows.allocate(self._codebook, 0))
        return decoded


def _both(one: tuple[int, int] | None, other: tuple[int, int] | None) -> tuple[int, int] | None:
    if one is None or other is None:
        return one or other
    return min(one[0], other[0]), max(one[1], other[1])


def _sequences(messages: MessageIndex) -> dict[int, tuple[int, int]]:
    """By channel id: the sequence number after the last message, and the number of messages."""
    channels = messages.field(CHANNEL_OFFSET, "<u2").astype(np.intp)
    counts = np.bincount(channels)
    ends = np.zeros(len(counts), np.int64)
    ends[channels] = messages.field(SEQUENCE_OFFSET, "<u4").astype(np.int64) + 1
    return {id_: (int(ends[id_]), int(counts[id_])) for id_ in np.flatnonzero(counts).tolist()}


@dataclass(slots=True)
class _Piece:
    """Unpacked sections, small ones together."""

    sections: list[_Section] = field(default_factory=list)
    records: list[bytes] = field(default_factory=list)
    starts: list[Array | None] = field(default_factory=list)
    size: int = 0

    def append(self, section: _Section, records: bytes, starts: Array | None) -> None:
        self.sections.append(section)
        self.records.append(records)
        self.starts.append(starts + self.size if self.size and starts is not None else starts)
        self.size += len(records)

    def index(self) -> Iterator[_IndexedPiece | LostBytes]:
        """The messages; of sections that cannot be indexed, each one's."""
        if not self.sections:
            return
        most = [section.most_records for section in self.sections]
        try:
            records, starts = _joined(self.records), _concatenated(self.starts)
            messages = index_messages(records, starts, sum(most))
            budget = ParseBudget([len(own) for own in self.records], most)
            yield _IndexedPiece(self.sections, messages, budget)
        except RecordError as error:
            if len(self.sections) == 1:
                yield self.sections[0].lost(error)
                return
            for section, own in zip(self.sections, self.records, strict=True):
                yield from _Piece([section], [own], [None]).index()


@dataclass(slots=True)
class _IndexedPiece:
    sections: list[_Section]
    messages: MessageIndex
    budget: ParseBudget


def _indexed(sections: list[_Section]) -> Iterator[_IndexedPiece | LostBytes]:
    """The messages of the sections, in pieces."""
    piece = _Piece()
    for section in sections:
        try:
            records, starts = section.unpack()
        except RecordError as error:
            yield from piece.index()
            piece = _Piece()
            yield section.lost(error)
            continue
        if piece.sections and piece.sections[0].trusted != section.trusted:
            yield from piece.index()
            piece = _Piece()
        piece.append(section, records, starts)
        del records, starts
        if piece.size >= _PIECE:
            yield from piece.index()
            piece = _Piece()
    yield from piece.index()


def _joined(records: list[bytes]) -> bytes:
    return records[0] if len(records) == 1 else b"".join(records)


def _concatenated(starts: list[Array | None]) -> Array | None:
    """All starts; None if those of a chunk are unknown."""
    known = [own for own in starts if own is not None]
    if len(starts) == 1:
        return starts[0]
    return np.concatenate(known) if len(known) == len(starts) else None
