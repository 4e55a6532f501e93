"""Messages to columns and back.

Two messages have the same skeleton if they differ in the values of fixed-size numbers, in the row's
own bytes, and in the enums that those imply only. One message of each skeleton is parsed, or
encoded, by protobuf; its wire format shows where the numbers are. Numpy reads and writes all others
as one table:

    09 ........ 11 ........ 1a 0a .......... 20 01 38 02 45 .... 4d ....     of a speed command
       offset      delay          raw         the rest is the skeleton

So faults, absent fields and damage of any length need no special case, and every version of the
schema is read in the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError

from fte_sniff.protocol.items import PortEvent, PortEventKind
from fte_sniff.protocol.rows import (
    ARRAYS,
    IS_HEADER,
    MOST_BYTES,
    Array,
    Bools,
    Codes,
    Ints,
    Row,
    Rows,
    fault_bits,
)
from fte_sniff.protocol.spec import FRAME_LENGTH, TAIL, Fault
from fte_sniff.recording.chunks import HEAD
from fte_sniff.recording.schema import FRAME_BYTES, MALFORMED, class_of, encode, topic_of

MESSAGE: Final = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<i8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log", "<i8"),
        ("publish", "<i8"),
    ]
)
"""The head of a message record; times in nanoseconds since 1970 UTC."""
MESSAGE_HEAD: Final = MESSAGE.itemsize
"""Bytes of a message record before the message."""
LONGEST: Final = 4096
"""Bytes of a message; longer ones are not read."""
_MOST_SKELETONS: Final = 1024
"""Skeletons of one schema and length. Messages of others are not read, so that a hostile file does
not take long."""
_WORD: Final = 8
_AT_ONCE: Final = 64
"""Messages that are compared in one row of numbers."""
_SIZES: Final = {1: 8, 5: 4}
"""Bytes of a number by its wire type."""
_DELIMITED: Final = 2
_DERIVED: Final = ("status", "kind")
"""The enums that the bytes and the faults imply; they may differ within a skeleton."""
_NUMBERS: Final = {"time_ns": "t_ns", "offset": "offset", "read_delay_ns": "delay_ns"}
"""The columns of the numbers that are not in the bytes."""


class Messages(NamedTuple):
    """The message records of unpacked chunks, in file order."""

    records: bytes
    starts: Ints
    """Offsets of the records."""
    lengths: Ints
    """Bytes of the messages, without their heads."""
    channels: Ints
    log_times: Ints
    """Nanoseconds since 1970 UTC; negative from the year 2262 on."""

    @classmethod
    def at(cls, starts: Ints, records: bytes) -> Messages:
        """The messages whose records begin at some offsets."""
        heads = at_every_byte(records, MESSAGE_HEAD)[starts].view(MESSAGE)
        lengths = heads["length"] - (MESSAGE_HEAD - HEAD.size)
        return cls(records, starts, lengths, heads["channel"].astype(int), heads["log"].copy())


@dataclass(frozen=True, slots=True, eq=False)
class MessageType:
    """The messages of a schema."""

    parse: Callable[[bytes], Any]
    names: Mapping[int, str]
    """The names of the fields by number."""
    is_event: bool

    def members(self, message: Any, field: str) -> list[str]:
        """The names of the enum values of a field, without their prefix; raises KeyError."""
        values = message.DESCRIPTOR.fields_by_name[field].enum_type.values_by_number
        prefix = len(values[0].name.removesuffix("NONE"))
        numbers = getattr(message, field)
        numbers = [numbers] if isinstance(numbers, int) else numbers
        return [values[number].name[prefix:].lower() for number in numbers]


class _Skeleton:
    """The messages of one skeleton: where their numbers are, and what they share."""

    def __init__(self, kind: MessageType, data: bytes) -> None:
        """Take one of the messages; raises DecodeError, AttributeError, or what `int` raises."""
        message = kind.parse(data)
        self.framed = getattr(message, "framed", True)
        self.fields, mask = fields_in(data, kind.names)
        _, self.size = self.fields["raw"]
        if not self.size or (self.framed and self.size != FRAME_LENGTH):
            raise ValueError("a row without bytes, or a frame of another length")
        self.shared = {
            "length": min(self.size, MOST_BYTES),
            "faults": fault_bits(map(Fault, kind.members(message, "faults"))),
            "framed": self.framed,
            "unordered": getattr(message, "order_uncertain", False),
        }
        self.padding = -len(data) % _WORD
        self._mask = np.frombuffer(bytes(self.padding) + mask, "<u8")
        self._expected = np.frombuffer(bytes(self.padding) + data, "<u8") & self._mask

    def fitting(self, windows: Array) -> Bools:
        """Which messages, behind their padding, have this skeleton."""
        words = windows.view("<u8").reshape(len(windows), -1)
        if all(self._agrees(words, combine) for combine in (np.bitwise_or, np.bitwise_and)):
            return np.ones(len(words), np.bool_)
        fits: Bools = ((words & self._mask) == self._expected).all(axis=1)
        return fits

    def _agrees(self, words: Array, combine: np.ufunc) -> bool:
        """Whether all messages, combined bit by bit, are like the skeleton."""
        many = len(words) // _AT_ONCE * _AT_ONCE
        wide = combine.reduce(words[:many].reshape(-1, _AT_ONCE * words.shape[1]), axis=0)
        rest = np.concatenate([wide.reshape(_AT_ONCE, -1), words[many:]])
        return bool(np.array_equal(combine.reduce(rest, axis=0) & self._mask, self._expected))

    def store(self, windows: Array, own: Array, columns: Rows) -> list[Rows]:
        """Fill in the columns of the rows `own` from their messages, behind their padding.

        What a message does not have, and most have alike, stays as it is. Returns the rows of each
        16 bytes beyond the first 16.
        """
        for name, column in _NUMBERS.items():
            place, size = self.fields.get(name, (0, 0))
            if size == _WORD:
                values = column_at(windows, "<i8", self.padding + place).copy()  # aligned: faster
                columns.columns[column][own] = values
        for column, value in self.shared.items():
            if value != ARRAYS[column][1]:
                columns.columns[column][own] = value
        self._store_raw(windows, 0, own, columns)
        more = []
        for first in range(MOST_BYTES, self.size, MOST_BYTES):
            rest = columns.select(own)
            rest.offset[:] += first
            rest.length[:] = min(self.size - first, MOST_BYTES)
            rest.raw[:] = 0
            self._store_raw(windows, first, slice(None), rest)
            more.append(rest)
        return more

    def _store_raw(self, windows: Array, first: int, own: Array | slice, columns: Rows) -> None:
        """Fill in `raw` with up to 16 bytes from the number `first` on."""
        kind = f"V{min(self.size - first, MOST_BYTES)}"
        place = self.padding + self.fields["raw"][0] + first
        column_at(columns.raw, kind, 0)[own] = column_at(windows, kind, place)


def column_at(table: Array, kind: str, place: int) -> Array:
    """The values of a type at a byte of each row of a table; not copied."""
    return np.ndarray(len(table), kind, table, place, table.strides[:1])


def fields_in(data: bytes, names: Mapping[int, str]) -> tuple[dict[str, tuple[int, int]], bytes]:
    """The offset and size of a message's numbers and bytes, and a mask of what else is compared.

    Raises IndexError if the message is cut.
    """
    fields, mask, at = {}, bytearray(b"\xff") * len(data), 0
    while at < len(data):
        tag, at = _varint(data, at)
        name, wire = names.get(tag >> 3, ""), tag & 7
        if wire == 0:
            first = at
            _, at = _varint(data, at)
            if name in _DERIVED and at == first + 1:
                mask[first] = 0x80
            continue
        size = _SIZES.get(wire, 0)
        if wire == _DELIMITED:
            size, at = _varint(data, at)
        if wire != _DELIMITED or name == "raw":
            fields[name] = at, size
            mask[at : at + size] = bytes(size)
        at += size
    return fields, bytes(mask)


def _varint(data: bytes, at: int) -> tuple[int, int]:
    found = shift = 0
    while True:
        byte = data[at]
        found, shift, at = found | (byte & 0x7F) << shift, shift + 7, at + 1
        if byte < 0x80:
            return found, at


class Decoded(NamedTuple):
    """The rows and events of some messages."""

    rows: Rows
    places: Ints
    """The index of each row's message."""
    events: dict[int, PortEvent]
    """By the index of their message."""
    unreadable: int
    """Messages that could not be read."""


