"""Repair a damaged recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Footer, Metadata, Schema, Statistics
from numpy.typing import NDArray

from fte_sniff.errors import FileError, unreadable, unwritable
from fte_sniff.protocol import Gap, GapKind, iso_time
from fte_sniff.recording.mcap.append_file import Stream
from fte_sniff.recording.mcap.reader import RecordStream
from fte_sniff.recording.mcap.records import HEAD, RecordError, parse, records_in, unpack
from fte_sniff.recording.mcap.salvage import Descriptions, FoundChunk, Salvage
from fte_sniff.recording.mcap.writer import McapBatch, McapFile
from fte_sniff.recording.messages.codec import MessageReader
from fte_sniff.recording.messages.packer import MESSAGE, MESSAGE_HEAD
from fte_sniff.recording.messages.schema import TOPIC_BY_NAME, schema_name
from fte_sniff.recording.metadata import library_name
from fte_sniff.recording.output_file import Existing, OutputPath

_Definition = TypeVar("_Definition", Schema, Channel)


def trusted_definitions(
    inside: Descriptions, outside: Descriptions
) -> tuple[dict[int, Channel], dict[int, Schema]]:
    """The usable channel and schema of each id.

    Definitions `inside` intact chunks, which a checksum protects, win; then the most frequent ones.
    """
    channels: dict[int, Channel] = {}
    schemas: dict[int, Schema] = {}
    candidates = _by_trust(inside.schemas, outside.schemas)
    for channel in _by_trust(inside.channels, outside.channels):
        if channel.id in channels:
            continue
        for schema in candidates:
            chosen = schemas.get(schema.id, schema)
            if schema.id == channel.schema_id and chosen == schema and _usable(channel, schema):
                channels[channel.id] = channel
                schemas[schema.id] = schema
                break
    return channels, schemas


def _by_trust(inside: Sequence[_Definition], outside: Sequence[_Definition]) -> list[_Definition]:
    ids = {one.id for one in inside}
    others: list[_Definition] = [one for one in outside if one.id not in ids]
    others.sort(key=list(others).count, reverse=True)
    return list(inside) + others


def _usable(channel: Channel, schema: Schema) -> bool:
    if channel.topic not in TOPIC_BY_NAME:
        return False
    try:
        MessageReader(channel.topic, "", schema.name, schema.data)
    except FileError:
        return False
    return schema.name == schema_name(TOPIC_BY_NAME[channel.topic])


@dataclass(frozen=True, slots=True)
class UnpackedMessages:
    """The messages of an unpacked chunk."""

    batch: McapBatch
    """Its data is the whole chunk."""
    sequences: NDArray[np.int64]
    stops: NDArray[np.int64]
    """The end of each message record."""

    @property
    def span(self) -> tuple[int, int]:
        """First and last time, nanoseconds since 1970 UTC; needs a message."""
        return int(self.batch.times.min()), int(self.batch.times.max())

    def select(self, kept: NDArray[np.bool_]) -> McapBatch:
        """A copy with only the messages for which `kept` is true."""
        starts, stops = self.batch.starts[kept], self.stops[kept]
        data = [self.batch.data[a:b] for a, b in zip(starts, stops, strict=True)]
        starts = np.cumsum(stops - starts) - (stops - starts)
        return McapBatch(b"".join(data), self.batch.channels[kept], self.batch.times[kept], starts)


def messages_of(records: bytes) -> UnpackedMessages:
    """The messages of an unpacked chunk, without records that are too short to be one."""
    found = []
    start = 0
    for opcode, body in records_in(records):
        stop = start + HEAD.size + len(body)
        if opcode == Opcode.MESSAGE and len(body) >= MESSAGE_HEAD:
            _, _, channel, sequence, time, _ = MESSAGE.unpack_from(records, start)
            found.append((channel, time, start, sequence, stop))
        start = stop
    columns = np.array(found, np.uint64).reshape(-1, 5).astype(np.int64).T
    channels, times, starts, sequences, stops = columns
    return UnpackedMessages(McapBatch(records, channels, times, starts), sequences, stops)


REPAIR_NAME = "fte-sniff.repair"
"""The metadata record of a repaired file: what was lost."""

_SEQUENCES = 2**32


@dataclass(slots=True)
class FileDamage:
    """What was found in a damaged file."""

    gaps: list[Gap] = field(default_factory=list)
    """The bytes that could not be read, in file order. A gap's reason names the bytes; its times
    are those of the last message before them and of the first one after them."""
    lost_bytes: int = 0
    chunks: int = 0
    """Intact chunks."""
    messages: int = 0
    """Messages (rows and port events) in them whose channel is defined."""
    undefined_messages: int = 0
    """Messages in them whose channel has no definition left; they are lost too."""
    lost_messages: int | None = None
    """By the file's statistics; None if unknown."""
    least_lost_messages: int = 0
    """At least, by the gaps in the sequence numbers."""

    def lose(self, start: int, stop: int, start_ns: int | None, end_ns: int | None) -> None:
        """Note bytes that could not be read, between the times of two messages."""
        where = f"bytes {start} to {stop} ({stop - start} bytes)"
        self.gaps.append(Gap(GapKind.DAMAGE, None, start_ns, end_ns, where))
        self.lost_bytes += stop - start


