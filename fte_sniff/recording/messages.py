"""Rows as protobuf messages and back: topics, schemas and channels, encoder and decoder.

All messages of fault-free frames of one schema are equally long: numbers are fixed32, fixed64,
float or double, enum numbers take one byte, and every field has presence, so that zeros are written
too. So each field is at the same offset in all messages that have the same fields (`Template`):

    09 offset (8) | 11 read delay (8) | 1a 0a raw (10) | 20 status | 38 kind | ... values

Only faults, a missing read delay, a time other than the log time, and an uncertain order change the
length. Numpy writes, checks and copies all messages of a template at once. The others, and those of
damage and port events, are read and written by protobuf, one by one: that takes twenty times as
long, so the number of those that are read is limited by the bytes that their chunk has in the file.

A value that every frame of the schema has is an integer. Another value is a float (double beyond
two bytes), and NaN in the frames without it: plotters skip NaN, but draw an absent field as 0.

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
import struct
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache, lru_cache
from itertools import islice
from math import nan
from types import MappingProxyType
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding
from numpy.typing import NDArray
from zlib_ng.zlib_ng import crc32

from fte_sniff.errors import FileError, TranslatableText, listed
from fte_sniff.platform import read_at
from fte_sniff.protocol import (
    FRAME_LENGTH,
    HEADERS,
    KIND_BY_NAME,
    KINDS,
    MOTORS,
    TAIL,
    VALUE_FIELDS,
    Fault,
    Field,
    Frame,
    FrameKind,
    PortEvent,
    PortEventKind,
    Row,
    Status,
)
from fte_sniff.protocol.rows import NO_TIME, Array, Bools, Rows
from fte_sniff.protocol.spec import CMD_OFFSET, KIND_BY_HEADER_AND_CMD, NUM_OFFSET
from fte_sniff.recording.mcap.reader import (
    CHANNEL_OFFSET,
    HEAD,
    LOG_TIME_OFFSET,
    MESSAGE_HEAD,
    SEQUENCE_OFFSET,
    MessageIndex,
    RecordError,
    at_every_byte,
    parse,
)
from fte_sniff.recording.mcap.writer import MOST_BETWEEN_COPIES, McapBatch
from fte_sniff.recording.metadata import (
    PORTS_NAME,
    PortFacts,
    baud_in,
    ports_from_metadata,
    ports_in,
)

# Topics and schemas


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic of a recording."""

    name: str
    schema: str
    """Name of the schema, without the package."""
    kinds: tuple[FrameKind, ...] = ()
    """The kinds of its frames; none for port events."""


MALFORMED = Topic("/fte/malformed", "Malformed", KINDS)
"""Every `Damage`, and every `Frame` of an unknown kind or with a malformed fault."""

EVENTS = Topic("/fte/port", "PortEvent")


def _schema_and_topics(kind: FrameKind) -> tuple[str, tuple[str, ...]]:
    """The schema of a kind, and the last component of each of its topics, with its slash."""
    if kind.names_motor:
        motors = tuple(f"/motor{motor}" for motor in MOTORS)
        return f"Motor{kind.direction.capitalize()}", motors
    if kind.fields:
        return "Chassis", ("/chassis",)
    return kind.name.capitalize(), (f"/{kind.name}",)


def _frame_topics() -> Iterator[Topic]:
    kinds_of: dict[tuple[str, str], list[FrameKind]] = {}
    for kind in KINDS:
        schema, names = _schema_and_topics(kind)
        for name in names:
            kinds_of.setdefault((schema, f"/fte/{kind.direction}{name}"), []).append(kind)
    for (schema, name), kinds in kinds_of.items():
        yield Topic(name, schema, tuple(kinds))


TOPICS: tuple[Topic, ...] = (*_frame_topics(), MALFORMED, EVENTS)

TOPIC_BY_NAME: Mapping[str, Topic] = MappingProxyType({topic.name: topic for topic in TOPICS})


def _topics_of_kinds() -> Iterator[tuple[tuple[str, int | None], Topic]]:
    for kind in KINDS:
        _, names = _schema_and_topics(kind)
        nums = MOTORS if kind.names_motor else (None,)
        for num, name in zip(nums, names, strict=True):
            yield (kind.name, num), TOPIC_BY_NAME[f"/fte/{kind.direction}{name}"]


