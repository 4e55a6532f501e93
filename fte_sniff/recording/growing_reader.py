"""GrowingReader: read a recording while another program writes it.

`AppendFile` overwrites only the tail of a file: the records before it never change. A pass reads
the records that are complete, and the next pass begins where they ended:

    pass 1   magic, head, chunk, indexes | tail
    pass 2                                 chunk, indexes | tail
    last                                                    chunk, indexes, tail

Only the last pass, after the end of the writer, reads the tail and reports what is damaged there.
"""

from __future__ import annotations

import os
from collections.abc import Generator, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Metadata

from fte_sniff.errors import FileError
from fte_sniff.platform import read_at
from fte_sniff.protocol.rows import Codebook, Rows
from fte_sniff.recording.batch_reader import EVERYTHING, BatchReader, RowRange, TimeRange
from fte_sniff.recording.file_lock import is_locked
from fte_sniff.recording.mcap.reader import RecordStream, read_summary
from fte_sniff.recording.mcap.records import (
    HEAD,
    LARGEST,
    MAGIC,
    RecordError,
    claimed,
    parse,
    unpack,
)
from fte_sniff.recording.metadata import END_NAME, NEXT_NAME, PROGRAM, part_of
from fte_sniff.recording.reader import SUFFIX, RecordingReader

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


class GrowingReader(RecordingReader):
    """Reader of a recording that grows; `new_ranges` continues where its last pass ended."""

    _is_followed = False

    def __init__(self, path: Path) -> None:
        """Read the start of the file and its summary.

        Raises FileError as `RecordingReader`, and if the file is no recording.
        """
        _check_kind(path)
        super().__init__(path)
        self._metadata_read: list[Metadata] = []
        self._all_metadata = self._metadata_read
        self._pass: BatchReader | None = None
        self._channels_read = self._known_channels()
        self._position = 0
        """Offset of the first record that was not read."""
        self._complete = self._indexed_stop()
        """Offset after the last complete record."""
        self._edge = b""
        self._state: tuple[int, int] = 0, 0
        with self._open() as stream:
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

    @property
    def next_path(self) -> Path | None:
        """The next file of the capture; None while the file names none."""
        for metadata in self._metadata_read:
            name = Path(metadata.metadata.get("file", "")).name
            if metadata.name == NEXT_NAME and name:
                return self.path.with_name(name)
        return None

    @property
    def limit(self) -> str:
        """The limit at which the recording ended, text from the file; empty if it names none."""
        found = (one.metadata for one in self._metadata_read if one.name == END_NAME)
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

    def poll(self) -> bool:
        """Whether it has changed since the previous call; `new_ranges` may then have rows.

        Raises FileError if it was deleted, replaced or cut off.
        """
        with self._open() as stream:
            found, self._state = self._state, self._state_of(stream)
            self._advance(stream)
        return found != self._state or self._complete > self._position

    @contextmanager
    def _open(self) -> Iterator[BinaryIO]:
        try:
            with super()._open() as stream:
                yield stream
        except FileError as error:
            if self._is_followed and isinstance(error.__cause__, FileNotFoundError):
                raise FileError(
                    "{path} was deleted or moved while it was followed", path=self.path
                ) from error
            raise

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
            self._metadata_read.append(parse(Metadata, body))

    def new_ranges(
        self, codebook: Codebook, span: TimeRange = EVERYTHING
    ) -> Iterator[tuple[RowRange, Rows]]:
        """The rows of the records that are complete since the previous call; see `ranges`.

        Codebook and span are those of the first call.
        """
        reader = self._reader(codebook, span)
        while self._position < self._complete:
            with self._open() as stream:
                self._check(stream)
                yield from self._read(reader, stream, span, self._complete)
                self._position = self._complete
                # It names the records of the first pass only.
                self._summary = None
                self.times = reader.found.times or self.times
                self._advance(stream)

    def last_ranges(
        self, codebook: Codebook, span: TimeRange = EVERYTHING
    ) -> Iterator[tuple[RowRange, Rows]]:
        """The rows up to the end of the file, which nobody writes any more; see `new_ranges`.

        Reports what is damaged, as `ranges` does after its pass.
        """
        reader = self._reader(codebook, span)
        with self._open() as stream:
            self._check(stream)
            self._summary = read_summary(stream)
            records = yield from self._read(reader, stream, span, None)
        self._finish(reader, self._channels_read, records, whole=span.everything)
        self._check_topics(reader, self._channels_read, cut=bool(self.damage))

    def _reader(self, codebook: Codebook, span: TimeRange) -> BatchReader:
        if self._pass is None:
            counts = self._summary is None
            self._pass = BatchReader(self._channels_read, codebook, span, count_sequences=counts)
        return self._pass

    def _read(
        self, reader: BatchReader, stream: BinaryIO, span: TimeRange, stop: int | None
    ) -> Generator[tuple[RowRange, Rows], None, RecordStream]:
        """The rows of the records from `_position` to `stop`; None for the end of the file."""
        wanted = None if span.everything else span.overlaps
        records = RecordStream(
            stream, self._summary, wanted, self._found, first=self._position, stop=stop
        )
        try:
            yield from reader.read(records)
        finally:
            self._damage |= dict.fromkeys((*records.losses, *reader.found.lost))
        return records


def _check_kind(path: Path) -> None:
    """Raise FileError for a file that is no recording, or no regular file."""
    start = MAGIC
    with suppress(OSError):  # raised again by `RecordingReader`
        if path.is_file():
            with path.open("rb") as stream:
                start = stream.read(len(MAGIC))
        elif path.exists():
            start = b"?"
    if not MAGIC.startswith(start):
        raise FileError("{path} is no recording; --follow reads only recordings (.mcap)", path=path)


def _is_intact(chunk: bytes) -> bool:
    try:
        unpack(chunk)
    except RecordError:
        return False
    return claimed(chunk)[1] > 0
