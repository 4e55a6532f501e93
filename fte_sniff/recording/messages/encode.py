"""Encoder of rows and port events as MCAP message records.

Fault-free frames with a read delay, whose time is the log time, have a `Template`: numpy fills in
all frames of one form at once. Protobuf serializes the other rows and the port events one by one.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, lru_cache
from math import nan
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding
from numpy.typing import NDArray

from fte_sniff.protocol import (
    FRAME_LENGTH,
    KIND_BY_NAME,
    KINDS,
    MOTORS,
    Fault,
    Frame,
    PortEvent,
    PortEventKind,
    Row,
    Status,
)
from fte_sniff.protocol.rows import NO_TIME, Array, Rows
from fte_sniff.protocol.spec import CMD_OFFSET, KIND_BY_HEADER_AND_CMD, NUM_OFFSET
from fte_sniff.recording.mcap.writer import McapBatch
from fte_sniff.recording.messages.schema import (
    EVENTS,
    LACKS,
    LACKS_IF_UNCERTAIN,
    MALFORMED,
    TOPIC_BY_KIND_AND_MOTOR,
    TOPIC_BY_NAME,
    TOPICS,
    Template,
    Topic,
    enum_number,
    message_class,
    schema_data,
    schema_name,
    value_fields,
)
from fte_sniff.recording.metadata import PortFacts

MESSAGE = struct.Struct("<BQHIQQ")
"""Header of a message record: opcode, length, channel, sequence, log and publish time."""

MESSAGE_HEAD = MESSAGE.size - 9
"""Bytes of a message record's body before the message."""

_HEAD_FIELDS = {
    "channel": ("<u2", 9),
    "sequence": ("<u4", 11),
    "log": ("<u8", 15),
    "publish": ("<u8", 23),
}


def topic_of(row: Row) -> Topic:
    """The topic of a row: that of its kind and motor, or `MALFORMED`."""
    if not isinstance(row, Frame) or (row.faults and row.status is Status.MALFORMED):
        return MALFORMED
    return _topic_of_head(row.raw[: NUM_OFFSET + 1])


@lru_cache(maxsize=1024)
def _topic_of_head(head: bytes) -> Topic:
    """The topic of a frame without malformed fault, by its bytes up to NUM."""
    kind = KIND_BY_HEADER_AND_CMD.get((head[0], head[CMD_OFFSET]))
    if kind is None:
        return MALFORMED
    motor = head[NUM_OFFSET] if kind.names_motor else None
    return TOPIC_BY_KIND_AND_MOTOR.get((kind.name, motor), MALFORMED)


_KIND_NUMBER = {name: enum_number("Kind", name) for name in KIND_BY_NAME}
_STATUS_NUMBER = {status: enum_number("Status", status) for status in Status}
_FAULT_NUMBER = {fault: enum_number("Fault", fault) for fault in Fault}
_EVENT_NUMBER = {kind: enum_number("PortEventKind", kind) for kind in PortEventKind}


@cache
def class_of(topic_name: str) -> Any:
    """The protobuf class of a topic's messages."""
    topic = TOPIC_BY_NAME[topic_name]
    return message_class(schema_name(topic), schema_data(topic.schema))


@cache
def _constants(topic_name: str, kind_name: str) -> dict[str, float]:
    """The kind, and NaN for the topic's fields that frames of the kind lack."""
    kind, fields = KIND_BY_NAME[kind_name], value_fields(TOPIC_BY_NAME[topic_name])
    absent = {field.name: nan for field in fields if kind.field(field.name) is None}
    return {"kind": _KIND_NUMBER[kind.name], **absent}


