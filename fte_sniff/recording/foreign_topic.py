"""Serial bytes in MCAP topics of other programs.

By the encoding of the message, the bytes are:

    cdr, with a schema        its one byte array: std_msgs/UInt8MultiArray, or any message of
                              numbers, strings, a Header and one uint8[]
    protobuf, with a schema   its one field of type bytes
    json                      its one base64 string, or its one list of numbers from 0 to 255
    other or none             the message itself

Messages may be in any order in a file. They are read in the order of their log times, as the
readers of the `mcap` package do: a chunk is read when the first of its times is due.
"""

from __future__ import annotations

import base64
import binascii
import json
import struct
from collections.abc import Callable, Collection, Iterator
from heapq import heapify, heappop, heappush
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO, Final, Literal, NamedTuple

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from fte_sniff.errors import FileError, TranslatableText, listed, unreadable
from fte_sniff.platform import read_at
from fte_sniff.protocol.items import Chunk
from fte_sniff.recording.chunks import (
    HEAD,
    ChunkRef,
    DamagedError,
    contents_of,
    records_in,
    unpack,
)
from fte_sniff.recording.schema import message_class

Payload = Callable[[bytes], bytes]
"""Extracts the serial bytes from a message; raises ValueError if there are none."""

_MESSAGE_HEAD: Final = struct.Struct("<HIQQ")
_END_NS: Final = 2**63
"""The year 2262: a later time does not fit 64-bit columns, and is dropped."""
_CDR_HEAD: Final = 4
_COUNT: Final = 4
_BYTE_ARRAYS: Final = (
    *("uint8[]", "byte[]", "octet[]", "char[]", "sequence<uint8>", "sequence<octet>"),
)


class _Message(NamedTuple):
    """A message of the topic; sorted by its time, then by its place in the file."""

    t_ns: int
    place: tuple[int, int]
    channel: int
    data: bytes


class _Span(NamedTuple):
    """The messages of a topic in a chunk, in file order."""

    first_ns: int
    last_ns: int
    falls: int
    """How often the log time falls from one to the next."""


def topic_chunks(
    path: Path, topics: Collection[str], note: Callable[[str], object] = lambda _text: None
) -> Iterator[Chunk]:
    """The bytes of topics, a chunk for each message, in the order of their log times.

    A topic is also the name of the port. `note` gets a line if a topic has another order in the
    file. Raises FileError if the file cannot be read, lacks a topic, or a message has no bytes; of
    a damaged file at its end.
    """
    try:
        with path.open("rb") as stream:
            yield from _TopicReader(path, topics, stream).chunks(note)
    except OSError as error:
        raise unreadable(path, error) from error


class _TopicReader:
    """Reads some topics of an open file."""

    def __init__(self, path: Path, topics: Collection[str], stream: BinaryIO) -> None:
        """Find the chunks of the file."""
        self._path, self._topics, self._stream = path, topics, stream
        self._contents = contents_of(stream)
        self._payloads: dict[int, Payload] = {}
        self._spans: dict[str, dict[int, _Span]] = {topic: {} for topic in topics}
        """By topic, and by the offset of the chunk."""

    def chunks(self, note: Callable[[str], object]) -> Iterator[Chunk]:
        """The bytes of the topics in the order of log times."""
        waiting = [*self._loose()]
        heapify(waiting)
        for chunk in sorted(self._contents.chunks, key=lambda one: (one.first_ns, one.start)):
            while waiting and waiting[0].t_ns < chunk.first_ns:
                yield self._chunk(heappop(waiting))
            for message in self._messages(chunk):
                heappush(waiting, message)
        self._check_topics()
        while waiting:
            yield self._chunk(heappop(waiting))
        self._note_falls(note)
        for lost in self._contents.lost:
            raise FileError(
                "{path}: {where}: {why}", path=self._path, where=lost.where, why=lost.why
            )

    def _note_falls(self, note: Callable[[str], object]) -> None:
        for topic, spans in self._spans.items():
            own = [spans[start] for start in sorted(spans)]
            falls = sum(one.falls for one in own)
            falls += sum(before.last_ns > after.first_ns for before, after in pairwise(own))
            if falls:
                note(
                    TranslatableText(
                        "{topic}: the log times of its messages fall {count} times in the file; "
                        "they are read in the order of log times",
                        topic=topic,
                        count=falls,
                    )
                )

    def _check_topics(self) -> None:
        names = sorted({channel.topic for channel in self._contents.channels.values()})
        for topic in self._topics:
            if topic not in names:
                raise FileError(
                    "{path} has no topic {topic}: it has {names}",
                    path=self._path,
                    topic=repr(topic),
                    names=listed(map(repr, names)) or TranslatableText("no topics at all"),
                )

    def _loose(self) -> Iterator[_Message]:
        """The messages outside of chunks."""
        descriptor = self._stream.fileno()
        for start, stop in self._contents.messages:
            body = read_at(descriptor, stop - start, start)[HEAD.size :]
            yield from self._of_topics((start, 0), body)

    def _messages(self, chunk: ChunkRef) -> Iterator[_Message]:
        """The messages of a chunk, in file order."""
        data = read_at(self._stream.fileno(), chunk.stop - chunk.start, chunk.start)
        try:
            records = unpack(data[HEAD.size :])
            for opcode, at, stop in records_in(records):
                body = records[at + HEAD.size : stop]
                if opcode == Opcode.MESSAGE:
                    yield from self._of_topics((chunk.start, at), body)
                else:
                    self._contents.define(opcode, body)
        except DamagedError as error:
            raise FileError(
                "{path}: {why} at byte {at}", path=self._path, why=error.why, at=chunk.start
            ) from error

    def _of_topics(self, place: tuple[int, int], body: bytes) -> Iterator[_Message]:
        """The message at a place of the file, if it is of one of the topics."""
        if len(body) < _MESSAGE_HEAD.size:
            return
        channel_id, _, t_ns, _ = _MESSAGE_HEAD.unpack_from(body)
        channel = self._contents.channels.get(channel_id)
        if channel is not None and channel.topic in self._topics:
            spans = self._spans[channel.topic]
            first_ns, last_ns, falls = spans.get(place[0], (t_ns, t_ns, 0))
            spans[place[0]] = _Span(first_ns, t_ns, falls + (last_ns > t_ns))
            yield _Message(t_ns, place, channel_id, body[_MESSAGE_HEAD.size :])

    def _chunk(self, message: _Message) -> Chunk:
        channel = self._contents.channels[message.channel]
        try:
            if message.channel not in self._payloads:
                self._payloads[message.channel] = self._payload_of(channel)
            data = self._payloads[message.channel](message.data)
        except ValueError as error:
            raise FileError(
                "{path}: {topic}: {why}", path=self._path, topic=channel.topic, why=str(error)
            ) from error
        return Chunk(channel.topic, message.t_ns if message.t_ns < _END_NS else None, data)

    def _payload_of(self, channel: Channel) -> Payload:
        schema = self._contents.schemas.get(channel.schema_id)
        if channel.message_encoding == "protobuf" and schema is not None:
            return _protobuf(schema)
        if channel.message_encoding == "cdr" and schema is not None:
            return _cdr(schema)
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
        has = ", ".join(names) or "none"
        raise ValueError(f"{schema} must have one field of bytes to be read; it has {has}")
    return names[0]
