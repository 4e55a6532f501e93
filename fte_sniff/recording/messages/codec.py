"""One row to one message by protobuf, and back; the readers of a recording's channels.

Reads the messages of any schema with the fields of a row; writes the rows and events that have no
fixed layout.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import StrEnum
from functools import cache, lru_cache
from math import nan
from typing import Any

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding

from fte_sniff.errors import FileError, TranslatableText, listed
from fte_sniff.protocol import (
    FRAME_LENGTH,
    HEADERS,
    KIND_BY_NAME,
    TAIL,
    Damage,
    Fault,
    Frame,
    PortEvent,
    PortEventKind,
    Row,
    Status,
)
from fte_sniff.recording.mcap.records import RecordError, parse
from fte_sniff.recording.messages.schema import (
    EVENTS,
    MALFORMED,
    PACKAGE,
    REPEATED,
    TOPIC_BY_NAME,
    Topic,
    enum_number,
    enum_value_name,
    message_class,
    schema_data,
    schema_name,
    value_fields,
)
from fte_sniff.recording.messages.wire_layout import WireLayouts

_GREATEST = 2**63 - 1
"""The largest offset and time: 64-bit columns hold no larger one."""

_LARGEST_MESSAGE = 64 * 1024
_MOST_DEFINITIONS = 2048
"""Changes of the definitions in one file."""

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


Definitions = Mapping[tuple[type[Schema | Channel], int], tuple[Schema | Channel, bool]]
"""Definitions by class and id, each with whether a checksum protects it."""

NOTHING: Definitions = {}


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
        self._fields = frozenset(fields)
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
        self.layouts = None if is_event else _layouts_of(schema, data)
        self._names = _names_by_number(fields["kind" if is_event else "faults"])
        self.entry: Callable[[bytes, int], Row | PortEvent] = self.event if is_event else self.row
        """Reads one message with its log time: `event` on the topic of port events, else `row`."""

    def row(self, data: bytes, log_time: int) -> Row:
        """The row of one message; raises ValueError if it does not fit its schema or is no row."""
        message = self._parse(data)
        faults = message.faults
        delay = message.read_delay_ns if message.HasField("read_delay_ns") else None
        made: type[Row] = Damage if "framed" in self._fields and not message.framed else Frame
        raw = message.raw
        if not (_is_framed(raw) if made is Frame else raw):
            what = TranslatableText("no frame") if made is Frame else TranslatableText("no damage")
            raise RecordError("{what} in its {size} bytes", what=what, size=len(raw))
        if message.offset > _GREATEST:
            raise RecordError(
                "offset {offset} is past the end of any stream", offset=message.offset
            )
        return made(
            self.port,
            message.offset,
            raw,
            self._time(message, log_time),
            tuple(map(self.fault, faults)) if faults else (),
            delay,
            "order_uncertain" in self._fields and message.order_uncertain,
        )

    def fault(self, number: int) -> Fault:
        """The fault with this number in the file's schema; ValueError if it is unknown."""
        return Fault(self._name(number))

    def event(self, data: bytes, log_time: int) -> PortEvent:
        """The port event of one message; raises ValueError if it is none."""
        message = self._parse(data)
        kind = PortEventKind(self._name(message.kind))
        count = message.count if "count" in self._fields else 0
        return PortEvent(self._time(message, log_time), self.port, kind, message.detail, count)

    def _parse(self, data: bytes) -> Any:
        if len(data) > _LARGEST_MESSAGE:
            raise RecordError("{size} bytes, more than any row has", size=len(data))
        try:
            return self._message.FromString(data)
        except DecodeError as error:
            raise RecordError("a message that does not fit its schema") from error

    def _time(self, message: Any, log_time: int) -> int:
        own = "time_ns" in self._fields and message.HasField("time_ns")
        time = int(message.time_ns) if own else log_time
        if time > _GREATEST:
            raise RecordError("time {time} ns is past the year 2262", time=time)
        return time

    def _name(self, number: int) -> str:
        name = self._names.get(number)
        if name is None:
            raise RecordError(
                "a word that this version does not know (number {number})", number=number
            )
        return name


