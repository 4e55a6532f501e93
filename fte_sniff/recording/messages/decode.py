"""Decoder of message records into rows, many at once; the definitions that it reads them with.

Messages that fit a `Template` are checked and copied with numpy. The others, of rows with faults
and of damage mostly, are parsed by protobuf, one by one: that takes twenty times as long, so their
number is limited by the bytes that their chunk has in the file.

The first chunk and the summary hold the definitions. If both are damaged, this program knows all
but the ports: `Channels` numbers the topics of the first port from 1, those of the second port
after them, and so on. Where a file says which ports it has:

    metadata fte-sniff.ports   copies with a checksum, between the chunks
    channel records            in what is left of the summary: a dozen for each port, all alike
    metadata fte-sniff         the ports at the beginning, without a checksum
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache
from itertools import islice
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema
from mcap.well_known import MessageEncoding

from fte_sniff.errors import FileError, TranslatableText, listed
from fte_sniff.platform import read_at
from fte_sniff.protocol import FRAME_LENGTH, HEADERS, TAIL, Fault, PortEvent, PortEventKind
from fte_sniff.protocol.rows import NO_TIME, Array, Bools, Rows
from fte_sniff.recording.mcap.reader import (
    CHANNEL_OFFSET,
    HEAD,
    LOG_TIME_OFFSET,
    MESSAGE_HEAD,
    MessageIndex,
    RecordError,
    parse,
)
from fte_sniff.recording.mcap.writer import MOST_BETWEEN_COPIES
from fte_sniff.recording.messages.encode import Channels, port_metadata
from fte_sniff.recording.messages.schema import (
    EVENTS,
    FIRST_FIELDS,
    PACKAGE,
    REPEATED,
    TOPIC_BY_NAME,
    TOPICS,
    Template,
    enum_value_name,
    message_class,
    table_crc,
    templates_of,
)
from fte_sniff.recording.metadata import (
    PORTS_NAME,
    PortFacts,
    baud_in,
    ports_from_metadata,
    ports_in,
)

_GREATEST = 2**63 - 1
"""The largest offset, time and read delay: 64-bit columns hold no larger one."""

_LARGEST_MESSAGE = 64 * 1024

_INTEGERS = (
    FieldDescriptor.CPPTYPE_UINT64,
    FieldDescriptor.CPPTYPE_INT64,
    FieldDescriptor.CPPTYPE_UINT32,
    FieldDescriptor.CPPTYPE_INT32,
)
_TEXT = (FieldDescriptor.CPPTYPE_STRING,)
"""Protobuf has one C++ type for text and bytes."""
_ENUM = (FieldDescriptor.CPPTYPE_ENUM,)
_ROW_NEEDS = {"offset": _INTEGERS, "read_delay_ns": _INTEGERS, "raw": _TEXT, "faults": _ENUM}
_EVENT_NEEDS = {"kind": _ENUM, "detail": _TEXT}
"""The fields that a message must have, and their types."""


RowValues = tuple[int, int, int, bool, bool, tuple[Fault, ...], bytes]
"""Time, offset, read delay or `NO_TIME`, whether it is a frame, whether its order is uncertain,
faults and bytes of a row; a plain tuple, because it is made for each row with a fault."""


class MessageReader:
    """Reads the messages of one channel with the schema in the file."""

    def __init__(self, topic: str, port: str, schema: str, data: bytes) -> None:
        """Take the full name of the message and the serialized FileDescriptorSet.

        Raises FileError if the schema is unusable, or its messages lack fields of a row.
        """
        self.topic = topic
        self.port = port
        try:
            self._message = message_class(schema, data)
        except ValueError as error:
            raise FileError(
                "{topic}: {why}; the file is damaged or not fte-sniff's",
                topic=topic,
                why=reason_in(error),
            ) from error
        fields = self._message.DESCRIPTOR.fields_by_name
        needed = _EVENT_NEEDS if topic == EVENTS.name else _ROW_NEEDS
        lacking = sorted(
            name
            for name, types in needed.items()
            if name not in fields
            or fields[name].cpp_type not in types
            or (fields[name].default_value == []) != (name in REPEATED)
        )
        if lacking:
            raise FileError(
                "{topic}: its messages ({schema}) have no {lacking}; "
                "fte-sniff reads what fte-sniff records",
                topic=topic,
                schema=schema,
                lacking=listed(lacking),
            )
        is_event = topic == EVENTS.name
        self.templates = () if is_event else _templates_of(schema, data)
        """The layouts of most of its messages; the same object for channels of one schema."""
        self._members = _members_by_number(fields["kind" if is_event else "faults"])
        self._faults = lru_cache(maxsize=256)(self._faults_of)
        self._has_own_time, self._has_count = "time_ns" in fields, "count" in fields
        self._has_damage, self._has_order = "framed" in fields, "order_uncertain" in fields
        self.read: Callable[[bytes, int], RowValues | PortEvent]
        """Parse one message with its log time; raises ValueError if it does not fit its schema, or
        is not a valid row or event."""
        self.read = self._event if is_event else self._row

    def _row(self, data: bytes, log_time: int) -> RowValues:
        message = self._parse(data)
        raw, offset, delay_ns = message.raw, message.offset, NO_TIME
        framed = not self._has_damage or message.framed
        if not (_is_framed(raw) if framed else raw):
            what = TranslatableText("no frame") if framed else TranslatableText("no damage")
            raise RecordError("{what} in its {size} bytes", what=what, size=len(raw))
        if offset > _GREATEST:
            raise RecordError("offset {offset} is past the end of any stream", offset=offset)
        if message.HasField("read_delay_ns"):
            delay_ns = message.read_delay_ns
            if delay_ns > _GREATEST:
                raise RecordError("a message that does not fit its schema")
        faults = self._faults(tuple(message.faults[:]))
        unordered = self._has_order and message.order_uncertain
        time = self._time(message, log_time)
        return time, offset, delay_ns, framed, unordered, faults, raw

    def _faults_of(self, numbers: tuple[int, ...]) -> tuple[Fault, ...]:
        return tuple(Fault(self._member(number)) for number in numbers)

    def _event(self, data: bytes, log_time: int) -> PortEvent:
        message = self._parse(data)
        kind = PortEventKind(self._member(message.kind))
        count = message.count if self._has_count else 0
        return PortEvent(self._time(message, log_time), self.port, kind, message.detail, count)

    def _parse(self, data: bytes) -> Any:
        if len(data) > _LARGEST_MESSAGE:
            raise RecordError("{size} bytes, more than any row has", size=len(data))
        try:
            return self._message.FromString(data)
        except DecodeError as error:
            raise RecordError("a message that does not fit its schema") from error

    def _time(self, message: Any, log_time: int) -> int:
        own = self._has_own_time and message.HasField("time_ns")
        time = int(message.time_ns) if own else log_time
        if time > _GREATEST:
            raise RecordError("time {time} ns is past the year 2262", time=time)
        return time

    def _member(self, number: int) -> StrEnum:
        member = self._members.get(number)
        if member is None:
            raise RecordError(
                "a word that this version does not know (number {number})", number=number
            )
        return member


ChannelReader = MessageReader | str | None
"""The reader of a channel, or why its messages cannot be read; None for other topics."""


def reason_in(error: Exception) -> str:
    """Why a message or a schema cannot be read, translatable if possible."""
    text = error.args[0] if error.args else ""
    return text if isinstance(text, TranslatableText) else str(error)


@lru_cache(maxsize=64)
def _templates_of(schema: str, data: bytes) -> tuple[Template, ...]:
    return templates_of(message_class(schema, data).DESCRIPTOR)


def _is_framed(raw: bytes) -> bool:
    return len(raw) == FRAME_LENGTH and raw[0] in HEADERS.values() and raw[-1] == TAIL


def _members_by_number(field: Any) -> dict[int, StrEnum]:
    """The faults or event kinds of this version, by their numbers in the file's schema."""
    if field.enum_type is None:
        return {}
    known: type[StrEnum] = PortEventKind if field.name == "kind" else Fault
    members = {enum_value_name(known.__name__, one): one for one in known}
    values = field.enum_type.values
    return {value.number: members[value.name] for value in values if value.name in members}


