"""Repair a damaged recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
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
from fte_sniff.recording.mcap.writer import McapBatch, McapFile, indexed
from fte_sniff.recording.messages.codec import MessageReader
from fte_sniff.recording.messages.packer import MESSAGE, MESSAGE_HEAD
from fte_sniff.recording.messages.schema import TOPIC_BY_NAME, schema_name
from fte_sniff.recording.metadata import library_name
from fte_sniff.recording.output_file import Existing, OutputPath

_Definition = TypeVar("_Definition", Schema, Channel)


def trusted_definitions(
    inside: Descriptions, outside: Descriptions
) -> tuple[dict[int, Channel], dict[int, Schema]]:
    """The channel and the schema of each number, and none that cannot be used.

    What a chunk defines is guarded by its checksum; of the rest what was found most often is
    believed first.

    Args:
        inside: what whole chunks define.
        outside: what stands outside of chunks.
    """
    channels: dict[int, Channel] = {}
    schemas: dict[int, Schema] = {}
    likely_schemas = _preferred(inside.schemas, outside.schemas)
    for channel in _preferred(inside.channels, outside.channels):
        if channel.id in channels:
            continue
        for schema in likely_schemas:
            settled = schemas.get(schema.id, schema)
            if schema.id == channel.schema_id and settled == schema and _usable(channel, schema):
                channels[channel.id] = channel
                schemas[schema.id] = schema
                break
    return channels, schemas


def _preferred(guarded: Sequence[_Definition], others: Sequence[_Definition]) -> list[_Definition]:
    """The definitions, those to be believed most first."""
    numbers = {one.id for one in guarded}
    unguarded: list[_Definition] = [one for one in others if one.id not in numbers]
    unguarded.sort(key=list(unguarded).count, reverse=True)
    return list(guarded) + unguarded


def _usable(channel: Channel, schema: Schema) -> bool:
    """Whether messages of ours can be read by this channel and schema."""
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
    """Where each message record ends."""

    @property
    def span(self) -> tuple[int, int]:
        """First and last time, nanoseconds since 1970 UTC; there is a message at least."""
        return int(self.batch.times.min()), int(self.batch.times.max())

    def only(self, kept: NDArray[np.bool_]) -> McapBatch:
        """The messages that are kept, packed anew."""
        starts, stops = self.batch.starts[kept], self.stops[kept]
        data = [self.batch.data[a:b] for a, b in zip(starts, stops, strict=True)]
        places = np.cumsum(stops - starts) - (stops - starts)
        return McapBatch(b"".join(data), self.batch.channels[kept], self.batch.times[kept], places)


def messages_of(records: bytes) -> UnpackedMessages:
    """The messages of an unpacked chunk; what is too short to be one is left out."""
    found = []
    place = 0
    for opcode, body in records_in(records):
        stop = place + HEAD.size + len(body)
        if opcode == Opcode.MESSAGE and len(body) >= MESSAGE_HEAD:
            _, _, channel, sequence, time, _ = MESSAGE.unpack_from(records, place)
            found.append((channel, time, place, sequence, stop))
        place = stop
    columns = np.array(found, np.uint64).reshape(-1, 5).astype(np.int64).T
    channels, times, places, sequences, stops = columns
    return UnpackedMessages(McapBatch(records, channels, times, places), sequences, stops)


REPAIR_NAME = "fte-sniff.repair"
"""The name of the metadata record that tells what was lost."""

_SEQUENCES = 2**32


@dataclass(slots=True)
class FileDamage:
    """What was found in a damaged file."""

    gaps: list[Gap] = field(default_factory=list)
    """What could not be read, in file order: the bytes as the reason, and the times of the last
    message before them and the first one after them."""
    lost_bytes: int = 0
    """Bytes that could not be read."""
    chunks: int = 0
    """Whole chunks."""
    messages: int = 0
    """Messages (rows and port events) in them whose channel is defined."""
    undescribed: int = 0
    """Messages in them whose channel is not defined any more; they are lost too."""
    missing: int | None = None
    """Lost messages by the file's statistics; None if unknown."""
    least_missing: int = 0
    """Lost messages at least, by the gaps in the sequence numbers."""

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
    """Whether nothing is wrong with a recording: its records, checksums, summary and end.

    A file without summary is legal, but not every tool opens it, so it counts as not whole.

    Raises:
        FileError: the file cannot be read.
    """
    try:
        with path.open("rb") as stream:
            records, indexed = RecordStream(stream), False
            for record in records:
                if record.opcode == Opcode.CHUNK:
                    for _ in records_in(unpack(record.body)):
                        pass
                elif record.opcode == Opcode.FOOTER:
                    indexed = parse(Footer, record.body).summary_start > 0
    except RecordError:
        return False
    except OSError as error:
        raise unreadable(path, error) from error
    return indexed and not records.ending and not records.losses


