"""Serial bytes in MCAP topics of other tools.

By the encoding of the message, the bytes are:

    cdr, with a schema        its one byte array: std_msgs/UInt8MultiArray, or any message of
                              numbers, strings, a Header and one uint8[]
    protobuf, with a schema   its one field of type bytes
    json                      its one base64 string, or its one list of numbers from 0 to 255
    other or none             the message itself
"""

from __future__ import annotations

import base64
import binascii
import json
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from fte_sniff.errors import FileError, unreadable
from fte_sniff.protocol import Chunk
from fte_sniff.recording.mcap.reader import (
    RawRecord,
    RecordError,
    RecordStream,
    parse,
    records_in,
    unpack,
)
from fte_sniff.recording.messages import message_class

Payload = Callable[[bytes], bytes]
"""Extracts the serial bytes from a message; raises ValueError if there are none."""

_MESSAGE_HEAD = struct.Struct("<HIQQ")
_END_NS = 2**63
"""The year 2262: a later time does not fit 64-bit columns, and is dropped."""
_CDR_HEAD = 4
_COUNT = 4
_BYTE_ARRAYS = ("uint8[]", "byte[]", "octet[]", "char[]", "sequence<uint8>", "sequence<octet>")


def topic_chunks(path: Path, topic: str) -> Iterator[Chunk]:
    """The bytes of a topic, a chunk for each message with its log time, in file order.

    The topic is also the name of the port.

    Raises FileError if the file cannot be read, lacks the topic, or a message holds no bytes.
    """
    try:
        with path.open("rb") as stream:
            yield from _TopicReader(path, topic).chunks(stream)
    except OSError as error:
        raise unreadable(path, error) from error


class _TopicReader:
    def __init__(self, path: Path, topic: str) -> None:
        self._path, self._topic = path, topic
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._payloads: dict[int, Payload] = {}

    def chunks(self, stream: Any) -> Iterator[Chunk]:
        records = RecordStream(stream)
        for record in records:
            for opcode, body in self._inner(record):
                if opcode == Opcode.MESSAGE and len(body) >= _MESSAGE_HEAD.size:
                    yield from self._chunk(body)
                elif opcode == Opcode.SCHEMA:
                    schema = parse(Schema, body)
                    self._schemas[schema.id] = schema
                elif opcode == Opcode.CHANNEL:
                    channel = parse(Channel, body)
                    self._channels[channel.id] = channel
        for lost in (*records.losses, records.ending):
            if lost is not None:
                raise FileError(f"{self._path}: {lost.text}")
        if not any(channel.topic == self._topic for channel in self._channels.values()):
            names = sorted({channel.topic for channel in self._channels.values()})
            has = ", ".join(map(repr, names)) or "no topics at all"
            raise FileError(f"{self._path} has no topic {self._topic!r}: it has {has}")

    def _inner(self, record: RawRecord) -> Iterator[tuple[int, bytes]]:
        if record.opcode != Opcode.CHUNK:
            yield record.opcode, record.body
            return
        try:
            yield from records_in(unpack(record.body))
        except RecordError as error:
            raise FileError(f"{self._path}: {error} at byte {record.position}") from error

    def _chunk(self, body: bytes) -> Iterator[Chunk]:
        channel_id, _, log_time, _ = _MESSAGE_HEAD.unpack_from(body)
        channel = self._channels.get(channel_id)
        if channel is None or channel.topic != self._topic:
            return
        if channel_id not in self._payloads:
            self._payloads[channel_id] = self._payload_of(channel)
        try:
            data = self._payloads[channel_id](body[_MESSAGE_HEAD.size :])
        except ValueError as error:
            raise FileError(f"{self._path}: {self._topic}: {error}") from error
        yield Chunk(self._topic, log_time if log_time < _END_NS else None, data)

    def _payload_of(self, channel: Channel) -> Payload:
        schema = self._schemas.get(channel.schema_id)
        try:
            if channel.message_encoding == "protobuf" and schema is not None:
                return _protobuf(schema)
            if channel.message_encoding == "cdr" and schema is not None:
                return _cdr(schema)
        except ValueError as error:
            raise FileError(f"{self._path}: {self._topic}: {error}") from error
        return _json if channel.message_encoding == "json" else bytes


