"""RowBatch to messages."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import accumulate
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding
from numpy.typing import NDArray

from fte_sniff.protocol import (
    FRAME_LENGTH,
    KINDS,
    MOTORS,
    Field,
    Frame,
    FrameKind,
    PortEvent,
    Row,
    Status,
    status_of,
)
from fte_sniff.protocol.spec import CMD_OFFSET, NUM_OFFSET
from fte_sniff.recording.mcap.writer import McapBatch
from fte_sniff.recording.messages.codec import class_of, encode_event, encode_row, plain
from fte_sniff.recording.messages.schema import (
    EVENTS,
    MALFORMED,
    TOPICS,
    Topic,
    schema_data,
    schema_name,
    topic_of,
)
from fte_sniff.recording.messages.wire_layout import SOUND_LACKS, WireField, laid
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.row_batch import Array, RowColumns

MESSAGE = struct.Struct("<BQHIQQ")
"""What stands before the data of a message: opcode, length, channel, sequence, log and publish
time."""

MESSAGE_HEAD = MESSAGE.size - 9
"""Bytes of a message record's body before its data."""

_HEAD_PLACES = {"channel": ("<u2", 9), "sequence": ("<u4", 11), "log": ("<u8", 15)}
_HEAD_PLACES["publish"] = ("<u8", 23)


@dataclass(frozen=True, slots=True)
class Columns:
    """What differs between the messages of one form, a value for each row."""

    channel: int | NDArray[np.int64]
    sequences: NDArray[np.uint32]
    times: NDArray[np.int64]
    offsets: NDArray[np.int64]
    delays: NDArray[np.int64]
    raws: NDArray[np.uint8]
    """The rows' ten bytes, one row a line."""


class RowModel:
    """Writes messages of one form: sound frames of one kind on one topic."""

    def __init__(
        self, model: bytes, message: Any, fields: tuple[Field, ...], lacking: frozenset[str]
    ) -> None:
        """Find the places.

        Args:
            model: one message of the form, with a read delay, without faults and own time.
            message: its protobuf class.
            fields: the frame's fields that differ from row to row.
            lacking: the names of the fields that are not in it.
        """
        head = MESSAGE.pack(Opcode.MESSAGE, MESSAGE_HEAD + len(model), 0, 0, 0, 0)
        self._bytes = np.frombuffer(head + model, np.uint8)
        self._fields = fields
        places = _HEAD_PLACES | {
            field.name: (_numpy_type(field), MESSAGE.size + field.place)
            for field in laid(message.DESCRIPTOR.fields, lacking)
        }
        self._type = np.dtype(
            {
                "names": list(places),
                "formats": [kind for kind, _ in places.values()],
                "offsets": [offset for _, offset in places.values()],
                "itemsize": len(self._bytes),
            }
        )

    @property
    def length(self) -> int:
        """Bytes of each message record."""
        return len(self._bytes)

    def records(self, columns: Columns) -> list[bytes]:
        """The message records of these rows."""
        found: list[bytes] = self.lines(columns).tolist()
        return found

    def lines(self, columns: Columns) -> NDArray[np.void]:
        """The same as an array, whose items are the records."""
        found: NDArray[np.void] = np.empty(len(columns.times), f"V{self.length}")
        found[:] = np.void(self._bytes.tobytes())
        table = found.view(self._type)
        table["channel"] = columns.channel
        table["sequence"] = columns.sequences
        table["log"] = table["publish"] = columns.times
        table["offset"] = columns.offsets
        table["read_delay_ns"] = columns.delays
        raws = np.ascontiguousarray(columns.raws)
        table["raw"] = raws.view(f"V{raws.shape[1]}")[:, 0]
        for field in self._fields:
            kind = f">{'i' if field.signed else 'u'}{field.size}"
            # Read where they stand: to cut them out first takes as long as all else.
            table[field.name] = np.ndarray(len(raws), kind, raws, field.start, raws.strides[:1])
        return found


def _numpy_type(field: WireField) -> str:
    return f"V{field.size}" if field.code == "s" else f"<{field.code}"


_HEAD = slice(0, 3)
"""The bytes of a frame that tell its kind and its motor."""

_Form = tuple[str, bytes, bool]
"""Port, head, and whether the order is uncertain: all that rows of one model have in common."""


