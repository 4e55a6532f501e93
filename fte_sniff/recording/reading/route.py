"""Owns the way through a file: where its records begin, and where they go on behind a damage.

It must not know rows. Where the summary does not tell where chunks begin, they are looked for, and
what a whole chunk is its checksum tells; the head of its record need not be whole then.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import BinaryIO

from mcap.opcode import Opcode

from fte_sniff.recording.container.record_stream import Place, RawRecord, RecordStream
from fte_sniff.recording.container.records import HEAD, records_in
from fte_sniff.recording.container.salvage import FoundChunk, next_chunk
from fte_sniff.recording.container.summary import Summary
from fte_sniff.recording.reading.passage import Range


class Route:
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