_TOPIC_BY_KIND_AND_MOTOR = MappingProxyType(dict(_topics_of_kinds()))


PACKAGE = "fte"

_TYPE = FieldDescriptorProto
_ENUMS: dict[str, tuple[str, ...]] = {
    "Kind": tuple(kind.name for kind in KINDS),
    "Status": tuple(Status),
    "Fault": tuple(Fault),
    "PortEventKind": tuple(PortEventKind),
}
_ROW_FIELDS: tuple[tuple[str, int | str], ...] = (
    ("offset", _TYPE.TYPE_FIXED64),
    ("read_delay_ns", _TYPE.TYPE_SFIXED64),
    ("raw", _TYPE.TYPE_BYTES),
    ("status", "Status"),
    ("faults", "Fault"),
    ("time_ns", _TYPE.TYPE_FIXED64),
    ("kind", "Kind"),
    ("order_uncertain", _TYPE.TYPE_BOOL),
)
_EVENT_FIELDS: tuple[tuple[str, int | str], ...] = (
    ("kind", "PortEventKind"),
    ("detail", _TYPE.TYPE_STRING),
    ("time_ns", _TYPE.TYPE_FIXED64),
    ("count", _TYPE.TYPE_FIXED64),
)
_DAMAGE_FIELDS: tuple[tuple[str, int | str], ...] = (
    ("framed", _TYPE.TYPE_BOOL),
    ("length", _TYPE.TYPE_FIXED32),
)
_REPEATED = frozenset({"faults"})


def _enum_value_name(enum: str, value: str) -> str:
    """The name of an enum value, unique within its message: `KIND_SPEED`."""
    prefix = "".join(f"_{letter}" if letter.isupper() else letter for letter in enum).lstrip("_")
    return f"{prefix}_{value}".upper()


def _enum_number(enum: str, value: str) -> int:
    """The number of an enum value; 0 is `..._NONE`."""
    return _ENUMS[enum].index(value) + 1


def value_fields(topic: Topic) -> tuple[Field, ...]:
    """The frame fields that messages of this topic hold, each once; none for `MALFORMED`."""
    if topic is MALFORMED:
        return ()
    names = {field.name for kind in topic.kinds for field in kind.fields}
    return tuple(field for field in VALUE_FIELDS if field.name in names)


def _value_type(field: Field, topic: Topic) -> int:
    if any(kind.field(field.name) is None for kind in topic.kinds):
        return _TYPE.TYPE_FLOAT if field.size <= 2 else _TYPE.TYPE_DOUBLE
    return _TYPE.TYPE_SFIXED32 if field.signed else _TYPE.TYPE_FIXED32


def _fields(topic: Topic) -> Iterator[tuple[str, int | str]]:
    if topic is EVENTS:
        yield from _EVENT_FIELDS
        return
    yield from _ROW_FIELDS
    if topic is MALFORMED:
        yield from _DAMAGE_FIELDS
        return
    yield "cmd", _TYPE.TYPE_FIXED32
    for field in value_fields(topic):
        yield field.name, _value_type(field, topic)


def _add_field(message: DescriptorProto, name: str, number: int, kind: int | str) -> None:
    field = message.field.add(name=name, number=number, json_name=name)
    if isinstance(kind, str):
        field.type = _TYPE.TYPE_ENUM
        field.type_name = f".{PACKAGE}.{message.name}.{kind}"
    else:
        field.type = kind  # type: ignore[assignment]
    if name in _REPEATED:
        field.label = _TYPE.LABEL_REPEATED
        return
    field.label = _TYPE.LABEL_OPTIONAL
    field.proto3_optional = True
    field.oneof_index = len(message.oneof_decl)
    message.oneof_decl.add(name=f"_{name}")


def _add_enum(message: DescriptorProto, enum: str) -> None:
    added = message.enum_type.add(name=enum)
    for number, value in enumerate(("none", *_ENUMS[enum])):
        added.value.add(name=_enum_value_name(enum, value), number=number)