_MOST_LOSSES = 20
_OTHER_LOSSES = TranslatableText("more could not be read")


class Losses(Counter[str]):
    """Unreadable messages by reason; beyond 20 different reasons, the others are one."""

    def append(self, text: str, count: int = 1) -> None:
        """Count a loss."""
        listed = text in self or len(self) < _MOST_LOSSES
        self[text if listed else _OTHER_LOSSES] += count

    def merge(self, other: Losses) -> None:
        """Count the losses of another counter."""
        for text, count in other.items():
            self.append(text, count)

    @property
    def lines(self) -> tuple[str, ...]:
        """One line for each text."""
        return tuple(
            text
            if count == 1
            else TranslatableText("{loss} ({count} times)", loss=text, count=count)
            for text, count in self.items()
        )


_RAW = np.dtype(f"V{FRAME_LENGTH}")
"""A frame as one opaque value, which numpy copies at once."""

_PER_SLOW_MESSAGE = 2
"""One in this number of the records that a chunk can hold may be parsed alone."""


class ParseBudget:
    """How many messages may be parsed one by one, of each of some concatenated chunks.

    A chunk has its own share, so that a hostile chunk does not cost the rows of the next one.
    """

    def __init__(self, sizes: Sequence[int], most: Sequence[int]) -> None:
        """Take the bytes of each unpacked chunk, and the number of records that it can hold."""
        self._ends = np.cumsum(sizes)
        self._left = np.array(most) // _PER_SLOW_MESSAGE

    def spend(self, starts: Array) -> Bools:
        """A mask of the messages with these starts, rising, that may be parsed."""
        chunks = np.searchsorted(self._ends, starts, "right")
        counts = np.bincount(chunks, minlength=len(self._left))
        numbers = np.arange(len(starts)) - (np.cumsum(counts) - counts)[chunks]
        found: Bools = numbers < self._left[chunks]
        self._left -= np.minimum(counts, self._left)
        return found


