"""Time ranges, row ranges of a file, and the scan of a file's records."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from fte_sniff.protocol import PortEvent, Row
from fte_sniff.recording.mcap.reader import Location, RawRecord, RecordStream, Summary
from fte_sniff.recording.mcap.records import HEAD, records_in
from fte_sniff.recording.mcap.salvage import FoundChunk, next_chunk
from fte_sniff.row_batch import Array, RowBatch

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

    def select(self, rows: RowBatch) -> RowBatch:
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
"""Start and end in a file."""


@dataclass(frozen=True, slots=True)
class Definitions:
    """The schemas and channels known at some point of a file, by id."""

    schemas: Mapping[int, Schema]
    channels: Mapping[int, Channel]


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
    """Number of rows."""
    after_loss: bool = False
    """Whether something could not be read between the previous rows and these."""


def merged(ranges: Iterable[ByteRange]) -> tuple[ByteRange, ...]:
    """The same ranges, contiguous ones merged."""
    found: list[ByteRange] = []
    for start, end in ranges:
        if found and found[-1][1] == start:
            start = found.pop()[0]
        found.append((start, end))
    return tuple(found)


class RecordScan:
    """Reads the records of one file, and remembers the chunks that had to be searched for."""

    def __init__(self) -> None:
        self.begin: Location | None = None
        """The first whole chunk, if nothing before it can be read."""
        self._found: dict[int, int] = {}

    def begin_with(self, chunk: FoundChunk) -> None:
        """Begin with this chunk; nothing before it can be read."""
        self.begin = self._remember(chunk)

    def records(
        self,
        stream: BinaryIO,
        summary: Summary | None,
        wanted: Callable[[int, int], bool] | None = None,
    ) -> RecordStream:
        """The file's records; arguments as for `RecordStream`."""
        if summary is not None:
            return RecordStream(stream, summary.starts, wanted, begin=self.begin)

        def search(position: int) -> Location | None:
            chunk = next_chunk(stream, position)
            return None if chunk is None else self._remember(chunk)

        return RecordStream(stream, (), wanted, search, self.begin)

    def read(self, stream: BinaryIO, records: ByteRange) -> Iterator[RawRecord]:
        """Records that were read before; raises RecordError if the file has other records now."""
        start, end = records
        stream.seek(start)
        data = bytearray(stream.read(end - start))
        for position, length in self._found.items():
            if start <= position < end:
                # The head of a chunk that was searched for may be damaged.
                HEAD.pack_into(data, position - start, Opcode.CHUNK, length - HEAD.size)
        for opcode, body in records_in(bytes(data)):
            yield RawRecord(start, opcode, body)
            start += HEAD.size + len(body)

    def _remember(self, chunk: FoundChunk) -> Location:
        self._found[chunk.position] = chunk.length
        return chunk.position, chunk.length
