"""Topics and schemas of a recording, and one message.

A topic is what people plot without filtering: `/fte/control/motor1`. The schemas are protobuf, made
from the frame table. Numbers are fixed32, fixed64, float or double, enum numbers take one byte, and
every field has presence, so that zeros are written too. So all messages with the same fields are
equally long (`skeletons`):

    09 offset (8) | 11 read delay (8) | 1a 0a raw (10) | 20 status | 38 kind | ... values

A value that every frame of the schema has is an integer. Another value is a float (double beyond
two bytes), and NaN in the frames without it: plotters skip NaN, but draw an absent field as 0.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from math import nan
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass
from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding

from fte_sniff.errors import encodable
from fte_sniff.protocol.items import PortEvent, PortEventKind
from fte_sniff.protocol.rows import NO_KIND, Codes, Row, Rows
from fte_sniff.protocol.spec import (
    CMD_OFFSET,
    KINDS,
    MOTORS,
    NUM_OFFSET,
    VALUE_FIELDS,
    Fault,
    Field,
    FrameKind,
    Role,
    Status,
)
from fte_sniff.recording.metadata import PortFacts

PACKAGE: Final = "fte"


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic of a recording."""

    name: str
    schema: str
    """Name of the schema, without the package."""
    kinds: tuple[FrameKind, ...] = ()
    """The kinds of its frames; none where other rows or port events are."""


MALFORMED: Final = Topic("/fte/malformed", "Malformed")
"""Every row that is not a frame, is of an unknown kind, or has a malformed fault."""

EVENTS: Final = Topic("/fte/port", "PortEvent")


def _topic_and_schema(kind: FrameKind, motor: int) -> tuple[str, str]:
    """The names for a kind of frame: of each motor, of the chassis, or of its own."""
    if kind.names_motor:
        return f"/fte/{kind.direction}/motor{motor}", f"Motor{kind.direction.capitalize()}"
    drives = any(field.role is Role.FORWARD for field in kind.fields)
    own = "chassis" if drives else kind.name
    return f"/fte/{kind.direction}/{own}", own.title().replace("_", "")


def _frame_topics() -> Iterator[Topic]:
    kinds_of: dict[tuple[str, str], dict[FrameKind, None]] = {}
    for kind in KINDS:
        for motor in MOTORS:
            kinds_of.setdefault(_topic_and_schema(kind, motor), {})[kind] = None
    for (name, schema), kinds in kinds_of.items():
        yield Topic(name, schema, tuple(kinds))


TOPICS: Final[tuple[Topic, ...]] = (*_frame_topics(), MALFORMED, EVENTS)

TOPIC_BY_NAME: Final[Mapping[str, Topic]] = MappingProxyType({one.name: one for one in TOPICS})


def _topic_codes() -> Codes:
    """By kind code and NUM: the index in `TOPICS`."""
    codes = np.full((NO_KIND + 1, 256), TOPICS.index(MALFORMED), np.uint8)
    for code, kind in enumerate(KINDS):
        for motor in MOTORS:
            nums = motor if kind.names_motor else slice(None)
            codes[code, nums] = TOPICS.index(TOPIC_BY_NAME[_topic_and_schema(kind, motor)[0]])
    return codes


_TOPIC_CODES: Final = _topic_codes()


def topics_of(rows: Rows) -> Codes:
    """The index in `TOPICS` of each row's topic, uint8."""
    codes: Codes = _TOPIC_CODES[rows.kinds, rows.nums]
    codes[rows.is_malformed] = TOPICS.index(MALFORMED)
    return codes


def topic_of(row: Row | PortEvent) -> Topic:
    """The topic of a row: that of its kind and motor, or `MALFORMED`; `EVENTS` of an event."""
    if isinstance(row, PortEvent):
        return EVENTS
    if row.kind is None or row.status is Status.MALFORMED:
        return MALFORMED
    return TOPICS[int(_TOPIC_CODES[KINDS.index(row.kind), row.raw[NUM_OFFSET]])]


# Schemas

_TYPE: Final = FieldDescriptorProto
_ENUMS: Final[dict[str, tuple[str, ...]]] = {
    "Kind": tuple(kind.name for kind in KINDS),
    "Status": tuple(Status),
    "Fault": tuple(Fault),
    "PortEventKind": tuple(PortEventKind),
}
_ROW_FIELDS: Final[tuple[tuple[str, int | str], ...]] = (
    ("offset", _TYPE.TYPE_FIXED64),
    ("read_delay_ns", _TYPE.TYPE_SFIXED64),
    ("raw", _TYPE.TYPE_BYTES),
    ("status", "Status"),
    ("faults", "Fault"),
    ("time_ns", _TYPE.TYPE_FIXED64),
    ("kind", "Kind"),
    ("order_uncertain", _TYPE.TYPE_BOOL),
)
FRAME_BYTES: Final[Mapping[str, int]] = MappingProxyType({"cmd": CMD_OFFSET})
"""The further fields of every frame that are one of its bytes, by offset."""
_EVENT_FIELDS: Final[tuple[tuple[str, int | str], ...]] = (
    ("kind", "PortEventKind"),
    ("detail", _TYPE.TYPE_STRING),
    ("time_ns", _TYPE.TYPE_FIXED64),
    ("count", _TYPE.TYPE_FIXED64),
)
_DAMAGE_FIELDS: Final[tuple[tuple[str, int | str], ...]] = (
    ("framed", _TYPE.TYPE_BOOL),
    ("length", _TYPE.TYPE_FIXED32),
)


def _number(enum: str, value: str) -> int:
    """The number of an enum value; 0 is `..._NONE`."""
    return _ENUMS[enum].index(value) + 1


