"""Owns where each field stands in messages that are equally long, so that many are read at once.

It must not know files, chunks or numpy; how fields lie one behind the other, `wire` says. A layout
holds for one schema and one length; whether the bytes of a message keep to it, `mask` and
`expected` tell: tags, lengths and the size of every number stand where they must, or the message is
read by protobuf itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import compress, product
from typing import Any

from google.protobuf.descriptor import FieldDescriptor

from fte_sniff.protocol import FRAME_LENGTH
from fte_sniff.recording.encoding.wire import MORE_FOLLOWS, has_known_size, laid

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
        self._fields = list(descriptor.fields)
        self._tells_framed = "framed" in descriptor.fields_by_name
        self._usable = _is_usable(descriptor)
        self._found: dict[int, tuple[Layout, ...]] = {}
        names = [name for name in _MAY_LACK if name in descriptor.fields_by_name]
        self._lacking = [
            frozenset(compress(names, lacks))
            for lacks in product(*(_MAY_LACK[name] for name in names))
        ]
        self.usual = self._built(FRAME_LENGTH, 0, self._lacking[0]) if self._usable else None
        """That of the most usual messages, whose rows are ten bytes without faults."""

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
        last = laid(self._fields, lacking, 0, faults)[-1]
        raw_length = length - last.place - last.size
        if raw_length >= MORE_FOLLOWS:
            raw_length -= 1
            if raw_length < MORE_FOLLOWS:
                return None
        fits = 0 < raw_length < _MOST_IN_TWO if self._tells_framed else raw_length == FRAME_LENGTH
        return self._built(raw_length, faults, lacking) if fits else None

    def _built(self, raw_length: int, faults: int, lacking: frozenset[str]) -> Layout:
        fields = laid(self._fields, lacking, raw_length, faults)
        places = {field.name: field.place for field in fields}
        return Layout(
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