def encode_row(topic: Topic, row: Row, log_time: int) -> bytes:
    """The message of a row, which must have a time, on its topic, from `topic_of`.

    It holds the row's own time if `log_time` differs.
    """
    values: dict[str, Any] = {"offset": row.offset, "raw": row.raw}
    if row.read_delay_ns is not None:
        values["read_delay_ns"] = row.read_delay_ns
    if row.t_ns != log_time:
        values["time_ns"] = row.t_ns
    if row.order_uncertain:
        values["order_uncertain"] = True
    if row.faults:
        values["faults"] = [_FAULT_NUMBER[fault] for fault in row.faults]
    values["status"] = _STATUS_NUMBER[row.status]
    kind = row.kind if isinstance(row, Frame) else None
    if topic is MALFORMED:
        values["kind"] = 0 if kind is None else _KIND_NUMBER[kind.name]
        values["framed"] = isinstance(row, Frame)
        values["length"] = len(row.raw)
    else:
        assert isinstance(row, Frame)
        assert kind is not None
        values |= _constants(topic.name, kind.name)
        values["cmd"] = row.cmd
        values |= {field.name: field.read(row.raw) for field in kind.fields}
    return bytes(class_of(topic.name)(**values).SerializeToString())


def encode_event(event: PortEvent, log_time: int) -> bytes:
    """The message of a port event; it holds the event's own time if `log_time` differs."""
    values: dict[str, Any] = {
        "kind": _EVENT_NUMBER[event.kind],
        "detail": encodable(event.detail),
        "count": event.count,
    }
    if event.t_ns != log_time:
        values["time_ns"] = event.t_ns
    return bytes(class_of(EVENTS.name)(**values).SerializeToString())


