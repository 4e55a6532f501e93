"""RecordingReader: read one recording; and the recordings that paths name.

A file may be truncated, damaged or written by another program. Everything readable is read;
`ending` and `losses` report the rest. A chunk counts only if its checksum is right.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
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
from fte_sniff.recording.mcap.records import MAGIC, RecordError, parse, records_in, unpack
from fte_sniff.recording.mcap.salvage import next_chunk
from fte_sniff.recording.messages.schema import TOPIC_BY_NAME
from fte_sniff.recording.metadata import (
    PortFacts,
    Selection,
    gap_from_metadata,
    selection_from_metadata,
)
from fte_sniff.recording.parallel import ParallelReader
from fte_sniff.recording.row_ranges import EVERYTHING, Definitions, RecordScan, RowRange, TimeRange
from fte_sniff.recording.sequential import SequentialReader, without_our_topics
from fte_sniff.row_batch import Codebook, RowBatch

_MOST_BAUD_DIGITS = 9
_BUFFER = 128 * 1024
"""Bytes read ahead: enough for the message indexes between two chunks."""
_HEAD_ENDS = frozenset({Opcode.CHUNK, Opcode.MESSAGE, Opcode.DATA_END, Opcode.FOOTER})


class RecordingReader:
    """Reader of one recording; each iteration reads the file anew.

    `ending` and `losses` are those of the last finished iteration.
    """

    def __init__(self, path: Path) -> None:
        """Read the start of the file and its summary.

        Raises FileError if the file cannot be read, is empty, no MCAP, or has none of fte-sniff's
        topics.
        """
        self._path = path
        self._channels: dict[int, Channel] = {}
        self._metadata: dict[str, dict[str, str]] = {}
        self._summary: Summary | None = None
        self._all_metadata: list[Metadata] | None = None
        self._ending = ""
        self._losses: tuple[str, ...] = ()
        self._times: tuple[int, int] | None = None
        self._scan = RecordScan()
        self._copy: IO[bytes] | None = None
        self._copy = self._copy_of_pipe()
        with self._open() as stream:
            self._identity = _identity(stream)
            self._read_start(stream)

    @property
    def path(self) -> Path:
        """The path of the recording."""
        return self._path

    @property
    def ports(self) -> tuple[PortFacts, ...]:
        """The ports named at the start of the file and in its summary, each once."""
        found = {}
        for channel in self._channels.values():
            if channel.topic in TOPIC_BY_NAME:
                facts = self._port_of(channel)
                found[facts.name] = facts
        return tuple(found.values())

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """The metadata records before the first row, by name."""
        return self._metadata

    @property
    def times(self) -> tuple[int, int] | None:
        """First and last log time, nanoseconds since 1970 UTC; None if unknown."""
        return self._times

    @property
    def count(self) -> int | None:
        """The number of messages in the summary; None without a trusted summary."""
        statistics = self._summary and self._summary.statistics
        return statistics.message_count if statistics else None

    @property
    def ending(self) -> str:
        """What is wrong with the end of the file; empty if nothing."""
        return self._ending

    @property
    def losses(self) -> tuple[str, ...]:
        """What could not be read, one line each; empty if nothing."""
        return self._losses

    def gaps(self) -> list[Gap]:
        """The gaps that the file's metadata reports; reads no chunk."""
        found = [gap_from_metadata(one.name, one.metadata) for one in self._read_metadata()]
        return [gap for gap in found if gap is not None]

    def selections(self) -> list[Selection]:
        """The filters that selected the rows of the file, from its metadata; reads no chunk."""
        metadata = self._read_metadata()
        found = [selection_from_metadata(one.name, one.metadata) for one in metadata]
        return [selection for selection in found if selection is not None]

    def __iter__(self) -> Iterator[Row]:
        """The rows, in file order.

        Raises FileError if reading failed, or the file has none of fte-sniff's topics.
        """
        return (entry for entry in self.entries() if not isinstance(entry, PortEvent))

    def events(self) -> Iterator[PortEvent]:
        """The port events, in file order; raises as iteration over rows does."""
        return (entry for entry in self.entries() if isinstance(entry, PortEvent))

    def entries(self) -> Iterator[Row | PortEvent]:
        """Rows and port events, in file order, one at a time; `batches` is much faster.

        Raises FileError as iteration over rows.
        """
        reader = SequentialReader(self._path, self._port_of, self._known(EVERYTHING))
        with self._open() as stream:
            records = self._scan.records(stream, self._summary)
            yield from reader.read(records)
        self._finish(reader, records, whole=True)

    def batches(
        self, codebook: Codebook | None = None, span: TimeRange = EVERYTHING
    ) -> Iterator[RowBatch]:
        """The same rows and events in batches, in file order, mostly of at least 64 thousand rows.

        Chunks outside `span`, by their log times, are skipped; a row that came late is in the range
        of its chunk. Damage in skipped chunks is not detected. Several readers can share a
        codebook. Raises FileError as iteration over rows.
        """
        return (rows for _, rows in self.ranges(codebook, span))

    def ranges(
        self, codebook: Codebook | None = None, span: TimeRange = EVERYTHING
    ) -> Iterator[tuple[RowRange, RowBatch]]:
        """The same batches, each with the range with which `read` reads it again."""
        known = self._known(span)
        reader = SequentialReader(self._path, self._port_of, known)
        with self._open() as stream:
            skips = known is not None and not span.everything
            wanted = span.overlaps if skips else None
            records = self._scan.records(stream, self._summary, wanted)
            yield from ParallelReader(reader, codebook or Codebook(), span).read(records)
        self._finish(reader, records, whole=span.everything)

    def read(self, rows: RowRange) -> RowBatch:
        """Read a range of rows again, with a codebook of its own.

        Raises FileError if the file cannot be read any more, or has changed.
        """
        reader = SequentialReader(self._path, self._port_of, rows.definitions)
        try:
            records = list(self._records_of(rows))
        except RecordError as error:
            raise self._changed() from error
        batches = list(ParallelReader(reader, Codebook(), rows.span).read_again(records))
        end = rows.skipped + rows.count
        if sum(map(len, batches)) < end:
            raise self._changed()
        return RowBatch.concat(batches)[rows.skipped : end]

    def _records_of(self, rows: RowRange) -> Iterator[RawRecord]:
        with self._open() as stream:
            if _identity(stream) != self._identity:
                raise self._changed()
            for records in rows.records:
                yield from self._scan.read(stream, records)

    def _changed(self) -> FileError:
        return FileError("{path}: has changed since it was read; open it again", path=self._path)

    def _read_metadata(self) -> list[Metadata]:
        if self._all_metadata is None:
            self._all_metadata = []
            with self._open() as stream:
                for record in self._scan.records(stream, self._summary, _no_chunk):
                    if record.opcode == Opcode.METADATA:
                        with suppress(RecordError):
                            self._all_metadata.append(parse(Metadata, record.body))
        return self._all_metadata

    def _known(self, span: TimeRange) -> Definitions | None:
        """The definitions in the summary, if a pass may begin with them.

        Without them no chunk can be skipped, because it may hold a definition.
        """
        summary = self._summary
        if summary is None or not summary.channels:
            return None
        if span.everything and not (self._scan.begin or summary.guarded):
            return None
        return Definitions(
            {schema.id: schema for schema in summary.schemas},
            {channel.id: channel for channel in summary.channels},
        )

    def _finish(self, reader: SequentialReader, records: RecordStream, *, whole: bool) -> None:
        self._ending = records.ending
        start = [self._start_lost(self._scan.begin[0])] if self._scan.begin else []
        self._losses = (*start, *records.losses, *reader.losses)
        if whole:
            self._times = reader.times or self._times
        count = self.count
        if whole and count is not None and count > reader.messages:
            missing = TranslatableText(
                "{missing} of {count} messages are missing",
                missing=count - reader.messages,
                count=count,
            )
            self._losses += (missing,)

    def _start_lost(self, count: int) -> TranslatableText:
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
        """A temporary copy of a pipe, because a pipe can be read only once."""
        with self._open() as stream:
            if stream.seekable():
                return None
            copy = NamedTemporaryFile(prefix="fte-sniff-", suffix=".mcap")  # noqa: SIM115
            copyfileobj(stream, copy)
            copy.flush()
            finalize(self, copy.close)
            return copy

    def _read_start(self, stream: BinaryIO) -> None:
        self._check_magic(stream)
        summary = read_summary(stream)
        if summary is not None and (summary.guarded or not self._scan.begin):
            self._summary = summary
        stream.seek(0)
        for record in () if self._scan.begin else RecordStream(stream):
            if record.opcode == Opcode.CHUNK and self._summary is None:
                self._read_definitions(record.body)
            if record.opcode in _HEAD_ENDS:
                break
            self._read_definition(record.opcode, record.body)
        if self._summary is not None:
            self._use_summary(self._summary)

    def _use_summary(self, summary: Summary) -> None:
        self._channels.update((channel.id, channel) for channel in summary.channels)
        statistics = summary.statistics
        if statistics is not None and statistics.message_count:
            self._times = (statistics.message_start_time, statistics.message_end_time)
        topics = [channel.topic for channel in summary.channels]
        if topics and not any(topic in TOPIC_BY_NAME for topic in topics):
            raise without_our_topics(self._path, topics)

    def _check_magic(self, stream: BinaryIO) -> None:
        """Check how the file begins; if it is damaged there, begin with the first whole chunk."""
        magic = stream.read(len(MAGIC))
        if not magic:
            raise FileError(f"{self._path} is empty: nothing was recorded into it")
        if magic == MAGIC:
            return
        if MAGIC.startswith(magic):
            raise FileError(f"{self._path} is cut after {len(magic)} bytes: nothing is left in it")
        first = next_chunk(stream)
        if first is None:
            raise FileError(
                f"{self._path} is not an MCAP recording; "
                "if it holds raw bytes or hex text, say --input raw or --input hex"
            )
        self._scan.begin_with(first)
        for opcode, body in records_in(first.records):
            self._read_definition(opcode, body)

    def _read_definitions(self, chunk: bytes) -> None:
        with suppress(RecordError):
            for opcode, body in records_in(unpack(chunk)):
                self._read_definition(opcode, body)

    def _read_definition(self, opcode: int, body: bytes) -> None:
        with suppress(RecordError):
            if opcode == Opcode.CHANNEL:
                channel = parse(Channel, body)
                self._channels[channel.id] = channel
            elif opcode == Opcode.METADATA:
                metadata = parse(Metadata, body)
                self._metadata[metadata.name] = metadata.metadata

    def _port_of(self, channel: Channel) -> PortFacts:
        """The port of a channel; the name of the file if the channel names none."""
        name = channel.metadata.get("port", self._path.name)
        baud = channel.metadata.get("baud", "")
        legible = baud.isascii() and baud.isdecimal() and len(baud) <= _MOST_BAUD_DIGITS
        return PortFacts(name, int(baud) if legible else None)


