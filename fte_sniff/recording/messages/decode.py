"""Decoder of message records into rows, many at once.

Messages that fit a `Template` are checked and copied with numpy. The others, of rows with faults
and of damage mostly, are parsed by protobuf, one by one: that takes twenty times as long, so their
number is limited by the bytes that their chunk has in the file.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from typing import Any

import numpy as np
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError

from fte_sniff.errors import FileError, TranslatableText, listed
from fte_sniff.protocol import FRAME_LENGTH, HEADERS, TAIL, Fault, PortEvent, PortEventKind
from fte_sniff.protocol.rows import NO_TIME, Array, Bools, Rows
from fte_sniff.recording.mcap.chunk_index import (
    CHANNEL_OFFSET,
    LOG_TIME_OFFSET,
    MESSAGE_HEAD,
    MessageIndex,
)
from fte_sniff.recording.mcap.records import RecordError
from fte_sniff.recording.messages.schema import EVENTS, REPEATED, enum_value_name, message_class
from fte_sniff.recording.messages.template import FIRST_FIELDS, Template, templates_of

_GREATEST = 2**63 - 1
"""The largest offset, time and read delay: 64-bit columns hold no larger one."""

_LARGEST_MESSAGE = 64 * 1024

_INTEGERS = (
    FieldDescriptor.CPPTYPE_UINT64,
    FieldDescriptor.CPPTYPE_INT64,
    FieldDescriptor.CPPTYPE_UINT32,
    FieldDescriptor.CPPTYPE_INT32,
)
_TEXT = (FieldDescriptor.CPPTYPE_STRING,)
"""Protobuf has one C++ type for text and bytes."""
_ENUM = (FieldDescriptor.CPPTYPE_ENUM,)
_ROW_NEEDS = {"offset": _INTEGERS, "read_delay_ns": _INTEGERS, "raw": _TEXT, "faults": _ENUM}
_EVENT_NEEDS = {"kind": _ENUM, "detail": _TEXT}
"""The fields that a message must have, and their types."""


RowValues = tuple[int, int, int, bool, bool, tuple[Fault, ...], bytes]
"""Time, offset, read delay or `NO_TIME`, whether it is a frame, whether its order is uncertain,
faults and bytes of a row; a plain tuple, because it is made for each row with a fault."""


class MessageReader:
    """Reads the messages of one channel with the schema in the file."""

    def __init__(self, topic: str, port: str, schema: str, data: bytes) -> None:
        """Take the full name of the message and the serialized FileDescriptorSet.

        Raises FileError if the schema is unusable, or its messages lack fields of a row.
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
                lacking=listed(lacking),
            )
        is_event = topic == EVENTS.name
        self.templates = () if is_event else _templates_of(schema, data)
        """The layouts of most of its messages; the same object for channels of one schema."""
        self._members = _members_by_number(fields["kind" if is_event else "faults"])
        self._faults = lru_cache(maxsize=256)(self._faults_of)
        self._has_own_time, self._has_count = "time_ns" in fields, "count" in fields
        self._has_damage, self._has_order = "framed" in fields, "order_uncertain" in fields
        self.read: Callable[[bytes, int], RowValues | PortEvent]
        """Parse one message with its log time; raises ValueError if it does not fit its schema, or
        is not a valid row or event."""
        self.read = self._event if is_event else self._row

    def _row(self, data: bytes, log_time: int) -> RowValues:
        message = self._parse(data)
        raw, offset, delay_ns = message.raw, message.offset, NO_TIME
        framed = not self._has_damage or message.framed
        if not (_is_framed(raw) if framed else raw):
            what = TranslatableText("no frame") if framed else TranslatableText("no damage")
            raise RecordError("{what} in its {size} bytes", what=what, size=len(raw))
        if offset > _GREATEST:
            raise RecordError("offset {offset} is past the end of any stream", offset=offset)
        if message.HasField("read_delay_ns"):
            delay_ns = message.read_delay_ns
            if delay_ns > _GREATEST:
                raise RecordError("a message that does not fit its schema")
        faults = self._faults(tuple(message.faults[:]))
        unordered = self._has_order and message.order_uncertain
        time = self._time(message, log_time)
        return time, offset, delay_ns, framed, unordered, faults, raw

    def _faults_of(self, numbers: tuple[int, ...]) -> tuple[Fault, ...]:
        return tuple(Fault(self._member(number)) for number in numbers)

    def _event(self, data: bytes, log_time: int) -> PortEvent:
        message = self._parse(data)
        kind = PortEventKind(self._member(message.kind))
        count = message.count if self._has_count else 0
        return PortEvent(self._time(message, log_time), self.port, kind, message.detail, count)

    def _parse(self, data: bytes) -> Any:
        if len(data) > _LARGEST_MESSAGE:
            raise RecordError("{size} bytes, more than any row has", size=len(data))
        try:
            return self._message.FromString(data)
        except DecodeError as error:
            raise RecordError("a message that does not fit its schema") from error

    def _time(self, message: Any, log_time: int) -> int:
        own = self._has_own_time and message.HasField("time_ns")
        time = int(message.time_ns) if own else log_time
        if time > _GREATEST:
            raise RecordError("time {time} ns is past the year 2262", time=time)
        return time

    def _member(self, number: int) -> StrEnum:
        member = self._members.get(number)
        if member is None:
            raise RecordError(
                "a word that this version does not know (number {number})", number=number
            )
        return member


