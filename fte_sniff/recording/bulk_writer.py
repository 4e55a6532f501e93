"""Write a recording from batches of rows, in the given order; threads compress the chunks.

Log times never fall: a row that is earlier than the previous one gets the same log time, and its
message holds its own time.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
from mcap.records import Metadata

from fte_sniff.errors import FileError
from fte_sniff.recording.mcap.append_file import Stream
from fte_sniff.recording.mcap.records import cores, keep_freed_memory
from fte_sniff.recording.mcap.writer import McapBatch, PackedChunk, packed
from fte_sniff.recording.messages.codec import encodable_items
from fte_sniff.recording.metadata import EARLY_NAME, PortFacts, early_facts
from fte_sniff.recording.writer import begin_recording
from fte_sniff.row_batch import Array, RowBatch

NamedFacts = tuple[str, Mapping[str, str]]
"""Name and content of a metadata record."""

CHUNK_ROWS = 32_768
"""Rows in a chunk: about 3 MB unpacked, so that the cost per chunk is negligible, and the chunk no
larger than those of other writers."""


class BulkWriter:
    """Writes a recording; an existing file is replaced.

    After an error the only call that is allowed is `abandon`.
    """

    def __init__(
        self, path: Path | int, ports: Sequence[PortFacts], facts: Mapping[str, str] | None = None
    ) -> None:
        """Create the file.

        Args:
            path: the file, or the descriptor of an empty one, which is not closed.
            ports: the known ports; rows of other ports are accepted too.
            facts: further content of the file's first metadata record.

        Raises OSError if the file cannot be created or written.
        """
        keep_freed_memory()
        self._last_time = 0
        self._waiting: list[RowBatch] = []
        self._waiting_rows = 0
        known = {port.name: port for port in ports}
        if isinstance(path, int):
            self._descriptor = os.dup(path)
        else:
            self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
        try:
            self._file, self._packer = begin_recording(
                Stream(self._descriptor), list(known.values()), facts or {}
            )
        except OSError:
            os.close(self._descriptor)
            raise
        self._threads = ThreadPoolExecutor(cores(), "compresses chunks")
        self._under_way: deque[Future[PackedChunk]] = deque()
        self._closed = False

    def write(self, batch: RowBatch) -> None:
        """Write rows and events; small batches without events share a chunk.

        Raises FileError if a row has no time, OSError if the file cannot be written.
        """
        _check_times(batch)
        if batch.events:
            self._write_waiting()
        if len(batch) or batch.events:
            self._waiting.append(batch)
            self._waiting_rows += len(batch)
        if batch.events or self._waiting_rows >= CHUNK_ROWS:
            self._write_waiting()

    def close(self, metadata: Iterable[NamedFacts] = ()) -> None:
        """Write pending rows, further metadata records and the index, and close; raises OSError."""
        self._write_waiting()
        while self._under_way:
            self._write_first()
        self._threads.shutdown()
        if (early_ns := self._packer.early_ns) is not None:
            metadata = [*metadata, (EARLY_NAME, early_facts(early_ns))]
        self._file.write_metadata(
            Metadata(name, encodable_items(facts)) for name, facts in metadata
        )
        self._file.close()
        self._closed = True
        os.close(self._descriptor)

    def abandon(self) -> None:
        """Close the file without writing more; does nothing if it is closed."""
        if not self._closed:
            self._closed = True
            self._threads.shutdown(cancel_futures=True)
            os.close(self._descriptor)

    def _write_waiting(self) -> None:
        if self._waiting:
            batch = RowBatch.concat(self._waiting)
            self._waiting, self._waiting_rows = [], 0
            for chunk in _chunks(batch):
                messages = self._messages(chunk)
                while len(self._under_way) > cores():
                    self._write_first()
                definitions = self._file.next_definitions()
                self._under_way.append(self._threads.submit(packed, definitions, messages))

    def _write_first(self) -> None:
        self._file.write_chunk(self._under_way.popleft().result())

    def _messages(self, chunk: RowBatch) -> McapBatch:
        times = self._log_times(chunk.t_ns)
        event_times = self._log_times(np.array([event.t_ns for event in chunk.events], np.int64))
        # Each event comes before the first later row.
        at = np.searchsorted(times, event_times, "right")
        times = np.insert(times, at, event_times)
        self._last_time = int(times[-1])
        return self._packer.pack(chunk, times, at + np.arange(len(at)))

    def _log_times(self, times: Array) -> Array:
        return np.maximum(np.maximum.accumulate(times), self._last_time) if len(times) else times


def _check_times(rows: RowBatch) -> None:
    untimed = np.flatnonzero(rows.t_ns < 0)
    if len(untimed):
        row = rows[int(untimed[0])]
        raise FileError(
            f"{row.port!r}, offset {row.offset}, has no time since 1970, and a recording needs one;"
            " write another format"
        )


def _chunks(rows: RowBatch) -> Iterator[RowBatch]:
    """The rows of each chunk, with the events until its last row."""
    events = sorted(rows.events, key=lambda event: event.t_ns)
    for start in range(0, max(len(rows), 1), CHUNK_ROWS):
        stop = start + CHUNK_ROWS
        end_ns = 2**63 if stop >= len(rows) else int(rows.t_ns[stop - 1])
        own = tuple(event for event in events if event.t_ns <= end_ns)
        events = events[len(own) :]
        yield rows.select(slice(start, stop), own)