def _file(topic: Topic) -> FileDescriptorProto:
    file = FileDescriptorProto(
        name=f"{PACKAGE}/{topic.schema}.proto", package=PACKAGE, syntax="proto3"
    )
    message = file.message_type.add(name=topic.schema)
    for number, (name, kind) in enumerate(_fields(topic), 1):
        _add_field(message, name, number, kind)
        if isinstance(kind, str):
            _add_enum(message, kind)
    return file


def table_text() -> str:
    """The topics in order, and the fields of their messages: what a channel's number stands for."""
    topics = (f"{topic.name} {schema_name(topic)} {[*_fields(topic)]}" for topic in TOPICS)
    return "\n".join([*topics, *(f"{name} {list(map(str, _ENUMS[name]))}" for name in _ENUMS)])


@cache
def table_crc() -> int:
    """The checksum of that table: files with another one need its topics and fields."""
    return int(crc32(table_text().encode()))


def schema_name(topic: Topic) -> str:
    """The full name of the topic's messages: `fte.MotorControl`."""
    return f"{PACKAGE}.{topic.schema}"


@cache
def schema_data(schema: str) -> bytes:
    """The serialized FileDescriptorSet of a schema: the schema data of an MCAP file."""
    topic = next(topic for topic in TOPICS if topic.schema == schema)
    return FileDescriptorSet(file=[_file(topic)]).SerializeToString(deterministic=True)


@lru_cache(maxsize=64)
def message_class(name: str, data: bytes) -> Any:
    """The message class with this name in a serialized FileDescriptorSet.

    Raises ValueError if the data is invalid or lacks the message.
    """
    pool = DescriptorPool()
    try:
        for file in FileDescriptorSet.FromString(data).file:
            pool.Add(file)
        return GetMessageClass(pool.FindMessageTypeByName(name))
    except (TypeError, KeyError, DecodeError) as error:
        raise ValueError(f"no usable protobuf schema {name}") from error


# The layout of the messages of fault-free frames

_VARINT, _FIXED64, _DELIMITED, _FIXED32 = 0, 1, 2, 5
_TYPES: dict[int, tuple[int, str, int]] = {
    FieldDescriptor.TYPE_FIXED64: (_FIXED64, "<u8", 0),
    FieldDescriptor.TYPE_SFIXED64: (_FIXED64, "<i8", 0),
    FieldDescriptor.TYPE_DOUBLE: (_FIXED64, "<f8", 0),
    FieldDescriptor.TYPE_FIXED32: (_FIXED32, "<u4", 0),
    FieldDescriptor.TYPE_SFIXED32: (_FIXED32, "<i4", 0),
    FieldDescriptor.TYPE_FLOAT: (_FIXED32, "<f4", 0),
    # A number of one byte: the bit that announces another byte is 0.
    FieldDescriptor.TYPE_ENUM: (_VARINT, "u1", 0x80),
    FieldDescriptor.TYPE_BOOL: (_VARINT, "u1", 0xFE),
    FieldDescriptor.TYPE_BYTES: (_DELIMITED, f"V{FRAME_LENGTH}", 0),
}
"""By type the wire type, the numpy type of the value, and the bits that are 0 in each byte."""

_LACKS = frozenset({"faults", "time_ns", "order_uncertain"})
"""Fields that a fault-free frame's message lacks if its time is the log time and its order certain.
"""
_LACKS_IF_UNCERTAIN = _LACKS - {"order_uncertain"}

_FIRST_FIELDS: Mapping[str, int] = {"offset": 1, "read_delay_ns": 10, "raw": 20}
"""Offsets of the first fields, the same in each template of a schema that fte-sniff writes."""

_ROW_TYPES = {
    "offset": FieldDescriptor.TYPE_FIXED64,
    "read_delay_ns": FieldDescriptor.TYPE_SFIXED64,
    "raw": FieldDescriptor.TYPE_BYTES,
    "faults": FieldDescriptor.TYPE_ENUM,
}
_OPTIONAL_TYPES = {
    "time_ns": FieldDescriptor.TYPE_FIXED64,
    "order_uncertain": FieldDescriptor.TYPE_BOOL,
}
_RAW = np.dtype(f"V{FRAME_LENGTH}")
"""A frame as one opaque value, which numpy copies at once."""
_WORD = 8
_STRIPE = 64
_SIGN = 0x80
"""The sign bit in the last byte of a little-endian number."""
_IS_HEADER = np.isin(np.arange(256), list(HEADERS.values()))