def lost_text(gap: Gap) -> str:
    """The bytes that could not be read, and the times of the messages around them."""
    if gap.start_ns is None and gap.end_ns is None:
        return gap.reason
    first = "the beginning" if gap.start_ns is None else iso_time(gap.start_ns)
    last = "the end" if gap.end_ns is None else iso_time(gap.end_ns)
    return f"{gap.reason}, between {first} and {last}"


def is_whole(path: Path) -> bool:
    """Whether a recording is intact: its records, checksums, summary and end.

    A file without summary is valid MCAP but not every tool opens it, so it is not intact.

    Raises FileError if the file cannot be read.
    """
    try:
        with path.open("rb") as stream:
            records, is_indexed = RecordStream(stream), False
            for record in records:
                if record.opcode == Opcode.CHUNK:
                    for _ in records_in(unpack(record.body)):
                        pass
                elif record.opcode == Opcode.FOOTER:
                    is_indexed = parse(Footer, record.body).summary_start > 0
    except RecordError:
        return False
    except OSError as error:
        raise unreadable(path, error) from error
    return is_indexed and not records.ending and not records.losses


def repair(path: Path, output: Path, existing: Existing) -> FileDamage:
    """Write everything intact in `path` to `output`.

    Raises:
        FileError: the file cannot be read, nothing in it is intact, or `output` cannot be written.
    """
    try:
        with path.open("rb") as stream:
            job = _RepairJob(path, Salvage(stream))
            job.scan()
            job.write(output, existing)
            return job.damage
    except OSError as error:
        raise unreadable(path, error) from error


class _RepairJob:
    def __init__(self, path: Path, salvage: Salvage) -> None:
        self.damage = FileDamage()
        self._path = path
        self._salvage = salvage
        self._outside, self._inside = Descriptions(), Descriptions()
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._counts: dict[int, tuple[int, int]] = {}
        """By channel id: the sequence number after the last message, and the messages found."""

    def scan(self) -> None:
        position = 0
        before_ns: int | None = None
        for found in self._salvage.chunks():
            for opcode, body in records_in(found.records):
                if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self._inside.update(opcode, body)
            messages = messages_of(found.records)
            first_ns, last_ns = messages.span if len(messages.sequences) else (before_ns, before_ns)
            self._lose(position, found.position, before_ns, first_ns)
            self._count(messages)
            position, before_ns = found.stop, last_ns
            self.damage.chunks += 1
        self._lose(position, self._salvage.size, before_ns, None)
        if not self.damage.chunks:
            raise FileError(f"{self._path}: {self._salvage.why_empty()}")
        self._channels, self._schemas = trusted_definitions(self._inside, self._outside)
        self._sum_up()

    def write(self, output: Path, existing: Existing) -> None:
        target = OutputPath(output, existing)
        try:
            file = self._begin(target)
            for found in self._salvage.chunks():
                self._copy(found, file)
            file.close()
            target.commit()
        except BaseException as error:
            target.discard()
            if isinstance(error, OSError):
                raise unwritable(output, error) from error
            raise
        target.close()

    def _begin(self, target: OutputPath) -> McapFile:
        damage = self.damage
        items = {
            "file": self._path.name,
            "library": library_name(),
            "lost.bytes": str(damage.lost_bytes),
            "lost.messages": "" if damage.lost_messages is None else str(damage.lost_messages),
        }
        items |= {f"lost.{n}": lost_text(gap) for n, gap in enumerate(damage.gaps[:100], 1)}
        header = self._outside.header
        file = McapFile(
            Stream(target.descriptor),
            header.library if header else library_name(),
            Metadata(REPAIR_NAME, items),
            self._schemas.values(),
            self._channels.values(),
        )
        file.write_metadata(_without_duplicates(self._outside.metadata))
        return file

    def _lose(self, start: int, stop: int, before: int | None, after: int | None) -> None:
        for first, end in self._salvage.between(start, stop, self._outside):
            self.damage.lose(first, end, before, after)

    def _count(self, messages: UnpackedMessages) -> None:
        for channel in np.unique(messages.batch.channels).tolist():
            own = messages.batch.channels == channel
            last = int(messages.sequences[own].max())
            end, count = self._counts.get(channel, (0, 0))
            self._counts[channel] = (max(end, last + 1), count + int(own.sum()))

    def _sum_up(self) -> None:
        damage, counts = self.damage, self._counts
        total = sum(count for _, count in counts.values())
        damage.messages = sum(count for id_, (_, count) in counts.items() if id_ in self._channels)
        damage.undefined_messages = total - damage.messages
        skipped = sum(max(0, end - count) for end, count in counts.values() if end < _SEQUENCES)
        damage.least_lost_messages = skipped + damage.undefined_messages
        expected = _message_count(self._outside.statistics)
        if expected is not None and expected >= damage.messages:
            damage.lost_messages = expected - damage.messages

    def _copy(self, found: FoundChunk, file: McapFile) -> None:
        """Write a chunk again, without the messages whose channel is not defined."""
        messages = messages_of(found.records)
        known = np.isin(messages.batch.channels, list(self._channels))
        if known.any():
            file.write_batch(messages.select(known))


def _message_count(statistics: Statistics | None) -> int | None:
    """How many messages the file had; None if the statistics are missing or inconsistent."""
    if statistics is None:
        return None
    total = sum(statistics.channel_message_counts.values())
    return total if total == statistics.message_count else None


def _without_duplicates(metadata: list[Metadata]) -> list[Metadata]:
    return [one for at, one in enumerate(metadata) if one not in metadata[:at]]
