"""Owns a quick way to the messages of sound frames, which are most of a recording.

It must not encode anything else, nor anything differently: the bytes are those that protobuf makes.

All messages of sound frames of one kind are equally long on the wire: what is the same in all of
them is encoded once, and only the numbers that differ are put in between.

    const  offset  const  read_delay_ns  const  raw  const  cmd  const  value  const  value ...
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import nan
from operator import attrgetter
from typing import Any, TypeAlias

from google.protobuf.descriptor import FieldDescriptor

from fte_sniff.protocol import FRAME_LENGTH, Frame, FrameKind

_Get: TypeAlias = Callable[[Frame], Any]

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_WIRE_FORMATS: Mapping[int, tuple[int, str]] = {
    FieldDescriptor.TYPE_FIXED64: (_FIXED64, "Q"),
    FieldDescriptor.TYPE_SFIXED64: (_FIXED64, "q"),
    FieldDescriptor.TYPE_DOUBLE: (_FIXED64, "d"),
    FieldDescriptor.TYPE_FIXED32: (_FIXED32, "I"),
    FieldDescriptor.TYPE_SFIXED32: (_FIXED32, "i"),
    FieldDescriptor.TYPE_FLOAT: (_FIXED32, "f"),
    FieldDescriptor.TYPE_ENUM: (_VARINT, "B"),
    FieldDescriptor.TYPE_BOOL: (_VARINT, "B"),
    FieldDescriptor.TYPE_BYTES: (_BYTES, f"{FRAME_LENGTH}s"),
}
"""By type, the wire type of a field and how `struct` packs it; enum numbers are below 128."""


@dataclass(frozen=True, slots=True)
class PlainForm:
    """How sound frames of one kind become messages."""

    pack: Callable[..., bytes]
    """Packs constant parts and numbers in turn."""
    parts: tuple[tuple[bytes, _Get], ...]
    """Each constant part, and where the number behind it comes from."""
    rest: bytes
    """The constant part behind the last number."""

    def encode(self, row: Frame) -> bytes:
        """The message of a row that has a read delay, no faults, and its message's own time."""
        values: list[Any] = []
        for constant, get in self.parts:
            values += (constant, get(row))
        return self.pack(*values, self.rest)


def plain_form(message: Any, kind: FrameKind, fixed: Mapping[str, int]) -> PlainForm:
    """The form of a kind's messages.

    Args:
        message: the protobuf class.
        kind: of the frames.
        fixed: the numbers of fields that are the same in all of them; other fields of the message
            that a frame of this kind does not have are NaN, or absent if that cannot be.
    """
    parts: list[tuple[bytes, _Get]] = []
    layout, constant = "<", b""
    for field in sorted(message.DESCRIPTOR.fields, key=lambda field: field.number):
        wire, code = _WIRE_FORMATS[field.type]
        tag = _tag(field.number, wire)
        get = _getter(field.name, kind)
        if get is not None:
            constant += tag
            layout += f"{len(constant)}s{code}"
            parts.append((constant, get))
            constant = b""
        elif field.name in fixed:
            constant += tag + struct.pack(f"<{code}", fixed[field.name])
        elif code in "fd":
            constant += tag + struct.pack(f"<{code}", nan)
    layout += f"{len(constant)}s"
    return PlainForm(struct.Struct(layout).pack, tuple(parts), constant)


def _tag(number: int, wire: int) -> bytes:
    key = number << 3 | wire
    tag = bytes([key]) if key < 0x80 else bytes([key & 0x7F | 0x80, key >> 7])
    return tag + bytes([FRAME_LENGTH]) if wire == _BYTES else tag


def _getter(name: str, kind: FrameKind) -> _Get | None:
    """Where the number of a message's field comes from; None where a frame does not have it."""
    if name in ("offset", "read_delay_ns", "raw", "cmd"):
        return attrgetter(name)
    field = kind.field(name)
    if field is None:
        return None
    read = field.read
    return lambda row: read(row.raw)
