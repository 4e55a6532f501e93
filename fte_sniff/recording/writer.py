"""Writers of one recording: rows as they come, and batches whose chunks threads compress.

Log times never fall. Rows of several ports come a little out of order, so `RecordingWriter` sorts
a chunk by time: a message's log time is its row's time. Only if a row comes after its chunk, or its
port's clock fell back, is the log time raised to the last one written; the message then holds the
row's own time too. `BulkWriter` keeps the given order, and raises log times in the same way.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from mcap.records import Metadata

from fte_sniff.errors import FileError, unwritable
from fte_sniff.platform import open_flags
from fte_sniff.protocol.rows import Bools, Ints, Rows
from fte_sniff.recording.mcap.reader import cores, keep_freed_memory
from fte_sniff.recording.mcap.writer import (
    AppendFile,
    AppendTarget,
    McapBatch,
    McapFile,
    PackedChunk,
    packed,
)
from fte_sniff.recording.messages import Channels, ColumnPacker, Topic, encodable_items, table_crc
from fte_sniff.recording.metadata import (
    EARLY_NAME,
    PORTS_NAME,
    PROGRAM,
    PortFacts,
    early_facts,
    library_name,
    ports_to_metadata,
    recording_facts,
)
from fte_sniff.recording.output_file import (
    Existing,
    FileIdentity,
    LostDataError,
    OutputPath,
    Stream,
    StreamOutput,
    is_stream,
    stopped_by_error,
)


class RecordingFile:
    """The head of a recording, and the messages of its rows."""

    def __init__(
        self, target: AppendTarget, ports: Sequence[PortFacts], facts: Mapping[str, str]
    ) -> None:
        """Write the head: metadata, and the schemas and channels of all ports.

        Further ports get their channels when their first rows come. Raises OSError if the target
        cannot be written.
        """
        self._channels = Channels()
        self._last_time = 0
        channels = self._channels
        self.mcap = McapFile(
            target,
            library_name(),
            Metadata(PROGRAM, encodable_items(recording_facts(ports, facts))),
            channels.schemas(),
            [channel for port in ports for channel in channels.of_port(port)],
            lambda: Metadata(
                PORTS_NAME, encodable_items(ports_to_metadata(channels.ports, table_crc()))
            ),
        )
        self._packer = ColumnPacker(self._channel_id)

    def _channel_id(self, port: str, topic: Topic) -> int:
        try:
            return self._channels.id_of(port, topic)
        except KeyError:  # tried first, because each odd row asks
            for channel in self._channels.of_port(PortFacts(port)):
                self.mcap.add_channel(channel)
            return self._channels.id_of(port, topic)

    def messages(self, rows: Rows, times: Ints, events_at: Ints) -> McapBatch:
        """The messages of rows and their events, in the order of their log times.

        A log time that would fall is raised. `events_at` are the indexes of the events among the
        messages, rising.
        """
        times = np.maximum(np.maximum.accumulate(times), self._last_time)
        self._last_time = int(times[-1])
        return self._packer.pack(rows, times, events_at)

    def early_record(self) -> list[Metadata]:
        """The record of the first row that is before the first message; empty without one."""
        early_ns = self._packer.early_ns
        return [] if early_ns is None else [Metadata(EARLY_NAME, early_facts(early_ns))]


class RecordingWriter:
    """Writes one recording, which is valid after each flush.

    When a write fails, that call and every later one raise the same FileError, and the file holds
    what was flushed before.
    """

    def __init__(
        self,
        path: Path,
        ports: Sequence[PortFacts],
        facts: Mapping[str, str] | None = None,
        *,
        existing: Existing = Existing.REFUSE,
    ) -> None:
        """Create the file, with the schemas and channels of all ports in it.

        Args:
            path: the file; only a regular file is replaced, once the new one has its head. `-`, a
                pipe or a device is written in sequence; a named pipe once it has a reader.
            ports: the ports whose rows will come; rows of others are accepted too.
            facts: further items for the file's metadata, e.g. `host_facts(now)`.
            existing: what to do if the file exists.

        Raises FileError if the file exists, another program records to it, its folder does not
        exist, or the system refuses it. The disk is unchanged then.
        """
        self._pending: list[_Pending] = []
        self.rows = 0
        """Rows written so far, flushed or not."""
        self.flushed_rows = self.flushed_events = 0
        """Rows and port events in the file."""
        self.span_ns: tuple[int, int] | None = None
        """First and last time of the entries, nanoseconds since 1970 UTC; None without any."""
        self.failure: FileError | None = None
        """Why the recording stopped; None while it goes on."""
        self.identity: FileIdentity | None = None
        """What the file is once it is closed; None if it was deleted, or is not a regular file."""
        self.is_gone = False
        """Whether the file was deleted, moved, replaced or cut off, or a pipe never read."""
        self._last_of_port: dict[str, int] = {}
        self._metadata: list[Metadata] = []
        self._output, target = _open_output(path, existing)
        self._closed = False
        try:
            self._file = RecordingFile(target, ports, facts or {})
            self._output.commit()
        except OSError as error:
            self._output.discard()
            raise unwritable(path, error) from error
        self.path = self._output.path
        """The file's name."""
        self.waits_for_reader = self._output.waits_for_reader
        """Whether the file is a named pipe that nobody had opened for reading at the start."""

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._file.mcap.size

    @property
    def index_length(self) -> int:
        """Bytes of the index after the data, which each flush writes again."""
        return self._file.mcap.index_length

    @property
    def unflushed(self) -> Rows:
        """The rows and events that are not in the file."""
        return Rows.concat([one.rows for one in self._pending])

    def write(self, rows: Rows) -> None:
        """Write rows, each port's in the order of its stream, and events; `flush` stores them.

        Raises FileError if a row has no time that a recording can hold, or writing failed.
        """
        self._check()
        _check_times(rows)
        if len(rows) or rows.events:
            self._append(rows)

    def write_metadata(self, metadata: Metadata) -> None:
        """Write one more metadata record; `flush` stores it."""
        self._metadata.append(metadata)

    def flush(self) -> None:
        """End the chunk and push it to the disk. A kill costs the rows since the last flush.

        Raises FileError if the disk is full or failed; or the file was deleted, moved, replaced or
        cut off by another program.
        """
        self._check()
        try:
            if self._pending:
                known = self._file.early_record()
                batch = self._batch()
                self._metadata += [] if known else self._file.early_record()
                self._file.mcap.write_batch(batch, self._metadata)
            else:
                self._file.mcap.write_metadata(self._metadata)
            self.flushed_events += sum(len(one.rows.events) for one in self._pending)
            self.flushed_rows = self.rows
            self._pending, self._metadata = [], []
            self._output.check()
        except OSError as error:
            raise self._stop(error) from error

    def close(self) -> None:
        """Flush, and close the file. Closing again, or after a failure, does nothing.

        Raises FileError if the last flush failed; the file is closed all the same.
        """
        if self._closed:
            return
        try:
            try:
                if self.failure is None:
                    self.flush()
                    self._file.mcap.close()
            finally:
                self._closed = True
                self.identity = self._output.identity
                self._output.close()  # some network file systems report write errors only now
        except OSError as error:
            raise self._stop(error) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def _check(self) -> None:
        if self.failure is not None:
            raise self.failure
        if self._closed:
            raise ValueError(f"{self.path} is closed already")

    def _stop(self, error: OSError) -> FileError:
        self.is_gone = isinstance(error, LostDataError)
        self.failure = stopped_by_error(self.path, error, self.flushed_rows)
        return self.failure

    def _append(self, rows: Rows) -> None:
        floors = self._last_of_port
        keys = [(max(one.t_ns, floors.get(one.port, 0)), at) for at, one in enumerate(rows.events)]
        keys.sort()
        rows = rows.with_columns(events=[rows.events[at] for _, at in keys])
        events = np.array([t_ns for t_ns, _ in keys], np.int64)
        times = rows.t_ns.copy()
        for code in rows.counts("port"):
            port, own = rows.codebook.ports[code], rows.port == code
            times[own] = np.maximum.accumulate(np.maximum(times[own], floors.get(port, 0)))
            floors[port] = int(times[own][-1])
        known = [] if self.span_ns is None else [self.span_ns]
        spans = np.concatenate([times, events, *known])
        self.span_ns = int(spans.min()), int(spans.max())
        self.rows += len(rows)
        for event, t_ns in zip(rows.events, events.tolist(), strict=True):
            floors[event.port] = max(t_ns, floors.get(event.port, 0))
        self._pending.append(_Pending(rows, *among(times, events)))

    def _batch(self) -> McapBatch:
        """The messages of all that is pending, sorted by time."""
        rows = Rows.concat([one.rows for one in self._pending])
        times = np.concatenate([one.times for one in self._pending])
        is_event = np.concatenate([one.is_event for one in self._pending])
        order = times.argsort(kind="stable")
        number = np.where(is_event, np.cumsum(is_event), np.cumsum(~is_event))[order] - 1
        is_event = is_event[order]
        events = tuple(rows.events[at] for at in number[is_event].tolist())
        rows = rows.select(number[~is_event], events)
        return self._file.messages(rows, times[order], np.flatnonzero(is_event))


