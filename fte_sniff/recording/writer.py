"""Writers of one recording.

While a capture runs, the file ends without a summary, which is legal: tools scan it. Each step
leads from one valid file to the next, also where it is half done, and `close` adds the summary:

    1   data | end |                    | end |      a second end, behind the offset of the new data
    2   data | 80 length . chunk . end  | end |      a private record, which readers skip
    3   data | chunk             | end  | end |      its first nine bytes become those of the chunk
    4   data | chunk             | end |             the second end is cut off

Log times never fall. Rows of several ports come a little out of order, so a chunk is sorted by
time, each port in the order of its stream: a message's log time is its row's time. If a row comes
after its chunk, or its port's clock fell back, the log time is raised to the last one written; the
message then has the row's own time too.
"""

from __future__ import annotations

import os
import struct
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, Self, TypeAlias

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from zlib_ng.zlib_ng import crc32

from fte_sniff.errors import FileError, encodable, reason_of
from fte_sniff.platform import sync_data, write_at
from fte_sniff.protocol.items import PortEvent
from fte_sniff.protocol.rows import NO_KIND, NO_TIME, Array, Ints, Rows
from fte_sniff.recording.chunks import HEAD, MAGIC
from fte_sniff.recording.metadata import PROGRAM, PortFacts, library_name, recording_facts
from fte_sniff.recording.output_file import (
    STOPPED,
    Existing,
    LostDataError,
    OutputFile,
    created,
)
from fte_sniff.recording.schema import (
    EVENTS,
    MALFORMED,
    TOPICS,
    channel_ids,
    channels_of,
    encode,
    schemas,
    topics_of,
)
from fte_sniff.recording.skeletons import (
    MESSAGE,
    MESSAGE_HEAD,
    Template,
    at_every_byte,
    groups_of,
)

MOST_ROWS: Final = 16_384
"""Rows of a chunk, at most."""

MOST_PORTS: Final = 0xFFFF // len(TOPICS)
"""Ports of a file, at most: a channel's number has 16 bits, and a port has one for each topic."""

Entry: TypeAlias = Rows | PortEvent
"""What is written."""

_PRIVATE: Final = 0x80