def _no_chunk(_first_ns: int, _last_ns: int) -> bool:
    return False


def _identity(stream: BinaryIO) -> tuple[int, int]:
    """Device and inode: the same for a file that has grown."""
    found = os.fstat(stream.fileno())
    return found.st_dev, found.st_ino


SUFFIX = ".mcap"
"""The suffix of recordings."""

_PATTERN = frozenset("*?[")
_LATEST = 2**64


def recordings_in(paths: Iterable[Path]) -> list[Path]:
    """The files of some paths, each once: see `files_of`."""
    return list(dict.fromkeys(found for path in paths for found in files_of(path)))


def files_of(path: Path) -> Iterator[Path]:
    """The file itself, the recordings in a folder, or the matches of a pattern, sorted by name.

    Raises FileError if the folder holds no recording, or nothing matches the pattern.
    """
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
    """The sort key of recordings: their first time, then their name."""
    return reader.times[0] if reader.times else _LATEST, str(reader.path)


_FIRST_STEP_NS = 10**9
_LONGER = 60
"""The factor by which the search for the latest time goes further back at each step."""


def row_times(reader: RecordingReader) -> tuple[int, int] | None:
    """Time of the first row in the file, and the latest time; None without rows.

    Raises FileError if the file cannot be read.
    """
    first_ns = next((int(rows.t_ns[0]) for rows in reader.batches() if len(rows)), None)
    return None if first_ns is None else (first_ns, _latest_ns(reader, first_ns))


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
