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

from collections.abc import Callable, Iterator, Mapping, Sequence
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
from fte_sniff.recording.schema import MALFORMED, class_of, encode_row, topic_of

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
    def at(cls, starts: Ints, heads: Array, records: bytes) -> Messages:
        """The messages at some offsets, with these heads."""
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

    def message(self, at: int) -> bytes:
        """One message, without its head."""
        start = int(self.starts[at]) + MESSAGE_HEAD
        return self.records[start : start + int(self.lengths[at])]


class MessageType(NamedTuple):
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
        first, self.size = self.fields["raw"]
        if not self.size or (self.framed and self.size != FRAME_LENGTH):
            raise ValueError("a row without bytes, or a frame of another length")
        self.padding = -len(data) % _WORD
        self.raw = slice(self.padding + first, self.padding + first + self.size)
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

    def store(self, windows: Array, rows: Array, columns: Rows) -> Bools:
        """Fill in the columns of these rows, up to their 16th byte; returns which are valid.

        What a message does not have, and most have alike, stays as it is.
        """
        valid: Bools = np.ones(len(rows), np.bool_)
        for name, column in _NUMBERS.items():
            first, size = self.fields.get(name, (0, 0))
            if size == _WORD:
                place = self.padding + first
                values = np.ndarray(len(windows), "<i8", windows, place, windows.strides)
                columns.columns[column][rows] = values
                valid &= (values >= 0) | (column == "delay_ns")
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
        raw = windows.view(np.uint8).reshape(len(windows), -1)[:, self.raw]
        start = np.ndarray(len(raw), f"V{length}", windows, self.raw.start, windows.strides)
        own: Array = np.ndarray(len(columns), f"V{length}", columns.raw, 0, columns.raw.strides[:1])
        own[rows] = start
        if self.framed:
            valid &= IS_HEADER[raw[:, 0]] & (raw[:, FRAME_LENGTH - 1] == TAIL)
        return valid

    def rest(self, windows: Array, rows: Rows, first: int) -> Rows:
        """The next row of each message, from its byte `first` on."""
        raw = windows.view(np.uint8).reshape(len(windows), -1)[:, self.raw]
        own = raw[:, first : first + MOST_BYTES]
        rows.offset[:] += first
        rows.length[:] = own.shape[1]
        rows.raw[:] = 0
        rows.raw[:, : own.shape[1]] = own
        return rows


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
        self._skeletons: dict[tuple[int, int], list[_Skeleton]] = {}
        """By the identity of the message type and the length."""

    def decode(
        self, messages: Messages, channels: Mapping[int, tuple[MessageType, str]]
    ) -> Decoded:
        """The rows and events of messages, by the type and the port of their channels.

        Messages of other channels are skipped. Noise of more than 16 bytes becomes several rows.
        """
        types = {id_: kind for id_, (kind, _) in channels.items()}
        ports = {id_: port for id_, (_, port) in channels.items()}
        known = np.zeros(1 << 16, np.bool_)
        known[list(types)] = True
        own = known.take(messages.channels)
        has_length = (messages.lengths > 0) & (messages.lengths < LONGEST)
        legible = np.flatnonzero(own & has_length & (messages.log_times >= 0))
        unreadable = int(own.sum()) - len(legible)
        if len(legible) < len(own):
            messages = Messages(messages.records, *(one[legible] for one in messages[1:]))
        names = tuple(dict.fromkeys(ports.values()))
        columns = Rows.blank(len(legible), names, t_ns=messages.log_times)
        kept = np.zeros(len(columns), np.bool_)
        more: list[tuple[Array, Rows]] = []
        events: dict[int, PortEvent] = {}
        port_codes = np.zeros(1 << 16, np.uint16)
        port_codes[list(ports)] = [names.index(port) for port in ports.values()]
        columns.port[:] = port_codes.take(messages.channels)
        for kind, length, alike in _alike(messages, types):
            if kind.is_event:
                own_events = _events(messages, alike, kind, ports)
                events |= {int(legible[at]): event for at, event in own_events.items()}
                unreadable += len(alike) - len(own_events)
            else:
                good = self._decode_alike(messages, length, alike, kind, columns, more)
                kept[good] = True
                unreadable += len(alike) - len(good)
        places = np.flatnonzero(kept)
        rows = columns if len(places) == len(columns) else columns.select(places)
        if more:
            places = np.concatenate([places, *(own for own, _ in more)])
            order = np.argsort(places, kind="stable")
            places = places[order]
            rows = Rows.concat([rows, *(rest for _, rest in more)]).select(order)
        return Decoded(rows, legible[places], events, unreadable)

    def _decode_alike(
        self,
        messages: Messages,
        length: int,
        rows: Array,
        kind: MessageType,
        columns: Rows,
        more: list[tuple[Array, Rows]],
    ) -> Array:
        """Decode messages of one type and length; returns the rows that could be read.

        `more` gets the rows beyond the 16th byte, with the indices of their messages.
        """
        known = self._skeletons.setdefault((id(kind), length), [])
        padding = -length % _WORD
        every = at_every_byte(messages.records, length + padding)
        windows = every[messages.starts[rows] + (MESSAGE_HEAD - padding)]
        good, number = [np.empty(0, np.int64)], 0
        while len(rows) and number < _MOST_SKELETONS:
            if number == len(known):
                try:
                    known.append(_Skeleton(kind, windows[0].tobytes()[padding:]))
                except (DecodeError, AttributeError, KeyError, ValueError, IndexError):
                    windows, rows = windows[1:], rows[1:]
                    continue
            skeleton, number = known[number], number + 1
            fits = skeleton.fitting(windows)
            if not fits.any():
                continue
            alike = fits.all()
            own, own_rows = (windows, rows) if alike else (windows[fits], rows[fits])
            valid = skeleton.store(own, own_rows, columns)
            good.append(own_rows[valid])
            for first in range(MOST_BYTES, skeleton.size, MOST_BYTES):
                more.append((good[-1], skeleton.rest(own[valid], columns.select(good[-1]), first)))
            windows, rows = (windows[:0], rows[:0]) if alike else (windows[~fits], rows[~fits])
        return np.concatenate(good)