ChannelReader = MessageReader | str | None
"""The reader of a channel, or why its messages cannot be read; None for other topics."""


def reason_in(error: Exception) -> str:
    """Why a message or a schema cannot be read, translatable if possible."""
    text = error.args[0] if error.args else ""
    return text if isinstance(text, TranslatableText) else str(error)


@lru_cache(maxsize=64)
def _templates_of(schema: str, data: bytes) -> tuple[Template, ...]:
    return templates_of(message_class(schema, data).DESCRIPTOR)


def _is_framed(raw: bytes) -> bool:
    return len(raw) == FRAME_LENGTH and raw[0] in HEADERS.values() and raw[-1] == TAIL


def _members_by_number(field: Any) -> dict[int, StrEnum]:
    """The faults or event kinds of this version, by their numbers in the file's schema."""
    if field.enum_type is None:
        return {}
    known: type[StrEnum] = PortEventKind if field.name == "kind" else Fault
    members = {enum_value_name(known.__name__, one): one for one in known}
    values = field.enum_type.values
    return {value.number: members[value.name] for value in values if value.name in members}


_MOST_LOSSES = 20
_OTHER_LOSSES = TranslatableText("more could not be read")


class Losses(Counter[str]):
    """Unreadable messages by reason; beyond 20 different reasons, the others are one."""

    def append(self, text: str, count: int = 1) -> None:
        """Count a loss."""
        listed = text in self or len(self) < _MOST_LOSSES
        self[text if listed else _OTHER_LOSSES] += count

    def merge(self, other: Losses) -> None:
        """Count the losses of another counter."""
        for text, count in other.items():
            self.append(text, count)

    @property
    def lines(self) -> tuple[str, ...]:
        """One line for each text."""
        return tuple(
            text
            if count == 1
            else TranslatableText("{loss} ({count} times)", loss=text, count=count)
            for text, count in self.items()
        )


_RAW = np.dtype(f"V{FRAME_LENGTH}")
"""A frame as one opaque value, which numpy copies at once."""

_PER_SLOW_MESSAGE = 2
"""One in this number of the records that a chunk can hold may be parsed alone."""


