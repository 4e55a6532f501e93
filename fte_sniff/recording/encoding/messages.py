"""Owns the way from one row or event to the bytes of its message.

It must not know files, channels or the order of messages, nor how they are read back
(`message_reader`). What a message says beside its raw bytes is for other tools.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from math import nan
from typing import Any

from fte_sniff.protocol import (
    KIND_BY_NAME,
    Fault,
    Field,
    Frame,
    PortEvent,
    PortEventKind,
    Row,
    Status,
)
from fte_sniff.recording.encoding.plain_messages import PlainForm, plain_form
from fte_sniff.recording.encoding.schema import (
    enum_number,
    message_class,
    schema_data,
    schema_name,
    value_fields,
)
from fte_sniff.recording.encoding.topics import EVENTS, MALFORMED, TOPIC_BY_NAME, Topic

_STATUS_NUMBER = {status: enum_number("Status", status) for status in Status}
_FAULT_NUMBER = {fault: enum_number("Fault", fault) for fault in Fault}
_EVENT_NUMBER = {kind: enum_number("PortEventKind", kind) for kind in PortEventKind}


def class_of(topic: Topic) -> Any:
    """The protobuf class of a topic's messages."""
    return message_class(schema_name(topic), schema_data(topic.schema))


_CLASS_OF_MALFORMED = class_of(MALFORMED)
_CLASS_OF_EVENT = class_of(EVENTS)


@dataclass(frozen=True, slots=True)
class _Form:
    """How frames of one kind become messages of one topic."""

    message: Any
    fixed: Mapping[str, float]
    """Whatever is the same in all of them."""
    read: tuple[tuple[str, Field], ...]
    """Whatever is to be read from each frame."""


@cache
def _form_of(topic_name: str, kind_name: str) -> _Form:
    topic, kind = TOPIC_BY_NAME[topic_name], KIND_BY_NAME[kind_name]
    absent = {field.name: nan for field in value_fields(topic) if kind.field(field.name) is None}
    return _Form(
        class_of(topic),
        {"kind": enum_number("Kind", kind.name), **absent},
        tuple((field.name, field) for field in kind.fields),
    )


def encode_row(topic: Topic, row: Row, log_time: int) -> bytes:
    """The message of a row on its topic.

    Args:
        topic: where `topic_of` sends the row.
        row: the row; its time must not be None.
        log_time: the message's log time; the row's own time is told where it differs.
    """
    if not row.faults and row.t_ns == log_time and row.read_delay_ns is not None:
        kind = row.kind if isinstance(row, Frame) else None
        if kind is not None and topic is not MALFORMED:
            assert isinstance(row, Frame)
            return _plain_form_of(topic.name, kind.name, row.order_uncertain).encode(row)
    return _encode_by_protobuf(topic, row, log_time)


@cache
def _plain_form_of(topic_name: str, kind_name: str, order_uncertain: bool) -> PlainForm:
    topic, kind = TOPIC_BY_NAME[topic_name], KIND_BY_NAME[kind_name]
    fixed = {"status": _STATUS_NUMBER[Status.OK], "kind": enum_number("Kind", kind.name)}
    if order_uncertain:
        fixed["order_uncertain"] = True
    return plain_form(class_of(topic), kind, fixed)


def _encode_by_protobuf(topic: Topic, row: Row, log_time: int) -> bytes:
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
    if topic is MALFORMED:
        return _encode_malformed(row, values)
    assert isinstance(row, Frame)
    kind = row.kind
    assert kind is not None
    form = _form_of(topic.name, kind.name)
    values.update(form.fixed)
    values["cmd"] = row.cmd
    for name, field in form.read:
        values[name] = field.read(row.raw)
    return bytes(form.message(**values).SerializeToString())


def _encode_malformed(row: Row, values: dict[str, Any]) -> bytes:
    kind = row.kind if isinstance(row, Frame) else None
    values["kind"] = 0 if kind is None else enum_number("Kind", kind.name)
    values["framed"] = isinstance(row, Frame)
    values["length"] = len(row.raw)
    return bytes(_CLASS_OF_MALFORMED(**values).SerializeToString())


def encode_event(event: PortEvent, log_time: int) -> bytes:
    """The message of a port event; its own time is told where `log_time` differs from it."""
    values: dict[str, Any] = {
        "kind": _EVENT_NUMBER[event.kind],
        "detail": plain(event.detail),
        "count": event.count,
    }
    if event.t_ns != log_time:
        values["time_ns"] = event.t_ns
    return bytes(_CLASS_OF_EVENT(**values).SerializeToString())


def plain(text: str) -> str:
    """Text that UTF-8 can hold: undecodable bytes of file names and the like as backslash codes."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")
