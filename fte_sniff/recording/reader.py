"""RecordingReader: read one recording; and the recordings that paths name.

A file may be truncated, damaged or written by another program. Everything readable is read;
`ending` and `losses` report the rest. A chunk counts only if its checksum is right, an index only
where the chunk agrees with it.

`AppendFile` overwrites only the tail of a file: the records before it never change. So a file that
another program writes is read up to its last complete record, and the next pass begins there:

    pass 1   magic, head, chunk, indexes | tail
    pass 2                                 chunk, indexes | tail
    last                                                    chunk, indexes, tail

Only the last pass, after the end of the writer, reads the tail and reports what is damaged there.
"""

from __future__ import annotations

import os
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from os import PathLike
from pathlib import Path
from shlex import quote
from shutil import copyfileobj
from tempfile import NamedTemporaryFile
from typing import IO, BinaryIO, TypeAlias
from weakref import finalize

from mcap.opcode import Opcode
from mcap.records import Channel, Header, Metadata, Statistics

from fte_sniff.errors import FileError, TranslatableText, listed, unreadable
from fte_sniff.platform import read_at
from fte_sniff.protocol import Gap, Row, iso_time
from fte_sniff.protocol.rows import Codebook, Rows
from fte_sniff.recording.file_lock import is_locked
from fte_sniff.recording.mcap.reader import (
    LostBytes,
    RawRecord,
    RecordStream,
    Summary,
    read_summary,
)
from fte_sniff.recording.mcap.records import (
    HEAD,
    LARGEST,
    MAGIC,
    RecordError,
    claimed,
    parse,
    records_in,
    unpack,
)
from fte_sniff.recording.messages.decode import Losses
from fte_sniff.recording.messages.definitions import (
    NOTHING,
    ChannelReaders,
    Definitions,
    LostDefinitions,
    lost_definitions,
)
from fte_sniff.recording.messages.schema import TOPIC_BY_NAME
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
from fte_sniff.recording.reading_pass import EVERYTHING, ReadingPass, RowRange, TimeRange

_BUFFER = 128 * 1024
"""Bytes read ahead: enough for the message indexes between two chunks."""
_HEAD_ENDS = frozenset({Opcode.CHUNK, Opcode.MESSAGE, Opcode.DATA_END, Opcode.FOOTER})
_MOST_TOPICS = 10
_SEQUENCES = 2**32

_DEFINITIONS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL})
"""Records that can belong to the data or to the tail."""
_DATA = _DEFINITIONS | {
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
        self.lost_messages: int | None = None
        """Messages that the last pass did not read, by the file's statistics; None if unknown."""
        self.least_lost_messages = 0
        """Lost messages by the gaps in the sequence numbers, without a trusted summary."""
        self.unreadable = 0
        """Messages that the last pass found and could not read."""
        self.chunks = 0
        """Chunks that the last pass read."""
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
                for record in records:
                    if record.opcode == Opcode.METADATA:
                        with suppress(RecordError):
                            self._all_metadata.append(parse(Metadata, record.body))
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
        for record in RecordStream(stream, self._summary, chunks=False, stop=self._complete):
            if record.opcode == Opcode.METADATA:
                self._read_metadata(record.body)
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
                if opcode == Opcode.METADATA:
                    self._read_metadata(body)
            position = stop
            if opcode not in _DEFINITIONS:
                complete = position
        edge = self._edge_of(stream, complete)
        if self._is_followed:
            # Last: if the file is overwritten at any moment, this or the next check sees it.
            self._check(stream)
        self._complete, self._edge = complete, edge

    def _read_metadata(self, body: bytes) -> None:
        with suppress(RecordError):
            self.all_metadata.append(parse(Metadata, body))

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
        self.least_lost_messages = skipped + found.unreadable
        self.unreadable, self.chunks = found.unreadable, found.chunks
        if count is None:
            return
        missing = count - found.messages
        self.lost_messages = self.least_lost_messages = max(0, missing + found.unreadable)
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
_LATEST = 2**64


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


def start_of(reader: RecordingReader) -> tuple[int, str]:
    """The sort key of recordings: their first time, then their name."""
    return reader.times[0] if reader.times else _LATEST, str(reader.path)


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