def value_fields(topic: Topic) -> tuple[Field, ...]:
    """The frame fields that messages of this topic hold, each once; none for `MALFORMED`."""
    names = {field.name for kind in topic.kinds for field in kind.fields}
    return tuple(field for field in VALUE_FIELDS if field.name in names)


def _value_type(field: Field, topic: Topic) -> int:
    if any(kind.field(field.name) is None for kind in topic.kinds):
        return _TYPE.TYPE_FLOAT if field.size <= 2 else _TYPE.TYPE_DOUBLE
    return _TYPE.TYPE_SFIXED32 if field.signed else _TYPE.TYPE_FIXED32


def _fields(topic: Topic) -> tuple[tuple[str, int | str], ...]:
    if topic is EVENTS:
        return _EVENT_FIELDS
    if topic is MALFORMED:
        return (*_ROW_FIELDS, *_DAMAGE_FIELDS)
    values = [(field.name, _value_type(field, topic)) for field in value_fields(topic)]
    return (*_ROW_FIELDS, *((name, _TYPE.TYPE_FIXED32) for name in FRAME_BYTES), *values)


def _add_field(message: DescriptorProto, name: str, number: int, kind: int | str) -> None:
    field = message.field.add(name=name, number=number, json_name=name)
    if isinstance(kind, str):
        field.type = _TYPE.TYPE_ENUM
        field.type_name = f".{PACKAGE}.{message.name}.{kind}"
    else:
        field.type = kind  # type: ignore[assignment]
    if name == "faults":
        field.label = _TYPE.LABEL_REPEATED
        return
    field.label = _TYPE.LABEL_OPTIONAL
    field.proto3_optional = True
    field.oneof_index = len(message.oneof_decl)
    message.oneof_decl.add(name=f"_{name}")


def _add_enum(message: DescriptorProto, enum: str) -> None:
    """Add an enum; its value names are unique within the message: `KIND_SPEED`."""
    prefix = "".join(f"_{letter}" if letter.isupper() else letter for letter in enum).lstrip("_")
    added = message.enum_type.add(name=enum)
    for number, value in enumerate(("none", *_ENUMS[enum])):
        added.value.add(name=f"{prefix}_{value}".upper(), number=number)


def schema_name(topic: Topic) -> str:
    """The full name of the topic's messages: `fte.MotorControl`."""
    return f"{PACKAGE}.{topic.schema}"


@cache
def schema_data(schema: str) -> bytes:
    """The serialized FileDescriptorSet of a schema: the schema data of an MCAP file."""
    topic = next(topic for topic in TOPICS if topic.schema == schema)
    file = FileDescriptorProto(name=f"{PACKAGE}/{schema}.proto", package=PACKAGE, syntax="proto3")
    message = file.message_type.add(name=schema)
    for number, (name, kind) in enumerate(_fields(topic), 1):
        _add_field(message, name, number, kind)
        if isinstance(kind, str):
            _add_enum(message, kind)
    return FileDescriptorSet(file=[file]).SerializeToString(deterministic=True)


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


def class_of(topic: Topic) -> Any:
    """The message class of a topic."""
    return message_class(schema_name(topic), schema_data(topic.schema))


# One message


def encode(entry: Row | PortEvent, log_time: int) -> bytes:
    """The message of a row, which must have a time, or of a port event, on its topic.

    It holds the time of the row or event if `log_time` differs.
    """
    topic = topic_of(entry)
    values = _event_values(entry) if isinstance(entry, PortEvent) else _row_values(entry, topic)
    if entry.t_ns != log_time:
        values["time_ns"] = entry.t_ns
    return bytes(class_of(topic)(**values).SerializeToString(deterministic=True))


def _row_values(row: Row, topic: Topic) -> dict[str, Any]:
    values: dict[str, Any] = {
        "offset": row.offset,
        "raw": row.raw,
        "status": _number("Status", row.status),
        "faults": [_number("Fault", fault) for fault in row.faults],
        "kind": 0 if row.kind is None else _number("Kind", row.kind.name),
    }
    if row.delay_ns is not None:
        values["read_delay_ns"] = row.delay_ns
    if row.unordered:
        values["order_uncertain"] = True
    if topic is MALFORMED:
        return values | {"framed": row.framed, "length": len(row.raw)}
    numbers = {field.name: nan for field in value_fields(topic)} | row.values
    return values | numbers | {name: row.raw[at] for name, at in FRAME_BYTES.items()}


def _event_values(event: PortEvent) -> dict[str, Any]:
    kind = _number("PortEventKind", event.kind)
    return {"kind": kind, "detail": encodable(event.detail), "count": event.count}


def schemas() -> list[Schema]:
    """Every schema of a recording."""
    topics = {topic.schema: topic for topic in TOPICS}.values()
    return [
        Schema(id_, schema_data(one.schema), SchemaEncoding.Protobuf, schema_name(one))
        for id_, one in enumerate(topics, 1)
    ]


def channel_ids(port: int) -> range:
    """The channels of a port, by its number in the file from 0: one for each of `TOPICS`."""
    return range(port * len(TOPICS) + 1, (port + 1) * len(TOPICS) + 1)


def channels_of(number: int, port: PortFacts) -> list[Channel]:
    """A channel for each topic of the port with this number in the file, from 0."""
    metadata = {"port": encodable(port.name)}
    if port.baud is not None:
        metadata["baud"] = str(port.baud)
    ids = {schema.name: schema.id for schema in schemas()}
    return [
        Channel(id_, topic.name, MessageEncoding.Protobuf, metadata, ids[schema_name(topic)])
        for id_, topic in zip(channel_ids(number), TOPICS, strict=True)
    ]