def _protobuf(schema: Schema) -> Payload:
    message = message_class(schema.name, schema.data)
    fields = [
        field.name
        for field in message.DESCRIPTOR.fields
        if field.type == FieldDescriptor.TYPE_BYTES and field.default_value != []
    ]
    name = _only(fields, schema.name)

    def payload(data: bytes) -> bytes:
        try:
            return bytes(getattr(message.FromString(data), name))
        except DecodeError as error:
            raise ValueError("a message that does not fit its schema") from error

    return payload


def _cdr(schema: Schema) -> Payload:
    """Extractor of the one byte array, for messages whose other fields can be skipped."""
    text = schema.data.decode("utf-8", "replace").split("=" * 20)[0]
    lines = [line.split("#")[0].split() for line in text.splitlines()]
    kinds = [line[0] for line in lines if len(line) >= 2 and "=" not in "".join(line[1:])]
    _only([kind for kind in kinds if kind in _BYTE_ARRAYS], schema.name)
    for kind in kinds[: next(at for at, kind in enumerate(kinds) if kind in _BYTE_ARRAYS)]:
        if kind not in _SKIPPED:
            raise ValueError(f"{schema.name} has a {kind} before its bytes, and cannot be read")

    def payload(data: bytes) -> bytes:
        reader = _Cdr(data)
        for kind in kinds:
            if kind in _BYTE_ARRAYS:
                return reader.sized()
            for simple in _SKIPPED[kind]:
                reader.skip(simple)
        raise AssertionError("there is one array of bytes")

    return payload


_NUMBERS = {
    **dict.fromkeys(("bool", "byte", "char", "uint8", "int8", "octet"), 1),
    **dict.fromkeys(("uint16", "int16"), 2),
    **dict.fromkeys(("uint32", "int32", "float32"), 4),
    **dict.fromkeys(("uint64", "int64", "float64"), 8),
}
_TEXT, _DIMENSIONS = "string", "dimensions"
_TIME = ("int32", "uint32")
_HEADER = (*_TIME, _TEXT)
_LAYOUT = (_DIMENSIONS, "uint32")
_SKIPPED: dict[str, tuple[str, ...]] = {
    **{kind: (kind,) for kind in (*_NUMBERS, _TEXT)},
    **dict.fromkeys(("builtin_interfaces/Time", "builtin_interfaces/msg/Time"), _TIME),
    **dict.fromkeys(("std_msgs/Header", "std_msgs/msg/Header", "Header"), _HEADER),
    **dict.fromkeys(
        ("std_msgs/MultiArrayLayout", "std_msgs/msg/MultiArrayLayout", "MultiArrayLayout"), _LAYOUT
    ),
}
"""The simple types in each type of field that can be skipped."""


class _Cdr:
    """Reader of a CDR message: four bytes of head, then numbers aligned to their size."""

    def __init__(self, data: bytes) -> None:
        if len(data) < _CDR_HEAD:
            raise ValueError("a message without its header")
        self._data = memoryview(data)[_CDR_HEAD:]
        self._order: Literal["little", "big"] = "little" if data[1] & 1 else "big"
        self._offset = 0

    def skip(self, kind: str) -> None:
        if kind == _TEXT:
            self.sized()
        elif kind == _DIMENSIONS:
            for _ in range(self._count()):
                for inner in (_TEXT, "uint32", "uint32"):
                    self.skip(inner)
        else:
            self._next(_NUMBERS[kind], _NUMBERS[kind])

    def sized(self) -> bytes:
        return bytes(self._next(self._count(), 1))

    def _count(self) -> int:
        return int.from_bytes(self._next(_COUNT, _COUNT), self._order)

    def _next(self, size: int, alignment: int) -> memoryview:
        start = self._offset + -self._offset % alignment
        if size > len(self._data) - start:
            raise ValueError("a message that is shorter than it says")
        self._offset = start + size
        return self._data[start : self._offset]


def _json(data: bytes) -> bytes:
    try:
        found = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise ValueError("a message that is not JSON") from error
    values = list(found.values()) if isinstance(found, dict) else [found]
    lists = [value for value in values if isinstance(value, list)]
    texts = [value for value in values if isinstance(value, str)]
    try:
        if len(lists) == 1:
            return bytes(lists[0])
        if len(texts) == 1:
            return base64.b64decode(texts[0], validate=True)
    except (TypeError, ValueError, binascii.Error) as error:
        raise ValueError("JSON without bytes in it") from error
    raise ValueError("JSON without one text of base64 or one list of bytes")


def _only(names: list[str], schema: str) -> str:
    if len(names) != 1:
        listed = ", ".join(names) or "none"
        raise ValueError(f"{schema} must have one field of bytes to be read; it has {listed}")
    return names[0]