class Packer:
    """Packs batches; counts the messages of each channel."""

    def __init__(self, channel_id: Callable[[str, Topic], int]) -> None:
        """Take what gives the id of a port's channel on a topic."""
        self._channel_id = channel_id
        self._channel_of_form: dict[_Form, int | None] = {}
        self._sequences: dict[int, int] = {}

    def pack(self, taken: Sequence[Row | PortEvent], times: NDArray[np.int64]) -> McapBatch:
        """The messages of `taken`, in that order.

        Args:
            taken: rows and events.
            times: their log times; never falling.
        """
        forms, odd = self._sorted(taken, times.tolist())
        channels = np.empty(len(taken), np.int64)
        for form, places in forms.items():
            channel = self._channel_of_form[form]
            assert channel is not None
            channels[places] = channel
        for place in odd:
            entry = taken[place]
            topic = EVENTS if isinstance(entry, PortEvent) else topic_of(entry)
            channels[place] = self._channel_id(entry.port, topic)
        sequences = self._count(channels)
        records: list[bytes] = [b""] * len(taken)
        for (_, head, uncertain), places in forms.items():
            rows = [taken[place] for place in places]
            columns = _columns(rows, channels, sequences, times, np.array(places))
            for place, record in zip(
                places, _row_model(head, uncertain).records(columns), strict=True
            ):
                records[place] = record
        for place in odd:
            records[place] = message_record(
                taken[place], int(channels[place]), int(sequences[place]), int(times[place])
            )
        return _joined(records, channels, times)

    def _sorted(
        self, taken: Sequence[Row | PortEvent], times: Sequence[int]
    ) -> tuple[dict[_Form, list[int]], list[int]]:
        """The places of the rows of each form, and of all that has none."""
        forms: dict[_Form, list[int]] = {}
        odd: list[int] = []
        known = self._channel_of_form
        for place, (entry, time) in enumerate(zip(taken, times, strict=True)):
            if (
                type(entry) is not Frame
                or entry.faults
                or entry.read_delay_ns is None
                or entry.t_ns != time
            ):
                odd.append(place)
                continue
            form = (entry.port, entry.raw[_HEAD], entry.order_uncertain)
            if form in forms:
                forms[form].append(place)
                continue
            if form not in known:
                known[form] = self._channel_of(entry)
            if known[form] is None:
                odd.append(place)
            else:
                forms[form] = [place]
        return forms, odd

    def _channel_of(self, row: Row) -> int | None:
        topic = topic_of(row)
        return None if topic is MALFORMED else self._channel_id(row.port, topic)

    def _count(self, channels: NDArray[np.int64]) -> NDArray[np.uint32]:
        """The sequence number of each message: they count up on each channel, and wrap."""
        sequences = np.empty(len(channels), np.uint64)
        for channel in np.unique(channels).tolist():
            own = np.flatnonzero(channels == channel)
            start = self._sequences.get(channel, 0)
            sequences[own] = np.arange(start, start + len(own), dtype=np.uint64)
            self._sequences[channel] = start + len(own)
        return sequences.astype(np.uint32)


@cache
def _row_model(head: bytes, uncertain: bool) -> RowModel:
    """The model of all sound frames that begin with `head`, and whose order is so certain."""
    raw = head + bytes(FRAME_LENGTH - len(head))
    model = Frame("", 0, raw, 0, (), 0, uncertain)
    topic, kind = topic_of(model), model.kind
    assert kind is not None
    lacking = SOUND_LACKS - {"order_uncertain"} if uncertain else SOUND_LACKS
    return RowModel(encode_row(topic, model, 0), class_of(topic), kind.fields, lacking)


def _columns(
    rows: Sequence[Row | PortEvent],
    channels: NDArray[np.int64],
    sequences: NDArray[np.uint32],
    times: NDArray[np.int64],
    places: NDArray[np.int64],
) -> Columns:
    frames = [row for row in rows if isinstance(row, Frame)]
    raws = np.frombuffer(b"".join([row.raw for row in frames]), np.uint8)
    return Columns(
        channel=int(channels[places[0]]),
        sequences=sequences[places],
        times=times[places],
        offsets=np.array([row.offset for row in frames], np.int64),
        delays=np.array([row.read_delay_ns for row in frames], np.int64),
        raws=raws.reshape(-1, FRAME_LENGTH),
    )


def message_record(entry: Row | PortEvent, channel: int, sequence: int, time: int) -> bytes:
    """The record of one message, from the row or event in it."""
    if isinstance(entry, PortEvent):
        data = encode_event(entry, time)
    else:
        data = encode_row(topic_of(entry), entry, time)
    head = (Opcode.MESSAGE, MESSAGE_HEAD + len(data), channel, sequence, time, time)
    return MESSAGE.pack(*head) + data


def _joined(
    records: list[bytes], channels: NDArray[np.int64], times: NDArray[np.int64]
) -> McapBatch:
    places = np.fromiter(accumulate(map(len, records), initial=0), np.int64, len(records))
    return McapBatch(b"".join(records), channels, times, places)


ChannelId = Callable[[str, Topic], int]

_BYTES = 256
_NO_FORM = 255


