"""RecordingReader: public reading interface, several files.

A file may be cut, damaged or written by another program. What can be read is read; what cannot is
told by `ending` and `losses`, and never made up: a chunk counts only if its checksum holds.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from shlex import quote
from shutil import copyfileobj
from tempfile import NamedTemporaryFile
from typing import IO, BinaryIO
from weakref import finalize

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata

from fte_sniff.errors import FileError, TranslatableText, unreadable
from fte_sniff.protocol import Gap, PortEvent, Row
from fte_sniff.recording.mcap.reader import RawRecord, RecordStream, Summary, read_summary
from fte_sniff.recording.mcap.records import MAGIC, RecordError, parse, records_in
from fte_sniff.recording.mcap.salvage import next_chunk
from fte_sniff.recording.messages.schema import TOPIC_BY_NAME
from fte_sniff.recording.metadata import PortFacts, Selection, gap_from_metadata, selection_of
from fte_sniff.recording.parallel import ParallelReading
from fte_sniff.recording.row_ranges import EVERYTHING, Definitions, RecordScan, RowRange, TimeRange
from fte_sniff.recording.sequential import SequentialReading, without_our_topics
from fte_sniff.row_batch import Codebook, RowBatch

_MOST_BAUD_DIGITS = 9
_BUFFER = 128 * 1024
"""Bytes read ahead: enough for the message indexes between two chunks."""
_HEAD_ENDS = frozenset({Opcode.CHUNK, Opcode.MESSAGE, Opcode.DATA_END, Opcode.FOOTER})


class RecordingReader:
    """Reads one recording; iterate it for its rows, as often as wanted.

    `ending` and `losses` tell of the last iteration that came to its end.
    """

    def __init__(self, path: Path) -> None:
        """Look at the file: that it is an MCAP, and what its head and summary tell.

        Raises:
            FileError: the file cannot be read, is empty, no MCAP, or has none of our topics.
        """
        self._path = path
        self._channels: dict[int, Channel] = {}
        self._metadata: dict[str, dict[str, str]] = {}
        self._summary: Summary | None = None
        self._noted: list[Metadata] | None = None
        self._ending = ""
        self._losses: tuple[str, ...] = ()
        self._times: tuple[int, int] | None = None
        self._route = RecordScan()
        self._copy: IO[bytes] | None = None
        self._copy = self._copy_of_pipe()
        with self._open() as stream:
            self._identity = _identity(stream)
            self._look(stream)

    @property
    def path(self) -> Path:
        """Where the recording lies."""
        return self._path

    @property
    def ports(self) -> tuple[PortFacts, ...]:
        """The ports that the file names before its rows are read, each once."""
        found = {}
        for channel in self._channels.values():
            if channel.topic in TOPIC_BY_NAME:
                facts = self._port_of(channel)
                found[facts.name] = facts
        return tuple(found.values())

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """The metadata records by name, as far as they stand before the first row."""
        return self._metadata

    @property
    def times(self) -> tuple[int, int] | None:
        """First and last log time, nanoseconds since 1970 UTC; None where the file cannot tell."""
        return self._times

    @property
    def count(self) -> int | None:
        """How many messages the summary tells of; None where there is none to be trusted."""
        statistics = self._summary and self._summary.statistics
        return statistics.message_count if statistics else None

    @property
    def ending(self) -> str:
        """How the file ends, where it does not end as it should; else empty."""
        return self._ending

    @property
    def losses(self) -> tuple[str, ...]:
        """What could not be read, one line each; empty where all could."""
        return self._losses

    def gaps(self) -> list[Gap]:
        """The gaps that the file's metadata reports; reads no chunk."""
        found = [gap_from_metadata(one.name, one.metadata) for one in self._notes()]
        return [gap for gap in found if gap is not None]

    def selections(self) -> list[Selection]:
        """The filters that chose the rows of the file, as it tells; no chunk is read for it."""
        found = [selection_of(one.name, one.metadata) for one in self._notes()]
        return [selection for selection in found if selection is not None]

    def _notes(self) -> list[Metadata]:
        """All metadata records, wherever they stand."""
        if self._noted is None:
            self._noted = []
            with self._open() as stream:
                for record in self._record_stream(stream, lambda _first, _last: False):
                    if record.opcode == Opcode.METADATA:
                        with suppress(RecordError):
                            self._noted.append(parse(Metadata, record.body))
        return self._noted

    def __iter__(self) -> Iterator[Row]:
        """The rows, in file order.

        Raises:
            FileError: reading failed, or the file turns out to have none of our topics.
        """
        return (entry for entry in self.entries() if not isinstance(entry, PortEvent))

    def events(self) -> Iterator[PortEvent]:
        """The port events, in file order; raises as iteration over rows does."""
        return (entry for entry in self.entries() if isinstance(entry, PortEvent))

    def entries(self) -> Iterator[Row | PortEvent]:
        """Rows and port events together, in file order; raises as iteration over rows does."""
        reading = SequentialReading(self._path, self._port_of, self._known(EVERYTHING))
        with self._open() as stream:
            records = self._record_stream(stream)
            yield from reading.entries(records)
        self._finish(reading, records, whole=True)

    def batches(
        self, codebook: Codebook | None = None, span: TimeRange = EVERYTHING
    ) -> Iterator[RowBatch]:
        """The same rows and events as columns, in file order, most often 64 thousand and more.

        Chunks outside `span` are passed over by their log times; a row that came late is looked
        for where it was recorded. What was passed over is not checked, nor missed.

        Args:
            codebook: takes up ports and faults; give the same to several readers whose columns are
                to be used together.
            span: rows and events outside it are left out.

        Raises:
            FileError: as iteration over rows.
        """
        return (columns for _, columns in self.passages(codebook, span))

    def passages(
        self, codebook: Codebook | None = None, span: TimeRange = EVERYTHING
    ) -> Iterator[tuple[RowRange, RowBatch]]:
        """The same as `batches`, each with the place at which `again` finds its rows."""
        known = self._known(span)
        reading = SequentialReading(self._path, self._port_of, known)
        with self._open() as stream:
            passes = known is not None and not span.everything
            records = self._record_stream(stream, span.touches if passes else None)
            yield from ParallelReading(reading, codebook or Codebook(), span).passages(records)
        self._finish(reading, records, whole=span.everything)

    def again(self, passage: RowRange) -> RowBatch:
        """The rows of a passage of this file once more, with words of their own.

        Raises:
            FileError: the file cannot be read any more, or is not what it was.
        """
        reading = SequentialReading(self._path, self._port_of, passage.known)
        try:
            records = list(self._records(passage))
        except RecordError as error:
            raise self._changed() from error
        parts = list(ParallelReading(reading, Codebook(), passage.span).again(records))
        end = passage.skipped + passage.count
        if sum(map(len, parts)) < end:
            raise self._changed()
        return RowBatch.concat(parts)[passage.skipped : end]

    def _records(self, passage: RowRange) -> Iterator[RawRecord]:
        with self._open() as stream:
            if _identity(stream) != self._identity:
                raise self._changed()
            for place in passage.ranges:
                yield from self._route.again(stream, place)

    def _changed(self) -> FileError:
        return FileError("{path}: has changed since it was read; open it again", path=self._path)

    def _definitions(self) -> Definitions | None:
        """What the summary tells of the channels: a chunk passed over may have defined one.

        None where it tells of none; then no chunk can be passed over.
        """
        summary = self._summary
        if summary is None or not summary.channels:
            return None
        return Definitions(
            {schema.id: schema for schema in summary.schemas},
            {channel.id: channel for channel in summary.channels},
        )

    def _known(self, span: TimeRange) -> Definitions | None:
        """What must be known before the first record that is read, where not all are read."""
        return None if span.everything and not self._route.begin else self._definitions()

    def _record_stream(
        self, stream: BinaryIO, wanted: Callable[[int, int], bool] | None = None
    ) -> RecordStream:
        """The file's records; where its beginning is damaged, from the first whole chunk on.

        What describes rows before that chunk, no checksum guards, and it is not believed.
        """
        return self._route.records(stream, self._summary, wanted)

    def _finish(self, reading: SequentialReading, records: RecordStream, *, whole: bool) -> None:
        """Keep what a pass has found out about the file."""
        self._ending = records.ending
        beginning = [self._beginning_lost(self._route.begin[0])] if self._route.begin else []
        self._losses = (*beginning, *records.losses, *reading.losses)
        if whole:
            self._times = reading.times or self._times
        expected = self._summary and self._summary.statistics
        if whole and expected and expected.message_count > reading.messages:
            missing = expected.message_count - reading.messages
            told = TranslatableText(
                "{missing} of {count} messages are missing",
                missing=missing,
                count=expected.message_count,
            )
            self._losses += (told,)

    def _beginning_lost(self, count: int) -> TranslatableText:
        return TranslatableText(
            "the beginning of this recording is damaged, its first {count} bytes; "
            "of what is whole behind them `fte-sniff repair {path}` makes a whole file",
            count=count,
            path=quote(str(self._path)),
        )

    @contextmanager
    def _open(self) -> Iterator[BinaryIO]:
        path = self._path if self._copy is None else Path(self._copy.name)
        try:
            with path.open("rb", _BUFFER) as stream:
                yield stream
        except OSError as error:
            raise unreadable(self._path, error) from error

    def _copy_of_pipe(self) -> IO[bytes] | None:
        """A temporary file with all that a pipe brings, because a pipe can be read only once."""
        with self._open() as stream:
            if stream.seekable():
                return None
            copy = NamedTemporaryFile(prefix="fte-sniff-", suffix=".mcap")  # noqa: SIM115
            copyfileobj(stream, copy)
            copy.flush()
            finalize(self, copy.close)
            return copy

    def _look(self, stream: BinaryIO) -> None:
        self._check_magic(stream)
        self._summary = read_summary(stream)
        if self._route.begin and self._summary is not None and not self._summary.guarded:
            self._summary = None
        stream.seek(0)
        for record in () if self._route.begin else RecordStream(stream):
            if record.opcode in _HEAD_ENDS:
                break
            self._take_from_head(record)
        if self._summary is not None:
            self._take_summary(self._summary)

    def _take_summary(self, summary: Summary) -> None:
        self._channels.update((channel.id, channel) for channel in summary.channels)
        statistics = summary.statistics
        if statistics is not None and statistics.message_count:
            self._times = (statistics.message_start_time, statistics.message_end_time)
        topics = [channel.topic for channel in summary.channels]
        if topics and not any(topic in TOPIC_BY_NAME for topic in topics):
            raise without_our_topics(self._path, topics)

    def _check_magic(self, stream: BinaryIO) -> None:
        magic = stream.read(len(MAGIC))
        if not magic:
            raise FileError(f"{self._path} is empty: nothing was recorded into it")
        if magic == MAGIC:
            return
        if MAGIC.startswith(magic):
            raise FileError(f"{self._path} is cut after {len(magic)} bytes: nothing is left in it")
        first = next_chunk(stream)
        if first is not None:
            self._route.begin_with(first)
            for opcode, body in records_in(first.records):
                self._take_from_head(RawRecord(first.position, opcode, body))
            return
        raise FileError(
            f"{self._path} is not an MCAP recording; "
            "if it holds raw bytes or hex text, say --input raw or --input hex"
        )

    def _take_from_head(self, record: RawRecord) -> None:
        try:
            if record.opcode == Opcode.CHANNEL:
                channel = parse(Channel, record.body)
                self._channels[channel.id] = channel
            elif record.opcode == Opcode.METADATA:
                metadata = parse(Metadata, record.body)
                self._metadata[metadata.name] = metadata.metadata
        except RecordError:
            return

    def _port_of(self, channel: Channel) -> PortFacts:
        """The port of a channel; the file's name stands in where the file names none."""
        name = channel.metadata.get("port", self._path.name)
        baud = channel.metadata.get("baud", "")
        legible = baud.isascii() and baud.isdecimal() and len(baud) <= _MOST_BAUD_DIGITS
        return PortFacts(name, int(baud) if legible else None)