class MessageDecoder:
    """Decodes the messages of a file; keeps its skeletons."""

    def __init__(self) -> None:
        self._skeletons: dict[tuple[MessageType, int], list[_Skeleton]] = {}
        """By the type and the length of the message."""

    def decode(
        self, messages: Messages, channels: Mapping[int, tuple[MessageType, str]]
    ) -> Decoded:
        """The rows and events of messages, by the type and the port of their channels.

        Messages of other channels are skipped. Noise of more than 16 bytes becomes several rows.
        """
        kinds = list(dict.fromkeys(kind for kind, _ in channels.values()))
        ports = tuple(dict.fromkeys(port for _, port in channels.values()))
        key_of, port_of = np.zeros((2, messages.channels.max(initial=0) + 1), np.int64)
        for id_, (kind, port) in channels.items():
            key_of[id_], port_of[id_] = (kinds.index(kind) + 1) * LONGEST, ports.index(port)
        keys = key_of.take(messages.channels)
        ours = int(np.count_nonzero(keys))
        keys += messages.lengths
        keys *= (messages.lengths < LONGEST) & (messages.log_times >= 0)
        if len(kinds) < (1 << 16) // LONGEST:
            keys = keys.astype(np.uint16)  # which numpy sorts in one pass
        port_codes = port_of.take(messages.channels)
        columns = Rows.blank(len(keys), ports, t_ns=messages.log_times, port=port_codes)
        kept = np.zeros(len(keys), np.bool_)
        more: list[tuple[Array, Rows]] = []
        events: dict[int, PortEvent] = {}
        for own in groups_of(keys):
            code = int(keys[own[0]]) // LONGEST
            if code and kinds[code - 1].is_event:
                events |= _events(messages, own, kinds[code - 1], columns)
            elif code:
                for read, rests in self._decode_alike(messages, own, kinds[code - 1], columns):
                    kept[read] = True
                    more += [(read, rest) for rest in rests]
        is_frame = IS_HEADER.take(columns.raw[:, 0]) & (columns.raw[:, FRAME_LENGTH - 1] == TAIL)
        kept &= (columns.t_ns >= 0) & (columns.offset >= 0) & (is_frame | ~columns.framed)
        places = np.flatnonzero(kept)
        rows = columns if len(places) == len(columns) else columns.select(places)
        unreadable = ours - len(places) - len(events)
        if more:
            more = [(own[kept[own]], rest.select(kept[own])) for own, rest in more]
            places = np.concatenate([places, *(own for own, _ in more)])
            order = np.argsort(places, kind="stable")
            places = places[order]
            rows = Rows.concat([rows, *(rest for _, rest in more)]).select(order)
        return Decoded(rows, places, events, unreadable)

    def _decode_alike(
        self, messages: Messages, own: Array, kind: MessageType, columns: Rows
    ) -> Iterator[tuple[Array, list[Rows]]]:
        """Decode messages of one type and length.

        Yields the rows of each skeleton, and those of their bytes beyond the first 16.
        """
        length = int(messages.lengths[own[0]])
        known = self._skeletons.setdefault((kind, length), [])
        padding = -length % _WORD
        every = at_every_byte(messages.records, length + padding)
        windows = every[messages.starts[own] + (MESSAGE_HEAD - padding)]
        number = 0
        while len(own) and number < _MOST_SKELETONS:
            if number == len(known):
                try:
                    known.append(_Skeleton(kind, windows[0].tobytes()[padding:]))
                except (DecodeError, AttributeError, KeyError, ValueError, IndexError):
                    windows, own = windows[1:], own[1:]
                    continue
            fits = known[number].fitting(windows)
            if fits.any():
                some = slice(None) if fits.all() else fits
                yield own[some], known[number].store(windows[some], own[some], columns)
                windows, own = windows[~fits], own[~fits]
            number += 1


