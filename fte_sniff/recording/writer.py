"""RecordingWriter: rows to one file.

Rows of several ports arrive a little out of order, a read at a time. They are kept until the chunk
ends and put in order of time then, so a message's log time is its row's time. Only where a row
comes later than its chunk, or its port's clock fell back, is the log time raised to what was
written last; the message then tells the row's own time too, so nothing is lost. The rows of one
port are never put in another order than they came in.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from mcap.records import Metadata

from fte_sniff.errors import FileError, unwritable
from fte_sniff.protocol import PortEvent, Row
from fte_sniff.recording.mcap.writer import McapBatch, McapFile
from fte_sniff.recording.messages.codec import plain
from fte_sniff.recording.messages.packer import Channels, ColumnPacker
from fte_sniff.recording.messages.schema import Topic
from fte_sniff.recording.metadata import PROGRAM, PortFacts, library_name, recording_facts
from fte_sniff.recording.output_file import Existing, opened, stopped, taken_away

METADATA_NAME = PROGRAM
"""The name of the file's metadata record."""

MOST_PENDING = 16_384
"""Rows that wait for the end of their chunk at most; then the chunk ends by itself."""

_LAST_TIME = 2**63 - 1


class RecordingWriter:
    """Writes one recording.

    What is written stands in the file after `flush`, and stays there whatever happens afterwards:
    the file is complete between any two flushes. Once a write has failed the recording has
    stopped: that call and every later one raise the same FileError, and the file holds what was
    flushed before.
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
            path: the file; nothing but a regular file is ever replaced, and that only when the
                new one has its head. `-`, a pipe or a device is written in sequence.
            ports: the ports whose rows will come; rows of others are taken too.
            facts: what else the file is to say about itself, e.g. `host_facts(now)`.
            existing: what to do if the file is there already.

        Raises:
            FileError: the file exists, another program records to it, its folder does not exist,
                or the system refuses it. Nothing has changed on the disk then.
        """
        self._failure: FileError | None = None
        self._gone = False
        self._pending: list[tuple[int, Row | PortEvent]] = []
        self._rows = self._flushed_rows = 0
        self._span: tuple[int, int] | None = None
        self._last_of_port: dict[str, int] = {}
        self._last_time = 0
        self._packer = ColumnPacker(self._channel_id)
        self._channels = Channels()
        channels = [channel for port in ports for channel in self._channels.of_port(port)]
        self._notes: list[Metadata] = []
        self._place, growing = opened(path, existing)
        self._closed = False
        try:
            self._file = McapFile(
                growing,
                library_name(),
                Metadata(METADATA_NAME, _plain_items(recording_facts(tuple(ports), facts or {}))),
                self._channels.schemas(),
                channels,
            )
            self._place.settle()
        except OSError as error:
            self._place.discard()
            raise unwritable(path, error) from error

    @property
    def path(self) -> Path:
        """Where the recording lies."""
        return self._place.path

    @property
    def rows(self) -> int:
        """Rows taken so far, flushed or not."""
        return self._rows

    @property
    def flushed_rows(self) -> int:
        """Rows that stand in the file."""
        return self._flushed_rows

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._file.size

    @property
    def index_length(self) -> int:
        """Bytes of the index behind the data, which each flush writes anew."""
        return self._file.index_length

    @property
    def unflushed(self) -> list[Row | PortEvent]:
        """What was taken and does not stand in the file; all that was, after a failure."""
        return [taken for _, taken in self._pending]

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """First and last time of what was taken, nanoseconds since 1970 UTC; None before that."""
        return self._span

    @property
    def gone(self) -> bool:
        """Whether the file was taken away, with all that stands in it."""
        return self._gone

    @property
    def failure(self) -> FileError | None:
        """Why the recording has stopped; None while it goes on."""
        return self._failure

    def write(self, entries: Iterable[Row | PortEvent]) -> None:
        """Take rows, each port's in the order of its stream, and events among them.

        They are in the file after `flush`.

        Raises:
            FileError: one has no time that a recording can hold, or writing failed.
        """
        self._check()
        coming = iter(entries)
        try:
            for entry in coming:
                self._take(entry)
                if len(self._pending) >= MOST_PENDING:
                    self.flush()
        finally:
            if self._failure is not None:
                # Not one of them is forgotten: whoever goes on elsewhere asks for `unflushed`.
                self._pending += [(entry.t_ns or 0, entry) for entry in coming]

    def write_event(self, event: PortEvent) -> None:
        """Take one port event, as `write` does."""
        self.write([event])

    def note(self, metadata: Metadata) -> None:
        """Take one more metadata record; it is in the file after the next chunk, or the end."""
        self._notes.append(metadata)

    def flush(self) -> None:
        """End the chunk and push it to the disk. Call it at least once a second.

        Raises:
            FileError: the disk is full or failed, and what was flushed before is in the file; or
                the file was deleted or moved away.
        """
        self._check()
        if self._pending:
            self._pending.sort(key=_time_of)
            try:
                self._file.write_batch(self._batch(self._pending), self._notes)
            except OSError as error:
                raise self._stop(error) from error
            self._pending, self._notes = [], []
            self._flushed_rows = self._rows
        try:
            left, deleted = self._place.left, self._place.deleted
        except OSError as error:
            raise self._stop(error) from error
        if left:
            self._gone = True
            self._failure = taken_away(self.path, self._flushed_rows, deleted=deleted)
            raise self._failure

    def close(self) -> None:
        """Flush, and close the file. Closing again, or after a failure, does nothing.

        Raises:
            FileError: the last flush failed; the file is closed all the same.
        """
        if self._closed:
            return
        try:
            if self._failure is None:
                self.flush()
                self._file.write_metadata(self._notes)
                self._file.close()
        except OSError as error:
            raise self._stop(error) from error
        finally:
            self._closed = True
            self._let_go()

    def _let_go(self) -> None:
        try:
            self._place.close()
        except OSError as error:  # some network file systems tell only now what they could not keep
            raise self._stop(error) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _check(self) -> None:
        if self._failure is not None:
            raise self._failure
        if self._closed:
            raise ValueError(f"{self.path} is closed already")

    def _stop(self, error: OSError) -> FileError:
        self._failure = stopped(self.path, error, self._flushed_rows)
        return self._failure

    def _take(self, taken: Row | PortEvent) -> None:
        time, port = taken.t_ns, taken.port
        if time is None or not 0 <= time <= _LAST_TIME:
            where = taken.kind if isinstance(taken, PortEvent) else f"offset {taken.offset}"
            raise FileError(
                f"{self.path} cannot hold {plain(port)!r}, {where}: it has no time since 1970, "
                "and a recording needs one; write another format"
            )
        last = self._last_of_port.get(port, 0)
        if time < last:
            time = last
        else:
            self._last_of_port[port] = time
        self._rows += type(taken) is not PortEvent
        first, last = self._span or (time, time)
        self._span = (min(first, time), max(last, time))
        self._pending.append((time, taken))

    def _batch(self, pending: list[tuple[int, Row | PortEvent]]) -> McapBatch:
        own = np.array([time for time, _ in pending], np.int64)
        times = np.maximum(own, self._last_time)
        self._last_time = int(times[-1])
        return self._packer.pack_entries([taken for _, taken in pending], times)

    def _channel_id(self, port: str, topic: Topic) -> int:
        for channel in self._channels.of_port(PortFacts(port)):
            self._file.add_channel(channel)
        return self._channels.id_of(port, topic)


def _time_of(waiting: tuple[int, Row | PortEvent]) -> int:
    return waiting[0]


def _plain_items(facts: Mapping[str, str]) -> dict[str, str]:
    return {plain(key): plain(value) for key, value in facts.items()}