def _forms() -> list[tuple[FrameKind, int]]:
    """Every kind with each of its CMDs: frames of one form make messages of one form."""
    return [(kind, cmd) for kind in KINDS for cmd in kind.cmds]


def _form_codes() -> Array:
    """By header and CMD, read as one little-endian number: the form's place in `_FORMS`."""
    codes = np.full(_BYTES * _BYTES, _NO_FORM, np.uint8)
    for code, (kind, cmd) in enumerate(_FORMS):
        codes[kind.header | cmd << 8] = code
    return codes


_FORMS = _forms()
_FORM_CODES = _form_codes()
_NAMES_MOTOR = np.zeros(_NO_FORM + 1, np.bool_)
"""By form, whether its frames name a motor."""
_NAMES_MOTOR[: len(_FORMS)] = [kind.names_motor for kind, _ in _FORMS]
_RAW = np.dtype(f"V{FRAME_LENGTH}")


class ColumnPacker:
    """Packs rows; counts the messages of each channel."""

    def __init__(self, channel_id: ChannelId) -> None:
        """Take what gives the id of a port's channel on a topic."""
        self._channel_id = channel_id
        self._sequences: dict[int, int] = {}

    def pack(self, rows: RowColumns, times: Array, event_times: Array) -> McapBatch:
        """The messages of the rows and of their events, in order of log time.

        Args:
            rows: the rows, in order.
            times: their log times, never falling.
            event_times: the log times of the events, never falling.
        """
        forms = self._forms_of(rows, times)
        channels = self._channels(rows, forms)
        # Each event stands before the first row that is later.
        at = np.searchsorted(times, event_times, "right")
        events = at + np.arange(len(at))
        channels = np.insert(channels, at, [self._channel_of(event) for event in rows.events])
        times = np.insert(times, at, event_times)
        sequences = self._count(channels)
        of_rows: Any = np.delete(np.arange(len(times)), events) if len(at) else slice(None)
        odd = np.flatnonzero(forms == _NO_FORM)
        places = np.arange(len(times))[of_rows][odd].tolist()
        single: list[tuple[int, Row | PortEvent]] = [
            *zip(places, rows.parted(odd).rows(), strict=True),
            *zip(events.tolist(), rows.events, strict=True),
        ]
        records = {
            place: message_record(
                entry, int(channels[place]), int(sequences[place]), int(times[place])
            )
            for place, entry in single
        }
        lengths = np.empty(len(times), np.int64)
        lengths[of_rows] = _lengths().take(forms)
        lengths[list(records)] = [len(record) for record in records.values()]
        ends = np.cumsum(lengths)
        places = ends - lengths
        data = np.empty(int(ends[-1]), np.uint8)
        for own, lines in self._lines(
            rows, forms, channels[of_rows], sequences[of_rows], times[of_rows]
        ):
            _put(data, places[of_rows].take(own), lines)
        for place, record in records.items():
            start = int(places[place])
            data[start : start + len(record)] = np.frombuffer(record, np.uint8)
        return McapBatch(data.data, channels, times, places)

    def _forms_of(self, rows: RowColumns, times: Array) -> Array:
        """The form of every row that can be written by columns."""
        head = rows.raw[:, 0] | rows.raw[:, CMD_OFFSET].astype(np.uint16) << np.uint16(8)
        forms: Array = _FORM_CODES.take(head)
        clean = np.array([not faults for faults in rows.words.faults]).take(rows.faults)
        plain = rows.framed & rows.delayed & ~rows.unordered & clean & (rows.t_ns == times)
        num = rows.raw[:, NUM_OFFSET]
        plain &= ~_NAMES_MOTOR.take(forms) | (num >= MOTORS[0]) & (num <= MOTORS[-1])
        forms[~plain] = _NO_FORM
        return forms

    def _channels(self, rows: RowColumns, forms: Array) -> Array:
        """The channel of each row: one for every port, form and motor that there is."""
        ports = rows.port.astype(np.int64)
        motors = np.where(_NAMES_MOTOR.take(forms), rows.raw[:, NUM_OFFSET], MOTORS[0])
        keys = (ports * len(_FORMS) + forms) * len(MOTORS) + motors - MOTORS[0]
        odd = np.flatnonzero(forms == _NO_FORM)
        keys[odd] = 0
        found = np.zeros(len(rows.words.ports) * len(_FORMS) * len(MOTORS), np.int64)
        present = np.bincount(keys)
        present[:1] -= len(odd)
        for key in np.flatnonzero(present).tolist():
            port_and_form, motor = divmod(key, len(MOTORS))
            port, form = divmod(port_and_form, len(_FORMS))
            topic = _topic(form, MOTORS[motor])
            found[key] = self._channel_id(rows.words.ports[port], topic)
        channels = found.take(keys)
        channels[odd] = [self._channel_of(row) for row in rows.parted(odd).rows()]
        return channels

    def _channel_of(self, entry: Row | PortEvent) -> int:
        topic = EVENTS if isinstance(entry, PortEvent) else topic_of(entry)
        return self._channel_id(entry.port, topic)

    def _count(self, channels: Array) -> Array:
        """The sequence number of each message: they count up on each channel, and wrap."""
        by_channel = np.argsort(channels.astype(np.uint16), kind="stable")
        counts = np.bincount(channels)
        present = np.flatnonzero(counts)
        counts = counts[present]
        starts = np.array([self._sequences.get(channel, 0) for channel in present.tolist()])
        ends = starts + counts
        self._sequences.update(zip(present.tolist(), ends.tolist(), strict=True))
        sequences = np.empty(len(channels), np.uint32)
        firsts = starts - (np.cumsum(counts) - counts)
        numbers = np.arange(len(channels)) + np.repeat(firsts, counts)
        sequences[by_channel] = numbers.astype(np.uint32)
        return sequences

    def _lines(
        self, rows: RowColumns, forms: Array, channels: Array, sequences: Array, times: Array
    ) -> Iterator[tuple[Array, Array]]:
        """For every form the places of its rows, and their records."""
        raws = np.ascontiguousarray(rows.raw).view(_RAW)[:, 0]
        by_form, first = np.argsort(forms, kind="stable"), 0
        for code, count in enumerate(np.bincount(forms, minlength=len(_FORMS))[: len(_FORMS)]):
            own = by_form[first : first + count]
            first += int(count)
            if not len(own):
                continue
            columns = Columns(
                channel=channels.take(own),
                sequences=sequences.take(own),
                times=times.take(own),
                offsets=rows.offset.take(own),
                delays=rows.delay_ns.take(own),
                raws=raws.take(own).view(np.uint8).reshape(-1, FRAME_LENGTH),
            )
            yield own, _model(code).lines(columns)


