"""Messages to columns and back.

Two messages have the same skeleton if they differ in the values of fixed-size numbers and in the
row's own bytes only. One message of each skeleton is parsed, or encoded, by protobuf; its wire
format shows where the numbers are. Numpy reads and writes all others as one table:

    09 ........ 11 ........ 1a 0a .......... 20 01 38 02 45 .... 4d ....     of a speed command
       offset      delay          raw         the rest is the skeleton

So faults, absent fields and damage of any length need no special case, and every version of the
schema is read in the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError

from fte_sniff.protocol.items import PortEvent, PortEventKind
from fte_sniff.protocol.rows import (
    COLUMNS,
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
from fte_sniff.protocol.spec import CMD_OFFSET, FRAME_LENGTH, TAIL, Fault
from fte_sniff.recording.chunks import HEAD
from fte_sniff.recording.schema import MALFORMED, class_of, encode, topic_of

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
_SIZES: Final = {1: 8, 5: 4}
"""Bytes of a number by its wire type."""
_DELIMITED: Final = 2
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

    @classmethod
    def joined(cls, parts: Sequence[Messages]) -> Messages:
        """The messages of several chunks, at least one, as of one."""
        if len(parts) == 1:
            return parts[0]
        shifts = np.cumsum([0, *(len(one.records) for one in parts[:-1])])
        starts = [one.starts + shift for one, shift in zip(parts, shifts, strict=True)]
        columns = zip(*(one[2:] for one in parts), strict=True)
        records = b"".join(one.records for one in parts)
        return cls(records, np.concatenate(starts), *map(np.concatenate, columns))


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
        self.faults = fault_bits(map(Fault, kind.members(message, "faults")))
        self.framed = getattr(message, "framed", True)
        self.unordered = getattr(message, "order_uncertain", False)
        self.fields, mask = fields_in(data, kind.names)
        _, self.size = self.fields["raw"]
        if not self.size or (self.framed and self.size != FRAME_LENGTH):
            raise ValueError("a row without bytes, or a frame of another length")
        self.padding = -len(data) % _WORD
        self._mask = np.frombuffer(bytes(self.padding) + mask, "<u8")
        self._expected = np.frombuffer(bytes(self.padding) + data, "<u8") & self._mask

    def fitting(self, windows: Array) -> Bools:
        """Which messages, behind their padding, have this skeleton."""
        words = windows.view("<u8").reshape(len(windows), -1)
        differing = np.zeros(len(words), "<u8")
        for at, (mask, expected) in enumerate(zip(self._mask, self._expected, strict=True)):
            if mask:
                differing |= (words[:, at] & mask) ^ expected
        fits: Bools = differing == 0
        return fits

    def store(
        self,
        windows: Array,
        fits: Bools,
        rows: Array,
        columns: Rows,
        more: list[tuple[Array, Rows]],
    ) -> Array:
        """Fill in the columns of `rows`, the messages that fit; returns the rows that are valid.

        What a message does not have, and most have alike, stays as it is. `more` gets the rows
        beyond the 16th byte, with the indices of their messages.
        """
        valid: Bools = np.ones(len(rows), np.bool_)
        for name, column in _NUMBERS.items():
            if self.fields.get(name, (0, 0))[1] == _WORD:
                place = self.padding + self.fields[name][0]
                values = column_at(windows, "<i8", place)[fits]
                columns.columns[column][rows] = values
                if column != "delay_ns":
                    valid &= values >= 0
        length = min(self.size, MOST_BYTES)
        shared = {
            "length": length,
            "faults": self.faults,
            "framed": self.framed,
            "unordered": self.unordered,
        }
        for column, value in shared.items():
            if value != COLUMNS[column][1]:
                columns.columns[column][rows] = value
        values = column_at(windows, f"V{self.size}", self.padding + self.fields["raw"][0])[fits]
        raw = values.view(np.uint8).reshape(-1, self.size)
        column_at(columns.raw, f"V{length}", 0)[rows] = column_at(raw, f"V{length}", 0)
        if self.framed:
            valid &= IS_HEADER[raw[:, 0]] & (raw[:, FRAME_LENGTH - 1] == TAIL)
        good = rows[valid]
        for first in range(MOST_BYTES, self.size, MOST_BYTES):
            rest, part = columns.select(good), raw[valid, first : first + MOST_BYTES]
            rest.offset[:] += first
            rest.length[:] = part.shape[1]
            rest.raw[:] = 0
            rest.raw[:, : part.shape[1]] = part
            more.append((good, rest))
        return good


def column_at(table: Array, kind: str, place: int) -> Array:
    """The values of a type at a byte of each row of a table; not copied."""
    return np.ndarray(len(table), kind, table, place, table.strides[:1])


def fields_in(data: bytes, names: Mapping[int, str]) -> tuple[dict[str, tuple[int, int]], bytes]:
    """The offset and size of a message's numbers and bytes, and a mask of all other bytes.

    Raises IndexError if the message is cut.
    """
    fields, mask, at = {}, bytearray(b"\xff") * len(data), 0
    while at < len(data):
        tag, at = _varint(data, at)
        name, wire = names.get(tag >> 3, ""), tag & 7
        if wire == 0:
            _, at = _varint(data, at)
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
        kind_codes, port_codes = np.zeros((2, 1 << 16), np.uint16)
        for id_, (kind, port) in channels.items():
            kind_codes[id_], port_codes[id_] = kinds.index(kind) + 1, ports.index(port)
        codes = kind_codes.take(messages.channels).astype(np.int64)
        legible = (messages.lengths < LONGEST) & (messages.log_times >= 0) & (codes > 0)
        keys = (codes * LONGEST + messages.lengths) * legible
        if len(kinds) < (1 << 16) // LONGEST:
            keys = keys.astype(np.uint16)  # which numpy sorts in one pass
        port_of = port_codes.take(messages.channels)
        columns = Rows.blank(len(keys), ports, t_ns=messages.log_times, port=port_of)
        kept = np.zeros(len(keys), np.bool_)
        more: list[tuple[Array, Rows]] = []
        events: dict[int, PortEvent] = {}
        for own in groups_of(keys):
            code, length = divmod(int(keys[own[0]]), LONGEST)
            if not length:
                continue
            kind = kinds[code - 1]
            if kind.is_event:
                events |= _events(messages, own, kind, columns)
            else:
                kept[self._decode_alike(messages, own, kind, columns, more)] = True
        places = np.flatnonzero(kept)
        rows = columns if len(places) == len(columns) else columns.select(places)
        unreadable = int(np.count_nonzero(codes)) - len(places) - len(events)
        if more:
            places = np.concatenate([places, *(own for own, _ in more)])
            order = np.argsort(places, kind="stable")
            places = places[order]
            rows = Rows.concat([rows, *(rest for _, rest in more)]).select(order)
        return Decoded(rows, places, events, unreadable)

    def _decode_alike(
        self,
        messages: Messages,
        own: Array,
        kind: MessageType,
        columns: Rows,
        more: list[tuple[Array, Rows]],
    ) -> Array:
        """Decode messages of one type and length; returns the rows that could be read."""
        length = int(messages.lengths[own[0]])
        known = self._skeletons.setdefault((kind, length), [])
        padding = -length % _WORD
        every = at_every_byte(messages.records, length + padding)
        windows = every[messages.starts[own] + (MESSAGE_HEAD - padding)]
        good, number = [own[:0]], 0
        while len(own) and number < _MOST_SKELETONS:
            if number == len(known):
                try:
                    known.append(_Skeleton(kind, windows[0].tobytes()[padding:]))
                except (DecodeError, AttributeError, KeyError, ValueError, IndexError):
                    windows, own = windows[1:], own[1:]
                    continue
            skeleton, number = known[number], number + 1
            fits = skeleton.fitting(windows)
            if fits.any():
                good.append(skeleton.store(windows, fits, own[fits], columns, more))
                windows, own = windows[~fits], own[~fits]
        return np.concatenate(good)


def at_every_byte(records: bytes | Codes, size: int) -> Array:
    """Opaque values of `size` bytes at every offset of some bytes."""
    return np.ndarray((max(0, len(records) - size + 1),), f"V{size}", records, 0, (1,))


def groups_of(keys: Array) -> list[Ints]:
    """The indices of each value, in order; the values rise."""
    by_key = np.argsort(keys, kind="stable")
    cuts = np.flatnonzero(np.diff(keys[by_key])) + 1
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
        self._fields = {
            field.name: (f">{'i' if field.signed else 'u'}{field.size}", field.start)
            for field in (kind.fields if kind else ())
        }
        """The type and offset of the message's values in the frame."""

    def encode(self, rows: Rows, own: Ints) -> Array:
        """The messages of some rows, as opaque values; fields of other kinds stay NaN."""
        messages, raw = np.full(len(own), np.void(self._message)), rows.raw[own]
        for name, (place, _) in self._places.items():
            if name in _NUMBERS:
                values = rows.columns[_NUMBERS[name]][own]
            elif name in self._fields:
                values = column_at(raw, *self._fields[name])
            elif name in ("raw", "cmd"):
                kind, start = (self._types[name], 0) if name == "raw" else ("u1", CMD_OFFSET)
                values = column_at(raw, kind, start)
            else:
                continue
            column_at(messages, self._types[name], place)[...] = values
        return messages