class ParseBudget:
    """How many messages may be parsed one by one, of each of some concatenated chunks.

    A chunk has its own share, so that a hostile chunk does not cost the rows of the next one.
    """

    def __init__(self, sizes: Sequence[int], most: Sequence[int]) -> None:
        """Take the bytes of each unpacked chunk, and the number of records that it can hold."""
        self._ends = np.cumsum(sizes)
        self._left = np.array(most) // _PER_SLOW_MESSAGE

    def spend(self, starts: Array) -> Bools:
        """A mask of the messages with these starts, rising, that may be parsed."""
        chunks = np.searchsorted(self._ends, starts, "right")
        counts = np.bincount(chunks, minlength=len(self._left))
        numbers = np.arange(len(starts)) - (np.cumsum(counts) - counts)[chunks]
        found: Bools = numbers < self._left[chunks]
        self._left -= np.minimum(counts, self._left)
        return found


@dataclass(slots=True)
class DecodedColumns:
    """The rows and events of some messages."""

    columns: Rows
    messages: int
    """Number of messages, of any topic."""
    times: tuple[int, int] | None
    """First and last log time of fte-sniff's messages."""
    losses: Losses


def decode_columns(
    messages: MessageIndex,
    reader_of: Callable[[int], ChannelReader],
    columns: Rows,
    budget: ParseBudget,
) -> DecodedColumns:
    """Decode the messages of one or more unpacked chunks, in their order.

    `reader_of` takes a channel id. `columns` are blank, with a row for each message. `budget` is
    that of the chunks.
    """
    return _Decoder(messages, reader_of, columns, budget).decode()


