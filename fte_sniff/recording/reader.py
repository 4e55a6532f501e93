"""RecordingReader: read one recording, in passes; and the recordings that paths name.

A file may be truncated, damaged or written by another program. Everything readable is read;
`ending` and `losses` report the rest. A chunk counts only if its checksum is right, an index only
where the chunk agrees with it.

In a pass, threads unpack and decode chunks ahead, with the definitions known at the time; zstd, CRC
and numpy release the interpreter lock. A chunk that changes the definitions is decoded again with
them when its turn comes.

`AppendFile` overwrites only the tail of a file: the records before it never change. So a file that
another program writes is read up to its last complete record, and the next pass begins there:

    pass 1   magic, head, chunk, indexes | tail
    pass 2                                 chunk, indexes | tail
    last                                                    chunk, indexes, tail

Only the last pass, after the end of the writer, reads the tail and reports what is damaged there.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from os import PathLike
from pathlib import Path
from shlex import quote
from shutil import copyfileobj
from tempfile import NamedTemporaryFile
from typing import IO, BinaryIO, TypeAlias
from weakref import finalize

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Metadata, Statistics

from fte_sniff.errors import FileError, TranslatableText, listed, unreadable
from fte_sniff.platform import read_at
from fte_sniff.protocol import Gap, PortEvent, Row, iso_time
from fte_sniff.protocol.rows import Array, Codebook, Rows
from fte_sniff.recording.mcap.reader import (
    CHANNEL_OFFSET,
    DEFINITIONS,
    HEAD,
    LARGEST,
    MAGIC,
    SEQUENCE_OFFSET,
    Definition,
    LostBytes,
    MessageIndex,
    RawRecord,
    RecordError,
    RecordStream,
    Summary,
    claimed,
    cores,
    index_messages,
    indexed_starts,
    keep_freed_memory,
    parse,
    read_summary,
    records_in,
    unpack,
)
from fte_sniff.recording.messages import (
    NOTHING,
    TOPIC_BY_NAME,
    ChannelReaders,
    DecodedColumns,
    Definitions,
    Losses,
    LostDefinitions,
    ParseBudget,
    decode_columns,
    lost_definitions,
)
from fte_sniff.recording.metadata import (
    EARLY_NAME,
    END_NAME,
    MARKS,
    NEXT_NAME,
    PROGRAM,
    PortFacts,
    Selection,
    baud_in,
    gap_from_metadata,
    part_of,
    selection_from_metadata,
)
from fte_sniff.recording.output_file import is_locked

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


@dataclass(frozen=True, slots=True)
class MessageCounts:
    """What a pass over a whole file found of its messages."""

    chunks: int = 0
    """Chunks that could be read."""
    unreadable: int = 0
    """Messages in them that could not be read; they are lost too."""
    lost: int | None = None
    """Messages that were not read, by the file's statistics; None if unknown."""
    least_lost: int = 0
    """The least number of them, by gaps in the sequence numbers; without a trusted summary."""


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


_BUFFER = 128 * 1024
"""Bytes read ahead: enough for the message indexes between two chunks."""
_HEAD_ENDS = frozenset({Opcode.CHUNK, Opcode.MESSAGE, Opcode.DATA_END, Opcode.FOOTER})
_MOST_TOPICS = 10
_SEQUENCES = 2**32

_DATA = DEFINITIONS | {
    Opcode.HEADER,
    Opcode.CHUNK,
    Opcode.MESSAGE,
    Opcode.MESSAGE_INDEX,
    Opcode.METADATA,
    Opcode.ATTACHMENT,
}
_STEP = 64 * 1024 * 1024
"""Bytes whose checksums are verified before their rows are read."""
_EDGE = 64
"""Bytes before the tail by which an overwritten file is recognised."""