@dataclass(slots=True)
class DecodedColumns:
    """The rows and events of some messages."""

    columns: Rows
    messages: int
    """Number of messages, of any topic."""
    times: tuple[int, int] | None
    """First and last log time of fte-sniff's messages."""
    losses: Losses


def decode_columns(
    messages: MessageIndex,
    reader_of: Callable[[int], ChannelReader],
    columns: Rows,
    budget: ParseBudget,
) -> DecodedColumns:
    """Decode the messages of one or more unpacked chunks, in their order.

    `reader_of` takes a channel id. `columns` are blank, with a row for each message. `budget` is
    that of the chunks.
    """
    return _Decoder(messages, reader_of, columns, budget).decode()


class _Decoder:
    def __init__(
        self,
        messages: MessageIndex,
        reader_of: Callable[[int], ChannelReader],
        columns: Rows,
        budget: ParseBudget,
    ) -> None:
        self._messages, self._reader_of, self._columns = messages, reader_of, columns
        self._budget = budget
        self._kept = np.ones(len(messages), np.bool_)
        self._events: list[tuple[int, PortEvent]] = []
        self._by_channel: dict[int, MessageReader] = {}
        self._losses = Losses()
        self._channels = messages.field(CHANNEL_OFFSET, "<u2").astype(np.intp)
        self._log_times = messages.field(LOG_TIME_OFFSET, "<i8").copy()

    def decode(self) -> DecodedColumns:
        self._fill()
        for reader, rows in self._by_schema():
            others = self._fit(reader.templates, rows)
            if len(others):
                self._parse(others)
        own = self._log_times if self._kept.all() else self._log_times[self._kept]
        logged = own.view(np.uint64)
        times = (int(logged.min()), int(logged.max())) if len(logged) else None
        self._events.sort(key=lambda numbered: numbered[0])
        events = tuple(event for _, event in self._events)
        self._kept[[row for row, _ in self._events]] = False
        whole = bool(self._kept.all())
        columns = self._columns.select(slice(None) if whole else self._kept, events)
        return DecodedColumns(columns, len(self._messages), times, self._losses)

    def _fill(self) -> None:
        """Fill the columns as if every message fitted a template."""
        columns, messages = self._columns, self._messages
        columns.t_ns[:] = self._log_times
        columns.offset[:] = messages.field(MESSAGE_HEAD + FIRST_FIELDS["offset"], "<i8")
        columns.delay_ns[:] = messages.field(MESSAGE_HEAD + FIRST_FIELDS["read_delay_ns"], "<i8")
        columns.raw.view(_RAW).reshape(-1)[:] = messages.field(
            MESSAGE_HEAD + FIRST_FIELDS["raw"], _RAW
        )

    def _by_schema(self) -> Iterator[tuple[MessageReader, Array]]:
        """A reader of each schema, and the rows of all its channels; sets the ports."""
        counts = np.bincount(self._channels, minlength=1)
        present = np.flatnonzero(counts).tolist()
        groups: dict[int, list[int]] = {}
        ports = np.zeros(len(counts), np.uint16)
        for channel in present:
            reader = self._reader_of(channel)
            if isinstance(reader, MessageReader):
                self._by_channel[channel] = reader
                groups.setdefault(id(reader.templates or reader), []).append(channel)
                ports[channel] = self._columns.codebook.port_code(reader.port)
            elif reader is not None:
                self._losses.append(reader, int(counts[channel]))
        self._columns.port[:] = ports.take(self._channels)
        codes = np.full(len(counts), len(groups), _code_type(len(groups)))
        for code, channels in enumerate(groups.values()):
            codes[channels] = code
        if len(groups) == 1 and len(self._by_channel) == len(present):
            by_code = np.arange(len(self._messages))
        else:
            by_code = np.argsort(codes.take(self._channels), kind="stable")
        first = 0
        for channels in groups.values():
            end = first + int(counts[channels].sum())
            yield self._by_channel[channels[0]], by_code[first:end]
            first = end
        self._kept[by_code[first:]] = False

    def _fit(self, templates: tuple[Template, ...], rows: Array) -> Array:
        """Complete the columns of the messages that fit a template; returns the other rows."""
        messages, columns = self._messages, self._columns
        lengths = messages.lengths.take(rows)
        fit = np.zeros(len(rows), np.bool_)
        for template in templates:
            at = np.flatnonzero(lengths == template.length)
            if not len(at):
                continue
            own = rows.take(at)
            starts = messages.starts.take(own) + MESSAGE_HEAD
            fit[at] = template.fitting(messages.records, starts)
            if "order_uncertain" in template:
                values = np.frombuffer(messages.records, np.bool_)
                columns.unordered[own] = values[starts + template.offset_of("order_uncertain")]
        # A time past the year 2262 is negative in the column.
        fit &= self._log_times.take(rows) >= 0
        return rows[~fit]

    def _parse(self, rows: Array) -> None:
        """Parse the messages of some rows one by one, as many as their chunks may have."""
        within = self._budget.spend(self._messages.starts.take(rows))
        if not within.all():
            too_many = rows[~within]
            self._kept[too_many] = False
            text = TranslatableText("messages that take too long to decode, for their size")
            self._losses.append(text, len(too_many))
            rows = rows[within]
        messages, codebook = self._messages, self._columns.codebook
        starts = messages.starts.take(rows) + MESSAGE_HEAD
        stops = starts + messages.lengths.take(rows)
        times = self._log_times.take(rows).view(np.uint64)
        found: list[RowValues] = []
        at: list[int] = []
        codes: list[int] = []
        columns = rows, self._channels.take(rows), starts, stops, times
        for row, channel, start, stop, time in zip(*(c.tolist() for c in columns), strict=True):
            reader = self._by_channel[channel]
            try:
                entry = reader.read(messages.records[start:stop], time)
                if isinstance(entry, PortEvent):
                    self._events.append((row, entry))
                    continue
                codes.append(codebook.fault_code(entry[5]))
            except ValueError as error:
                self._kept[row] = False
                why = reason_in(error)
                self._losses.append(TranslatableText("{topic}: {why}", topic=reader.topic, why=why))
                continue
            at.append(row)
            found.append(entry)
        if found:
            self._store(at, found, codes)

    def _store(self, at: list[int], found: list[RowValues], codes: list[int]) -> None:
        columns = self._columns
        t_ns, offsets, delays, framed, unordered, _, raws = zip(*found, strict=True)
        columns.t_ns[at], columns.offset[at], columns.delay_ns[at] = t_ns, offsets, delays
        columns.framed[at], columns.unordered[at] = framed, unordered
        columns.length[at] = lengths = list(map(len, raws))
        columns.faults[at] = codes
        first = b"".join([raw[:FRAME_LENGTH].ljust(FRAME_LENGTH, b"\0") for raw in raws])
        columns.raw[at] = np.frombuffer(first, np.uint8).reshape(-1, FRAME_LENGTH)
        if max(lengths) > FRAME_LENGTH:
            long = zip(at, raws, strict=True)
            columns.long.update((row, raw) for row, raw in long if len(raw) > FRAME_LENGTH)


