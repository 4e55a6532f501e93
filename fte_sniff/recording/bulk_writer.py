"""Batch writer with packing in a worker.

Rows come in the order in which they are to stand. A log time never falls: a row that is earlier
than the one before it gets that one's, and its message tells its own time beside.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from mcap.records import Metadata

from fte_sniff.errors import FileError, unwritable
from fte_sniff.protocol import PortEvent
from fte_sniff.recording.mcap.append_file import Stream
from fte_sniff.recording.mcap.records import cores, keep_freed_memory
from fte_sniff.recording.mcap.writer import McapBatch, McapFile, PackedChunk, packed
from fte_sniff.recording.messages.codec import plain
from fte_sniff.recording.messages.packer import Channels, ColumnPacker
from fte_sniff.recording.messages.schema import Topic
from fte_sniff.recording.metadata import PortFacts, library_name, recording_facts
from fte_sniff.recording.writer import METADATA_NAME
from fte_sniff.row_batch import Array, RowBatch


class BackgroundPacker:
    """Adds chunks to a file; when it is left all of them are there, unless an error ended it."""

    def __init__(self, file: McapFile) -> None:
        """Take the file, to which nobody else may add chunks meanwhile."""
        self._file = file
        self._threads = ThreadPoolExecutor(cores(), "packs chunks")
        self._under_way: deque[Future[PackedChunk]] = deque()
        self._most = cores() + 1

    def __enter__(self) -> Self:
        return self

    def add(self, batch: McapBatch) -> None:
        """Add a chunk; waits while enough of them are under way.

        Raises:
            OSError: this chunk or one before cannot be written; nothing more can be added then.
        """
        while len(self._under_way) >= self._most:
            self._write_first()
        definitions = self._file.definitions_for(batch)
        self._under_way.append(self._threads.submit(packed, definitions, batch))

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            while kind is None and self._under_way:
                self._write_first()
        finally:
            self._threads.shutdown(cancel_futures=True)

    def _write_first(self) -> None:
        self._file.write_chunk(self._under_way.popleft().result())


Note = tuple[str, Mapping[str, str]]
"""The name of a metadata record, and what it tells."""

CHUNK_ROWS = 32_768
"""Rows in a chunk: some 3 MB unpacked, so that what a chunk costs by itself is next to nothing, and
no more than other writers put into one."""


def write_recording(
    path: Path,
    ports: Sequence[PortFacts],
    batches: Iterable[RowBatch],
    facts: Mapping[str, str] | None = None,
    notes: Callable[[], Iterable[Note]] = tuple,
) -> None:
    """Write a recording; a file that is there already is replaced.

    Args:
        path: the file.
        ports: the ports whose rows come, as far as they are known; rows of others are taken too.
        batches: the rows and events.
        facts: what the file is to say about itself beside the ports.
        notes: gives what else it is to say; asked for once all batches have come.

    Raises:
        FileError: the file cannot be written, or what the batches raise.
    """
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o666)
    except OSError as error:
        raise unwritable(path, error) from error
    try:
        writer = _Writer(descriptor, ports, facts or {})
        writer.write_all(batches)
        writer.finish(notes())
    except OSError as error:
        raise unwritable(path, error) from error
    finally:
        os.close(descriptor)


class _Writer:
    def __init__(
        self, descriptor: int, ports: Sequence[PortFacts], facts: Mapping[str, str]
    ) -> None:
        keep_freed_memory()
        self._channels = Channels()
        self._packer = ColumnPacker(self._channel_id)
        self._last_time = 0
        known = {port.name: port for port in ports}
        about = recording_facts(tuple(known.values()), facts)
        self._file = McapFile(
            Stream(descriptor),
            library_name(),
            Metadata(METADATA_NAME, {plain(key): plain(value) for key, value in about.items()}),
            self._channels.schemas(),
            [channel for port in known.values() for channel in self._channels.of_port(port)],
        )

    def write_all(self, batches: Iterable[RowBatch]) -> None:
        with BackgroundPacker(self._file) as ahead:
            for columns in batches:
                _check_times(columns)
                for chunk in _chunks(columns):
                    if len(chunk) or chunk.events:
                        ahead.add(self._messages(chunk))

    def finish(self, notes: Iterable[Note]) -> None:
        self._file.write_metadata(
            Metadata(name, {key: plain(value) for key, value in told.items()})
            for name, told in notes
        )
        self._file.close()

    def _messages(self, chunk: RowBatch) -> McapBatch:
        times = self._log_times(chunk.t_ns)
        event_times = self._log_times(np.array([event.t_ns for event in chunk.events], np.int64))
        # Each event stands before the first row that is later.
        at = np.searchsorted(times, event_times, "right")
        times = np.insert(times, at, event_times)
        self._last_time = int(times[-1])
        return self._packer.pack(chunk, times, at + np.arange(len(at)))

    def _log_times(self, times: Array) -> Array:
        return np.maximum(np.maximum.accumulate(times), self._last_time) if len(times) else times

    def _channel_id(self, port: str, topic: Topic) -> int:
        for channel in self._channels.of_port(PortFacts(port)):
            self._file.add_channel(channel)
        return self._channels.id_of(port, topic)


def _check_times(rows: RowBatch) -> None:
    untimed = np.flatnonzero(~rows.timed | (rows.t_ns < 0))
    if len(untimed):
        row = rows[int(untimed[0])]
        raise FileError(
            f"{row.port!r}, offset {row.offset}, has no time since 1970, and a recording needs one;"
            " write another format"
        )


def _chunks(columns: RowBatch) -> Iterator[RowBatch]:
    """The columns by so many rows as a chunk holds, events with the rows that follow them."""
    events = sorted(columns.events, key=_time_of)
    for start in range(0, max(len(columns), 1), CHUNK_ROWS):
        part = columns[start : start + CHUNK_ROWS]
        last = start + CHUNK_ROWS >= len(columns)
        end = 2**63 if last else int(part.t_ns[-1])
        own = tuple(event for event in events if event.t_ns <= end)
        events = events[len(own) :]
        yield columns.select(slice(start, start + CHUNK_ROWS), own)


def _time_of(event: PortEvent) -> int:
    return event.t_ns