def _identity(stream: BinaryIO) -> tuple[int, int]:
    """Tells whether it is the same file, though it may have grown."""
    found = os.fstat(stream.fileno())
    return found.st_dev, found.st_ino


SUFFIX = ".mcap"
"""How the names of recordings end."""

_PATTERN = frozenset("*?[")
_LATEST = 2**64


def recordings_in(paths: Iterable[Path]) -> list[Path]:
    """The files that paths mean: each file itself, a folder's recordings, a pattern's matches.

    Raises:
        FileError: a folder holds no recording, or nothing matches a pattern.
    """
    return list(dict.fromkeys(found for path in paths for found in files_of(path)))


def files_of(path: Path) -> Iterator[Path]:
    """The files that one path means, sorted by name; raises as `recordings_in`."""
    if path.is_dir():
        found = sorted(entry for entry in path.glob(f"*{SUFFIX}") if entry.is_file())
        if not found:
            raise FileError(f"{path} is a directory, and there is no recording (*{SUFFIX}) in it")
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
    """By what recordings are put in order: their first time, then their name."""
    return reader.times[0] if reader.times else _LATEST, str(reader.path)


_LENGTH_NS = 10**9
_LONGER = 60
"""How many times as far back the last row is looked for where there was none."""


def row_times(reader: RecordingReader) -> tuple[int, int] | None:
    """Time of the first row in the file, and the latest of all; None where there is no row.

    Raises:
        FileError: the file cannot be read.
    """
    first_ns = _first_ns(reader)
    return None if first_ns is None else (first_ns, _last_ns(reader, first_ns))


def _first_ns(reader: RecordingReader) -> int | None:
    return next((int(rows.t_ns[0]) for rows in reader.batches() if len(rows)), None)


def _last_ns(reader: RecordingReader, first_ns: int) -> int:
    """The latest time; chunks at the end of the file are looked through first."""
    end_ns = reader.times[1] if reader.times else first_ns
    back_ns = _LENGTH_NS
    while end_ns - back_ns > first_ns:
        found = _latest_ns(reader, TimeRange(end_ns - back_ns))
        if found is not None:
            return found
        back_ns *= _LONGER
    return max(first_ns, _latest_ns(reader, TimeRange(first_ns)) or first_ns)


def _latest_ns(reader: RecordingReader, span: TimeRange) -> int | None:
    latest = [int(rows.t_ns.max()) for rows in reader.batches(span=span) if len(rows)]
    return max(latest, default=None)