def _code_type(codes: int) -> type[np.unsignedinteger[Any]]:
    """The shortest type for one code more: numpy sorts it in the fewest passes."""
    return np.uint8 if codes < 2**8 else np.uint32


_MOST_DEFINITIONS = 2048
"""Changes of the definitions in one file."""
_SEARCHED = 2 * MOST_BETWEEN_COPIES
"""Bytes that are searched at the beginning and at the end of a file."""
_LONGEST = 1024 * 1024
"""Bytes of the longest record that is searched for."""
_RECORD = re.compile(
    # Opcode, a length below 16 MB, and the start of the record.
    rb"\x0c...\0{5}\x0f\0{3}fte-sniff\.ports|\x04...\0{5}....[\x05-\x40]\0{3}/fte/",
    re.DOTALL,
)
_MOST_RECORDS = 4096
"""Such records that are read of each end, so that a hostile file does not take long."""
_LEAST_ALIKE = 3
"""Channel records of a port that must agree: one damaged sector does not make three alike."""
_MOST_PORTS = 2**16 // len(TOPICS)
_CHANNELS = Channels().of_port(PortFacts(""))
"""Those of one port, whose numbers begin at 1."""


Definitions = Mapping[tuple[type[Schema | Channel], int], tuple[Schema | Channel, bool]]
"""Definitions by class and id, each with whether a checksum protects it."""

