"""Protobuf wire format offsets and varints."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from itertools import compress, product
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


def wire_fields(
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


_MOST_IN_TWO = 2**14
_MOST_KEPT = 4096
MOST_FAULTS = 4
"""Faults of one row at most that a layout has room for; rows with more are read one by one."""

_ROW_TYPES = {
    "offset": FieldDescriptor.TYPE_FIXED64,
    "read_delay_ns": FieldDescriptor.TYPE_SFIXED64,
    "raw": FieldDescriptor.TYPE_BYTES,
    "faults": FieldDescriptor.TYPE_ENUM,
}
_OPTIONAL_TYPES = {
    "time_ns": FieldDescriptor.TYPE_FIXED64,
    "framed": FieldDescriptor.TYPE_BOOL,
    "order_uncertain": FieldDescriptor.TYPE_BOOL,
}
_MAY_LACK = {
    "order_uncertain": (True, False),
    "time_ns": (True, False),
    "read_delay_ns": (False, True),
}
"""The fields that a message may lack, and whether it does; what is most usual stands first."""


@dataclass(frozen=True, slots=True)
class WireLayout:
    """Places of the fields, in bytes from the start of the message."""

    mask: bytes
    """One byte for each of the message: the bits that every such message has alike."""
    expected: bytes
    """What those bits are."""
    offset: int
    raw: int
    raw_length: int
    """Bytes of the row."""
    faults: int
    fault_count: int
    """Faults of each row; 0 where there is no such field."""
    delay: int | None
    """Place of the read delay; None where these rows have none."""
    time: int | None
    """Place of the row's own time; None where that is the log time."""
    framed: int | None
    """Place of the byte that tells frames from damage; None where all are frames."""
    unordered: int | None
    """Place of the byte that tells whether the order is uncertain; None where it is certain."""


class WireLayouts:
    """The layouts that messages of one schema can have."""

    def __init__(self, descriptor: Any) -> None:
        """Take the message's protobuf descriptor; a schema of another form has no layouts."""
        self._fields = list(descriptor.fields)
        self._tells_framed = "framed" in descriptor.fields_by_name
        self._usable = _is_usable(descriptor)
        self._found: dict[int, tuple[WireLayout, ...]] = {}
        names = [name for name in _MAY_LACK if name in descriptor.fields_by_name]
        self._lacking = [
            frozenset(compress(names, lacks))
            for lacks in product(*(_MAY_LACK[name] for name in names))
        ]
        self.usual = self._built(FRAME_LENGTH, 0, self._lacking[0]) if self._usable else None
        """That of the most usual messages, whose rows are ten bytes without faults."""

    def of_length(self, length: int) -> tuple[WireLayout, ...]:
        """The layouts that make a message so long, the most usual first."""
        if length not in self._found:
            if len(self._found) >= _MOST_KEPT:
                self._found.clear()
            self._found[length] = tuple(self._layouts(length)) if self._usable else ()
        return self._found[length]

    def _layouts(self, length: int) -> Iterator[WireLayout]:
        for faults, lacking in product(range(MOST_FAULTS + 1), self._lacking):
            layout = self._layout(length, faults, lacking)
            if layout is not None:
                yield layout

    def _layout(self, length: int, faults: int, lacking: frozenset[str]) -> WireLayout | None:
        last = wire_fields(self._fields, lacking, 0, faults)[-1]
        raw_length = length - last.place - last.size
        if raw_length >= MORE_FOLLOWS:
            raw_length -= 1
            if raw_length < MORE_FOLLOWS:
                return None
        fits = 0 < raw_length < _MOST_IN_TWO if self._tells_framed else raw_length == FRAME_LENGTH
        return self._built(raw_length, faults, lacking) if fits else None

    def _built(self, raw_length: int, faults: int, lacking: frozenset[str]) -> WireLayout:
        fields = wire_fields(self._fields, lacking, raw_length, faults)
        places = {field.name: field.place for field in fields}
        return WireLayout(
            b"".join(b"\xff" * len(one.tag) + bytes([one.zeros]) * one.size for one in fields),
            b"".join(one.tag + bytes(one.size) for one in fields),
            places["offset"],
            places["raw"],
            raw_length,
            places.get("faults", 0),
            faults,
            places.get("read_delay_ns"),
            places.get("time_ns"),
            places.get("framed"),
            places.get("order_uncertain"),
        )


def _is_usable(descriptor: Any) -> bool:
    """Whether every field is of a form whose size is known before its value is."""
    fields = descriptor.fields_by_name
    needed = all(name in fields and fields[name].type == kind for name, kind in _ROW_TYPES.items())
    optional = all(
        fields[name].type == kind for name, kind in _OPTIONAL_TYPES.items() if name in fields
    )
    return needed and optional and all(map(_has_known_form, descriptor.fields))


def _has_known_form(field: Any) -> bool:
    known = has_known_size(field)
    return bool(known and (field.default_value == []) == (field.name == "faults"))