def at_every_byte(records: bytes | Codes, size: int) -> Array:
    """Opaque values of `size` bytes at every offset of some bytes."""
    return np.ndarray((max(0, len(records) - size + 1),), f"V{size}", records, 0, (1,))


def groups_of(keys: Array) -> list[Ints]:
    """The indices of each value, in order; the values rise."""
    by_key = np.argsort(keys, kind="stable")
    cuts = np.flatnonzero(np.diff(keys[by_key])) + 1
    return np.split(by_key, cuts) if len(keys) else []


def heads_at(records: bytes, starts: Ints) -> Array:
    """The heads of the message records at some offsets."""
    return at_every_byte(records, MESSAGE_HEAD)[starts].view(MESSAGE)


def _alike(
    messages: Messages, types: Mapping[int, MessageType]
) -> Iterator[tuple[MessageType, int, Array]]:
    """The messages of each type and length: their indices, in file order."""
    kinds = list({id(one): one for one in types.values()}.values())
    numbers = {id(one): number for number, one in enumerate(kinds)}
    codes = np.zeros(1 << 16, np.int64)
    codes[list(types)] = [numbers[id(one)] for one in types.values()]
    keys = codes.take(messages.channels) * LONGEST + messages.lengths
    if len(kinds) <= (1 << 16) // LONGEST:
        keys = keys.astype(np.uint16)  # which numpy sorts in one pass
    for rows in groups_of(keys):
        code, length = divmod(int(keys[rows[0]]), LONGEST)
        yield kinds[code], length, rows


def _events(
    messages: Messages, rows: Array, kind: MessageType, ports: Mapping[int, str]
) -> dict[int, PortEvent]:
    """The events that can be read, by the index of their message."""
    found: dict[int, PortEvent] = {}
    for row in rows.tolist():
        port, t_ns = ports[int(messages.channels[row])], int(messages.log_times[row])
        try:
            message = kind.parse(messages.message(row))
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
        self._message = encode_row(topic, row, log_time)
        descriptors = class_of(topic).DESCRIPTOR.fields
        types = {one.name: _TYPES.get(one.type, f"V{len(row.raw)}") for one in descriptors}
        offsets, _ = fields_in(self._message, {one.number: one.name for one in descriptors})
        kind = row.kind if topic is not MALFORMED else None
        self._fields = {
            field.name: (field.start, np.dtype(f">{'i' if field.signed else 'u'}{field.size}"))
            for field in (kind.fields if kind else ())
        }
        """Where the frame has the values of the message."""
        self._type = np.dtype(
            {
                "names": list(offsets),
                "formats": [types[name] for name in offsets],
                "offsets": [first for first, _ in offsets.values()],
                "itemsize": len(self._message),
            }
        )

    def encode(self, rows: Rows, own: Ints) -> Array:
        """The messages of some rows, as opaque values; fields of other kinds stay NaN."""
        messages = np.full(len(own), np.void(self._message))
        table, raw = messages.view(self._type), rows.raw[own]
        columns = {"offset": rows.offset, "read_delay_ns": rows.delay_ns, "time_ns": rows.t_ns}
        for name in self._type.names or ():
            if name in self._fields:
                start, wire = self._fields[name]
                table[name] = np.ndarray(len(raw), wire, raw, start, raw.strides[:1])
            elif name == "raw":
                kind = self._type[name]
                table[name] = np.ndarray(len(raw), kind, raw, 0, raw.strides[:1])
            elif name == "cmd":
                table[name] = raw[:, CMD_OFFSET]
            elif name in columns:
                table[name] = columns[name][own]
        return messages