NOTHING: Definitions = {}


class ChannelReaders:
    """The definitions of a recording, and the reader of each channel.

    A definition that a checksum protects takes precedence over one of the same id without. Threads
    may read while one thread defines; what they read is then of no single version.
    """

    def __init__(
        self,
        port_of: Callable[[Channel], str],
        known: Definitions = NOTHING,
        lost: Callable[[int], tuple[Channel, Schema] | None] = lambda _channel_id: None,
    ) -> None:
        """Take the port's name for a channel, the definitions so far, and those of a channel that
        the file does not define, by its id.
        """
        self._port_of, self._lost = port_of, lost
        self._known = dict(known)
        self._readers: dict[int, ChannelReader] = {}
        self._updates = 0
        self.version = 0
        """Rises with every change of the definitions."""

    def update(self, opcode: int, body: bytes, *, trusted: bool) -> None:
        """Apply a schema or channel record.

        Raises RecordError if it is damaged, or there are too many.
        """
        definition = parse(Schema if opcode == Opcode.SCHEMA else Channel, body)
        known, _ = self._known.get((type(definition), definition.id), (None, False))
        if known != definition and _costs(definition, known):
            if self._updates >= _MOST_DEFINITIONS:
                raise RecordError("more definitions than a recording has")
            self._updates += 1
        self.define(definition, trusted=trusted)

    def define(self, definition: Schema | Channel, *, trusted: bool) -> None:
        """Apply a definition; `trusted` if a checksum protects it."""
        key = type(definition), definition.id
        known, was_trusted = self._known.get(key, (None, False))
        if known == definition:
            self._known[key] = definition, trusted or was_trusted
        elif trusted or not was_trusted:
            self._known[key] = definition, trusted
            self._readers = {}
            self.version += 1

    @property
    def definitions(self) -> Definitions:
        """A copy of the definitions so far."""
        return dict(self._known)

    @property
    def channels(self) -> list[Channel]:
        """The channels that are defined so far."""
        return [one for one, _ in self._known.values() if isinstance(one, Channel)]

    def get(self, channel_id: int) -> ChannelReader:
        """The reader of a channel."""
        readers = self._readers
        if channel_id not in readers:
            readers[channel_id] = self._reader_of(channel_id)
        return readers[channel_id]

    def _reader_of(self, channel_id: int) -> ChannelReader:
        channel, _ = self._known.get((Channel, channel_id), (None, False))
        schema: object = None
        if isinstance(channel, Channel):
            schema, _ = self._known.get((Schema, channel.schema_id), (None, False))
        if schema is None and (lost := self._lost(channel_id)):
            channel, schema = lost if channel is None else (channel, lost[1])
        if not isinstance(channel, Channel):
            return TranslatableText(
                "messages of channel {channel}, which has no description in the file",
                channel=channel_id,
            )
        if channel.topic not in TOPIC_BY_NAME:
            return None
        if channel.message_encoding != MessageEncoding.Protobuf or not isinstance(schema, Schema):
            encoding = channel.message_encoding if schema else "without schema"
            return TranslatableText(
                "{topic} is {encoding}; fte-sniff reads protobuf with schema",
                topic=channel.topic,
                encoding=repr(encoding),
            )
        try:
            return MessageReader(channel.topic, self._port_of(channel), schema.name, schema.data)
        except FileError as error:
            return error.message


def _costs(definition: Schema | Channel, known: object) -> bool:
    """True if rows may be read with the definition."""
    if isinstance(definition, Schema):
        return known is not None or definition.name.startswith(f"{PACKAGE}.")
    return definition.topic in TOPIC_BY_NAME