ChannelReader = MessageReader | str | None
"""The reader of a channel, or why its messages cannot be read; None for other topics."""


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


def reason_in(error: Exception) -> str:
    """Why a message or a schema cannot be read, translatable if possible."""
    text = error.args[0] if error.args else ""
    return text if isinstance(text, TranslatableText) else str(error)


@lru_cache(maxsize=64)
def _layouts_of(schema: str, data: bytes) -> WireLayouts:
    return WireLayouts(message_class(schema, data).DESCRIPTOR)


def _is_framed(raw: bytes) -> bool:
    return len(raw) == FRAME_LENGTH and raw[0] in HEADERS.values() and raw[-1] == TAIL


def _names_by_number(field: Any) -> dict[int, str]:
    """The faults or event kinds of this version, by their numbers in the file's schema."""
    if field.enum_type is None:
        return {}
    known: type[StrEnum] = PortEventKind if field.name == "kind" else Fault
    names = {enum_value_name(known.__name__, one): str(one) for one in known}
    return {
        value.number: names[value.name] for value in field.enum_type.values if value.name in names
    }


_KIND_NUMBER = {name: enum_number("Kind", name) for name in KIND_BY_NAME}
_STATUS_NUMBER = {status: enum_number("Status", status) for status in Status}
_FAULT_NUMBER = {fault: enum_number("Fault", fault) for fault in Fault}
_EVENT_NUMBER = {kind: enum_number("PortEventKind", kind) for kind in PortEventKind}


@cache
def class_of(topic_name: str) -> Any:
    """The protobuf class of a topic's messages."""
    topic = TOPIC_BY_NAME[topic_name]
    return message_class(schema_name(topic), schema_data(topic.schema))


@cache
def _constants(topic_name: str, kind_name: str) -> dict[str, float]:
    """The kind, and NaN for the topic's fields that frames of the kind lack."""
    kind, fields = KIND_BY_NAME[kind_name], value_fields(TOPIC_BY_NAME[topic_name])
    absent = {field.name: nan for field in fields if kind.field(field.name) is None}
    return {"kind": _KIND_NUMBER[kind.name], **absent}


def encode_row(topic: Topic, row: Row, log_time: int) -> bytes:
    """The message of a row, which must have a time, on its topic, from `topic_of`.

    It holds the row's own time if `log_time` differs.
    """
    values: dict[str, Any] = {"offset": row.offset, "raw": row.raw}
    if row.read_delay_ns is not None:
        values["read_delay_ns"] = row.read_delay_ns
    if row.t_ns != log_time:
        values["time_ns"] = row.t_ns
    if row.order_uncertain:
        values["order_uncertain"] = True
    if row.faults:
        values["faults"] = [_FAULT_NUMBER[fault] for fault in row.faults]
    values["status"] = _STATUS_NUMBER[row.status]
    kind = row.kind if isinstance(row, Frame) else None
    if topic is MALFORMED:
        values["kind"] = 0 if kind is None else _KIND_NUMBER[kind.name]
        values["framed"] = isinstance(row, Frame)
        values["length"] = len(row.raw)
    else:
        assert isinstance(row, Frame)
        assert kind is not None
        values |= _constants(topic.name, kind.name)
        values["cmd"] = row.cmd
        values |= {field.name: field.read(row.raw) for field in kind.fields}
    return bytes(class_of(topic.name)(**values).SerializeToString())


def encode_event(event: PortEvent, log_time: int) -> bytes:
    """The message of a port event; it holds the event's own time if `log_time` differs."""
    values: dict[str, Any] = {
        "kind": _EVENT_NUMBER[event.kind],
        "detail": encodable(event.detail),
        "count": event.count,
    }
    if event.t_ns != log_time:
        values["time_ns"] = event.t_ns
    return bytes(class_of(EVENTS.name)(**values).SerializeToString())


def encodable(text: str) -> str:
    """Text for UTF-8: undecodable bytes (of file names, for example) as backslash escapes."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def encodable_items(facts: Mapping[str, str]) -> dict[str, str]:
    """Names and values for UTF-8."""
    return {encodable(name): encodable(value) for name, value in facts.items()}