def at_every_byte(records: bytes | Codes, size: int) -> Array:
    """Opaque values of `size` bytes at every offset of some bytes."""
    return np.ndarray((max(0, len(records) - size + 1),), f"V{size}", records, 0, (1,))


def groups_of(keys: Array) -> list[Ints]:
    """The indices of each value, in order; the values rise."""
    by_key = np.argsort(keys, kind="stable")
    cuts = np.flatnonzero(np.diff(keys[by_key]) != 0) + 1
    return np.split(by_key, cuts) if len(keys) else []


def _events(
    messages: Messages, own: Array, kind: MessageType, columns: Rows
) -> dict[int, PortEvent]:
    """The events that can be read, by the index of their message."""
    found: dict[int, PortEvent] = {}
    for row in own.tolist():
        port, t_ns = columns.ports[columns.port[row]], int(messages.log_times[row])
        try:
            start = int(messages.starts[row]) + MESSAGE_HEAD
            message = kind.parse(messages.records[start : start + int(messages.lengths[row])])
            (name,) = kind.members(message, "kind")
            # The first recordings have neither a time nor a count.
            t_ns = getattr(message, "time_ns", 0) or t_ns
            count = getattr(message, "count", 0)
            event = PortEvent(t_ns, port, PortEventKind(name), message.detail, count)
        except (DecodeError, AttributeError, KeyError, ValueError):
            continue
        if 0 <= t_ns < 1 << 63:
            found[row] = event
    return found


