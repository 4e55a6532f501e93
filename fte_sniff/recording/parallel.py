"""Read batches with worker processes.

Chunks are unpacked and gathered ahead by threads (unpacking, checksums and numpy let go of the
interpreter) on the strength of what is known of the channels then. A chunk that cannot be read that
way, or that defines something new, is read record by record when its turn comes, so that the
outcome is always that of reading one record after the other.
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
from fte_sniff.recording.row_ranges import Range, RowRange, TimeRange, ranges_of
from fte_sniff.recording.sequential import SequentialReading
from fte_sniff.row_batch import Array, Codebook, RowBatch, RowBuffer

JOB = 8 * 1024 * 1024
"""Unpacked bytes that one batch of columns is made of, more or less: 64 thousand rows at least."""

FIRST_JOB = 512 * 1024
"""The same for the first batch, so that something is there soon."""

PIECE = 1024 * 1024
"""Unpacked bytes that are gathered at once, at least: so many rows that numpy pays, and so few
that they stay in a core's cache."""

SLOW_BATCH = 65_536
"""Rows of one batch, where they are read record by record."""

_MOST_ROOM = 2 * JOB // MESSAGE_HEAD
"""Rows that are given room before they are seen, whatever an index says."""

_DEFINITIONS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.HEADER})


@dataclass(slots=True)
class _Part:
    """A chunk with its message indexes, or the bytes of records that stand in no chunk."""

    chunk: RawRecord | None
    indexes: list[bytes] = field(default_factory=list)
    loose: bytearray = field(default_factory=bytearray)
    ranges: list[Range] = field(default_factory=list)
    """Where its records stand in the file."""
    after_loss: bool = False
    """Whether the file could not be read right before it."""

    @property
    def named(self) -> int:
        """How many messages its indexes name."""
        return message_count(self.indexes)

    @property
    def size(self) -> int:
        return len(self.loose) if self.chunk is None else unpacked_size(self.chunk.body)

    def entries(self, reading: SequentialReading) -> Iterator[Row | PortEvent]:
        """Record by record."""
        if self.chunk is not None:
            yield from reading.chunk_entries(self.chunk)
            return
        for opcode, body in records_in(bytes(self.loose)):
            yield from reading.entries_of(opcode, body)


@dataclass(slots=True)
class _Outcome:
    """What a thread made of a job, given what was known of the channels."""

    version: int
    gathered: list[DecodedColumns]
    columns: RowBatch
    definitions: list[tuple[int, bytes]]


@dataclass(slots=True)
class _Job:
    parts: list[_Part]
    size: int
    outcome: Future[_Outcome | None]