class Template:
    """The offsets of the fields of a message, and the bytes that all such messages have."""

    def __init__(self, fields: Iterable[Any], lacks: Collection[str] = ()) -> None:
        """Take the fields of a message's descriptor; messages lack those whose names are `lacks`.

        Raises KeyError if the size of a field depends on its value.
        """
        self._fields: dict[str, tuple[str, int]] = {}
        mask, expected = bytearray(), bytearray()
        for field in sorted(fields, key=lambda field: int(field.number)):
            if field.name in lacks:
                continue
            wire, kind, zeros = _TYPES[field.type]
            size = np.dtype(kind).itemsize
            tag = _varint(field.number << 3 | wire) + bytes([size] * (wire == _DELIMITED))
            self._fields[field.name] = kind, len(mask) + len(tag)
            mask += b"\xff" * len(tag) + bytes([zeros]) * size
            expected += tag + bytes(size)
        mask[self.offset_of("offset") + _WORD - 1] |= _SIGN
        tail = self.offset_of("raw") + FRAME_LENGTH - 1
        mask[tail], expected[tail] = 0xFF, TAIL
        self.length = len(mask)
        """Bytes of a message."""
        # In front, where the record of a message has its head, so that the words are whole.
        self._padding = -self.length % _WORD
        self._mask = np.frombuffer(bytes(self._padding) + mask, "<u8")
        self._expected = np.frombuffer(bytes(self._padding) + expected, "<u8")

    def __contains__(self, name: object) -> bool:
        return name in self._fields

    def offset_of(self, name: str) -> int:
        """The offset of a field's value in a message."""
        return self._fields[name][1]

    def fitting(self, records: bytes, starts: Array) -> Bools:
        """A mask of the messages that have this layout, and are frames.

        `starts` are those of messages of the template's length in `records`, which have at least
        seven bytes before each.
        """
        windows = at_every_byte(records, self._padding + self.length)
        words = windows[starts - self._padding].view("<u8").reshape(len(starts), -1)
        heads = np.frombuffer(records, np.uint8)[starts + self.offset_of("raw")]
        framed: Bools = _IS_HEADER.take(heads)
        if not self._all_agree(words):
            framed &= ~self._deviations(words).any(axis=1)
        return framed

    def _deviations(self, words: Array) -> Array:
        found: Array = words & self._mask
        found ^= self._expected
        return found

    def _all_agree(self, words: Array) -> bool:
        """Whether every message agrees; `words` has a line for each."""
        striped = len(words) // _STRIPE * _STRIPE
        if self._deviations(words[striped:]).any():
            return False
        if not striped:
            return True
        # 64 messages in a line: numpy reduces long lines at the speed of memory.
        wide = words[:striped].reshape(-1, _STRIPE * words.shape[1])
        found = self._deviations(np.bitwise_or.reduce(wide, axis=0).reshape(_STRIPE, -1))
        found |= self._deviations(np.bitwise_and.reduce(wide, axis=0).reshape(_STRIPE, -1))
        return not found.any()

    def record_type(self, head: Mapping[str, tuple[str, int]], base: int) -> np.dtype[Any]:
        """The numpy type of a record: a head, with types and offsets, and the message at `base`."""
        fields = {name: (kind, base + offset) for name, (kind, offset) in self._fields.items()}
        kinds, offsets = zip(*{**head, **fields}.values(), strict=True)
        return np.dtype(
            {
                "names": [*head, *fields],
                "formats": list(kinds),
                "offsets": list(offsets),
                "itemsize": base + self.length,
            }
        )


