"""Recording: the rows, port events and gaps of one MCAP file.

    chunks     c1   c2   c3 (damaged)   c4          `contents_of`, `walk`
    batches    [c1  c2   c3]            [c4]        a thread unpacks ahead, numpy decodes
    items      Rows PortEvent Rows  Gap  Rows       in file order

`grow` finds the chunks that another program added; `read` reads chunks again.
"""

from __future__ import annotations

import os
import re
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache, partial
from glob import escape
from itertools import accumulate, groupby
from operator import itemgetter
from pathlib import Path
from typing import BinaryIO, Final, TypeAlias

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel
from mcap.well_known import MessageEncoding
from zstandard import ZstdDecompressor

from fte_sniff.ahead import ahead
from fte_sniff.errors import FileError, TranslatableText, listed, unreadable
from fte_sniff.platform import is_locked, read_at
from fte_sniff.protocol.items import Gap, GapKind, PortEvent
from fte_sniff.protocol.rows import Array, Bools, Item, Rows
from fte_sniff.recording.chunks import (
    HEAD,
    MAGIC,
    ChunkRef,
    DamagedError,
    LostBytes,
    contents_of,
    records_in,
    unpack,
    walk,
)
from fte_sniff.recording.metadata import (
    PROGRAM,
    PortFacts,
    Selection,
    gap_from_metadata,
    number_in,
    selection_from_metadata,
)
from fte_sniff.recording.schema import (
    EVENTS,
    TOPIC_BY_NAME,
    TOPICS,
    message_class,
    schema_data,
    schema_name,
)
from fte_sniff.recording.skeletons import (
    LONGEST,
    MESSAGE_HEAD,
    MessageDecoder,
    Messages,
    MessageType,
    at_every_byte,
)

BATCH: Final = 2 * 1024 * 1024
"""Unpacked bytes of a batch, about; a chunk of more than half of them is not copied into one."""
_SPAN: Final = 2 * BATCH
"""Bytes of the file that a batch begins in; they are read at once, also what lies between."""
_MOST_TOPICS: Final = 10
_MOST_LOSSES: Final = 10
_MOST_SCANNED: Final = 4 * 1024 * 1024
"""Bytes of chunks that are scanned for messages, which takes a multiple of them in memory."""
_PASSES: Final = 3
"""Attempts to find the heads of messages among the places that look like one."""


@dataclass(frozen=True, slots=True)
class TimeRange:
    """A range of time, nanoseconds since 1970 UTC, without its end."""

    first_ns: int = 0
    end_ns: int = 2**63 - 1

    def overlaps(self, first_ns: int, last_ns: int) -> bool:
        """Whether the range overlaps the time from `first_ns` to `last_ns`, both included."""
        return self.first_ns <= last_ns and first_ns < self.end_ns

    def mask(self, t_ns: Array) -> Bools:
        """Which times are in the range."""
        found: Bools = (t_ns >= self.first_ns) & (t_ns < self.end_ns)
        return found

    def within(self, items: Iterable[Item]) -> Iterator[Item]:
        """The rows and events of items in the range, and the gaps."""
        for item in items:
            if isinstance(item, Rows) and self != EVERYTHING:
                rows = item.select(self.mask(item.t_ns))
                yield from [rows] if len(rows) else []
            elif not isinstance(item, PortEvent) or self.overlaps(item.t_ns, item.t_ns):
                yield item


EVERYTHING: Final = TimeRange()

_Group: TypeAlias = Sequence[ChunkRef | LostBytes]
"""The chunks of a batch, and the lost bytes between them."""