class ChannelDefinition(NamedTuple):
    """A channel and its schema."""

    channel: Channel
    schema: Schema


class LostDefinitions:
    """The channels of a file as this program numbers them."""

    def __init__(self, known: Mapping[int, PortFacts], named: Mapping[int, PortFacts]) -> None:
        """Take the ports by number, from 0: those that are certain, and others.

        A port of neither is named by its number.
        """
        self._known, self._named = known, named
        self._schemas = {schema.id: schema for schema in Channels().schemas()}
        self._asked: set[int] = set()

    @property
    def ports(self) -> list[PortFacts]:
        """The ports that the file names."""
        ports = {**self._named, **self._known}
        return [ports[number] for number in sorted(ports)]

    def get(self, channel_id: int) -> ChannelDefinition | None:
        """The definition of a channel; None if this program does not write such a number."""
        number = (channel_id - 1) // len(TOPICS)
        if not 0 <= number < _MOST_PORTS:
            return None
        self._asked.add(channel_id)
        unnamed = PortFacts(f"port {number + 1}")
        port = self._known.get(number) or self._named.get(number) or unnamed
        channel = _channel_of(port, channel_id)
        return ChannelDefinition(channel, self._schemas[channel.schema_id])

    def doubts(self, defined: Mapping[int, object]) -> list[TranslatableText]:
        """What is not certain about the channels that were used and that no chunk defined."""
        numbers = {(id_ - 1) // len(TOPICS) for id_ in self._asked if id_ not in defined}
        doubtful = sorted(numbers - self._known.keys())
        lost = [number for number in doubtful if number not in self._named]
        found = []
        if len(lost) < len(doubtful):
            found.append(
                TranslatableText(
                    "the names of the ports are from a record that no checksum protects"
                )
            )
        if lost:
            found.append(
                TranslatableText(
                    "the names of {count} ports are lost; their rows have the names 'port N'",
                    count=len(lost),
                )
            )
        return found


def _channel_of(port: PortFacts, channel_id: int) -> Channel:
    like = _CHANNELS[(channel_id - 1) % len(TOPICS)]
    return replace(like, id=channel_id, metadata=port_metadata(port))


def lost_definitions(
    stream: BinaryIO, facts: Mapping[str, str], *, is_ours: bool
) -> LostDefinitions | None:
    """What can be found of the ports of a file whose summary is not certain.

    `facts` are those of its own metadata record, `is_ours` whether its header names this program.
    None if nothing shows that this program wrote it.
    """
    copies: list[PortFacts] = []
    channels: dict[int, Channel] = {}
    for record in _records_in(stream):
        if isinstance(record, Channel):
            channels[record.id] = record
        elif record.name == PORTS_NAME:
            copies = max(copies, ports_from_metadata(record.metadata, table_crc()), key=len)
    known = {**_agreed_ports(channels), **dict(enumerate(copies))}
    if not known and not is_ours:
        return None
    return LostDefinitions(known, dict(enumerate(ports_in(facts))))


def _agreed_ports(channels: Mapping[int, Channel]) -> dict[int, PortFacts]:
    """The ports, by number, of which enough channels agree with each other and with the table."""
    votes: dict[int, Counter[PortFacts]] = {}
    for id_, channel in channels.items():
        number = (id_ - 1) // len(TOPICS)
        facts = channel.metadata
        port = PortFacts(facts.get("port", ""), baud_in(facts.get("baud", "")))
        if number >= 0 and channel == _channel_of(port, id_):
            votes.setdefault(number, Counter())[port] += 1
    best = {number: ports.most_common(1)[0] for number, ports in votes.items()}
    return {number: port for number, (port, count) in best.items() if count >= _LEAST_ALIKE}


def _records_in(stream: BinaryIO) -> Iterator[Channel | Metadata]:
    """The channel records and copies of the ports at the beginning and end of a file."""
    size = os.fstat(stream.fileno()).st_size
    for start in sorted({0, max(0, size - _SEARCHED)}):
        data = read_at(stream.fileno(), min(size, _SEARCHED), start)
        for found in islice(_RECORD.finditer(data), _MOST_RECORDS):
            opcode, length = HEAD.unpack_from(data, found.start())
            first = found.start() + HEAD.size
            body = data[first : first + min(length, _LONGEST)]
            with suppress(RecordError):
                yield parse(Metadata, body) if opcode == Opcode.METADATA else parse(Channel, body)
