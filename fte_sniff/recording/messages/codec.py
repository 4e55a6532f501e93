"""One row to one message and back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from math import nan
from typing import Any

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError

from fte_sniff.errors import FileError, TranslatableText
from fte_sniff.protocol import (
    FRAME_LENGTH,
    HEADERS,
    KIND_BY_NAME,
    TAIL,
    Damage,
    Fault,
    Field,
    Frame,
    PortEvent,
    PortEventKind,
    Row,
    Status,
)
from fte_sniff.recording.messages.schema import (
    EVENTS,
    MALFORMED,
    REPEATED,
    TOPIC_BY_NAME,
    Topic,
    enum_number,
    enum_value_name,
    message_class,
    schema_data,
    schema_name,
    value_fields,
)
from fte_sniff.recording.messages.wire_layout import WireLayouts

_GREATEST = 2**63 - 1
"""The largest offset and time that the columns of any tool can hold."""

_INTEGERS = (
    FieldDescriptor.CPPTYPE_UINT64,
    FieldDescriptor.CPPTYPE_INT64,
    FieldDescriptor.CPPTYPE_UINT32,
    FieldDescriptor.CPPTYPE_INT32,
)
_TEXT = (FieldDescriptor.CPPTYPE_STRING,)
"""Of text and of bytes: protobuf has one for both."""
_ENUM = (FieldDescriptor.CPPTYPE_ENUM,)
_ROW_NEEDS = {"offset": _INTEGERS, "read_delay_ns": _INTEGERS, "raw": _TEXT, "faults": _ENUM}
_EVENT_NEEDS = {"kind": _ENUM, "detail": _TEXT}
"""What messages must have to be read, and of which type."""


class MessageReader:
    """Reads the messages of one channel by the schema that the file gives them."""

    def __init__(self, topic: str, port: str, schema: str, data: bytes) -> None:
        """Take the schema.

        Args:
            topic: the channel's topic, for error messages.
            port: the port that the channel's rows belong to.
            schema: the full name of the message.
            data: the serialized FileDescriptorSet.

        Raises:
            FileError: the schema cannot be used, or its messages do not hold what rows are made of.
        """
        self.topic = topic
        self.port = port
        try:
            self._message = message_class(schema, data)
        except ValueError as error:
            raise FileError(
                "{topic}: {why}; the file is damaged or not fte-sniff's",
                topic=topic,
                why=reason_in(error),
            ) from error
        fields = self._message.DESCRIPTOR.fields_by_name
        self._tells_framed = "framed" in fields
        self._tells_time = "time_ns" in fields
        self._tells_order = "order_uncertain" in fields
        self._tells_count = "count" in fields
        needed = _EVENT_NEEDS if topic == EVENTS.name else _ROW_NEEDS
        lacking = sorted(
            name
            for name, types in needed.items()
            if name not in fields
            or fields[name].cpp_type not in types
            or (fields[name].default_value == []) != (name in REPEATED)
        )
        if lacking:
            raise FileError(
                "{topic}: its messages ({schema}) have no {lacking}; "
                "fte-sniff reads what fte-sniff records",
                topic=topic,
                schema=schema,
                lacking=", ".join(lacking),
            )
        is_event = topic == EVENTS.name
        self.layouts = None if is_event else _layouts_of(schema, data)
        """How messages can be read many at once; None where they must be read one by one."""
        self._words = _words_of(fields["kind" if is_event else "faults"])
        self.entry: Callable[[bytes, int], Row | PortEvent] = self.event if is_event else self.row
        """Reads one message: `event` on the topic of port events, `row` on any other."""

    def row(self, data: bytes, log_time: int) -> Row:
        """The row of one message.

        Raises:
            ValueError: the message does not fit its schema or makes no row.
        """
        message = self._parse(data)
        faults = message.faults
        delay = message.read_delay_ns if message.HasField("read_delay_ns") else None
        made: type[Row] = Damage if self._tells_framed and not message.framed else Frame
        raw = message.raw
        if not (_is_framed(raw) if made is Frame else raw):
            what = TranslatableText("no frame") if made is Frame else TranslatableText("no damage")
            raise ValueError(
                TranslatableText("{what} in its {size} bytes", what=what, size=len(raw))
            )
        if message.offset > _GREATEST:
            raise ValueError(
                TranslatableText(
                    "offset {offset} is past the end of any stream", offset=message.offset
                )
            )
        return made(
            self.port,
            message.offset,
            raw,
            self._time(message, log_time),
            tuple(map(self.fault, faults)) if faults else (),
            delay,
            self._tells_order and message.order_uncertain,
        )

    def fault(self, number: int) -> Fault:
        """The fault that the file's schema gives this number.

        Raises:
            ValueError: this version does not know it.
        """
        return Fault(self._word(number))

    def event(self, data: bytes, log_time: int) -> PortEvent:
        """The port event of one message.

        Raises:
            ValueError: the message does not fit its schema or makes no event.
        """
        message = self._parse(data)
        kind = PortEventKind(self._word(message.kind))
        count = message.count if self._tells_count else 0
        return PortEvent(self._time(message, log_time), self.port, kind, message.detail, count)

    def _parse(self, data: bytes) -> Any:
        try:
            return self._message.FromString(data)
        except DecodeError as error:
            raise ValueError(TranslatableText("a message that does not fit its schema")) from error

    def _time(self, message: Any, log_time: int) -> int:
        own = self._tells_time and message.HasField("time_ns")
        time = int(message.time_ns) if own else log_time
        if time > _GREATEST:
            raise ValueError(TranslatableText("time {time} ns is past the year 2262", time=time))
        return time

    def _word(self, number: int) -> str:
        word = self._words.get(number)
        if word is None:
            raise ValueError(
                TranslatableText(
                    "a word that this version does not know (number {number})", number=number
                )
            )
        return word


def reason_in(error: ValueError) -> str:
    """Why a message or a schema cannot be read, to be said in any language where it can be."""
    text = error.args[0] if error.args else ""
    return text if isinstance(text, TranslatableText) else str(error)


@lru_cache(maxsize=64)
def _layouts_of(schema: str, data: bytes) -> WireLayouts:
    return WireLayouts(message_class(schema, data).DESCRIPTOR)


def _is_framed(raw: bytes) -> bool:
    return len(raw) == FRAME_LENGTH and raw[0] in HEADERS.values() and raw[-1] == TAIL


def _words_of(field: Any) -> dict[int, str]:
    """The words of this version by the numbers that the file's schema gives them."""
    if field.enum_type is None:
        return {}
    enum = "PortEventKind" if field.name == "kind" else "Fault"
    known = PortEventKind if enum == "PortEventKind" else Fault
    word_of = {enum_value_name(enum, word): str(word) for word in known}
    return {
        value.number: word_of[value.name]
        for value in field.enum_type.values
        if value.name in word_of
    }


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
        topic: the result of `topic_of`.
        row: the row; its time must not be None.
        log_time: the message's log time; the message holds the row's own time if it differs.
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