# Columns to messages

_TYPES: Final = {
    FieldDescriptor.TYPE_FIXED64: "<u8",
    FieldDescriptor.TYPE_SFIXED64: "<i8",
    FieldDescriptor.TYPE_DOUBLE: "<f8",
    FieldDescriptor.TYPE_FIXED32: "<u4",
    FieldDescriptor.TYPE_SFIXED32: "<i4",
    FieldDescriptor.TYPE_FLOAT: "<f4",
}


class Template:
    """The messages of rows that are like a sample in all but their numbers and bytes."""

    def __init__(self, row: Row, log_time: int) -> None:
        """Encode the sample."""
        topic = topic_of(row)
        self._message = encode(row, log_time)
        descriptors = class_of(topic).DESCRIPTOR.fields
        self._types = {one.name: _TYPES.get(one.type, f"V{len(row.raw)}") for one in descriptors}
        self._places, _ = fields_in(self._message, {one.number: one.name for one in descriptors})
        kind = row.kind if topic is not MALFORMED else None
        self._fields = {"raw": (f"V{len(row.raw)}", 0)}
        self._fields |= {name: ("u1", at) for name, at in FRAME_BYTES.items()}
        self._fields |= {
            field.name: (f">{'i' if field.signed else 'u'}{field.size}", field.start)
            for field in (kind.fields if kind else ())
        }
        """The type and offset, in the row's bytes, of the values that differ from the sample's."""

    def encode(self, rows: Rows, own: Ints) -> Array:
        """The messages of some rows, as opaque values; fields of other kinds stay NaN."""
        messages, raw = np.full(len(own), np.void(self._message)), rows.raw[own]
        for name, (place, _) in self._places.items():
            if name in _NUMBERS:
                values = rows.columns[_NUMBERS[name]][own]
            elif name in self._fields:
                values = column_at(raw, *self._fields[name])
            else:
                continue
            column_at(messages, self._types[name], place)[...] = values
        return messages