@lru_cache(maxsize=64)
def _templates_of(schema: str, data: bytes) -> tuple[Template, ...]:
    """The templates of a schema in a file: of rows whose order is certain, and uncertain.

    None for a schema of another form, and for that of damage.
    """
    fields = message_class(schema, data).DESCRIPTOR.fields
    types = {field.name: field.type for field in fields}
    repeated = [field.name for field in fields if field.default_value == []]
    optional = all(types.get(name, kind) == kind for name, kind in _OPTIONAL_TYPES.items())
    if "framed" in types or repeated != ["faults"] or not (types.items() >= _ROW_TYPES.items()):
        return ()
    if not optional or any(kind not in _TYPES for kind in types.values()):
        return ()
    absences = dict.fromkeys(frozenset(types) & lacks for lacks in (_LACKS, _LACKS_IF_UNCERTAIN))
    found = [Template(fields, lacks) for lacks in absences]
    first = [{name: one.offset_of(name) for name in _FIRST_FIELDS} for one in found]
    return tuple(found) if all(one == _FIRST_FIELDS for one in first) else ()


def _varint(number: int) -> bytes:
    found = bytearray()
    while number >= 0x80:
        found.append(number & 0x7F | 0x80)
        number >>= 7
    found.append(number)
    return bytes(found)


# The encoder

_MESSAGE = struct.Struct("<BQHIQQ")
"""Header of a message record: opcode, length, channel, sequence, log and publish time."""

_HEAD_FIELDS = {
    "channel": ("<u2", CHANNEL_OFFSET),
    "sequence": ("<u4", SEQUENCE_OFFSET),
    "log": ("<u8", LOG_TIME_OFFSET),
    "publish": ("<u8", LOG_TIME_OFFSET + 8),
}


def topic_of(row: Row) -> Topic:
    """The topic of a row: that of its kind and motor, or `MALFORMED`."""
    if not isinstance(row, Frame) or (row.faults and row.status is Status.MALFORMED):
        return MALFORMED
    return _topic_of_head(row.raw[: NUM_OFFSET + 1])


@lru_cache(maxsize=1024)
def _topic_of_head(head: bytes) -> Topic:
    """The topic of a frame without malformed fault, by its bytes up to NUM."""
    kind = KIND_BY_HEADER_AND_CMD.get((head[0], head[CMD_OFFSET]))
    if kind is None:
        return MALFORMED
    motor = head[NUM_OFFSET] if kind.names_motor else None
    return _TOPIC_BY_KIND_AND_MOTOR.get((kind.name, motor), MALFORMED)


_KIND_NUMBER = {name: _enum_number("Kind", name) for name in KIND_BY_NAME}
_STATUS_NUMBER = {status: _enum_number("Status", status) for status in Status}
_FAULT_NUMBER = {fault: _enum_number("Fault", fault) for fault in Fault}
_EVENT_NUMBER = {kind: _enum_number("PortEventKind", kind) for kind in PortEventKind}


@cache
def _class_of(topic_name: str) -> Any:
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
    return bytes(_class_of(topic.name)(**values).SerializeToString())


def encode_event(event: PortEvent, log_time: int) -> bytes:
    """The message of a port event; it holds the event's own time if `log_time` differs."""
    values: dict[str, Any] = {
        "kind": _EVENT_NUMBER[event.kind],
        "detail": encodable(event.detail),
        "count": event.count,
    }
    if event.t_ns != log_time:
        values["time_ns"] = event.t_ns
    return bytes(_class_of(EVENTS.name)(**values).SerializeToString())


