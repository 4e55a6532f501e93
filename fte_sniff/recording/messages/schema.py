"""Topics and protobuf schemas; the layout of a fault-free frame's message, to read and to write.

All messages of fault-free frames of one schema are equally long: numbers are fixed32, fixed64,
float or double, enum numbers take one byte, and every field has presence, so that zeros are written
too. So each field is at the same offset in all messages that have the same fields (`Template`):

    09 offset (8) | 11 read delay (8) | 1a 0a raw (10) | 20 status | 38 kind | ... values

Only faults, a missing read delay, a time other than the log time, and an uncertain order change the
length; such messages, and those of damage, are read and written by protobuf.

A value that every frame of the schema has is an integer. Another value is a float (double beyond
two bytes), and NaN in the frames without it: plotters skip NaN, but draw an absent field as 0.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from types import MappingProxyType
from typing import Any

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
from zlib_ng.zlib_ng import crc32

from fte_sniff.protocol import (
    FRAME_LENGTH,
    HEADERS,
    KINDS,
    MOTORS,
    TAIL,
    VALUE_FIELDS,
    Fault,
    Field,
    FrameKind,
    PortEventKind,
    Status,
)
from fte_sniff.protocol.rows import Array, Bools
from fte_sniff.recording.mcap.reader import at_every_byte


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


TOPIC_BY_KIND_AND_MOTOR = MappingProxyType(dict(_topics_of_kinds()))


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
REPEATED = frozenset({"faults"})


def enum_value_name(enum: str, value: str) -> str:
    """The name of an enum value, unique within its message: `KIND_SPEED`."""
    prefix = "".join(f"_{letter}" if letter.isupper() else letter for letter in enum).lstrip("_")
    return f"{prefix}_{value}".upper()


def enum_number(enum: str, value: str) -> int:
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
    if name in REPEATED:
        field.label = _TYPE.LABEL_REPEATED
        return
    field.label = _TYPE.LABEL_OPTIONAL
    field.proto3_optional = True
    field.oneof_index = len(message.oneof_decl)
    message.oneof_decl.add(name=f"_{name}")


def _add_enum(message: DescriptorProto, enum: str) -> None:
    added = message.enum_type.add(name=enum)
    for number, value in enumerate(("none", *_ENUMS[enum])):
        added.value.add(name=enum_value_name(enum, value), number=number)


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

LACKS = frozenset({"faults", "time_ns", "order_uncertain"})
"""Fields that a fault-free frame's message lacks if its time is the log time and its order certain.
"""
LACKS_IF_UNCERTAIN = LACKS - {"order_uncertain"}

FIRST_FIELDS: Mapping[str, int] = {"offset": 1, "read_delay_ns": 10, "raw": 20}
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


def templates_of(descriptor: Any) -> tuple[Template, ...]:
    """The templates of a schema in a file: of rows whose order is certain, and uncertain.

    None for a schema of another form, and for that of damage.
    """
    fields = descriptor.fields
    types = {field.name: field.type for field in fields}
    repeated = [field.name for field in fields if field.default_value == []]
    optional = all(types.get(name, kind) == kind for name, kind in _OPTIONAL_TYPES.items())
    if "framed" in types or repeated != ["faults"] or not (types.items() >= _ROW_TYPES.items()):
        return ()
    if not optional or any(kind not in _TYPES for kind in types.values()):
        return ()
    absences = dict.fromkeys(frozenset(types) & lacks for lacks in (LACKS, LACKS_IF_UNCERTAIN))
    found = [Template(fields, lacks) for lacks in absences]
    first = [{name: one.offset_of(name) for name in FIRST_FIELDS} for one in found]
    return tuple(found) if all(one == FIRST_FIELDS for one in first) else ()


def _varint(number: int) -> bytes:
    found = bytearray()
    while number >= 0x80:
        found.append(number & 0x7F | 0x80)
        number >>= 7
    found.append(number)
    return bytes(found)