class RecordingReader:
    """Reader of one recording; each iteration reads the file anew, up to its last complete record
    while it grows. `added` goes on where it ended. `ending` and `losses` are those of all so far.
    """

    def __init__(
        self, path: Path, stream: BinaryIO | None = None, *, growing: bool = False
    ) -> None:
        """Read the start of the file and its summary; of a stream, which `path` names, a copy.

        A file is `growing` while another program may write it, until `settle`. Raises FileError if
        the file cannot be read, is empty, no MCAP, has none of fte-sniff's topics, or cannot grow.
        """
        if growing:
            _check_kind(path)
        self.path = path
        self._pass: ReadingPass | None = None
        """The pass of `added`."""
        self._grows = growing
        """Whether a pass ends at `_complete`, and not at the end of the file."""
        self._complete = 0
        """Offset after the last complete record of a growing file."""
        self._is_followed = False
        self._edge = b""
        self._state: tuple[int, int] = 0, 0
        self._channels: dict[int, Channel] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        """The metadata records before the first row, by name."""
        self._summary: Summary | None = None
        self._is_ours = False
        self._all_metadata: list[Metadata] | None = None
        self._found: dict[int, int] = {}
        """Position and body length of chunks whose heads are damaged."""
        self.times: tuple[int, int] | None = None
        """First and last log time, nanoseconds since 1970 UTC; None if unknown."""
        self._damage: dict[LostBytes, None] = {}
        self._ending: LostBytes | None = None
        self._losses: tuple[str, ...] = ()
        self._remark: TranslatableText | None = None
        self.messages = MessageCounts()
        """Those of the last pass over the whole file."""
        self.nothing_read: FileError | None = None
        """Why the last pass read no row, although the file has data; None if it did, or has none.
        """
        self._lost: LostDefinitions | None = None
        self._copy: IO[bytes] | None = None
        self._copy = self._copy_of_pipe() if stream is None else self._copy_of(stream)
        with self._open() as stream:
            self._identity = _identity(stream)
            self.version = file_version(os.fstat(stream.fileno()))
            """What changes when the file does, read before its summary."""
            self.size = os.fstat(stream.fileno()).st_size
            """Bytes of the file when it was opened."""
            self._read_start(stream)
            if growing:
                self._follow(stream)

    @property
    def ports(self) -> tuple[PortFacts, ...]:
        """The ports named at the start of the file and in its summary, each once.

        Of a file with damaged definitions, those that its other records name.
        """
        found = {port.name: port for port in self._lost.ports} if self._lost else {}
        for channel in self._channels.values():
            if channel.topic in TOPIC_BY_NAME:
                facts = self._port_of(channel)
                found[facts.name] = facts
        return tuple(found.values())

    @property
    def count(self) -> int | None:
        """The number of messages in the summary; None without a trusted summary."""
        statistics = self._summary and self._summary.statistics
        return _count_in(statistics) if statistics else None

    @property
    def ending(self) -> str:
        """What is wrong with the end of the file; empty if nothing."""
        return self._ending.text if self._ending else ""

    @property
    def losses(self) -> tuple[str, ...]:
        """What could not be read, one line each; empty if nothing."""
        damage = Losses()
        for lost in sorted(self._damage, key=lambda lost: lost.start):
            damage.append(lost.text if lost.start or not lost.stop else self._start_lost(lost.stop))
        remark = (self._remark,) if self._remark else ()
        return (*damage.lines, *self._losses, *remark)

    @property
    def damage(self) -> list[LostBytes]:
        """The bytes that could not be read, in file order."""
        ending = [self._ending] if self._ending else []
        return sorted([*self._damage, *ending], key=lambda lost: lost.start)

    @property
    def has_summary(self) -> bool:
        """Whether the file ends with a summary, as a recording that is complete does."""
        return self._summary is not None

    @property
    def is_whole(self) -> bool:
        """Whether the passes so far found everything intact, and the file has a summary."""
        summary = self._summary
        return summary is not None and summary.guarded and not (self.damage or self.losses)

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """Nanoseconds since 1970 UTC: no row is before the first or after the second.

        None if the summary does not show it; the first is 0 if it does not show that one.
        """
        if not self.is_whole or self.times is None or self._summary is None:
            return None
        first_ns, last_ns = self.times
        is_marked = self.metadata.get(PROGRAM, {}).get(MARKS) == EARLY_NAME
        shown = is_marked and EARLY_NAME not in self._summary.metadata
        return first_ns if shown else 0, last_ns

    def gaps(self) -> list[Gap]:
        """The gaps that the file's metadata reports; reads no chunk."""
        found = [gap_from_metadata(one.name, one.metadata) for one in self.all_metadata]
        return [gap for gap in found if gap is not None]

    def selections(self) -> list[Selection]:
        """The filters that selected the rows of the file, from its metadata; reads no chunk."""
        found = [selection_from_metadata(one.name, one.metadata) for one in self.all_metadata]
        return [selection for selection in found if selection is not None]

    def __iter__(self) -> Iterator[Row]:
        """The rows, in file order.

        Raises FileError if reading failed, or the file has none of fte-sniff's topics.
        """
        return (row for rows in self.batches() for row in rows)

    def batches(
        self, codebook: Codebook | None = None, span: TimeRange = EVERYTHING
    ) -> Iterator[Rows]:
        """Rows and events in batches, in file order, mostly of at least 64 thousand rows.

        Chunks outside `span`, by their log times, are skipped where the index agrees with them; a
        row that came late is in the range of its chunk. Damage in skipped chunks is not detected.
        Several readers can share a codebook. Raises FileError as iteration over rows.
        """
        return (rows for _, rows in self.ranges(codebook, span))

    def ranges(
        self, codebook: Codebook | None = None, span: TimeRange = EVERYTHING, share: int = 1
    ) -> Generator[tuple[RowRange, Rows], None, None]:
        """The batches, each with the range with which `read` reads it again.

        Of a growing file, the records that are complete. `share` divides the memory: batches are
        smaller, and fewer are decoded ahead.
        """
        return self._read(self._new_pass(codebook or Codebook(), span, share))

    def added(
        self, codebook: Codebook | None = None, span: TimeRange = EVERYTHING
    ) -> Iterator[tuple[RowRange, Rows]]:
        """The batches of a growing file, as `ranges`, that were added since the previous call.

        After `settle`, all that is left. Codebook and span are those of the first call.
        """
        current = self._pass = self._pass or self._new_pass(codebook or Codebook(), span, 1)
        yield from self._read(current)
        while self._grows and current.position < self._complete:
            yield from self._read(current)

    def _new_pass(self, codebook: Codebook, span: TimeRange, share: int) -> ReadingPass:
        channels, counts = self._known_channels(), self._summary is None
        return ReadingPass(channels, codebook, span, count_sequences=counts, share=share)

    def _read(self, current: ReadingPass) -> Generator[tuple[RowRange, Rows], None, None]:
        """The rows from the position of a pass to the end, or the last complete record."""
        stop = self._complete if self._grows else None
        if stop is not None and current.position >= stop:
            return
        wanted = None if current.span.everything else current.span.overlaps
        with self._open() as stream:
            if current is self._pass and stop is not None:
                self._check(stream)
            records = RecordStream(
                stream, self._summary, wanted, self._found, first=current.position, stop=stop
            )
            try:
                yield from current.read(records)
            finally:
                self._damage |= dict.fromkeys((*records.losses, *current.found.lost))
            if current is self._pass and stop is not None:
                current.position = stop
                # It names the records of the first pass only.
                self._summary = None
                self.times = current.found.times or self.times
                self._advance(stream)
        if stop is None:
            self._finish(current, records)
            self._check_topics(current, cut=bool(records.ending or records.losses))

    def read(self, rows: RowRange) -> Rows:
        """Read a range of rows again, with a codebook of its own.

        Raises FileError if the file cannot be read any more, or has changed.
        """
        again = ReadingPass(self._channel_readers(rows.definitions), Codebook(), rows.span)
        try:
            records = list(self._records_of(rows))
        except RecordError as error:
            raise self._changed() from error
        batches = [own for _, own in again.read(records)]
        end = rows.skipped + rows.count
        if sum(map(len, batches)) < end:
            raise self._changed()
        return Rows.concat(batches)[rows.skipped : end]

    def _records_of(self, rows: RowRange) -> Iterator[RawRecord]:
        with self._open() as stream:
            if _identity(stream) != self._identity:
                raise self._changed()
            for start, end in rows.records:
                stream.seek(start)
                data = bytearray(stream.read(end - start))
                for position, length in self._found.items():
                    if start <= position < end:
                        HEAD.pack_into(data, position - start, Opcode.CHUNK, length)
                for opcode, body in records_in(bytes(data)):
                    yield RawRecord(start, opcode, body)
                    start += HEAD.size + len(body)

    def count_times_from(self, first_ns: int, latest_ns: int) -> None:
        """Report, for a damaged file, the times from which relative times count."""
        self._remark = TranslatableText(
            "relative times count from {first} and {last}, the first and the last row that could"
            " be read",
            first=iso_time(first_ns),
            last=iso_time(latest_ns),
        )

    def _changed(self) -> FileError:
        return FileError("{path}: has changed since it was read; open it again", path=self.path)

    @property
    def all_metadata(self) -> list[Metadata]:
        """Every metadata record of the file; reads no chunk."""
        if self._all_metadata is None:
            self._all_metadata = []
            with self._open() as stream:
                records = RecordStream(stream, self._summary, None, self._found, chunks=False)
                self._collect_metadata(records)
        return self._all_metadata

    @property
    def next_path(self) -> Path | None:
        """The next file of the capture; None while the file names none."""
        for metadata in self.all_metadata:
            name = Path(metadata.metadata.get("file", "")).name
            if metadata.name == NEXT_NAME and name:
                return self.path.with_name(name)
        return None

    @property
    def limit(self) -> str:
        """The limit at which the recording ended, text from the file; empty if it names none."""
        found = (one.metadata for one in self.all_metadata if one.name == END_NAME)
        return next((facts.get("reason", "") for facts in found), "")

    def find_next(self) -> Path | None:
        """The next file, also if this one could not name it because the disk failed."""
        if self.next_path is not None:
            return self.next_path
        own = part_of(self.metadata.get(PROGRAM, {}))
        for path in sorted(self.path.parent.glob(f"*{SUFFIX}")) if own else ():
            with suppress(FileError, OSError):
                if path.stat().st_mtime_ns < self._state[1]:
                    continue
                facts = RecordingReader(path).metadata.get(PROGRAM, {})
                if own and part_of(facts) == own.next and facts.get("previous") == self.path.name:
                    return path
        return None

    @property
    def has_writer(self) -> bool:
        """Whether a program holds the writer's lock; False also where locks do not work."""
        with self._open() as stream:
            return is_locked(stream.fileno())

    def grow(self) -> bool:
        """Find what was added to a growing file; True if it has changed since the previous call.

        Raises FileError if it was deleted, replaced or cut off.
        """
        with self._open() as stream:
            found, self._state = self._state, self._state_of(stream)
            self._advance(stream)
        position = self._pass.position if self._pass else 0
        return found != self._state or self._complete > position

    def settle(self) -> None:
        """Read a growing file to its end from now on, because nobody writes it any more.

        Raises FileError as `grow`.
        """
        with self._open() as stream:
            self._check(stream)
            self._summary = read_summary(stream)
        self._grows = False

    def _follow(self, stream: BinaryIO) -> None:
        """Find the complete records of a growing file, and the metadata in them."""
        self._complete = self._indexed_stop()
        self._all_metadata = []
        self._collect_metadata(
            RecordStream(stream, self._summary, chunks=False, stop=self._complete)
        )
        self._advance(stream)
        self._is_followed = True

    def _indexed_stop(self) -> int:
        """The end of the last chunk in the summary; the tail after it may change at any time."""
        if self._summary is None or not self._summary.guarded:
            self._summary = None
            return len(MAGIC)
        heads = {
            start: head for start, head in self._summary.heads.items() if head[0] == Opcode.CHUNK
        }
        self._summary.heads = heads
        stops = (start + HEAD.size + HEAD.unpack_from(head)[1] for start, head in heads.items())
        return max(stops, default=len(MAGIC))

    def _state_of(self, stream: BinaryIO) -> tuple[int, int]:
        found = os.fstat(stream.fileno())
        return found.st_size, found.st_mtime_ns

    def _check(self, stream: BinaryIO) -> None:
        """Raise FileError if what was read is not in the file any more."""
        found = os.fstat(stream.fileno())
        if (found.st_dev, found.st_ino) != self._identity:
            raise FileError(
                "{path} was replaced by another file while it was followed", path=self.path
            )
        if found.st_size < self._complete:
            raise FileError(
                "{path} was cut off to {size:,} bytes while it was followed",
                path=self.path,
                size=found.st_size,
            )
        if self._edge != self._edge_of(stream, self._complete):
            raise FileError("{path} was overwritten while it was followed", path=self.path)

    @staticmethod
    def _edge_of(stream: BinaryIO, stop: int) -> bytes:
        start = max(0, stop - _EDGE)
        return read_at(stream.fileno(), stop - start, start)

    def _advance(self, stream: BinaryIO) -> None:
        """Move `_complete` over the records that are whole; a chunk by its checksum.

        Raises FileError if what was read before is not in the file any more.
        """
        descriptor, size = stream.fileno(), os.fstat(stream.fileno()).st_size
        position = complete = self._complete
        limit = position + _STEP
        while position < min(limit, size - HEAD.size):
            head = read_at(descriptor, HEAD.size, position)
            if len(head) < HEAD.size:  # cut off since its size was read
                break
            opcode, length = HEAD.unpack(head)
            stop = position + HEAD.size + length
            if opcode not in _DATA or length > LARGEST or stop > size:
                break
            if opcode in (Opcode.CHUNK, Opcode.METADATA):
                body = read_at(descriptor, length, position + HEAD.size)
                if opcode == Opcode.CHUNK and not _is_intact(body):
                    break
                self._collect_metadata([RawRecord(position, opcode, body)])
            position = stop
            if opcode not in DEFINITIONS:  # they can belong to the tail
                complete = position
        edge = self._edge_of(stream, complete)
        if self._is_followed:
            # Last: if the file is overwritten at any moment, this or the next check sees it.
            self._check(stream)
        self._complete, self._edge = complete, edge

    def _collect_metadata(self, records: Iterable[RawRecord]) -> None:
        for record in records:
            if record.opcode == Opcode.METADATA:
                with suppress(RecordError):
                    self.all_metadata.append(parse(Metadata, record.body))

    def _known_channels(self) -> ChannelReaders:
        """The definitions in the summary, if a checksum protects it."""
        channels = self._channel_readers(NOTHING)
        if self._summary is not None and self._summary.guarded:
            for schema in self._summary.schemas:
                channels.define(schema, trusted=True)
            for channel in self._summary.channels:
                channels.define(channel, trusted=True)
        return channels

    def _channel_readers(self, known: Definitions) -> ChannelReaders:
        if self._lost is None:
            return ChannelReaders(self._port_name, known)
        return ChannelReaders(self._port_name, known, self._lost.get)

    def _finish(self, done: ReadingPass, records: RecordStream) -> None:
        """Report what a pass found, at its end."""
        found, whole = done.found, done.span.everything
        self._ending = records.ending or (None if whole else self._ending)
        self._losses = found.losses.lines
        if self._lost is not None:
            defined = {channel.id: channel for channel in done.channels.channels}
            self._losses += tuple(self._lost.doubts(defined))
        self.nothing_read = self._nothing_read(done, records)
        if not whole:
            return
        self.times = found.times or self.times
        count = self.count
        if count is None and done.statistics is not None:
            count = _count_in(done.statistics)
        sequences = [(end, n) for end, n in found.sequences.values() if end < _SEQUENCES]
        skipped = sum(max(0, end - n) for end, n in sequences)
        least = skipped + found.unreadable
        self.messages = MessageCounts(found.chunks, found.unreadable, None, least)
        if count is None:
            return
        missing = count - found.messages
        lost = max(0, missing + found.unreadable)
        self.messages = MessageCounts(found.chunks, found.unreadable, lost, lost)
        if missing > 0:
            text = TranslatableText(
                "{missing} of {count} messages are missing", missing=missing, count=count
            )
            self._losses += (text,)

    def _nothing_read(self, done: ReadingPass, records: RecordStream) -> FileError | None:
        """See `nothing_read`; of a part of the file, only if nothing else was skipped."""
        found, is_indexed = done.found, self._summary is not None and self._summary.guarded
        is_part = not done.span.everything
        if found.rows or (is_part and (is_indexed or found.times is not None)):
            return None
        if self.count is not None:
            has_lost = found.messages - found.unreadable < self.count
        else:
            has_lost = records.has_lost_data or bool(found.lost) or bool(found.unreadable)
        if not has_lost:
            return None
        why = next((loss for loss in (*self.losses, self.ending) if loss), "")
        return FileError(
            "{path}: no row in it could be read, although it has data: {why}; try another copy of "
            "the file",
            path=self.path,
            why=why,
        )

    def _check_topics(self, done: ReadingPass, *, cut: bool) -> None:
        """Refuse a file of which nothing could be read, at the end of a pass."""
        if done.found.times is not None:
            return
        for channel in done.channels.channels:
            why = done.channels.get(channel.id)
            if isinstance(why, str) and why in done.found.losses:
                raise FileError("{path}: {why}", path=self.path, why=why)
        topics = [channel.topic for channel in done.channels.channels]
        ours = self._is_ours or any(topic in TOPIC_BY_NAME for topic in topics)
        if not ours and (topics or not cut):
            raise self._without_our_topics(topics)

    def _without_our_topics(self, topics: Iterable[str]) -> FileError:
        """The error for an MCAP file without fte-sniff's topics; it lists the file's topics."""
        names = sorted(set(topics))
        has: str = TranslatableText("no topics at all")
        if names:
            has = listed(map(repr, names[:_MOST_TOPICS]))
        if len(names) > _MOST_TOPICS:
            has = TranslatableText(
                "{listed} and {count} more", listed=has, count=len(names) - _MOST_TOPICS
            )
        return FileError(
            "{path} is an MCAP, but holds nothing of fte-sniff's (topics /fte/...): "
            "it has {topics}; if one of them holds serial bytes, name it with --topic",
            path=self.path,
            topics=has,
        )

    def _start_lost(self, count: int) -> TranslatableText:
        return TranslatableText(
            "the first {count} bytes of this recording are damaged; `fte-sniff repair {path}` "
            "copies the undamaged rest to a new file",
            count=count,
            path=quote(str(self.path)),
        )

    @contextmanager
    def _open(self) -> Iterator[BinaryIO]:
        path = self.path if self._copy is None else Path(self._copy.name)
        try:
            with path.open("rb", _BUFFER) as stream:
                yield stream
        except OSError as error:
            if self._is_followed and isinstance(error, FileNotFoundError):
                raise FileError(
                    "{path} was deleted or moved while it was followed", path=self.path
                ) from error
            raise unreadable(self.path, error) from error

    def _copy_of_pipe(self) -> IO[bytes] | None:
        with self._open() as stream:
            return None if stream.seekable() else self._copy_of(stream)

    def _copy_of(self, stream: BinaryIO) -> IO[bytes]:
        """A temporary copy of what can be read only once."""
        copy = NamedTemporaryFile(prefix="fte-sniff-", suffix=".mcap")  # noqa: SIM115
        finalize(self, copy.close)
        copyfileobj(stream, copy)
        copy.flush()
        return copy

    def _read_start(self, stream: BinaryIO) -> None:
        magic = stream.read(len(MAGIC))
        if not magic:
            raise FileError(f"{self.path} is empty: nothing was recorded into it")
        if magic != MAGIC and MAGIC.startswith(magic):
            raise FileError(f"{self.path} is cut after {len(magic)} bytes: nothing is left in it")
        self._summary = read_summary(stream)
        records = RecordStream(stream, self._summary)
        summary = self._summary
        known = summary is not None and summary.guarded and bool(summary.channels)
        for record in records:
            # A summary with a checksum has the same definitions; a chunk has many messages.
            if record.opcode == Opcode.CHUNK and not known:
                with suppress(RecordError):
                    for opcode, body in records_in(unpack(record.body)):
                        self._read_definition(opcode, body)
            if record.opcode in _HEAD_ENDS:
                break
            self._read_definition(record.opcode, record.body)
        if magic != MAGIC and not any(lost.stop for lost in records.losses):
            raise FileError(
                f"{self.path} is not an MCAP recording; make one of a log: "
                "`fte-sniff decode --input hex LOG -o NAME.mcap`, or --input raw for raw bytes"
            )
        if self._summary is not None:
            self._use_summary(self._summary)
        if not known:
            facts = self.metadata.get(PROGRAM, {})
            self._lost = lost_definitions(stream, facts, is_ours=self._is_ours)

    def _use_summary(self, summary: Summary) -> None:
        self._channels.update((channel.id, channel) for channel in summary.channels)
        statistics = summary.statistics
        if statistics is not None and statistics.message_count:
            self.times = (statistics.message_start_time, statistics.message_end_time)
        topics = [channel.topic for channel in summary.channels]
        if topics and not any(topic in TOPIC_BY_NAME for topic in topics):
            raise self._without_our_topics(topics)

    def _read_definition(self, opcode: int, body: bytes) -> None:
        with suppress(RecordError):
            if opcode == Opcode.CHANNEL:
                channel = parse(Channel, body)
                self._channels[channel.id] = channel
            elif opcode == Opcode.METADATA:
                metadata = parse(Metadata, body)
                self.metadata[metadata.name] = metadata.metadata
            elif opcode == Opcode.HEADER:
                self._is_ours = parse(Header, body).library.startswith(PROGRAM)

    def _port_name(self, channel: Channel) -> str:
        """The port of a channel; the name of the file if the channel names none."""
        return channel.metadata.get("port", self.path.name)

    def _port_of(self, channel: Channel) -> PortFacts:
        return PortFacts(self._port_name(channel), baud_in(channel.metadata.get("baud", "")))