def encodable(text: str) -> str:
    """Text for UTF-8: undecodable bytes (of file names, for example) as backslash escapes."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def encodable_items(facts: Mapping[str, str]) -> dict[str, str]:
    """Names and values for UTF-8."""
    return {encodable(name): encodable(value) for name, value in facts.items()}


_ChannelId = Callable[[str, Topic], int]

_FORMS = [(kind, cmd, uncertain) for uncertain in (0, 1) for kind in KINDS for cmd in kind.cmds]
"""Kind, CMD and `order_uncertain`: frames of one form make messages of one layout."""
_UNCERTAIN = len(_FORMS) // 2
_NO_FORM = 255
_BYTES = 256


_FORM_CODES = np.full(_BYTES * _BYTES, _NO_FORM, np.uint8)
"""By header and CMD, read as one little-endian number: the index in `_FORMS`."""
_HEADS = [kind.header | cmd << 8 for kind, cmd, _ in _FORMS[:_UNCERTAIN]]
_FORM_CODES[_HEADS] = np.arange(_UNCERTAIN)
_NAMES_MOTOR = np.zeros(_NO_FORM + 1, np.bool_)
"""By form, whether its frames name a motor."""
_NAMES_MOTOR[: len(_FORMS)] = [kind.names_motor for kind, *_ in _FORMS]


class _RecordTemplate:
    """Template of the message records of one form."""

    def __init__(self, code: int) -> None:
        kind, _, uncertain = _FORMS[code]
        frame = _frame_of(code, MOTORS[0])
        topic = topic_of(frame)
        assert topic is not MALFORMED
        message = encode_row(topic, frame, 0)
        head = _message_head(len(message), 0, 0, 0)
        self._template = np.void(head + message)
        self.length = self._template.itemsize
        self._values = kind.fields
        fields = _class_of(topic.name).DESCRIPTOR.fields
        template = Template(fields, _LACKS_IF_UNCERTAIN if uncertain else _LACKS)
        self._type = template.record_type(_HEAD_FIELDS, MESSAGE_HEAD)

    def records(self, fields: dict[str, Array]) -> NDArray[np.void]:
        """The message records of some rows.

        `fields` has, by name of the MCAP header or the message, a value for each row; `raw` as
        opaque values of ten bytes, from which the frame's own fields are read.
        """
        raws = fields["raw"]
        found: NDArray[np.void] = np.full(len(raws), self._template)
        table = found.view(self._type)
        for name, values in fields.items():
            table[name] = values
        for field in self._values:
            kind = f">{'i' if field.signed else 'u'}{field.size}"
            # A strided view: copying the field out first takes as long as everything else.
            table[field.name] = np.ndarray(len(raws), kind, raws, field.start, raws.strides)
        return found


def _frame_of(code: int, motor: int) -> Frame:
    kind, cmd, uncertain = _FORMS[code]
    raw = bytes([kind.header, cmd, motor]).ljust(FRAME_LENGTH, b"\0")
    return Frame("", 0, raw, 0, (), 0, bool(uncertain))


@cache
def _topic(code: int, motor: int) -> Topic:
    return topic_of(_frame_of(code, motor))


_template_of = cache(_RecordTemplate)


@cache
def _record_lengths() -> Array:
    lengths = np.zeros(_NO_FORM + 1, np.int64)
    lengths[: len(_FORMS)] = [_template_of(code).length for code in range(len(_FORMS))]
    return lengths


class ColumnPacker:
    """Packs batches of rows; counts the messages of each channel."""

    def __init__(self, channel_id: _ChannelId) -> None:
        self._channel_id = channel_id
        self._sequences: dict[int, int] = {}
        self._first_time: int | None = None
        self.early_ns: int | None = None
        """Time of a row before the first message; None without such a row."""

    def pack(self, rows: Rows, times: Array, events_at: Array) -> McapBatch:
        """The messages of the rows and of their events, one at least, each in order.

        `times` are the log times of the messages, never falling; `events_at` the indexes of the
        events among the messages, rising.
        """
        if self._first_time is None:
            self._first_time = int(times[0])
        if self.early_ns is None and rows.t_ns.min(initial=self._first_time) < self._first_time:
            self.early_ns = int(rows.t_ns.min())
        rows_at: Any = slice(None)
        if len(events_at):
            rows_at = np.delete(np.arange(len(times)), events_at)
        forms = _forms_of(rows, times[rows_at])
        odd = np.flatnonzero(forms == _NO_FORM)
        odd_rows = list(rows.select(odd))
        channels = np.empty(len(times), np.int64)
        channels[rows_at] = self._channels(rows, forms, odd, odd_rows)
        channels[events_at] = [self._channel_of(event) for event in rows.events]
        sequences = self._count(channels)
        single: dict[int, Row | PortEvent] = {
            **dict(zip(np.arange(len(times))[rows_at][odd].tolist(), odd_rows, strict=True)),
            **dict(zip(events_at.tolist(), rows.events, strict=True)),
        }
        records = {
            at: _message_record(entry, int(channels[at]), int(sequences[at]), int(times[at]))
            for at, entry in single.items()
        }
        lengths = np.empty(len(times), np.int64)
        lengths[rows_at] = _record_lengths().take(forms)
        lengths[list(records)] = [len(record) for record in records.values()]
        ends = np.cumsum(lengths)
        starts = ends - lengths
        data = np.empty(int(ends[-1]), np.uint8)
        heads = {"channel": channels, "sequence": sequences, "log": times, "publish": times}
        own_heads = {name: values[rows_at] for name, values in heads.items()}
        for own, packed in _records_by_form(rows, forms, own_heads):
            _write_at(data, starts[rows_at].take(own), packed)
        for at, record in records.items():
            data[starts[at] : ends[at]] = np.frombuffer(record, np.uint8)
        return McapBatch(data.data, channels, times, starts)

    def _channels(self, rows: Rows, forms: Array, odd: Array, odd_rows: Sequence[Row]) -> Array:
        """The channel of each row; each combination of port, form and motor is looked up once."""
        ports = rows.port.astype(np.int64)
        motors = np.where(_NAMES_MOTOR.take(forms), rows.raw[:, NUM_OFFSET], MOTORS[0])
        keys = (ports * len(_FORMS) + forms) * len(MOTORS) + motors - MOTORS[0]
        found = np.zeros(len(rows.codebook.ports) * len(_FORMS) * len(MOTORS), np.int64)
        for key in np.flatnonzero(np.bincount(np.delete(keys, odd))).tolist():
            port_and_form, motor = divmod(key, len(MOTORS))
            port, form = divmod(port_and_form, len(_FORMS))
            found[key] = self._channel_id(rows.codebook.ports[port], _topic(form, MOTORS[motor]))
        channels = found.take(keys, mode="clip")  # the key of an odd row has no meaning
        channels[odd] = [self._channel_of(row) for row in odd_rows]
        return channels

    def _channel_of(self, entry: Row | PortEvent) -> int:
        topic = EVENTS if isinstance(entry, PortEvent) else topic_of(entry)
        return self._channel_id(entry.port, topic)

    def _count(self, channels: Array) -> Array:
        """The sequence number of each message: it counts up on each channel, and wraps."""
        by_channel = np.argsort(channels.astype(np.uint16), kind="stable")
        counts = np.bincount(channels)
        present = np.flatnonzero(counts)
        counts = counts[present]
        starts = np.array([self._sequences.get(channel, 0) for channel in present.tolist()])
        ends = starts + counts
        self._sequences.update(zip(present.tolist(), ends.tolist(), strict=True))
        sequences = np.empty(len(channels), np.uint32)
        firsts = starts - (np.cumsum(counts) - counts)
        numbers = np.arange(len(channels)) + np.repeat(firsts, counts)
        sequences[by_channel] = numbers.astype(np.uint32)
        return sequences


def _forms_of(rows: Rows, times: Array) -> Array:
    """The form of every row that can be packed with numpy, `_NO_FORM` for the others."""
    head = rows.raw[:, 0] | rows.raw[:, CMD_OFFSET].astype(np.uint16) << np.uint16(8)
    forms: Array = _FORM_CODES.take(head)
    clean = np.array([not faults for faults in rows.codebook.faults]).take(rows.faults)
    packable = (forms != _NO_FORM) & rows.framed & clean & (rows.t_ns == times)
    packable &= rows.delay_ns != NO_TIME
    num = rows.raw[:, NUM_OFFSET]
    packable &= ~_NAMES_MOTOR.take(forms) | (num >= MOTORS[0]) & (num <= MOTORS[-1])
    forms += rows.unordered * np.uint8(_UNCERTAIN)
    forms[~packable] = _NO_FORM
    return forms


def _records_by_form(
    rows: Rows, forms: Array, heads: dict[str, Array]
) -> Iterator[tuple[Array, Array]]:
    """For each form the indexes of its rows, and their message records."""
    raws = np.ascontiguousarray(rows.raw).view(_RAW)[:, 0]
    fields = heads | {"offset": rows.offset, "read_delay_ns": rows.delay_ns, "raw": raws}
    by_form, first = np.argsort(forms, kind="stable"), 0
    for code, count in enumerate(np.bincount(forms)[: len(_FORMS)].tolist()):
        own = by_form[first : first + count]
        first += count
        if count:
            taken = {name: values.take(own) for name, values in fields.items()}
            yield own, _template_of(code).records(taken)


def _write_at(data: Array, starts: Array, records: Array) -> None:
    width = records.dtype.itemsize
    at_every_byte: Array = np.ndarray((len(data) - width + 1,), records.dtype, data, 0, (1,))
    at_every_byte[starts] = records


def _message_record(entry: Row | PortEvent, channel: int, sequence: int, time: int) -> bytes:
    """The record of one message."""
    if isinstance(entry, PortEvent):
        data = encode_event(entry, time)
    else:
        data = encode_row(topic_of(entry), entry, time)
    return _message_head(len(data), channel, sequence, time) + data


def _message_head(size: int, channel: int, sequence: int, time: int) -> bytes:
    length = MESSAGE_HEAD - HEAD.size + size
    return _MESSAGE.pack(Opcode.MESSAGE, length, channel, sequence, time, time)


def _port_metadata(port: PortFacts) -> dict[str, str]:
    """The metadata of a port's channels."""
    baud = {} if port.baud is None else {"baud": str(port.baud)}
    return {"port": encodable(port.name), **baud}


