"""Owns where each field stands in messages that are equally long, so that many are read at once.

It must not know files, chunks or numpy. A layout holds for one schema and one length; whether the
bytes of a message keep to it, `mask` and `expected` tell: tags, lengths and the size of every
number stand where they must, or the message is read by protobuf itself.

    tag value  tag value  tag length bytes  tag value ...      fields in the order of their numbers
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import compress, product
from typing import Any

from google.protobuf.descriptor import FieldDescriptor

from fte_sniff.protocol import FRAME_LENGTH

_FIXED_SIZE = {
    FieldDescriptor.TYPE_FIXED32: 4,
    FieldDescriptor.TYPE_SFIXED32: 4,
    FieldDescriptor.TYPE_FLOAT: 4,
    FieldDescriptor.TYPE_FIXED64: 8,
    FieldDescriptor.TYPE_SFIXED64: 8,
    FieldDescriptor.TYPE_DOUBLE: 8,
}
_WIRE_TYPE_OF_SIZE = {4: 5, 8: 1}
_VARINT, _DELIMITED = 0, 2
_MORE_FOLLOWS = 0x80
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
class Layout:
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


class Layouts:
    """The layouts that messages of one schema can have."""

    def __init__(self, descriptor: Any) -> None:
        """Take the message's protobuf descriptor; a schema of another form has no layouts."""
        self._fields = sorted(descriptor.fields, key=lambda field: int(field.number))
        self._tells_framed = "framed" in descriptor.fields_by_name
        self._usable = _is_usable(descriptor)
        self._found: dict[int, tuple[Layout, ...]] = {}
        names = [name for name in _MAY_LACK if name in descriptor.fields_by_name]
        self._lacking = [
            frozenset(compress(names, lacks))
            for lacks in product(*(_MAY_LACK[name] for name in names))
        ]

    def of_length(self, length: int) -> tuple[Layout, ...]:
        """The layouts that make a message so long, the most usual first."""
        if length not in self._found:
            if len(self._found) >= _MOST_KEPT:
                self._found.clear()
            self._found[length] = tuple(self._layouts(length)) if self._usable else ()
        return self._found[length]

    def _layouts(self, length: int) -> Iterator[Layout]:
        for faults, lacking in product(range(MOST_FAULTS + 1), self._lacking):
            layout = self._layout(length, faults, lacking)
            if layout is not None:
                yield layout

    def _layout(self, length: int, faults: int, lacking: frozenset[str]) -> Layout | None:
        raw_length = length - len(_Builder(self._fields, 0, faults, lacking).mask)
        if raw_length >= _MORE_FOLLOWS:
            raw_length -= 1
            if raw_length < _MORE_FOLLOWS:
                return None
        fits = 0 < raw_length < _MOST_IN_TWO if self._tells_framed else raw_length == FRAME_LENGTH
        return _Builder(self._fields, raw_length, faults, lacking).layout() if fits else None


def _is_usable(descriptor: Any) -> bool:
    """Whether every field is of a form whose size is known before its value is."""
    fields = descriptor.fields_by_name
    needed = all(name in fields and fields[name].type == kind for name, kind in _ROW_TYPES.items())
    optional = all(
        fields[name].type == kind for name, kind in _OPTIONAL_TYPES.items() if name in fields
    )
    return needed and optional and all(map(_has_known_size, descriptor.fields))


def _has_known_size(field: Any) -> bool:
    one_byte = (FieldDescriptor.TYPE_ENUM, FieldDescriptor.TYPE_BOOL)
    known = field.type in _FIXED_SIZE or field.type in one_byte or field.name == "raw"
    return bool(known and (field.default_value == []) == (field.name == "faults"))


class _Builder:
    """Lays the fields of a message one behind the other."""

    def __init__(
        self, fields: list[Any], raw_length: int, faults: int, lacking: frozenset[str]
    ) -> None:
        self.mask, self.expected = bytearray(), bytearray()
        self._places: dict[str, int] = {}
        self._raw_length, self._faults = raw_length, faults
        for field in fields:
            if field.name not in lacking and (faults or field.name != "faults"):
                self._add(field)

    def layout(self) -> Layout:
        places = self._places
        return Layout(
            bytes(self.mask),
            bytes(self.expected),
            places["offset"],
            places["raw"],
            self._raw_length,
            places.get("faults", 0),
            self._faults,
            places.get("read_delay_ns"),
            places.get("time_ns"),
            places.get("framed"),
            places.get("order_uncertain"),
        )

    def _add(self, field: Any) -> None:
        size = _FIXED_SIZE.get(field.type)
        if size is not None:
            self._alike(_varint(field.number << 3 | _WIRE_TYPE_OF_SIZE[size]))
            self._free(field.name, size)
        elif field.name == "raw":
            self._alike(_varint(field.number << 3 | _DELIMITED) + _varint(self._raw_length))
            self._free(field.name, self._raw_length)
        elif field.name == "faults":
            self._alike(_varint(field.number << 3 | _DELIMITED) + _varint(self._faults))
            self._free(field.name, self._faults, _MORE_FOLLOWS)
        else:
            is_bool = field.type == FieldDescriptor.TYPE_BOOL
            self._alike(_varint(field.number << 3 | _VARINT))
            self._free(field.name, 1, 0xFE if is_bool else _MORE_FOLLOWS)

    def _alike(self, data: bytes) -> None:
        self.mask += b"\xff" * len(data)
        self.expected += data

    def _free(self, name: str, size: int, zeros: int = 0) -> None:
        """Bytes of any value in which only the bits of `zeros` must be 0."""
        self._places[name] = len(self.mask)
        self.mask += bytes([zeros]) * size
        self.expected += bytes(size)


def _varint(number: int) -> bytes:
    found = bytearray()
    while number >= _MORE_FOLLOWS:
        found.append(number & 0x7F | _MORE_FOLLOWS)
        number >>= 7
    found.append(number)
    return bytes(found)