def _open_output(path: Path, existing: Existing) -> tuple[OutputPath | StreamOutput, AppendTarget]:
    """Open the output of a recording, and the target of its bytes.

    Raises FileError as `OutputPath` and `StreamOutput`.
    """
    if is_stream(path):
        stream = StreamOutput(path)
        return stream, stream.target
    output = OutputPath(path, existing)
    return output, AppendFile(output.descriptor)


@dataclass(frozen=True, slots=True)
class _Pending:
    """Rows and events that wait for the end of their chunk, and the times that sort them."""

    rows: Rows
    times: Ints
    """Of rows and events, in their order."""
    is_event: Bools


def among(times: Ints, event_times: Ints) -> tuple[Ints, Bools]:
    """The times of rows and events, each event before the first later row; which are events."""
    at = np.searchsorted(np.maximum.accumulate(times), event_times, "right")
    return np.insert(times, at, event_times), np.insert(np.zeros(len(times), np.bool_), at, True)


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
        """Create the file; or take the descriptor of an empty one, which is not closed.

        Rows of other ports are accepted too. `facts` are further items of the file's first metadata
        record. Raises OSError if the file cannot be created or written.
        """
        keep_freed_memory()
        self._waiting: list[Rows] = []
        self._waiting_rows = 0
        known = {port.name: port for port in ports}
        if isinstance(path, int):
            self._descriptor = os.dup(path)
        else:
            self._descriptor = os.open(path, open_flags("O_WRONLY", "O_CREAT", "O_TRUNC"), 0o666)
        try:
            self._file = RecordingFile(Stream(self._descriptor), list(known.values()), facts or {})
        except OSError:
            os.close(self._descriptor)
            raise
        self._threads = ThreadPoolExecutor(cores(), "compresses chunks")
        self._under_way: deque[Future[PackedChunk]] = deque()
        self._closed = False

    def write(self, batch: Rows) -> None:
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
        further = [Metadata(name, encodable_items(facts)) for name, facts in metadata]
        self._file.mcap.write_metadata([*further, *self._file.early_record()])
        self._file.mcap.close()
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
            batch = Rows.concat(self._waiting)
            self._waiting, self._waiting_rows = [], 0
            for chunk in _chunks(batch):
                event_times = np.array([event.t_ns for event in chunk.events], np.int64)
                times, is_event = among(chunk.t_ns, event_times)
                messages = self._file.messages(chunk, times, np.flatnonzero(is_event))
                while len(self._under_way) > cores():
                    self._write_first()
                definitions = self._file.mcap.next_definitions()
                self._under_way.append(self._threads.submit(packed, definitions, messages))

    def _write_first(self) -> None:
        self._file.mcap.write_chunk(self._under_way.popleft().result())


def _check_times(rows: Rows) -> None:
    untimed = np.flatnonzero(rows.t_ns < 0)
    if len(untimed):
        row = rows[int(untimed[0])]
        raise FileError(
            f"{row.port!r}, offset {row.offset}, has no time since 1970, and a recording needs one;"
            " write another format"
        )


def _chunks(rows: Rows) -> Iterator[Rows]:
    """The rows of each chunk, with the events until its last row."""
    events = sorted(rows.events, key=lambda event: event.t_ns)
    for start in range(0, max(len(rows), 1), CHUNK_ROWS):
        stop = start + CHUNK_ROWS
        end_ns = 2**63 if stop >= len(rows) else int(rows.t_ns[stop - 1])
        own = tuple(event for event in events if event.t_ns <= end_ns)
        events = events[len(own) :]
        yield rows.select(slice(start, stop), own)