class Channels:
    """The channels of one file, numbered from 1 in the order in which their ports are added."""

    def __init__(self) -> None:
        self._ids: dict[tuple[str, str], int] = {}
        self.ports: list[PortFacts] = []
        """The ports that were added, in the order of their channels."""
        names = dict.fromkeys(topic.schema for topic in TOPICS)
        self._schema_ids = {name: id_ for id_, name in enumerate(names, 1)}

    def schemas(self) -> list[Schema]:
        """Every schema of a recording."""
        named = {topic.schema: topic for topic in TOPICS}
        return [
            Schema(id_, schema_data(name), SchemaEncoding.Protobuf, schema_name(named[name]))
            for name, id_ in self._schema_ids.items()
        ]

    def of_port(self, port: PortFacts) -> list[Channel]:
        """Add a port, and return a channel for each topic; none if the port is known."""
        if (port.name, TOPICS[0].name) in self._ids:
            return []
        self.ports.append(PortFacts(encodable(port.name), port.baud))
        metadata = _port_metadata(port)
        channels = []
        for topic in TOPICS:
            id_ = self._ids[port.name, topic.name] = len(self._ids) + 1
            schema_id = self._schema_ids[topic.schema]
            channels.append(Channel(id_, topic.name, MessageEncoding.Protobuf, metadata, schema_id))
        return channels

    def id_of(self, port: str, topic: Topic) -> int:
        """The channel of a port on a topic; raises KeyError if the port was not added."""
        return self._ids[port, topic.name]