class Recording:
    """One recording."""

    def __init__(self, path: Path, *, is_growing: bool = False) -> None:
        """Find the chunks of a file.

        Another program may write a file that `is_growing`. Raises FileError if it cannot be read,
        is not an MCAP file, or has no topics of this program.
        """
        self.path = path
        self._decoder = MessageDecoder()
        self._has_rows = False
        with self._open() as file:
            self._found = os.fstat(file.fileno())
            self.contents = walk(file, is_growing=True) if is_growing else contents_of(file)
            # Without a summary, only the chunks have the definitions.
            first = [] if self.contents.is_indexed else self.contents.chunks[:1]
            self._define_from(_messages_of(first, _unpacked(file.fileno(), first)))
            self._check(file, is_growing=is_growing)

    # What the file reports about itself

    @property
    def ports(self) -> list[PortFacts]:
        """The ports of its channels, each once."""
        channels = [one for one in self.contents.channels.values() if _is_ours(one)]
        facts = {self._port_of(one.id): one.metadata.get("baud", "") for one in channels}
        return [PortFacts(name, number_in(baud)) for name, baud in facts.items()]

    @property
    def facts(self) -> dict[str, str]:
        """The file's own metadata record: host, clock, ports, and its part of the capture."""
        own = [one.metadata for one in self.contents.metadata if one.name == PROGRAM]
        return own[-1] if own else {}

    @property
    def count(self) -> int | None:
        """The number of messages, as the file claims; None if it does not."""
        statistics = self.contents.statistics
        return statistics.message_count if statistics else None

    @property
    def times(self) -> tuple[int, int] | None:
        """The first and the last log time of its chunks; None without chunks."""
        chunks = self.contents.chunks
        if not chunks:
            return None
        return min(one.first_ns for one in chunks), max(one.last_ns for one in chunks)

    def gaps(self) -> list[Gap]:
        """The gaps that the file's metadata reports."""
        found = [gap_from_metadata(one.name, one.metadata) for one in self.contents.metadata]
        return list(dict.fromkeys(gap for gap in found if gap is not None))

    def selections(self) -> list[Selection]:
        """The filters that selected the rows of the file."""
        found = [selection_from_metadata(one.name, one.metadata) for one in self.contents.metadata]
        return [selection for selection in found if selection is not None]

    @property
    def is_whole(self) -> bool:
        """Whether it has a summary, and everything that was read so far is intact."""
        return self.contents.is_indexed and not self.losses

    @property
    def losses(self) -> list[str]:
        """What could not be read so far, one line each."""
        lines: list[str] = [
            TranslatableText("bytes {start} to {stop} could not be read: {why}", **lost._asdict())
            for lost in sorted(self.contents.lost)
        ]
        more = len(lines) - _MOST_LOSSES
        if more > 0:
            lines[_MOST_LOSSES:] = [TranslatableText("{count} more damaged spans", count=more)]
        return lines

    # Reading

    def items(self, span: TimeRange = EVERYTHING) -> Iterator[Item]:
        """The rows, port events and gaps in file order; a gap that the metadata reports by time.

        The chunks outside `span`, by their log times, are skipped: damage in them is not noticed.
        Raises FileError if the file cannot be read any more.
        """
        gaps = deque(sorted(self.gaps(), key=lambda gap: gap.start_ns or 0))
        for item in self.read(self.contents.chunks, span):
            rest = item
            while isinstance(rest, Rows) and gaps and len(rest):
                rising = np.maximum.accumulate(rest.t_ns)
                place = int(rising.searchsorted(gaps[0].start_ns or 0))
                if place == len(rest):
                    break
                yield from [rest[:place]] if place else []
                yield gaps.popleft()
                rest = rest[place:]
            yield rest
        yield from gaps

    def read(self, chunks: Sequence[ChunkRef], span: TimeRange = EVERYTHING) -> Iterator[Item]:
        """The rows and port events of some chunks in a span, and gaps where the file is damaged.

        Raises FileError if the file cannot be read any more.
        """
        within = {one.start: one for one in chunks if span.overlaps(one.first_ns, one.last_ns)}
        first, last = min(within, default=0), max(within, default=0)
        lost = {one.start: one for one in self.contents.lost if first < one.start < last}
        groups = [*_groups([one for _, one in sorted((lost | within).items())])]
        then = ahead if len(groups) > 1 else iter  # a file that grows has one new group
        with self._open() as file:
            parts = map(partial(_unpacked, file.fileno()), groups)
            for items in map(self._items_of, groups, then(map(_messages_of, groups, then(parts)))):
                yield from span.within(items)

    def grow(self, *, is_over: bool = False) -> list[ChunkRef]:
        """The chunks that another program added since the previous call.

        If nobody writes the file any more (`is_over`), those behind damage too.

        Raises FileError if the file was deleted, replaced or cut off.
        """
        contents, last = self.contents, self.contents.chunks[-1:]
        with self._open() as file:
            before, self._found = self._found, os.fstat(file.fileno())
            is_same, size = os.path.samestat(before, self._found), self._found.st_size
            if not is_same or size < sum(one.stop for one in last):
                raise FileError(
                    "{path} was replaced by another file, or cut off, while it was followed",
                    path=self.path,
                )
            if size == before.st_size and not is_over:
                return []
            added = walk(file, sum(one.start for one in last), is_growing=not is_over)
        contents.chunks += added.chunks[len(last) :]
        contents.metadata += [one for one in added.metadata if one not in contents.metadata]
        contents.lost |= added.lost
        contents.schemas |= added.schemas
        contents.channels |= added.channels
        return added.chunks[len(last) :]

    def is_intact(self) -> bool:
        """Whether all of the file can be read, also what a summary does not list."""
        with self._open() as file:
            self.contents.lost |= walk(file).lost
        for _ in self.items():
            pass
        return self.is_whole

    @property
    def has_writer(self) -> bool:
        """Whether a program holds the writer's lock; False also where locks do not work."""
        with self._open() as file:
            return is_locked(file.fileno())

    def find_next(self) -> Path | None:
        """The next file of the capture: that of the next number, whose metadata names this one."""
        stem, number = self.path.stem, number_in(self.facts.get("part", "1")) or 0
        if "part" in self.facts:
            stem = re.sub(r"_\d+(-\d+)?$", "", stem)
        numbered = f"{escape(stem)}_{number + 1:05}*{self.path.suffix}"
        own = self.path.name, self.facts.get("start")
        for path in sorted(self.path.parent.glob(numbered)):
            with suppress(FileError):
                facts = Recording(path, is_growing=True).facts
                if (facts.get("previous"), facts.get("start")) == own:
                    return path
        return None

    @property
    def nothing_read(self) -> FileError | None:
        """Why no row was read, although the file has data; None if one was, or it has none."""
        if self._has_rows or not self.losses:
            return None
        return FileError(
            "{path}: no row in it could be read, although it has data: {why}",
            path=self.path,
            why=self.losses[0],
        )

    # Decoding

    def _items_of(self, group: _Group, parts: list[Messages | LostBytes]) -> Iterator[Item]:
        """The rows, port events and gaps of a group that was unpacked."""
        for part in parts:
            if isinstance(part, Messages):
                yield from self._decode(group, part)
                continue
            self.contents.lost.add(part)
            yield Gap(GapKind.DAMAGE, reason=part.why)

    def _decode(self, group: _Group, messages: Messages) -> Iterator[Item]:
        """The rows and port events of consecutive chunks of a group."""
        self._define_from([messages] if not self.contents.is_indexed else ())
        used = np.flatnonzero(np.bincount(messages.channels)).tolist()
        channels = {id_: own for id_ in used if (own := self._channel(id_)) is not None}
        found = self._decoder.decode(messages, channels)
        if found.unreadable:
            why = TranslatableText("{count} messages", count=found.unreadable)
            self.contents.lost.add(LostBytes(group[0].start, group[-1].stop, why))
        self._has_rows |= bool(len(found.rows))
        done = 0
        for place, event in sorted(found.events.items(), key=itemgetter(0)):
            before = int(found.places.searchsorted(place))
            yield from [found.rows[done:before]] if before > done else []
            yield event
            done = before
        yield from [found.rows[done:]] if done < len(found.rows) else []

    def _define_from(self, parts: Iterable[Messages | LostBytes]) -> None:
        """Apply the definitions at the beginning of chunks, which have a checksum."""
        for one in parts:
            if isinstance(one, Messages):
                records = one.records[: one.starts[0] if len(one.starts) else None]
                for opcode, at, stop in records_in(records):
                    self.contents.define(opcode, records[at + HEAD.size : stop])

    def _channel(self, id_: int) -> tuple[MessageType, str] | None:
        """The message type and the port of a channel; None if it is not one of ours.

        A definition that is lost is that of this program, which numbers the channels of each port.
        """
        channel = self.contents.channels.get(id_)
        schema = None
        if channel is not None and _is_ours(channel):
            topic = TOPIC_BY_NAME[channel.topic]
            schema = self.contents.schemas.get(channel.schema_id)
        elif id_ and self._is_own:
            topic = TOPICS[(id_ - 1) % len(TOPICS)]
        else:
            return None
        with suppress(ValueError):
            if schema is not None:
                return _type_of(schema.name, schema.data), self._port_of(id_)
        return _type_of(schema_name(topic), schema_data(topic.schema)), self._port_of(id_)

    def _port_of(self, id_: int) -> str:
        """The port of a channel, or by the channel's number."""
        channel, number = self.contents.channels.get(id_), (id_ - 1) // len(TOPICS) + 1
        if channel is not None and "port" in channel.metadata:
            return channel.metadata["port"]
        if not self._is_own:
            return self.path.name
        return self.facts.get(f"port.{number}.name", f"port {number}")

    @property
    def _is_own(self) -> bool:
        """Whether this program wrote the file, as far as its header is left."""
        return self.contents.library.startswith(PROGRAM[: len(self.contents.library)])

    # The file

    @contextmanager
    def _open(self) -> Iterator[BinaryIO]:
        try:
            with self.path.open("rb") as stream:
                yield stream
        except OSError as error:
            raise unreadable(self.path, error) from error

    def _check(self, file: BinaryIO, *, is_growing: bool) -> None:
        """Raise FileError unless a file has, or may have had, topics of this program."""
        start = file.read(len(MAGIC))
        if not start:
            raise FileError("{path} is empty; there is nothing to read", path=self.path)
        if start != MAGIC and not walk(file).chunks:
            raise FileError(
                "{path} is not an MCAP recording; make one of a log: "
                "`fte-sniff decode --input hex LOG -o NAME.mcap`, or --input raw for raw bytes",
                path=self.path,
            )
        channels = self.contents.channels.values()
        may_grow = is_growing or bool(self.contents.lost)
        if self.contents.library.startswith(PROGRAM) or (may_grow and not channels):
            return
        if not any(map(_is_ours, channels)):
            names = [*map(repr, sorted({one.topic for one in channels}))]
            names[_MOST_TOPICS:] = ["..."] * (len(names) > _MOST_TOPICS)
            raise FileError(
                "{path} is an MCAP, but has no topics of fte-sniff (/fte/...): it has {topics}; if "
                "one of them has serial bytes, name it with --topic",
                path=self.path,
                topics=listed(names) or TranslatableText("no topics at all"),
            )