@cache
def _topic(form: int, motor: int) -> Topic:
    """Where frames of this form and of this motor go."""
    kind, cmd = _FORMS[form]
    return topic_of(Frame("", 0, bytes([kind.header, cmd, motor]).ljust(FRAME_LENGTH, b"\0"), 0))


@cache
def _model(code: int) -> RowModel:
    """The layout of the messages of a form."""
    kind, cmd = _FORMS[code]
    raw = bytes([kind.header, cmd, MOTORS[0]]).ljust(FRAME_LENGTH, b"\0")
    frame = Frame("", 0, raw, 0, (), 0)
    topic = topic_of(frame)
    assert topic is not MALFORMED
    assert status_of(()) is Status.OK
    return RowModel(encode_row(topic, frame, 0), class_of(topic), kind.fields, SOUND_LACKS)


@cache
def _lengths() -> Array:
    """Bytes of a record of each form, by its code."""
    lengths = np.zeros(_NO_FORM + 1, np.int64)
    lengths[: len(_FORMS)] = [_model(code).length for code in range(len(_FORMS))]
    return lengths


def _put(data: Array, places: Array, lines: Array) -> None:
    """Write records of one length to their places."""
    width = lines.dtype.itemsize
    at_every_byte: Array = np.ndarray((len(data) - width + 1,), lines.dtype, data, 0, (1,))
    at_every_byte[places] = lines


class Channels:
    """The channels of one file, numbered from 1 in the order in which their ports come."""

    def __init__(self) -> None:
        self._ids: dict[tuple[str, str], int] = {}
        names = dict.fromkeys(topic.schema for topic in TOPICS)
        self._schema_ids = {name: id_ for id_, name in enumerate(names, 1)}

    def schemas(self) -> list[Schema]:
        """Every schema that a recording can need."""
        named = {topic.schema: topic for topic in TOPICS}
        return [
            Schema(id_, schema_data(name), SchemaEncoding.Protobuf, schema_name(named[name]))
            for name, id_ in self._schema_ids.items()
        ]

    def of_port(self, port: PortFacts) -> list[Channel]:
        """One channel for each topic, now that this port has come; none where it has already."""
        if (port.name, TOPICS[0].name) in self._ids:
            return []
        metadata = {"port": plain(port.name)}
        if port.baud is not None:
            metadata["baud"] = str(port.baud)
        channels = []
        for topic in TOPICS:
            id_ = self._ids[port.name, topic.name] = len(self._ids) + 1
            schema_id = self._schema_ids[topic.schema]
            channels.append(Channel(id_, topic.name, MessageEncoding.Protobuf, metadata, schema_id))
        return channels

    def id_of(self, port: str, topic: Topic) -> int:
        """The channel of a port on a topic.

        Raises:
            KeyError: the port has not come.
        """
        return self._ids[port, topic.name]
