"""Serial bytes in MCAP topics of other programs.

By the encoding of the message, the bytes are:

    cdr, with a schema        its one byte array: std_msgs/UInt8MultiArray, or any message whose
                              schema has one uint8[]
    protobuf, with a schema   its one field of type bytes
    other or none             the message itself, but not JSON

Messages may be in any order in a file. They are read in the order of their log times, as the
readers of the `mcap` package do: a chunk is read when the first of its times is due.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Collection, Iterator
from heapq import heappop, heappush
from pathlib import Path
from typing import Final, Literal, TypeAlias

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from fte_sniff.errors import FileError, TranslatableText, listed, unreadable
from fte_sniff.platform import read_at
from fte_sniff.protocol.items import Chunk
from fte_sniff.recording.chunks import (
    HEAD,
    Contents,
    DamagedError,
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
_END_NS: Final = 2**63
"""The year 2262: a later time does not fit 64-bit columns, and is dropped."""


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
                yield Chunk(topic, t_ns if t_ns < _END_NS else None, payloads[id_](data))
    except OSError as error:
        raise unreadable(path, error) from error
    except DamagedError as error:
        raise FileError("{path}: {why}", path=path, why=error.args[0]) from error
    except ValueError as error:
        raise FileError("{path}: {topic}: {why}", path=path, topic=topic, why=str(error)) from error
    names = sorted({channel.topic for channel in contents.channels.values()})
    for topic in set(topics).difference(names):
        has = listed(map(repr, names)) or TranslatableText("no topics at all")
        raise FileError(
            "{path} has no topic {topic}: it has {names}", path=path, topic=repr(topic), names=has
        )
    for lost in contents.lost:
        raise FileError("{path}: {where}: {why}", path=path, where=lost.where, why=lost.why)


def _in_order(descriptor: int, contents: Contents, topics: Collection[str]) -> Iterator[_Message]:
    """The messages of the topics; raises ValueError at damage."""
    parts = [(one.first_ns, one.start, one.stop, True) for one in contents.chunks]
    parts += [(0, start, stop, False) for start, stop in contents.messages]
    waiting: list[_Message] = []
    for first_ns, start, stop, is_chunk in sorted(parts):
        while waiting and waiting[0][0] < first_ns:
            yield heappop(waiting)
        data = read_at(descriptor, stop - start, start)
        records = unpack(data[HEAD.size :]) if is_chunk else data
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
    schema = contents.schemas.get(channel.schema_id)
    if channel.message_encoding == "protobuf" and schema is not None:
        return _protobuf(schema)
    if channel.message_encoding == "cdr" and schema is not None:
        return _cdr(schema)
    if channel.message_encoding == "json":
        raise ValueError("its messages are JSON, which is not read")
    return bytes


def _protobuf(schema: Schema) -> Payload:
    message = message_class(schema.name, schema.data)
    fields = message.DESCRIPTOR.fields
    names = [
        one.name for one in fields if one.type == FieldDescriptor.TYPE_BYTES and not one.is_repeated
    ]
    name = _only(names, schema.name)

    def payload(data: bytes) -> bytes:
        try:
            return bytes(getattr(message.FromString(data), name))
        except DecodeError as error:
            raise ValueError("a message that does not fit its schema") from error

    return payload


_SIZES: Final = {
    **dict.fromkeys(("bool", "byte", "char", "uint8", "int8", "octet"), 1),
    **dict.fromkeys(("uint16", "int16"), 2),
    **dict.fromkeys(("uint32", "int32", "float32"), 4),
    **dict.fromkeys(("uint64", "int64", "float64"), 8),
}
"""Bytes of the numbers of a CDR message."""
_BYTES: Final = ("uint8[]", "byte[]", "char[]")
_OWN: Final = {"Time": ["int32", "uint32"], "Duration": ["int32", "uint32"]}
_CDR_HEAD: Final = 4


def _cdr(schema: Schema) -> Payload:
    """Extractor of the one byte array; the fields before it are skipped.

    The text of a schema has the fields of its message, and then those of the messages in it.
    """
    main, *others = re.split(r"=+\s*MSG: ", schema.data.decode("utf-8", "replace"))
    types = _OWN | {text.split()[0].split("/")[-1]: _kinds(text) for text in others if text.strip()}
    kinds = _kinds(main)
    array = _only([kind for kind in kinds if kind in _BYTES], schema.name)
    before = kinds[: kinds.index(array)]

    def payload(data: bytes) -> bytes:
        reader = _Cdr(data)
        try:
            for kind in before:
                reader.skip(kind, types)
        except RecursionError as error:
            raise ValueError(f"{schema.name} has itself as a field") from error
        return reader.sized()

    return payload


def _kinds(text: str) -> list[str]:
    """The types of the fields of a message; constants are none."""
    lines = [line.split("#")[0].split() for line in text.splitlines()]
    return [line[0] for line in lines if len(line) >= 2 and "=" not in "".join(line[1:])]


class _Cdr:
    """Reader of a CDR message: four bytes of head, then numbers aligned to their size.

    Each field takes at least one byte, so that a hostile schema does not take long.
    """

    def __init__(self, data: bytes) -> None:
        if len(data) < _CDR_HEAD:
            raise ValueError("a message without its header")
        self._data = memoryview(data)[_CDR_HEAD:]
        self._order: Literal["little", "big"] = "little" if data[1] & 1 else "big"
        self._offset = 0

    def skip(self, kind: str, types: dict[str, list[str]]) -> None:
        """Skip a field; raises ValueError if its type is unknown, or the message too short."""
        array = re.fullmatch(r"(.+)\[(<=)?(\d*)\]", kind)
        if array is not None:
            kind, bound, count = array.groups()
            for _ in range(int(count) if count and not bound else self._count()):
                self.skip(kind, types)
        elif kind in _SIZES:
            self._next(_SIZES[kind], _SIZES[kind])
        elif kind.startswith("string"):
            self.sized()
        elif inner := types.get(kind.split("/")[-1]):
            for one in inner:
                self.skip(one, types)
        else:
            raise ValueError(f"a field of type {kind} before its bytes, which cannot be read")

    def sized(self) -> bytes:
        """The bytes of a string or an array behind their number."""
        return bytes(self._next(self._count(), 1))

    def _count(self) -> int:
        return int.from_bytes(self._next(4, 4), self._order)

    def _next(self, size: int, alignment: int) -> memoryview:
        start = self._offset + -self._offset % alignment
        if size > len(self._data) - start:
            raise ValueError("a message that is shorter than it says")
        self._offset = start + size
        return self._data[start : self._offset]


def _only(names: list[str], schema: str) -> str:
    if len(names) != 1:
        has = ", ".join(names) or "none"
        raise ValueError(f"{schema} must have one field of bytes to be read; it has {has}")
    return names[0]