class _Decoder:
    def __init__(
        self,
        messages: MessageIndex,
        reader_of: Callable[[int], ChannelReader],
        columns: Rows,
        budget: ParseBudget,
    ) -> None:
        self._messages, self._reader_of, self._columns = messages, reader_of, columns
        self._budget = budget
        self._kept = np.ones(len(messages), np.bool_)
        self._events: list[tuple[int, PortEvent]] = []
        self._by_channel: dict[int, MessageReader] = {}
        self._losses = Losses()
        self._channels = messages.field(CHANNEL_OFFSET, "<u2").astype(np.intp)
        self._log_times = messages.field(LOG_TIME_OFFSET, "<i8").copy()

    def decode(self) -> DecodedColumns:
        self._fill()
        for reader, rows in self._by_schema():
            others = self._fit(reader.templates, rows)
            if len(others):
                self._parse(others)
        own = self._log_times if self._kept.all() else self._log_times[self._kept]
        logged = own.view(np.uint64)
        times = (int(logged.min()), int(logged.max())) if len(logged) else None
        self._events.sort(key=lambda numbered: numbered[0])
        events = tuple(event for _, event in self._events)
        self._kept[[row for row, _ in self._events]] = False
        whole = bool(self._kept.all())
        columns = self._columns.select(slice(None) if whole else self._kept, events)
        return DecodedColumns(columns, len(self._messages), times, self._losses)

    def _fill(self) -> None:
        """Fill the columns as if every message fitted a template."""
        columns, messages = self._columns, self._messages
        columns.t_ns[:] = self._log_times
        columns.offset[:] = messages.field(MESSAGE_HEAD + FIRST_FIELDS["offset"], "<i8")
        columns.delay_ns[:] = messages.field(MESSAGE_HEAD + FIRST_FIELDS["read_delay_ns"], "<i8")
        columns.raw.view(_RAW).reshape(-1)[:] = messages.field(
            MESSAGE_HEAD + FIRST_FIELDS["raw"], _RAW
        )

    def _by_schema(self) -> Iterator[tuple[MessageReader, Array]]:
        """A reader of each schema, and the rows of all its channels; sets the ports."""
        counts = np.bincount(self._channels, minlength=1)
        present = np.flatnonzero(counts).tolist()
        groups: dict[int, list[int]] = {}
        ports = np.zeros(len(counts), np.uint16)
        for channel in present:
            reader = self._reader_of(channel)
            if isinstance(reader, MessageReader):
                self._by_channel[channel] = reader
                groups.setdefault(id(reader.templates or reader), []).append(channel)
                ports[channel] = self._columns.codebook.port_code(reader.port)
            elif reader is not None:
                self._losses.append(reader, int(counts[channel]))
        self._columns.port[:] = ports.take(self._channels)
        codes = np.full(len(counts), len(groups), _code_type(len(groups)))
        for code, channels in enumerate(groups.values()):
            codes[channels] = code
        if len(groups) == 1 and len(self._by_channel) == len(present):
            by_code = np.arange(len(self._messages))
        else:
            by_code = np.argsort(codes.take(self._channels), kind="stable")
        first = 0
        for channels in groups.values():
            end = first + int(counts[channels].sum())
            yield self._by_channel[channels[0]], by_code[first:end]
            first = end
        self._kept[by_code[first:]] = False

    def _fit(self, templates: tuple[Template, ...], rows: Array) -> Array:
        """Complete the columns of the messages that fit a template; returns the other rows."""
        messages, columns = self._messages, self._columns
        lengths = messages.lengths.take(rows)
        fit = np.zeros(len(rows), np.bool_)
        for template in templates:
            at = np.flatnonzero(lengths == template.length)
            if not len(at):
                continue
            own = rows.take(at)
            starts = messages.starts.take(own) + MESSAGE_HEAD
            fit[at] = template.fitting(messages.records, starts)
            if "order_uncertain" in template:
                values = np.frombuffer(messages.records, np.bool_)
                columns.unordered[own] = values[starts + template.offset_of("order_uncertain")]
        # A time past the year 2262 is negative in the column.
        fit &= self._log_times.take(rows) >= 0
        return rows[~fit]

    def _parse(self, rows: Array) -> None:
        """Parse the messages of some rows one by one, as many as their chunks may have."""
        within = self._budget.spend(self._messages.starts.take(rows))
        if not within.all():
            too_many = rows[~within]
            self._kept[too_many] = False
            text = TranslatableText("messages that take too long to decode, for their size")
            self._losses.append(text, len(too_many))
            rows = rows[within]
        messages, codebook = self._messages, self._columns.codebook
        starts = messages.starts.take(rows) + MESSAGE_HEAD
        stops = starts + messages.lengths.take(rows)
        times = self._log_times.take(rows).view(np.uint64)
        found: list[RowValues] = []
        at: list[int] = []
        codes: list[int] = []
        columns = rows, self._channels.take(rows), starts, stops, times
        for row, channel, start, stop, time in zip(*(c.tolist() for c in columns), strict=True):
            reader = self._by_channel[channel]
            try:
                entry = reader.read(messages.records[start:stop], time)
                if isinstance(entry, PortEvent):
                    self._events.append((row, entry))
                    continue
                codes.append(codebook.fault_code(entry[5]))
            except ValueError as error:
                self._kept[row] = False
                why = reason_in(error)
                self._losses.append(TranslatableText("{topic}: {why}", topic=reader.topic, why=why))
                continue
            at.append(row)
            found.append(entry)
        if found:
            self._store(at, found, codes)

    def _store(self, at: list[int], found: list[RowValues], codes: list[int]) -> None:
        columns = self._columns
        t_ns, offsets, delays, framed, unordered, _, raws = zip(*found, strict=True)
        columns.t_ns[at], columns.offset[at], columns.delay_ns[at] = t_ns, offsets, delays
        columns.framed[at], columns.unordered[at] = framed, unordered
        columns.length[at] = lengths = list(map(len, raws))
        columns.faults[at] = codes
        first = b"".join([raw[:FRAME_LENGTH].ljust(FRAME_LENGTH, b"\0") for raw in raws])
        columns.raw[at] = np.frombuffer(first, np.uint8).reshape(-1, FRAME_LENGTH)
        if max(lengths) > FRAME_LENGTH:
            long = zip(at, raws, strict=True)
            columns.long.update((row, raw) for row, raw in long if len(raw) > FRAME_LENGTH)


def _code_type(codes: int) -> type[np.unsignedinteger[Any]]:
    """The shortest type for one code more: numpy sorts it in the fewest passes."""
    return np.uint8 if codes < 2**8 else np.uint32