def _count_in(statistics: Statistics) -> int | None:
    """The number of messages; None if the statistics contradict themselves."""
    total = sum(statistics.channel_message_counts.values())
    return total if total == statistics.message_count else None


def _identity(stream: BinaryIO) -> tuple[int, int]:
    """Device and inode: the same for a file that has grown."""
    found = os.fstat(stream.fileno())
    return found.st_dev, found.st_ino


def _check_kind(path: Path) -> None:
    """Raise FileError unless the file is a recording, and a regular file."""
    start = MAGIC
    with suppress(OSError):  # raised again by `RecordingReader`
        if path.is_file():
            with path.open("rb") as stream:
                start = stream.read(len(MAGIC))
        elif path.exists():
            start = b"?"
    if not MAGIC.startswith(start):
        raise FileError(
            "{path} is not a recording; --follow reads only recordings (.mcap)", path=path
        )


def _is_intact(chunk: bytes) -> bool:
    try:
        unpack(chunk)
    except RecordError:
        return False
    return claimed(chunk)[1] > 0


FileVersion = tuple[int, int, int, int]


def file_version(found: os.stat_result) -> FileVersion:
    """Device, inode, size and time of the last change of a file."""
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


SUFFIX = ".mcap"

_PATTERN = frozenset("*?[")


