"""Fixed layouts of messages in the protobuf wire format.

Messages of a schema that have the same fields, with rows and fault lists of the same length, are
equally long, and each field is at the same offset. A layout names those offsets, and the bits that
all such messages have in common.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from itertools import compress, product
from typing import Any, NamedTuple

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass

from fte_sniff.protocol import FRAME_LENGTH, HEADERS, TAIL

_CONTINUED = 0x80
"""The bit of a varint's byte that announces another byte; enum numbers have one byte without it."""

_VARINT, _FIXED64, _DELIMITED, _FIXED32 = 0, 1, 2, 5
_TYPES: dict[int, tuple[int, str, int]] = {
    FieldDescriptor.TYPE_FIXED64: (_FIXED64, "Q", 0),
    FieldDescriptor.TYPE_SFIXED64: (_FIXED64, "q", 0),
    FieldDescriptor.TYPE_DOUBLE: (_FIXED64, "d", 0),
    FieldDescriptor.TYPE_FIXED32: (_FIXED32, "I", 0),
    FieldDescriptor.TYPE_SFIXED32: (_FIXED32, "i", 0),
    FieldDescriptor.TYPE_FLOAT: (_FIXED32, "f", 0),
    FieldDescriptor.TYPE_ENUM: (_VARINT, "B", _CONTINUED),
    FieldDescriptor.TYPE_BOOL: (_VARINT, "B", 0xFE),
}
"""By type the wire type, the `struct` code of the value, and the bits that are 0 in each byte."""

SOUND_LACKS = frozenset({"faults", "time_ns", "order_uncertain"})
"""Fields that a fault-free frame's message lacks if its time is the log time and its order certain.
"""


@dataclass(frozen=True, slots=True)
class WireField:
    """One field of a message."""

    name: str
    tag: bytes
    """The bytes before the value: number and wire type, and the length of a delimited value."""
    offset: int
    """Of the value, in bytes from the start of the message."""
    size: int
    code: str
    """The `struct` and numpy code of the little-endian value; `s` for bytes."""
    zeros: int
    """The bits that are 0 in every byte of any value."""


def wire_fields(
    fields: Iterable[Any],
    lacking: Collection[str] = (),
    raw_length: int = FRAME_LENGTH,
    faults: int = 0,
) -> tuple[WireField, ...]:
    """The fields of a message, in wire order, without those whose names are `lacking`.

    `fields` are those of its descriptor, each of known size. The row has `raw_length` bytes; with
    no `faults`, their field is absent.
    """
    found: list[WireField] = []
    end = 0
    for field in sorted(fields, key=lambda field: int(field.number)):
        if field.name in lacking or (field.name == "faults" and not faults):
            continue
        wire, code, zeros = _TYPES.get(field.type, (_DELIMITED, "s", 0))
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
    while number >= _CONTINUED:
        found.append(number & 0x7F | _CONTINUED)
        number >>= 7
    found.append(number)
    return bytes(found)


_MOST_IN_TWO = 2**14
"""Row lengths from here on have a varint of three bytes."""
_MOST_CACHED = 4096
_MOST_FAULTS = 4
"""Rows with more faults are decoded one by one."""
_SIGN = 0x80
"""The sign bit in the last byte of a little-endian number."""

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
"""The fields that a message may lack, and whether it does, the most frequent case first."""


class CommonOffsets(NamedTuple):
    """Offsets in the messages of fault-free frames, the same in every schema of fte-sniff."""

    offset: int = 1
    delay: int = 10
    raw: int = 20


COMMON = CommonOffsets()


@dataclass(frozen=True, slots=True)
class WireLayout:
    """Offsets of the fields, in bytes from the start of the message."""

    mask: bytes
    """The bits that all messages of the layout have in common: tags, lengths, the signs of offset
    and time, `framed`, header and tail of a frame."""
    expected: bytes
    offset: int
    raw: int
    raw_length: int
    faults: int
    fault_count: int
    """Number of faults; 0 without the field."""
    delay: int | None
    """None if the rows have no read delay."""
    time: int | None
    """The row's own time; None if it is the log time."""
    unordered: int | None
    """The byte `order_uncertain`; None if the order is certain."""
    framed: bool
    """Whether the rows are frames; if not, damage."""

    @property
    def is_common(self) -> bool:
        """Whether the rows are fault-free frames, whose fields are at the offsets of `COMMON`."""
        plain = self.time is None and self.unordered is None and not self.fault_count
        return plain and self.framed and (self.offset, self.delay, self.raw) == COMMON

    def fits(self, message: bytes) -> bool:
        """Whether a message of the layout's length has this layout."""
        mask, expected = int.from_bytes(self.mask), int.from_bytes(self.expected)
        return int.from_bytes(message) & mask == expected