def bytes_of(*records: McapRecord) -> bytes:
    """The bytes of MCAP records."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


END: Final = bytes_of(DataEnd(0), Footer(0, 0, 0)) + MAGIC
"""What a file ends with while it grows."""


class AppendFile:
    """A file that is a valid MCAP file after, and during, each of its writes.

    A power cut can damage what came since the last write that waited for the disk; the end of this
    program cannot.
    """

    def __init__(self, output: OutputFile, head: bytes, tail: bytes) -> None:
        """Begin an empty file, which the caller closes; raises OSError."""
        self._output = output
        self.end = len(head)
        """Where the next data begins."""
        self._tail = tail
        """The bytes behind it, which the next data overwrites: the end of the file."""
        self._write(head + tail, 0)
        self._sync()

    def append(self, data: bytes, tail: bytes, *, waits: bool = True) -> None:
        """Write data and a new tail.

        Raises LostDataError if another program took the file; or another OSError, and the file has
        its old tail then.
        """
        start, size, new = self.end, self.end + len(self._tail), data + tail
        after = max(start + len(new), size)
        # Zeros replace the rest of a longer tail: a reader would report it as foreign bytes.
        private = HEAD.pack(_PRIVATE, after - start - HEAD.size) + new[HEAD.size :]
        self._output.check(size)
        try:
            self._write(self._tail, after)
            self._settle(after + len(self._tail), waits=waits)
            self._write(private.ljust(after - start, b"\0"), start)
            self._settle(after + len(self._tail), waits=waits)
            self._write(new[: HEAD.size], start)
            os.ftruncate(self._output.descriptor, start + len(new))
            self._settle(start + len(new), waits=waits)
        except LostDataError:
            raise
        except OSError:
            self._write(self._tail, start)
            os.ftruncate(self._output.descriptor, size)
            raise
        self.end, self._tail = start + len(data), tail

    def _settle(self, least: int, *, waits: bool) -> None:
        """Wait for the disk; if another program cut off the file meanwhile, raise LostDataError.

        The next write would fill what is missing with zeros.
        """
        if waits:
            self._sync()
        self._output.check(least)

    def _sync(self) -> None:
        sync_data(self._output.descriptor)
        self.is_synced = True

    def _write(self, data: bytes, offset: int) -> None:
        view, self.is_synced = memoryview(data), False
        while view:
            written = write_at(self._output.descriptor, view, offset)
            view, offset = view[written:], offset + written


class Encoder:
    """Rows and port events to the bytes of a recording, in the order of the file."""

    def __init__(self, ports: Sequence[PortFacts], facts: Mapping[str, str]) -> None:
        """Take the ports whose rows will come, and further items for the file's metadata.

        Of more than `MOST_PORTS`, each is defined with its first row or event.
        """
        ports = ports if len(ports) <= MOST_PORTS else []
        self._ports: dict[str, int] = {}
        self._schemas = schemas()
        self._defined: list[Channel] = []
        self._pending: list[Schema | Channel] = [*self._schemas]
        """The schemas and channels that no chunk defines yet."""
        for port in ports:
            self._define(port)
        self._templates: dict[int, Template] = {}
        self._counts = Counter[int]()
        """Messages by channel."""
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self.times: tuple[int, int] | None = None
        """The first and the last log time, nanoseconds since 1970 UTC."""
        own = Metadata(PROGRAM, recording_facts(ports, facts))
        head = MAGIC + bytes_of(Header("", library_name()))
        self.head = head + self.metadata(own, len(head))
        """The first bytes of the file."""

    @property
    def tail(self) -> bytes:
        """The end of the file while it grows; until the first chunk it has the definitions."""
        return bytes_of(*self._pending) + END

    def metadata(self, record: Metadata, at: int) -> bytes:
        """The bytes of a metadata record at an offset of the file."""
        items = {encodable(name): encodable(value) for name, value in record.metadata.items()}
        data = bytes_of(Metadata(record.name, items))
        self._metadata.append(MetadataIndex(at, len(data), record.name))
        return data

    def chunk(self, entries: Sequence[Entry], at: int) -> bytes:
        """A chunk of rows and events, one at least, at an offset of the file.

        Raises ValueError if a row has no time, and FileError if there are too many ports.
        """
        rows = Rows.concat([one for one in entries if isinstance(one, Rows)])
        events = [one for one in entries if isinstance(one, PortEvent)]
        if (rows.t_ns < 0).any():
            raise ValueError("each row of a recording must have a time")
        for name in (*rows.used_ports, *(event.port for event in events)):
            self._define(PortFacts(name))
        definitions, self._pending = bytes_of(*self._pending), []
        order, times = self._in_order(rows, events)
        channels = self._channels_of(rows, events)[order]
        data, starts = self._records(rows, events, order, times, channels)
        data, first, last = definitions + data, int(times[0]), int(times[-1])
        self.times = (self.times[0] if self.times else first), last
        packed = zstandard.ZstdCompressor(level=-1).compress(data)
        record = bytes_of(Chunk("zstd", packed, last, first, crc32(data), len(data)))
        indexes, offsets = _message_indexes(channels, times, starts + len(definitions))
        offsets = {channel: at + len(record) + offset for channel, offset in offsets.items()}
        sizes = len(indexes), offsets, first, len(data)
        self._chunks.append(ChunkIndex(len(record), at, "zstd", len(packed), last, *sizes))
        return record + indexes

    def summary(self, at: int) -> bytes:
        """The end of the file, with its summary, at an offset."""
        # A file without a chunk has its definitions here.
        data_end = bytes_of(*self._pending, DataEnd(0))
        start = at + len(data_end)
        first, last = self.times or (0, 0)
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._defined),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=self._counts.total(),
            message_end_time=last,
            message_start_time=first,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        definitions = bytes_of(*self._schemas, *self._defined)
        summary = definitions + bytes_of(statistics, *self._chunks, *self._metadata)
        crc = crc32(struct.pack("<BQQQ", Opcode.FOOTER, 20, start, 0), crc32(summary))
        return data_end + summary + bytes_of(Footer(start, 0, crc)) + MAGIC

    def _define(self, port: PortFacts) -> None:
        """Give a port its channels, if it has none yet; raises FileError at too many ports."""
        if port.name in self._ports:
            return
        if len(self._ports) == MOST_PORTS:
            form = "a recording has at most {most:,} ports; decode some with --filter"
            raise FileError(form, most=MOST_PORTS)
        number = self._ports[port.name] = len(self._ports)
        new = channels_of(number, port)
        self._defined += new
        self._pending += new

    def _in_order(self, rows: Rows, events: Sequence[PortEvent]) -> tuple[Ints, Ints]:
        """The entries (rows, then events) in the order of time, and their log times."""
        rising = np.empty(len(rows), np.int64)
        for code in np.unique(rows.port):
            own = rows.port == code
            rising[own] = np.maximum.accumulate(rows.t_ns[own])
        times = np.concatenate([rising, np.array([one.t_ns for one in events], np.int64)])
        order = np.argsort(times, kind="stable")
        least = self.times[1] if self.times else 0
        return order, np.maximum(times[order], least)

    def _channels_of(self, rows: Rows, events: Sequence[PortEvent]) -> Ints:
        # A port without rows need not have a number.
        firsts = np.array([channel_ids(self._ports.get(one, 0))[0] for one in rows.ports], np.int64)
        of_events = [channel_ids(self._ports[one.port])[TOPICS.index(EVENTS)] for one in events]
        return np.append(firsts[rows.port] + topics_of(rows), of_events).astype(int)

    def _groups(
        self, rows: Rows, events: Sequence[PortEvent], log_times: Ints
    ) -> list[tuple[Ints, Array]]:
        """The messages of equal length: the numbers of their entries, and opaque values."""
        found: list[tuple[Ints, Array]] = []
        keys = _keys_of(rows, log_times[: len(rows)])
        for own in groups_of(keys):
            first = int(own[0])
            key = int(keys[first])
            if key not in self._templates:
                self._templates[key] = Template(rows[first], int(log_times[first]))
            found.append((own, self._templates[key].encode(rows, own)))
        for number, event in enumerate(events, len(rows)):
            message = encode(event, int(log_times[number]))
            found.append((np.array([number]), np.array([np.void(message)])))
        return found

    def _records(
        self, rows: Rows, events: Sequence[PortEvent], order: Ints, times: Ints, channels: Ints
    ) -> tuple[bytes, Ints]:
        """The message records in their order, and their starts."""
        places = np.empty_like(order)
        places[order] = np.arange(len(order))
        messages = self._groups(rows, events, times[places])
        lengths = np.empty(len(times), np.int64)
        for own, values in messages:
            lengths[places[own]] = MESSAGE_HEAD + values.itemsize
        stops = np.cumsum(lengths)
        starts, data = stops - lengths, np.empty(int(stops[-1]), np.uint8)
        heads = np.zeros(len(times), MESSAGE)  # sequence 0: not numbered
        heads["opcode"], heads["length"] = Opcode.MESSAGE, lengths - HEAD.size
        heads["channel"] = channels
        heads["log"] = heads["publish"] = times
        self._counts += Counter(dict(enumerate(np.bincount(channels).tolist())))
        at_every_byte(data, MESSAGE_HEAD)[starts] = heads.view(f"V{MESSAGE_HEAD}")
        for own, values in messages:
            at_every_byte(data, values.itemsize)[starts[places[own]] + MESSAGE_HEAD] = values
        return data.tobytes(), starts


def _message_indexes(channels: Ints, times: Ints, starts: Ints) -> tuple[bytes, dict[int, int]]:
    """The index of the messages of each channel, and where it begins among them."""
    entries = np.empty((len(times), 2), "<u8")
    entries[:, 0], entries[:, 1] = times, starts
    indexes, offsets = bytearray(), dict[int, int]()
    for own in groups_of(channels.astype(np.uint16)):
        channel, body = int(channels[own[0]]), entries[own].tobytes()
        offsets[channel] = len(indexes)
        indexes += HEAD.pack(Opcode.MESSAGE_INDEX, len(body) + 6)
        indexes += struct.pack("<HI", channel, len(body)) + body
    return bytes(indexes), offsets


def _keys_of(rows: Rows, log_times: Ints) -> Ints:
    """A number of each row; rows with the same number have the same template."""
    keys: Ints = (topics_of(rows) == TOPICS.index(MALFORMED)).astype(np.int64)
    columns: Iterable[tuple[Array, int]] = (
        (rows.kinds, NO_KIND.bit_length()),
        (rows.faults, 16),
        (rows.length, 5),
        (rows.framed, 1),
        (rows.unordered, 1),
        (rows.delay_ns == NO_TIME, 1),
        (rows.t_ns != log_times, 1),
    )
    for values, bits in columns:
        keys = keys << bits | values
    return keys


class RecordingWriter:
    """Writes a recording while it is captured; rows reach the file with `flush`.

    When a write fails, the file has what was flushed before. It stays locked until `close`, so that
    those who follow it wait for what its capture does next.
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
            path: the file.
            ports: the ports whose rows will come; rows of others are accepted too.
            facts: further items for the file's metadata, e.g. `host_facts(now)`.
            existing: what to do if the file exists.

        Raises FileError if the file exists, another program records to it, its folder does not
        exist, or the system refuses it. The disk is unchanged then.
        """
        self.is_gone = False
        """Whether the file was deleted, moved, replaced or cut off."""
        self._is_final = False
        """Whether nothing more is written: after an error, or the summary."""
        self.unflushed: list[Entry] = []
        self.flushed_rows = 0
        """Rows in the file."""
        self.span_ns: tuple[int, int] | None = None
        """First and last log time in the file; None without any."""
        self._encoder = Encoder(ports, facts or {})
        with created(path, existing) as self.output:
            self._file = AppendFile(self.output, self._encoder.head, self._encoder.tail)
        self.path = self.output.path
        """The file's name."""

    @property
    def size(self) -> int:
        """Bytes in the file, without its end."""
        return self._file.end

    def write(self, *entries: Entry) -> None:
        """Write rows and port events; `flush` stores them."""
        self.unflushed += [one for one in entries if isinstance(one, PortEvent) or len(one)]

    def write_metadata(self, record: Metadata) -> None:
        """Write one more metadata record; raises as `flush`."""
        self._append(self._encoder.metadata(record, self._file.end))

    def flush(self, *, waits: bool = True) -> None:
        """Write a chunk of all that is pending; after a FileError, only `close`.

        With `waits`, the disk has it then, and all that came before.
        """
        if self.unflushed:
            chunk = self._encoder.chunk(self.unflushed, self._file.end)
            self._append(chunk, waits=waits)
            self.flushed_rows += row_count(self.unflushed)
            self.unflushed = []
            self.span_ns = self._encoder.times
        elif waits and not self._file.is_synced:
            self._append(b"")

    def close(self) -> None:
        """Flush, write the summary, and close; after an error, or again, only close.

        Raises FileError, and the file is closed then.
        """
        try:
            if not self._is_final:
                self.flush()
                self._append(b"", self._encoder.summary(self._file.end))
        finally:
            self._is_final = True
            self.output.close()

    def stopped_by(self, error: OSError) -> FileError:
        """The error, with its cause, of a recording that the system does not let go on."""
        form = STOPPED[LostDataError if isinstance(error, LostDataError) else OSError]
        reason = reason_of(error)
        found = FileError(form, path=self.path, rows=self.flushed_rows, reason=reason)
        found.__cause__ = error
        return found

    def _append(self, data: bytes, tail: bytes | None = None, *, waits: bool = True) -> None:
        try:
            self._file.append(data, tail or self._encoder.tail, waits=waits)
        except OSError as error:
            self._is_final, self.is_gone = True, isinstance(error, LostDataError)
            raise self.stopped_by(error) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()