def encodable(text: str) -> str:
    """Text for UTF-8: undecodable bytes (of file names, for example) as backslash escapes."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def encodable_items(facts: Mapping[str, str]) -> dict[str, str]:
    """Names and values for UTF-8."""
    return {encodable(name): encodable(value) for name, value in facts.items()}


ChannelId = Callable[[str, Topic], int]

_FORMS = [(kind, cmd, uncertain) for uncertain in (0, 1) for kind in KINDS for cmd in kind.cmds]
"""Kind, CMD and `order_uncertain`: frames of one form make messages of one layout."""
_UNCERTAIN = len(_FORMS) // 2
_NO_FORM = 255
_BYTES = 256


_FORM_CODES = np.full(_BYTES * _BYTES, _NO_FORM, np.uint8)
"""By header and CMD, read as one little-endian number: the index in `_FORMS`."""
_HEADS = [kind.header | cmd << 8 for kind, cmd, _ in _FORMS[:_UNCERTAIN]]
_FORM_CODES[_HEADS] = np.arange(_UNCERTAIN)
_NAMES_MOTOR = np.zeros(_NO_FORM + 1, np.bool_)
"""By form, whether its frames name a motor."""
_NAMES_MOTOR[: len(_FORMS)] = [kind.names_motor for kind, *_ in _FORMS]
_RAW = np.dtype(f"V{FRAME_LENGTH}")


class RecordTemplate:
    """Template of the message records of one form."""

    def __init__(self, code: int) -> None:
        kind, _, uncertain = _FORMS[code]
        frame = _frame_of(code, MOTORS[0])
        topic = topic_of(frame)
        assert topic is not MALFORMED
        message = encode_row(topic, frame, 0)
        head = MESSAGE.pack(Opcode.MESSAGE, MESSAGE_HEAD + len(message), 0, 0, 0, 0)
        self._template = np.void(head + message)
        self.length = self._template.itemsize
        self._values = kind.fields
        fields = class_of(topic.name).DESCRIPTOR.fields
        template = Template(fields, LACKS_IF_UNCERTAIN if uncertain else LACKS)
        self._type = template.record_type(_HEAD_FIELDS, MESSAGE.size)

    def records(self, fields: dict[str, Array]) -> NDArray[np.void]:
        """The message records of some rows.

        `fields` has, by name of the MCAP header or the message, a value for each row; `raw` as
        opaque values of ten bytes, from which the frame's own fields are read.
        """
        raws = fields["raw"]
        found: NDArray[np.void] = np.full(len(raws), self._template)
        table = found.view(self._type)
        for name, values in fields.items():
            table[name] = values
        for field in self._values:
            kind = f">{'i' if field.signed else 'u'}{field.size}"
            # A strided view: copying the field out first takes as long as everything else.
            table[field.name] = np.ndarray(len(raws), kind, raws, field.start, raws.strides)
        return found


def _frame_of(code: int, motor: int) -> Frame:
    kind, cmd, uncertain = _FORMS[code]
    raw = bytes([kind.header, cmd, motor]).ljust(FRAME_LENGTH, b"\0")
    return Frame("", 0, raw, 0, (), 0, bool(uncertain))


@cache
def _topic(code: int, motor: int) -> Topic:
    return topic_of(_frame_of(code, motor))


_template_of = cache(RecordTemplate)


@cache
def _record_lengths() -> Array:
    lengths = np.zeros(_NO_FORM + 1, np.int64)
    lengths[: len(_FORMS)] = [_template_of(code).length for code in range(len(_FORMS))]
    return lengths


class ColumnPacker:
    """Packs batches of rows; counts the messages of each channel."""

    def __init__(self, channel_id: ChannelId) -> None:
        self._channel_id = channel_id
        self._sequences: dict[int, int] = {}
        self._first_time: int | None = None
        self.early_ns: int | None = None
        """Time of a row before the first message; None without such a row."""

    def pack(self, rows: Rows, times: Array, events_at: Array) -> McapBatch:
        """The messages of the rows and of their events, one at least, each in order.

        `times` are the log times of the messages, never falling; `events_at` the indexes of the
        events among the messages, rising.
        """
        if self._first_time is None:
            self._first_time = int(times[0])
        if self.early_ns is None and rows.t_ns.min(initial=self._first_time) < self._first_time:
            self.early_ns = int(rows.t_ns.min())
        rows_at: Any = slice(None)
        if len(events_at):
            rows_at = np.delete(np.arange(len(times)), events_at)
        forms = _forms_of(rows, times[rows_at])
        odd = np.flatnonzero(forms == _NO_FORM)
        odd_rows = list(rows.select(odd))
        channels = np.empty(len(times), np.int64)
        channels[rows_at] = self._channels(rows, forms, odd, odd_rows)
        channels[events_at] = [self._channel_of(event) for event in rows.events]
        sequences = self._count(channels)
        single: dict[int, Row | PortEvent] = {
            **dict(zip(np.arange(len(times))[rows_at][odd].tolist(), odd_rows, strict=True)),
            **dict(zip(events_at.tolist(), rows.events, strict=True)),
        }
        records = {
            at: message_record(entry, int(channels[at]), int(sequences[at]), int(times[at]))
            for at, entry in single.items()
        }
        lengths = np.empty(len(times), np.int64)
        lengths[rows_at] = _record_lengths().take(forms)
        lengths[list(records)] = [len(record) for record in records.values()]
        ends = np.cumsum(lengths)
        starts = ends - lengths
        data = np.empty(int(ends[-1]), np.uint8)
        heads = {"channel": channels, "sequence": sequences, "log": times, "publish": times}
        own_heads = {name: values[rows_at] for name, values in heads.items()}
        for own, packed in _records_by_form(rows, forms, own_heads):
            _write_at(data, starts[rows_at].take(own), packed)
        for at, record in records.items():
            data[starts[at] : ends[at]] = np.frombuffer(record, np.uint8)
        return McapBatch(data.data, channels, times, starts)

    def _channels(self, rows: Rows, forms: Array, odd: Array, odd_rows: Sequence[Row]) -> Array:
        """The channel of each row; each combination of port, form and motor is looked up once."""
        ports = rows.port.astype(np.int64)
        motors = np.where(_NAMES_MOTOR.take(forms), rows.raw[:, NUM_OFFSET], MOTORS[0])
        keys = (ports * len(_FORMS) + forms) * len(MOTORS) + motors - MOTORS[0]
        keys[odd] = 0
        found = np.zeros(len(rows.codebook.ports) * len(_FORMS) * len(MOTORS), np.int64)
        counts = np.bincount(keys)
        counts[:1] -= len(odd)
        for key in np.flatnonzero(counts).tolist():
            port_and_form, motor = divmod(key, len(MOTORS))
            port, form = divmod(port_and_form, len(_FORMS))
            found[key] = self._channel_id(rows.codebook.ports[port], _topic(form, MOTORS[motor]))
        channels = found.take(keys)
        channels[odd] = [self._channel_of(row) for row in odd_rows]
        return channels

    def _channel_of(self, entry: Row | PortEvent) -> int:
        topic = EVENTS if isinstance(entry, PortEvent) else topic_of(entry)
        return self._channel_id(entry.port, topic)

    def _count(self, channels: Array) -> Array:
        """The sequence number of each message: it counts up on each channel, and wraps."""
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


def _forms_of(rows: Rows, times: Array) -> Array:
    """The form of every row that can be packed with numpy, `_NO_FORM` for the others."""
    head = rows.raw[:, 0] | rows.raw[:, CMD_OFFSET].astype(np.uint16) << np.uint16(8)
    forms: Array = _FORM_CODES.take(head)
    clean = np.array([not faults for faults in rows.codebook.faults]).take(rows.faults)
    packable = (forms != _NO_FORM) & rows.framed & clean & (rows.t_ns == times)
    packable &= rows.delay_ns != NO_TIME
    num = rows.raw[:, NUM_OFFSET]
    packable &= ~_NAMES_MOTOR.take(forms) | (num >= MOTORS[0]) & (num <= MOTORS[-1])
    forms += rows.unordered * np.uint8(_UNCERTAIN)
    forms[~packable] = _NO_FORM
    return forms


def _records_by_form(
    rows: Rows, forms: Array, heads: dict[str, Array]
) -> Iterator[tuple[Array, Array]]:
    """For each form the indexes of its rows, and their message records."""
    raws = np.ascontiguousarray(rows.raw).view(_RAW)[:, 0]
    fields = heads | {"offset": rows.offset, "read_delay_ns": rows.delay_ns, "raw": raws}
    by_form, first = np.argsort(forms, kind="stable"), 0
    for code, count in enumerate(np.bincount(forms)[: len(_FORMS)].tolist()):
        own = by_form[first : first + count]
        first += count
        if count:
            taken = {name: values.take(own) for name, values in fields.items()}
            yield own, _template_of(code).records(taken)


def _write_at(data: Array, starts: Array, records: Array) -> None:
    width = records.dtype.itemsize
    at_every_byte: Array = np.ndarray((len(data) - width + 1,), records.dtype, data, 0, (1,))
    at_every_byte[starts] = records


def message_record(entry: Row | PortEvent, channel: int, sequence: int, time: int) -> bytes:
    """The record of one message."""
    if isinstance(entry, PortEvent):
        data = encode_event(entry, time)
    else:
        data = encode_row(topic_of(entry), entry, time)
    head = (Opcode.MESSAGE, MESSAGE_HEAD + len(data), channel, sequence, time, time)
    return MESSAGE.pack(*head) + data


def port_metadata(port: PortFacts) -> dict[str, str]:
    """The metadata of a port's channels."""
    baud = {} if port.baud is None else {"baud": str(port.baud)}
    return {"port": encodable(port.name), **baud}