# The decoder

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
                why=_reason_in(error),
            ) from error
        fields = self._message.DESCRIPTOR.fields_by_name
        needed = _EVENT_NEEDS if topic == EVENTS.name else _ROW_NEEDS
        lacking = sorted(
            name
            for name, types in needed.items()
            if name not in fields
            or fields[name].cpp_type not in types
            or (fields[name].default_value == []) != (name in _REPEATED)
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


def _reason_in(error: Exception) -> str:
    """Why a message or a schema cannot be read, translatable if possible."""
    text = error.args[0] if error.args else ""
    return text if isinstance(text, TranslatableText) else str(error)


def _is_framed(raw: bytes) -> bool:
    return len(raw) == FRAME_LENGTH and raw[0] in HEADERS.values() and raw[-1] == TAIL


def _members_by_number(field: Any) -> dict[int, StrEnum]:
    """The faults or event kinds of this version, by their numbers in the file's schema."""
    if field.enum_type is None:
        return {}
    known: type[StrEnum] = PortEventKind if field.name == "kind" else Fault
    members = {_enum_value_name(known.__name__, one): one for one in known}
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
        columns.offset[:] = messages.field(MESSAGE_HEAD + _FIRST_FIELDS["offset"], "<i8")
        columns.delay_ns[:] = messages.field(MESSAGE_HEAD + _FIRST_FIELDS["read_delay_ns"], "<i8")
        columns.raw.view(_RAW).reshape(-1)[:] = messages.field(
            MESSAGE_HEAD + _FIRST_FIELDS["raw"], _RAW
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
                why = _reason_in(error)
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


# The definitions of channels

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
    return replace(like, id=channel_id, metadata=_port_metadata(port))


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