class ParallelReading:
    """One pass over a recording by columns."""

    def __init__(self, reading: SequentialReading, codebook: Codebook, span: TimeRange) -> None:
        """Begin a pass.

        Args:
            reading: knows the channels, and reads what must be read record by record.
            codebook: takes up ports and faults.
            span: rows outside it are left out.
        """
        keep_freed_memory()
        self._reading, self._codebook, self._span = reading, codebook, span
        self._readers: tuple[int, Readers] = (-1, {})
        self._jobs: deque[_Job] = deque()
        self._ahead = cores() + 1

    def passages(self, records: RecordStream) -> Iterator[tuple[RowRange, RowBatch]]:
        """The rows and events of the records, in their order, many thousands at once.

        Each time with what it takes to read them again.

        Raises:
            FileError: the file has none of our topics, or none that can be read.
        """
        begun = False
        with ThreadPoolExecutor(cores(), "unpacks chunks") as threads:
            try:
                for parts in self._jobs_of(records):
                    size = sum(part.size for part in parts)
                    while self._jobs and not self._has_room(size):
                        yield from self._placed(self._jobs.popleft())
                    outcome = threads.submit(self._outcome, parts, *self._known())
                    self._jobs.append(_Job(parts, size, outcome))
                    if not begun:
                        # Whoever waits for the first rows shall not share the cores with the next.
                        begun = True
                        yield from self._placed(self._jobs.popleft())
                while self._jobs:
                    yield from self._placed(self._jobs.popleft())
            finally:
                for job in self._jobs:
                    job.outcome.cancel()
        self._reading.check_topics(cut=records.cut)

    def again(self, records: Iterable[RawRecord]) -> Iterator[RowBatch]:
        """The rows and events of a few records, in their order and without threads."""
        for parts in self._jobs_of(records):
            outcome: Future[_Outcome | None] = Future()
            outcome.set_result(self._outcome(parts, *self._known()))
            yield from (columns for columns, _ in self._finished(_Job(parts, 0, outcome)))

    def _placed(self, job: _Job) -> Iterator[tuple[RowRange, RowBatch]]:
        known, skipped = self._reading.definitions, 0
        ranges = ranges_of(one for part in job.parts for one in part.ranges)
        for columns, after_loss in self._finished(job):
            yield RowRange(known, ranges, self._span, skipped, len(columns), after_loss), columns
            skipped += len(columns)

    def _has_room(self, size: int) -> bool:
        """Whether one more job may be under way, for its number and for what it may take up."""
        taken = sum(job.size for job in self._jobs)
        return len(self._jobs) < self._ahead and taken + size <= LARGEST

    def _known(self) -> tuple[int, Readers]:
        version = self._reading.version
        if self._readers[0] != version:
            self._readers = version, self._reading.readers()
        return self._readers

    def _jobs_of(self, records: Iterable[RawRecord]) -> Iterator[list[_Part]]:
        parts: list[_Part] = []
        size, enough, skipped = 0, FIRST_JOB, 0
        for record in records:
            if record.opcode == Opcode.MESSAGE_INDEX:
                if parts:
                    parts[-1].indexes.append(record.body)
                    parts[-1].ranges.append(_range(record))
                continue
            begins = record.opcode in (Opcode.CHUNK, Opcode.MESSAGE)
            lost = _skipped(records) > skipped
            if begins and parts and (lost or size >= enough):
                yield parts
                parts, size, enough = [], 0, JOB
            if record.opcode == Opcode.CHUNK:
                parts.append(_Part(record, ranges=[_range(record)]))
                size += parts[-1].size
            elif record.opcode == Opcode.MESSAGE or record.opcode in _DEFINITIONS:
                size += self._take_loose(record, parts)
            if begins:
                parts[-1].after_loss |= lost
                skipped = _skipped(records)
        if parts:
            yield parts

    def _take_loose(self, record: RawRecord, parts: list[_Part]) -> int:
        """Take a record that stands in no chunk; how many bytes it adds to the job."""
        if record.opcode != Opcode.MESSAGE and not parts and not self._jobs:
            for _ in self._reading.entries_of(record.opcode, record.body):
                raise AssertionError("a definition is no row")
            return 0
        if not parts or parts[-1].chunk is not None:
            parts.append(_Part(None))
        parts[-1].ranges.append(_range(record))
        parts[-1].loose += HEAD.pack(record.opcode, len(record.body)) + record.body
        return HEAD.size + len(record.body)

    def _finished(self, job: _Job) -> Iterator[tuple[RowBatch, bool]]:
        """The rows, and whether something was lost right before them."""
        outcome = job.outcome.result()
        if outcome is not None and outcome.version != self._reading.version:
            outcome = self._outcome(job.parts, *self._known())
        if outcome is None or not all(self._reading.knows(*known) for known in outcome.definitions):
            yield from self._one_by_one(job.parts)
            return
        for gathered in outcome.gathered:
            self._reading.count(gathered.messages, gathered.times)
        yield outcome.columns, job.parts[0].after_loss

    def _one_by_one(self, parts: list[_Part]) -> Iterator[tuple[RowBatch, bool]]:
        batch: list[Row | PortEvent] = []
        after_loss = False
        for lost, entry in self._entries(parts):
            if lost or len(batch) == SLOW_BATCH:
                if batch or after_loss:
                    yield self._columns_of(batch), after_loss
                batch, after_loss = [], lost
            if entry is not None:
                batch.append(entry)
        if batch or after_loss:
            yield self._columns_of(batch), after_loss

    def _entries(self, parts: list[_Part]) -> Iterator[tuple[bool, Row | PortEvent | None]]:
        """What the parts hold, and whether something was lost before it; None at the last end."""
        known = self._reading.lost
        for part in parts:
            skipped = part.after_loss
            for entry in part.entries(self._reading):
                yield skipped or self._reading.lost > known, entry
                known, skipped = self._reading.lost, False
            if skipped:
                yield True, None
        yield self._reading.lost > known, None

    def _columns_of(self, batch: list[Row | PortEvent]) -> RowBatch:
        events = [entry for entry in batch if isinstance(entry, PortEvent)]
        rows = [entry for entry in batch if not isinstance(entry, PortEvent)]
        return self._span.part_of(RowBatch.from_rows(rows, self._codebook, events))

    def _outcome(self, parts: list[_Part], version: int, readers: Readers) -> _Outcome | None:
        """Runs in a thread. None where the parts must be read record by record."""
        gathered: list[DecodedColumns] = []
        definitions: list[tuple[int, bytes]] = []
        room = RowBuffer(self._codebook, min(sum(part.named for part in parts), _MOST_ROOM))
        try:
            for records, places in _pieces(parts):
                messages = index_messages(records, places)
                definitions += messages.others
                gathered.append(decode_columns(messages, readers, room.reserve(len(messages))))
                # Let go of before the next are unpacked, which then come where a core's cache has
                # them.
                del records, places, messages
        except (ValueError, KeyError):
            return None
        columns = room.filled() if all(piece.in_place for piece in gathered) else None
        if columns is None:
            columns = RowBatch.concat([piece.columns for piece in gathered])
        return _Outcome(version, gathered, self._span.part_of(columns), definitions)


def _skipped(records: Iterable[RawRecord]) -> int:
    """How often reading the file went on elsewhere so far."""
    return len(records.losses) if isinstance(records, RecordStream) else 0


def _range(record: RawRecord) -> Range:
    return record.position, record.position + HEAD.size + len(record.body)


def _pieces(parts: list[_Part]) -> Iterator[tuple[bytes, Array | None]]:
    """The parts unpacked, small chunks joined, with the places that their indexes name."""
    for loose, group in groupby(parts, lambda part: part.chunk is None):
        if loose:
            yield from ((bytes(part.loose), None) for part in group)
        else:
            yield from _joined_chunks(group)


def _joined_chunks(parts: Iterable[_Part]) -> Iterator[tuple[bytes, Array | None]]:
    records: list[bytes] = []
    places: list[Array | None] = []
    size = 0
    for part in parts:
        assert part.chunk is not None
        records.append(unpack(part.chunk.body))
        named = indexed_starts(part.indexes, len(records[-1]))
        places.append(named + size if size and named is not None else named)
        size += len(records[-1])
        if size >= PIECE:
            yield _joined(records), _all_places(places)
            records, places, size = [], [], 0
    if records:
        yield _joined(records), _all_places(places)


def _joined(records: list[bytes]) -> bytes:
    return records[0] if len(records) == 1 else b"".join(records)


def _all_places(places: list[Array | None]) -> Array | None:
    known = [named for named in places if named is not None]
    if len(places) == 1:
        return places[0]
    return np.concatenate(known) if len(known) == len(places) else None