class BulkWriter:
    """Writes a recording in sequence, for example to a pipe: valid once it is closed."""

    def __init__(
        self, descriptor: int, ports: Sequence[PortFacts], facts: Mapping[str, str] | None = None
    ) -> None:
        """Write the head to an open descriptor, which is not closed; raises OSError."""
        self._descriptor, self._encoder = descriptor, Encoder(ports, facts or {})
        self._pending: list[Entry] = []
        self._size = 0
        self._append(self._encoder.head)

    def write(self, *entries: Entry) -> None:
        """Write rows and port events; raises OSError."""
        for portion in portions(entries):
            self._pending.append(portion)
            if row_count(self._pending) >= MOST_ROWS:
                self.flush()

    def flush(self) -> None:
        """Write a chunk of all that is pending; raises OSError."""
        if self._pending:
            self._append(self._encoder.chunk(self._pending, self._size))
            self._pending = []

    def close(self, metadata: Iterable[Metadata] = ()) -> None:
        """Write the rest, these metadata records, and the summary; raises OSError."""
        self.flush()
        for record in metadata:
            self._append(self._encoder.metadata(record, self._size))
        self._append(self._encoder.summary(self._size))

    def _append(self, data: bytes) -> None:
        self._size += len(data)
        view = memoryview(data)
        while view:
            view = view[os.write(self._descriptor, view) :]


def row_count(entries: Iterable[Entry]) -> int:
    """The number of rows in entries."""
    return sum(len(one) for one in entries if isinstance(one, Rows))


def portions(entries: Iterable[Entry]) -> Iterator[Entry]:
    """The entries, rows in portions of `MOST_ROWS` at most."""
    for entry in entries:
        if isinstance(entry, PortEvent):
            yield entry
            continue
        for start in range(0, len(entry), MOST_ROWS):
            yield entry[start : start + MOST_ROWS]
