"""Template: the layout of a fault-free frame's message, to read and to write.

Every field of such a message has a fixed size, so each is at the same offset in all messages that
have the same fields:

    09 offset (8) | 11 read delay (8) | 1a 0a raw (10) | 20 status | 38 kind | ... values

Rows with faults, a time of their own or no read delay, and damage, have other fields; they are read
and written by protobuf.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np
from google.protobuf.descriptor import FieldDescriptor

from fte_sniff.protocol import FRAME_LENGTH, HEADERS, TAIL
from fte_sniff.protocol.rows import Array, Bools
from fte_sniff.recording.mcap.chunk_index import at_every_byte

_VARINT, _FIXED64, _DELIMITED, _FIXED32 = 0, 1, 2, 5
_TYPES: dict[int, tuple[int, str, int]] = {
    FieldDescriptor.TYPE_FIXED64: (_FIXED64, "<u8", 0),
    FieldDescriptor.TYPE_SFIXED64: (_FIXED64, "<i8", 0),
    FieldDescriptor.TYPE_DOUBLE: (_FIXED64, "<f8", 0),
    FieldDescriptor.TYPE_FIXED32: (_FIXED32, "<u4", 0),
    FieldDescriptor.TYPE_SFIXED32: (_FIXED32, "<i4", 0),
    FieldDescriptor.TYPE_FLOAT: (_FIXED32, "<f4", 0),
    # A number of one byte: the bit that announces another byte is 0.
    FieldDescriptor.TYPE_ENUM: (_VARINT, "u1", 0x80),
    FieldDescriptor.TYPE_BOOL: (_VARINT, "u1", 0xFE),
    FieldDescriptor.TYPE_BYTES: (_DELIMITED, f"V{FRAME_LENGTH}", 0),
}
"""By type the wire type, the numpy type of the value, and the bits that are 0 in each byte."""

LACKS = frozenset({"faults", "time_ns", "order_uncertain"})
"""Fields that a fault-free frame's message lacks if its time is the log time and its order certain.
"""
LACKS_IF_UNCERTAIN = LACKS - {"order_uncertain"}

FIRST_FIELDS: Mapping[str, int] = {"offset": 1, "read_delay_ns": 10, "raw": 20}
"""Offsets of the first fields, the same in each template of a schema that fte-sniff writes."""

_ROW_TYPES = {
    "offset": FieldDescriptor.TYPE_FIXED64,
    "read_delay_ns": FieldDescriptor.TYPE_SFIXED64,
    "raw": FieldDescriptor.TYPE_BYTES,
    "faults": FieldDescriptor.TYPE_ENUM,
}
_OPTIONAL_TYPES = {
    "time_ns": FieldDescriptor.TYPE_FIXED64,
    "order_uncertain": FieldDescriptor.TYPE_BOOL,
}
_WORD = 8
_STRIPE = 64
_SIGN = 0x80
"""The sign bit in the last byte of a little-endian number."""
_IS_HEADER = np.isin(np.arange(256), list(HEADERS.values()))


class Template:
    """The offsets of the fields of a message, and the bytes that all such messages have."""

    def __init__(self, fields: Iterable[Any], lacks: Collection[str] = ()) -> None:
        """Take the fields of a message's descriptor; messages lack those whose names are `lacks`.

        Raises KeyError if the size of a field depends on its value.
        """
        self._fields: dict[str, tuple[str, int]] = {}
        mask, expected = bytearray(), bytearray()
        for field in sorted(fields, key=lambda field: int(field.number)):
            if field.name in lacks:
                continue
            wire, kind, zeros = _TYPES[field.type]
            size = np.dtype(kind).itemsize
            tag = _varint(field.number << 3 | wire) + bytes([size] * (wire == _DELIMITED))
            self._fields[field.name] = kind, len(mask) + len(tag)
            mask += b"\xff" * len(tag) + bytes([zeros]) * size
            expected += tag + bytes(size)
        mask[self.offset_of("offset") + _WORD - 1] |= _SIGN
        tail = self.offset_of("raw") + FRAME_LENGTH - 1
        mask[tail], expected[tail] = 0xFF, TAIL
        self.length = len(mask)
        """Bytes of a message."""
        # In front, where the record of a message has its head, so that the words are whole.
        self._padding = -self.length % _WORD
        self._mask = np.frombuffer(bytes(self._padding) + mask, "<u8")
        self._expected = np.frombuffer(bytes(self._padding) + expected, "<u8")

    def __contains__(self, name: object) -> bool:
        return name in self._fields

    def offset_of(self, name: str) -> int:
        """The offset of a field's value in a message."""
        return self._fields[name][1]

    def fitting(self, records: bytes, starts: Array) -> Bools:
        """A mask of the messages that have this layout, and are frames.

        `starts` are those of messages of the template's length in `records`, which have at least
        seven bytes before each.
        """
        windows = at_every_byte(records, self._padding + self.length)
        words = windows[starts - self._padding].view("<u8").reshape(len(starts), -1)
        heads = np.frombuffer(records, np.uint8)[starts + self.offset_of("raw")]
        framed: Bools = _IS_HEADER.take(heads)
        if not self._all_agree(words):
            framed &= ~self._deviations(words).any(axis=1)
        return framed

    def _deviations(self, words: Array) -> Array:
        found: Array = words & self._mask
        found ^= self._expected
        return found

    def _all_agree(self, words: Array) -> bool:
        """Whether every message agrees; `words` has a line for each."""
        striped = len(words) // _STRIPE * _STRIPE
        if self._deviations(words[striped:]).any():
            return False
        if not striped:
            return True
        # 64 messages in a line: numpy reduces long lines at the speed of memory.
        wide = words[:striped].reshape(-1, _STRIPE * words.shape[1])
        found = self._deviations(np.bitwise_or.reduce(wide, axis=0).reshape(_STRIPE, -1))
        found |= self._deviations(np.bitwise_and.reduce(wide, axis=0).reshape(_STRIPE, -1))
        return not found.any()

    def record_type(self, head: Mapping[str, tuple[str, int]], base: int) -> np.dtype[Any]:
        """The numpy type of a record: a head, with types and offsets, and the message at `base`."""
        fields = {name: (kind, base + offset) for name, (kind, offset) in self._fields.items()}
        kinds, offsets = zip(*{**head, **fields}.values(), strict=True)
        return np.dtype(
            {
                "names": [*head, *fields],
                "formats": list(kinds),
                "offsets": list(offsets),
                "itemsize": base + self.length,
            }
        )


def templates_of(descriptor: Any) -> tuple[Template, ...]:
    """The templates of a schema in a file: of rows whose order is certain, and uncertain.

    None for a schema of another form, and for that of damage.
    """
    fields = descriptor.fields
    types = {field.name: field.type for field in fields}
    repeated = [field.name for field in fields if field.default_value == []]
    optional = all(types.get(name, kind) == kind for name, kind in _OPTIONAL_TYPES.items())
    if "framed" in types or repeated != ["faults"] or not (types.items() >= _ROW_TYPES.items()):
        return ()
    if not optional or any(kind not in _TYPES for kind in types.values()):
        return ()
    absences = dict.fromkeys(frozenset(types) & lacks for lacks in (LACKS, LACKS_IF_UNCERTAIN))
    found = [Template(fields, lacks) for lacks in absences]
    first = [{name: one.offset_of(name) for name in FIRST_FIELDS} for one in found]
    return tuple(found) if all(one == FIRST_FIELDS for one in first) else ()


def _varint(number: int) -> bytes:
    found = bytearray()
    while number >= 0x80:
        found.append(number & 0x7F | 0x80)
        number >>= 7
    found.append(number)
    return bytes(found)