Paths: TypeAlias = str | PathLike[str] | Sequence[str | PathLike[str]]
"""A path, or several of them."""


def recordings_in(paths: Paths) -> list[Path]:
    """The files of paths, each once: see `files_of`."""
    listed = [paths] if isinstance(paths, str | PathLike) else paths
    return list(dict.fromkeys(found for path in listed for found in files_of(Path(path))))


def files_of(path: Path) -> Iterator[Path]:
    """The file itself, the recordings in a folder, or the matches of a pattern, sorted by name.

    Raises FileError if the folder holds no recording, or nothing matches the pattern.
    """
    if path.is_dir():
        found = sorted(entry for entry in path.glob(f"*{SUFFIX}") if entry.is_file())
        if not found:
            raise FileError(f"{path} is a directory without a recording (*{SUFFIX}) in it")
        yield from found
    elif _PATTERN.intersection(str(path)) and not path.exists():
        start = Path(path.anchor)
        found = sorted(start.glob(str(path.relative_to(start))))
        if not found:
            raise FileError(f"{path}: no file matches this pattern; check the name and the folder")
        yield from found
    else:
        yield path


_FIRST_STEP_NS = 10**9
_LONGER = 60
"""The factor by which the search for the latest time goes further back at each step."""


def row_times(reader: RecordingReader) -> tuple[int, int] | None:
    """Time of the first row in the file, and the latest time; None without rows.

    Raises FileError if the file cannot be read.
    """
    first = next(iter(reader), None)
    if first is None or first.t_ns is None:
        return None
    first_ns = first.t_ns
    latest_ns = _latest_ns(reader, first_ns)
    if reader.damage:
        reader.count_times_from(first_ns, latest_ns)
    return first_ns, latest_ns


def _latest_ns(reader: RecordingReader, first_ns: int) -> int:
    """The latest time; searches the chunks at the end of the file first."""
    end_ns = reader.times[1] if reader.times else first_ns
    back_ns = _FIRST_STEP_NS
    while end_ns - back_ns > first_ns:
        found = _latest_in(reader, TimeRange(end_ns - back_ns))
        if found is not None:
            return found
        back_ns *= _LONGER
    return max(first_ns, _latest_in(reader, TimeRange(first_ns)) or first_ns)


def _latest_in(reader: RecordingReader, span: TimeRange) -> int | None:
    latest = [int(rows.t_ns.max()) for rows in reader.batches(span=span) if len(rows)]
    return max(latest, default=None)
