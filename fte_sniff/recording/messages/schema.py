"""Topics and protobuf schemas.

All messages of fault-free frames of one schema are equally long: numbers are fixed32, fixed64,
float or double, enum numbers take one byte, and every field has presence, so that zeros are written
too. Only faults, a missing read delay, a time other than the log time, and an uncertain order
change the length.

A value that every frame of the schema has is an integer. Another value is a float (double beyond
two bytes), and NaN in the frames without it: plotters skip NaN, but draw an absent field as 0.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from types import MappingProxyType
from typing import Any

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
    KINDS,
    MOTORS,
    VALUE_FIELDS,
    Fault,
    Field,
    FrameKind,
    PortEventKind,
    Status,
)


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
