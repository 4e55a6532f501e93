"""Owns the way from the bytes of one message to its row or event, by the schema of its file.

It must not know files or the order of messages. Reading a row takes the raw bytes, where they
stood, and what the framer thought of them, and derives the rest anew.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError

from fte_sniff.errors import FileError, Said
from fte_sniff.protocol import (
    FRAME_LENGTH,
    HEADERS,
    TAIL,
    Damage,
    Fault,
    Frame,
    PortEvent,
    PortEventKind,
    Row,
)
from fte_sniff.recording.encoding.layout import Layouts
from fte_sniff.recording.encoding.schema import REPEATED, enum_value_name, message_class
from fte_sniff.recording.encoding.topics import EVENTS

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
                Said(
                    "{topic}: {why}; the file is damaged or not fte-sniff's",
                    topic=topic,
                    why=reason_in(error),
                )
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
                Said(
                    "{topic}: its messages ({schema}) have no {lacking}; "
                    "fte-sniff reads what fte-sniff records",
                    topic=topic,
                    schema=schema,
                    lacking=", ".join(lacking),
                )
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
            what = Said("no frame") if made is Frame else Said("no damage")
            raise ValueError(Said("{what} in its {size} bytes", what=what, size=len(raw)))
        if message.offset > _GREATEST:
            raise ValueError(
                Said("offset {offset} is past the end of any stream", offset=message.offset)
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
            raise ValueError(Said("a message that does not fit its schema")) from error

    def _time(self, message: Any, log_time: int) -> int:
        own = self._tells_time and message.HasField("time_ns")
        time = int(message.time_ns) if own else log_time
        if time > _GREATEST:
            raise ValueError(Said("time {time} ns is past the year 2262", time=time))
        return time

    def _word(self, number: int) -> str:
        word = self._words.get(number)
        if word is None:
            raise ValueError(
                Said("a word that this version does not know (number {number})", number=number)
            )
        return word


def reason_in(error: ValueError) -> str:
    """Why a message or a schema cannot be read, to be said in any language where it can be."""
    text = error.args[0] if error.args else ""
    return text if isinstance(text, Said) else str(error)


@lru_cache(maxsize=64)
def _layouts_of(schema: str, data: bytes) -> Layouts:
    return Layouts(message_class(schema, data).DESCRIPTOR)


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