def repair(path: Path, output: Path, existing: Existing) -> FileDamage:
    """Write all that is whole in `path` to `output`.

    Raises:
        FileError: the file cannot be read, nothing is left in it, or `output` cannot be written.
    """
    try:
        with path.open("rb") as stream:
            mending = _Repair(path, Salvage(stream))
            mending.look()
            mending.write(output, existing)
            return mending.damage
    except OSError as error:
        raise unreadable(path, error) from error


class _Repair:
    """One damaged file on its way to a whole one."""

    def __init__(self, path: Path, salvage: Salvage) -> None:
        self.damage = FileDamage()
        self._path = path
        self._salvage = salvage
        self._outside, self._inside = Descriptions(), Descriptions()
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._numbers: dict[int, tuple[int, int]] = {}

    def look(self) -> None:
        """Learn what there is."""
        position = 0
        after_ns: int | None = None
        last_ns = 0
        for found in self._salvage.chunks():
            self._describe(found)
            messages = messages_of(found.records)
            before_ns = after_ns
            if len(messages.sequences):
                before_ns, last_ns = messages.span
            self._lose(position, found.position, after_ns, before_ns)
            self._number(messages)
            position = found.stop
            after_ns = after_ns if before_ns is None else last_ns
            self.damage.chunks += 1
        self._lose(position, self._salvage.size, after_ns, None)
        if not self.damage.chunks:
            raise FileError(f"{self._path}: {self._salvage.why_empty()}")
        self._channels, self._schemas = trusted_definitions(self._inside, self._outside)
        self._reckon()

    def write(self, output: Path, existing: Existing) -> None:
        """Write the new file."""
        place = OutputPath(output, existing)
        try:
            file = self._begin(place)
            for found in self._salvage.chunks():
                self._copy(found, file)
            file.close()
            place.settle()
        except OSError as error:
            place.discard()
            raise unwritable(output, error) from error
        except BaseException:
            place.discard()
            raise
        place.close()

    def _begin(self, place: OutputPath) -> McapFile:
        told = {
            "file": self._path.name,
            "library": library_name(),
            "lost.bytes": str(self.damage.lost_bytes),
            "lost.messages": "" if self.damage.missing is None else str(self.damage.missing),
        }
        told |= {f"lost.{n}": lost_text(gap) for n, gap in enumerate(self.damage.gaps[:100], 1)}
        header = self._outside.header
        library = header.library if header else library_name()
        file = McapFile(
            Stream(place.descriptor),
            library,
            Metadata(REPAIR_NAME, told),
            self._schemas.values(),
            self._channels.values(),
        )
        file.write_metadata(_without_doubles(self._outside.metadata))
        return file

    def _describe(self, found: FoundChunk) -> None:
        for opcode, body in records_in(found.records):
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._inside.update(opcode, body)

    def _lose(self, start: int, stop: int, after: int | None, before: int | None) -> None:
        for lost, end in self._salvage.between(start, stop, self._outside):
            self.damage.lose(lost, end, after, before)

    def _number(self, messages: UnpackedMessages) -> None:
        """Note how far each channel's messages are numbered, and how many of them there are."""
        for channel in np.unique(messages.batch.channels).tolist():
            own = messages.batch.channels == channel
            last = int(messages.sequences[own].max())
            known, count = self._numbers.get(channel, (0, 0))
            self._numbers[channel] = (max(known, last + 1), count + int(own.sum()))

    def _reckon(self) -> None:
        damage, channels = self.damage, self._channels
        numbers = self._numbers
        damage.messages = sum(count for id_, (_, count) in numbers.items() if id_ in channels)
        damage.undescribed = sum(
            count for id_, (_, count) in numbers.items() if id_ not in channels
        )
        gaps = sum(max(0, end - count) for end, count in numbers.values() if end < _SEQUENCES)
        damage.least_missing = gaps + damage.undescribed
        counted = _counted(self._outside.statistics)
        if counted is not None and counted >= damage.messages:
            damage.missing = counted - damage.messages

    def _copy(self, found: FoundChunk, file: McapFile) -> None:
        """Write a chunk as it is, or what is described of it, if anything is."""
        messages = messages_of(found.records)
        known = np.isin(messages.batch.channels, list(self._channels))
        if known.all() and len(known):
            first, last = messages.span
            chunk = replace(found.chunk, message_start_time=first, message_end_time=last)
            file.write_chunk(indexed(chunk, messages.batch))
        elif known.any():
            file.write_batch(messages.only(known))


def _counted(statistics: Statistics | None) -> int | None:
    """How many messages there were, where the statistics do not contradict themselves."""
    if statistics is None:
        return None
    each = sum(statistics.channel_message_counts.values())
    return each if each == statistics.message_count else None


def _without_doubles(metadata: list[Metadata]) -> list[Metadata]:
    """The records, those that say the same only once."""
    return [one for place, one in enumerate(metadata) if one not in metadata[:place]]
