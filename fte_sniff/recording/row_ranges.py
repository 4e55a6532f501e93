"""Row ranges of a file and how a damaged file is read."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from fte_sniff.protocol import PortEvent, Row
from fte_sniff.recording.mcap.reader import Place, RawRecord, RecordStream, Summary
from fte_sniff.recording.mcap.records import HEAD, records_in
from fte_sniff.recording.mcap.salvage import FoundChunk, next_chunk
from fte_sniff.row_batch import Array, RowBatch

_LATEST = 2**63 - 1


@dataclass(frozen=True, slots=True)
class TimeRange:
    """From one time to another, nanoseconds since 1970 UTC; the end is not part of it."""

    first_ns: int = 0
    end_ns: int = _LATEST

    @property
    def everything(self) -> bool:
        """Whether it leaves nothing out."""
        return self.first_ns <= 0 and self.end_ns >= _LATEST

    def touches(self, first_ns: int, last_ns: int) -> bool:
        """Whether something from `first_ns` to `last_ns`, both included, can lie in the span."""
        return self.first_ns <= last_ns and first_ns < self.end_ns

    def holds(self, entry: Row | PortEvent) -> bool:
        """Whether a row or event lies in the span; what has no time does not."""
        return entry.t_ns is not None and self.first_ns <= entry.t_ns < self.end_ns

    def among(self, t_ns: Array) -> Array:
        """Which of these times lie in the span."""
        found: Array = (t_ns >= self.first_ns) & (t_ns < self.end_ns)
        return found

    def part_of(self, columns: RowBatch) -> RowBatch:
        """The rows and events that lie in the span."""
        if self.everything:
            return columns
        inside = self.among(columns.t_ns)
        events = tuple(filter(self.holds, columns.events))
        if inside.all() and len(events) == len(columns.events):
            return columns
        return columns.select(inside, events)


EVERYTHING = TimeRange()
"""All of time."""


Range = tuple[int, int]
"""Where records begin in a file, and where the last of them ends."""


@dataclass(frozen=True, slots=True)
class Definitions:
    """What a pass knew of the channels before it came to a stretch."""

    schemas: Mapping[int, Schema]
    channels: Mapping[int, Channel]


@dataclass(frozen=True, slots=True)
class RowRange:
    """Some rows of a recording, by where they stand in the file."""

    known: Definitions
    ranges: tuple[Range, ...]
    """Of the records that hold the rows, rising."""
    span: TimeRange
    """Rows outside it were left out."""
    skipped: int
    """Rows that these records hold before them."""
    count: int
    """How many rows they are."""
    after_loss: bool = False
    """Whether something could not be read between the rows before and these."""


def ranges_of(records: Iterable[Range]) -> tuple[Range, ...]:
    """The same, with those that follow each other without a gap as one."""
    found: list[Range] = []
    for start, end in records:
        if found and found[-1][1] == start:
            start = found.pop()[0]
        found.append((start, end))
    return tuple(found)


class RecordScan:
    """The way through one file; it remembers the chunks that had to be looked for."""

    def __init__(self) -> None:
        """The file is whole, as far as is known."""
        self.begin: Place | None = None
        """The first whole chunk, where nothing before it can be read."""
        self._found: dict[int, int] = {}

    def begin_with(self, chunk: FoundChunk) -> None:
        """Nothing before this chunk can be read."""
        self.begin = self._noted(chunk)

    def _noted(self, chunk: FoundChunk) -> Place:
        self._found[chunk.position] = chunk.length
        return chunk.position, chunk.length

    def records(
        self,
        stream: BinaryIO,
        summary: Summary | None,
        wanted: Callable[[int, int], bool] | None = None,
    ) -> RecordStream:
        """The file's records, as far as they can be read; see `RecordStream`."""
        if summary is not None:
            return RecordStream(stream, summary.starts, wanted, begin=self.begin)

        def search(position: int) -> Place | None:
            chunk = next_chunk(stream, position)
            return None if chunk is None else self._noted(chunk)

        return RecordStream(stream, (), wanted, search, self.begin)

    def again(self, stream: BinaryIO, place: Range) -> Iterator[RawRecord]:
        """The records that were read there before.

        Raises:
            RecordError: there are others by now.
        """
        start, end = place
        stream.seek(start)
        data = bytearray(stream.read(end - start))
        for position, length in self._found.items():
            if start <= position < end:
                head = slice(position - start, position - start + HEAD.size)
                data[head] = HEAD.pack(Opcode.CHUNK, length - HEAD.size)
        for opcode, body in records_in(bytes(data)):
            yield RawRecord(start, opcode, body)
            start += HEAD.size + len(body)