_Form = tuple[int, frozenset[str]]
"""The number of faults of a message, and the fields that it lacks."""


class WireLayouts:
    """The layouts that messages of one schema can have."""

    def __init__(self, descriptor: Any) -> None:
        """Take the message's protobuf descriptor; a schema of another form has no layouts."""
        self._fields = list(descriptor.fields)
        self._message = GetMessageClass(descriptor)
        self._has_damage = "framed" in descriptor.fields_by_name
        self._cached: dict[tuple[_Form, int], tuple[WireLayout, ...]] = {}
        self._optional = [name for name in _MAY_LACK if name in descriptor.fields_by_name]
        lacking = [
            frozenset(compress(self._optional, lacks))
            for lacks in product(*(_MAY_LACK[name] for name in self._optional))
        ]
        usable = _is_usable(descriptor)
        self._forms = list(product(range(_MOST_FAULTS + 1), lacking)) if usable else []

    def like(self, message: bytes) -> Iterator[WireLayout]:
        """The layouts of the message's length; its own layout is the first.

        A layout is made when it is needed: a file may have messages of hundreds of lengths.
        """
        own = self._form_of(message)
        for form in sorted(self._forms, key=lambda one: one != own):
            layouts = self._of_form(form, len(message))
            yield from sorted(layouts, key=lambda one: not one.fits(message))

    def _form_of(self, message: bytes) -> _Form | None:
        """The form of a message; None if it does not fit its schema."""
        try:
            found: Any = self._message.FromString(message)
            lacking = frozenset(name for name in self._optional if not found.HasField(name))
        except (DecodeError, ValueError):
            return None
        return len(found.faults), lacking

    def _of_form(self, form: _Form, length: int) -> tuple[WireLayout, ...]:
        found = self._cached.get((form, length))
        if found is None:
            if len(self._cached) >= _MOST_CACHED:
                self._cached.clear()
            found = self._cached[form, length] = tuple(self._layouts(form, length))
        return found

    def _layouts(self, form: _Form, length: int) -> Iterator[WireLayout]:
        faults, lacking = form
        raw_length = self._raw_length(length, faults, lacking)
        if self._has_damage and 0 < raw_length < _MOST_IN_TWO:
            yield self._layout(raw_length, faults, lacking, None)
        if raw_length == FRAME_LENGTH:
            for header in HEADERS.values():
                yield self._layout(raw_length, faults, lacking, header)

    def _raw_length(self, length: int, faults: int, lacking: frozenset[str]) -> int:
        """Bytes of the row in a message of this length; 0 if it cannot be."""
        last = wire_fields(self._fields, lacking, 0, faults)[-1]
        raw_length = length - last.offset - last.size
        if raw_length < _CONTINUED:
            return max(0, raw_length)
        return raw_length - 1 if raw_length > _CONTINUED else 0

    def _layout(
        self, raw_length: int, faults: int, lacking: frozenset[str], header: int | None
    ) -> WireLayout:
        """The layout of frames with this header, or of damage."""
        fields = wire_fields(self._fields, lacking, raw_length, faults)
        offsets = {field.name: field.offset for field in fields}
        mask = bytearray(b"".join(b"\xff" * len(f.tag) + bytes([f.zeros]) * f.size for f in fields))
        expected = bytearray(b"".join(f.tag + bytes(f.size) for f in fields))
        for field in fields:
            if field.name in ("offset", "time_ns"):
                mask[field.offset + field.size - 1] |= _SIGN
        fixed = {}
        if self._has_damage:
            fixed[offsets["framed"]] = int(header is not None)
        if header is not None:
            fixed |= {offsets["raw"]: header, offsets["raw"] + FRAME_LENGTH - 1: TAIL}
        for at, byte in fixed.items():
            mask[at], expected[at] = 0xFF, byte
        return WireLayout(
            bytes(mask),
            bytes(expected),
            offsets["offset"],
            offsets["raw"],
            raw_length,
            offsets.get("faults", 0),
            faults,
            offsets.get("read_delay_ns"),
            offsets.get("time_ns"),
            offsets.get("order_uncertain"),
            header is not None,
        )


def _is_usable(descriptor: Any) -> bool:
    """Whether the size of every field is known before its value is."""
    types = {field.name: field.type for field in descriptor.fields}
    repeated = [field.name for field in descriptor.fields if field.default_value == []]
    sized = all(kind in _TYPES or name == "raw" for name, kind in types.items())
    optional = all(types.get(name, kind) == kind for name, kind in _OPTIONAL_TYPES.items())
    return sized and optional and repeated == ["faults"] and types.items() >= _ROW_TYPES.items()
