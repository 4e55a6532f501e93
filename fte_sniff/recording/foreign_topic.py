"""Serial bytes in MCAP topics of other programs.

By the encoding of the message, the bytes are:

    cdr         of std_msgs/UInt8MultiArray, as ROS 2 drivers publish: its data
    protobuf    its one field of type bytes
    other       the message itself, but not JSON

Messages may be in any order in a file. They are read in the order of their log times, as the
readers of the `mcap` package do: a chunk is read when the first of its times is due.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Collection, Iterator
from heapq import heappop, heappush
from pathlib import Path
from typing import Final, TypeAlias

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from zstandard import ZstdDecompressor

from fte_sniff.errors import FileError, TranslatableText, listed, unreadable
from fte_sniff.platform import read_at
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.rows import END_NS
from fte_sniff.recording.chunks import (
    HEAD,
    Contents,
    contents_of,
    records_in,
    unpack,
)
from fte_sniff.recording.schema import message_class

Payload: TypeAlias = Callable[[bytes], bytes]
"""Extracts the serial bytes from a message; raises ValueError if there are none."""

_Message: TypeAlias = tuple[int, tuple[int, int], int, bytes]
"""A message: its time and its place in the file, which sort it; its channel; its bytes."""

_MESSAGE_HEAD: Final = struct.Struct("<HIQQ")


def topic_chunks(path: Path, topics: Collection[str]) -> Iterator[Chunk]:
    """The bytes of topics, a chunk for each message, in the order of their log times.

    A topic is also the name of the port. Raises FileError if the file cannot be read, lacks a
    topic, or a message has no bytes; of a damaged file at its end.
    """
    payloads: dict[int, Payload] = {}
    try:
        with path.open("rb") as stream:
            contents = contents_of(stream)
            for t_ns, _, id_, data in _in_order(stream.fileno(), contents, topics):
                topic = contents.channels[id_].topic
                if id_ not in payloads:
                    payloads[id_] = _payload_of(contents.channels[id_], contents)
                yield Chunk(topic, t_ns if t_ns < END_NS else None, payloads[id_](data))
    except OSError as error:
        raise unreadable(path, error) from error
    except ValueError as error:
        raise FileError("{path}: {why}", path=path, why=str(error)) from error
    names = sorted({channel.topic for channel in contents.channels.values()})
    for topic in set(topics).difference(names):
        has = listed(map(repr, names)) or TranslatableText("no topics at all")
        raise FileError(
            "{path} has no topic {topic}: it has {names}", path=path, topic=repr(topic), names=has
        )
    for lost in sorted(contents.lost):
        raise FileError("{path}: byte {at}: {why}", path=path, at=lost.start, why=lost.why)


def _in_order(descriptor: int, contents: Contents, topics: Collection[str]) -> Iterator[_Message]:
    """The messages of the topics; raises ValueError at damage."""
    parts = [(one.first_ns, one.start, one.stop, True) for one in contents.chunks]
    parts += [(0, start, stop, False) for start, stop in contents.messages]
    waiting: list[_Message] = []
    for first_ns, start, stop, is_chunk in sorted(parts):
        while waiting and waiting[0][0] < first_ns:
            yield heappop(waiting)
        data = read_at(descriptor, stop - start, start)
        records = unpack(data[HEAD.size :], ZstdDecompressor()) if is_chunk else data
        for opcode, at, end in records_in(records):
            body = records[at + HEAD.size : end]
            contents.define(opcode, body)
            if opcode == Opcode.MESSAGE and len(body) >= _MESSAGE_HEAD.size:
                id_, _, t_ns, _ = _MESSAGE_HEAD.unpack_from(body)
                channel = contents.channels.get(id_)
                if channel is not None and channel.topic in topics:
                    heappush(waiting, (t_ns, (start, at), id_, body[_MESSAGE_HEAD.size :]))
    while waiting:
        yield heappop(waiting)


def _payload_of(channel: Channel, contents: Contents) -> Payload:
    encoding, schema = channel.message_encoding, contents.schemas.get(channel.schema_id)
    if encoding == "protobuf" and schema is not None:
        return _protobuf(schema)
    if encoding == "cdr" and schema is not None and schema.name.endswith("/UInt8MultiArray"):
        return _multi_array
    if encoding in ("cdr", "json"):
        name = schema.name if schema else encoding
        raise ValueError(f"its messages are {name}, which is not read; publish UInt8MultiArray")
    return bytes


def _protobuf(schema: Schema) -> Payload:
    message = message_class(schema.name, schema.data)
    fields = message.DESCRIPTOR.fields
    names = [
        one.name for one in fields if one.type == FieldDescriptor.TYPE_BYTES and not one.is_repeated
    ]
    if len(names) != 1:
        has = ", ".join(names) or "none"
        raise ValueError(f"{schema.name} must have one field of bytes to be read; it has {has}")

    def payload(data: bytes) -> bytes:
        try:
            return bytes(getattr(message.FromString(data), names[0]))
        except DecodeError as error:
            raise ValueError("a message that does not fit its schema") from error

    return payload


def _multi_array(data: bytes) -> bytes:
    """The data of a `std_msgs/UInt8MultiArray`; numbers are aligned to four bytes.

    head 4 | dimensions: count 4 (label: size 4, text | size 4 | stride 4)... | offset 4 |
    data: size 4, bytes
    """
    try:
        number = struct.Struct("<I" if data[1] & 1 else ">I")
        (dimensions,), at = number.unpack_from(data, 4), 8
        for _ in range(dimensions):
            (size,) = number.unpack_from(data, at)
            at += 12 + size + -size % 4
        (size,) = number.unpack_from(data, at + 4)
        return bytes(struct.unpack_from(f"{size}s", data, at + 8)[0])
    except (IndexError, struct.error) as error:
        raise ValueError("a message that is shorter than it says") from error
