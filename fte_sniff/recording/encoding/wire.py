"""Owns how the fields of a message lie on the wire, one behind the other.

It must not know files, chunks or numpy. This is the one description that the reading of many
messages at once (`layout`), the writing of many (`model`) and the packing of single ones
(`plain_messages`) follow; what the fields are, `schema` says.

    tag value  tag value  tag length bytes  tag value ...      fields in the order of their numbers
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Any

from google.protobuf.descriptor import FieldDescriptor

from fte_sniff.protocol import FRAME_LENGTH

MORE_FOLLOWS = 0x80
"""The bit of a varint's byte that tells of another; enum numbers are below it."""

_VARINT, _FIXED64, _DELIMITED, _FIXED32 = 0, 1, 2, 5
_FORMS: dict[int, tuple[int, str, int]] = {
    FieldDescriptor.TYPE_FIXED64: (_FIXED64, "Q", 0),
    FieldDescriptor.TYPE_SFIXED64: (_FIXED64, "q", 0),
    FieldDescriptor.TYPE_DOUBLE: (_FIXED64, "d", 0),
    FieldDescriptor.TYPE_FIXED32: (_FIXED32, "I", 0),
    FieldDescriptor.TYPE_SFIXED32: (_FIXED32, "i", 0),
    FieldDescriptor.TYPE_FLOAT: (_FIXED32, "f", 0),
    FieldDescriptor.TYPE_ENUM: (_VARINT, "B", MORE_FOLLOWS),
    FieldDescriptor.TYPE_BOOL: (_VARINT, "B", 0xFE),
}
"""By type the wire type, the code of the value, and the bits that are 0 in each of its bytes."""

SOUND_LACKS = frozenset({"faults", "time_ns", "order_uncertain"})
"""What messages of sound frames lack, if their order is certain and their time is the log time."""


@dataclass(frozen=True, slots=True)
class WireField:
    """One field of a message."""

    name: str
    tag: bytes
    """All that stands before the value; with its length, where the type does not tell that."""
    place: int
    """Of the value, in bytes from the start of the message."""
    size: int
    """Bytes of the value."""
    code: str
    """The value's form, little-endian, as `struct` and numpy call it; `s` for so many bytes."""
    zeros: int
    """The bits that are 0 in every byte of any value."""


def has_known_size(field: Any) -> bool:
    """Whether the size of a descriptor's field is known before its value is."""
    return field.type in _FORMS or field.name == "raw"


def laid(
    fields: Iterable[Any],
    lacking: Collection[str] = (),
    raw_length: int = FRAME_LENGTH,
    faults: int = 0,
) -> tuple[WireField, ...]:
    """The fields of a message.

    Args:
        fields: those of its descriptor; each of known size.
        lacking: the names of those that are not there.
        raw_length: bytes of the row.
        faults: how many there are; without any, their field is lacking.
    """
    found: list[WireField] = []
    end = 0
    for field in sorted(fields, key=lambda field: int(field.number)):
        if field.name in lacking or (field.name == "faults" and not faults):
            continue
        wire, code, zeros = _FORMS.get(field.type, (_DELIMITED, "s", 0))
        size, length = struct.calcsize(f"<{code}"), b""
        if field.name in ("raw", "faults"):
            wire, code = _DELIMITED, "s"
            size = raw_length if field.name == "raw" else faults
            length = _varint(size)
        tag = _varint(field.number << 3 | wire) + length
        found.append(WireField(field.name, tag, end + len(tag), size, code, zeros))
        end += len(tag) + size
    return tuple(found)


def _varint(number: int) -> bytes:
    found = bytearray()
    while number >= MORE_FOLLOWS:
        found.append(number & 0x7F | MORE_FOLLOWS)
        number >>= 7
    found.append(number)
    return bytes(found)