def _is_ours(channel: Channel) -> bool:
    return channel.message_encoding == MessageEncoding.Protobuf and channel.topic in TOPIC_BY_NAME


@lru_cache(maxsize=64)
def _type_of(name: str, data: bytes) -> MessageType:
    """The messages of a schema; raises ValueError if it is not a usable one of ours."""
    own = message_class(name, data)
    names = {field.number: field.name for field in own.DESCRIPTOR.fields}
    is_event = name == schema_name(EVENTS)
    if not is_event and "raw" not in names.values():
        raise ValueError(f"{name} has no bytes")
    return MessageType(own.FromString, names, is_event)


def _groups(chunks: _Group) -> Iterator[_Group]:
    """Consecutive chunks of a batch, near each other, and the lost bytes between them."""
    sizes = [one.size if isinstance(one, ChunkRef) else 0 for one in chunks]
    keys = (
        (before // BATCH, before * (2 * size > BATCH), one.start // _SPAN)
        for before, size, one in zip(accumulate(sizes, initial=0), sizes, chunks, strict=False)
    )
    return ([*own] for _, own in groupby(chunks, lambda _: next(keys)))


def _unpacked(descriptor: int, group: _Group) -> list[bytes | LostBytes]:
    """Read and unpack the records of chunks."""
    zstd = ZstdDecompressor()
    start = min((one.start for one in group), default=0)
    stop = max((one.stop for one in group if isinstance(one, ChunkRef)), default=start)
    data = memoryview(read_at(descriptor, stop - start, start))
    return [_read(data[one.start - start : one.stop - start], one, zstd) for one in group]


def _messages_of(group: _Group, parts: Sequence[bytes | LostBytes]) -> list[Messages | LostBytes]:
    """The messages of chunks that were unpacked; those of a batch together, if nothing is lost."""
    whole = [part for part in parts if not isinstance(part, LostBytes)]
    if len(whole) == len(parts) and (found := _tiled(b"".join(whole))) is not None:
        return [found]
    return [_messages_in(*pair) for pair in zip(group, parts, strict=True)]


def _read(data: memoryview, one: ChunkRef | LostBytes, zstd: ZstdDecompressor) -> bytes | LostBytes:
    """Unpack the records of a chunk."""
    if isinstance(one, LostBytes):
        return one
    try:
        return unpack(data[HEAD.size :], zstd)
    except DamagedError as error:
        return LostBytes(one.start, one.stop, error.args[0])


def _messages_in(one: ChunkRef | LostBytes, part: bytes | LostBytes) -> Messages | LostBytes:
    """The messages of a chunk that was read."""
    if isinstance(part, LostBytes):
        return part
    try:
        return _tiled(part) or _walked(part)
    except DamagedError as error:
        return LostBytes(one.start, one.stop, error.args[0])


def _tiled(records: bytes) -> Messages | None:
    """The messages, if they tile the records behind the definitions; None if they do not."""
    if len(records) > _MOST_SCANNED:
        return None
    smallest = MESSAGE_HEAD - HEAD.size
    with suppress(DamagedError, StopIteration):
        first = next(at for code, at, _ in records_in(records) if code == Opcode.MESSAGE)
        values = np.frombuffer(records, np.uint8)[first : max(first, len(records) - smallest)]
        # An enum costs numpy another type.
        starts = first + np.flatnonzero(values == int(Opcode.MESSAGE))
        sizes = at_every_byte(records, 8)[starts + 1].view("<i8")
        seem = np.flatnonzero((sizes >= smallest) & (sizes < LONGEST))
        starts = starts[seem]
        stops = starts + sizes[seem] + HEAD.size
        for _ in range(_PASSES):
            if np.array_equal(np.append(starts, len(records)), np.append(first, stops)):
                return Messages.at(starts, records)
            # Heads are where the record before ends; the others are in the bytes of messages.
            is_stop = np.zeros(len(records) + LONGEST + HEAD.size, np.bool_)
            is_stop[stops] = is_stop[first] = True
            starts, stops = starts[is_stop[starts]], stops[is_stop[starts]]
    return None


def _walked(records: bytes) -> Messages:
    """The messages among some records; raises DamagedError if a record is cut."""
    own = [
        at
        for opcode, at, stop in records_in(records)
        if opcode == Opcode.MESSAGE and stop - at >= MESSAGE_HEAD
    ]
    return Messages.at(np.array(own, np.int64), records)