class Channels:
    """The channels of one file, numbered from 1 in the order in which their ports are added."""

    def __init__(self) -> None:
        self._ids: dict[tuple[str, str], int] = {}
        self.ports: list[PortFacts] = []
        """The ports that were added, in the order of their channels."""
        names = dict.fromkeys(topic.schema for topic in TOPICS)
        self._schema_ids = {name: id_ for id_, name in enumerate(names, 1)}

    def schemas(self) -> list[Schema]:
        """Every schema of a recording."""
        named = {topic.schema: topic for topic in TOPICS}
        return [
            Schema(id_, schema_data(name), SchemaEncoding.Protobuf, schema_name(named[name]))
            for name, id_ in self._schema_ids.items()
        ]

    def of_port(self, port: PortFacts) -> list[Channel]:
        """Add a port, and return a channel for each topic; none if the port is known."""
        if (port.name, TOPICS[0].name) in self._ids:
            return []
        self.ports.append(PortFacts(encodable(port.name), port.baud))
        metadata = port_metadata(port)
        channels = []
        for topic in TOPICS:
            id_ = self._ids[port.name, topic.name] = len(self._ids) + 1
            schema_id = self._schema_ids[topic.schema]
            channels.append(Channel(id_, topic.name, MessageEncoding.Protobuf, metadata, schema_id))
        return channels

    def id_of(self, port: str, topic: Topic) -> int:
        """The channel of a port on a topic; raises KeyError if the port was not added."""
        return self._ids[port, topic.name]
