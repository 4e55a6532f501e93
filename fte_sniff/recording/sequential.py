"""Reading of rows record by record, and the channel definitions met on the way.

A later definition replaces an earlier one of the same id. So the definitions in a chunk, under its
checksum, take precedence over those at the start of the file, which no checksum covers: a flipped
bit there would assign rows to another port.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from mcap.opcode import Opcode
from mcap.records import Channel, Header, Schema
from mcap.well_known import MessageEncoding

from fte_sniff.errors import FileError, TranslatableText
from fte_sniff.protocol import PortEvent, Row
from fte_sniff.recording.mcap.reader import RawRecord, RecordStream
from fte_sniff.recording.mcap.records import RecordError, parse, records_in, unpack
from fte_sniff.recording.messages.codec import MessageReader, reason_in
from fte_sniff.recording.messages.schema import TOPIC_BY_NAME
from fte_sniff.recording.metadata import PROGRAM, PortFacts
from fte_sniff.recording.row_ranges import Definitions

_MESSAGE_HEAD = struct.Struct("<HIQQ")
_MOST_LOSSES = 20
_OTHER_LOSSES = TranslatableText("more could not be read")
_MOST_TOPICS = 10
_Definition = TypeVar("_Definition", Schema, Channel)


class SequentialReader:
    """One pass over a recording; knows its channels, and counts messages and losses."""

    def __init__(
        self,
        path: Path,
        port_of: Callable[[Channel], PortFacts],
        known: Definitions | None = None,
    ) -> None:
        """Begin a pass; one that begins later in the file needs the definitions so far."""
        self._path, self._port_of = path, port_of
        self._schemas: dict[int, Schema] = dict(known.schemas) if known else {}
        self._channels: dict[int, Channel] = dict(known.channels) if known else {}
        self._definitions: tuple[int, Definitions] | None = None
        self._readers: dict[int, MessageReader | None] = {}
        self._refused: FileError | None = None
        self._ours = False
        self._losses: Counter[str] = Counter()
        self.version = 0
        """Rises with every change of the definitions."""
        self.messages = 0
        """Number of messages of any topic."""
        self.times: tuple[int, int] | None = None
        """First and last log time of fte-sniff's messages."""

    @property
    def losses(self) -> tuple[str, ...]:
        """What could not be read, one line each."""
        return tuple(
            text
            if count == 1
            else TranslatableText("{loss} ({count} times)", loss=text, count=count)
            for text, count in self._losses.items()
        )

    @property
    def loss_count(self) -> int:
        """How often something could not be read."""
        return self._losses.total()

    @property
    def definitions(self) -> Definitions:
        """The definitions so far."""
        if self._definitions is None or self._definitions[0] != self.version:
            known = Definitions(dict(self._schemas), dict(self._channels))
            self._definitions = self.version, known
        return self._definitions[1]

    def read(self, records: RecordStream) -> Iterator[Row | PortEvent]:
        """The rows and events of the records, in their order.

        Raises FileError if the file has none of fte-sniff's topics, or none that can be read.
        """
        for record in records:
            if record.opcode == Opcode.CHUNK:
                yield from self.read_chunk(record)
            else:
                yield from self.read_record(record.opcode, record.body)
        self.check_topics(cut=records.cut)

    def read_chunk(self, record: RawRecord) -> Iterator[Row | PortEvent]:
        """The rows and events of a chunk, in their order."""
        try:
            for opcode, body in records_in(unpack(record.body)):
                yield from self.read_record(opcode, body)
        except RecordError as error:
            loss = TranslatableText(
                "{error} at byte {position} ({size} bytes)",
                error=error.message,
                position=record.position,
                size=len(record.body),
            )
            self._add_loss(loss)

    def read_record(self, opcode: int, body: bytes) -> Iterator[Row | PortEvent]:
        """The row or event of a message; applies a definition."""
        if opcode == Opcode.MESSAGE:
            yield from self._read_message(body)
        else:
            self._define(opcode, body)

    def count(self, messages: int, times: tuple[int, int] | None) -> None:
        """Count messages, with the first and last log time of fte-sniff's among them."""
        self.messages += messages
        if times is not None:
            first, last = self.times or times
            self.times = (min(first, times[0]), max(last, times[1]))

    def readers(self) -> dict[int, MessageReader | None]:
        """The reader of each channel; None for other topics.

        Channels that cannot be read are absent: only their messages are losses.
        """
        for channel_id, channel in self._channels.items():
            if channel_id not in self._readers:
                with suppress(FileError):
                    ours = channel.topic in TOPIC_BY_NAME
                    self._readers[channel_id] = self._message_reader(channel) if ours else None
        return dict(self._readers)

    def changes_nothing(self, opcode: int, body: bytes) -> bool:
        """Whether a record outside messages defines only what is known already."""
        try:
            if opcode == Opcode.SCHEMA:
                schema = parse(Schema, body)
                return bool(self._schemas.get(schema.id) == schema)
            if opcode == Opcode.CHANNEL:
                channel = parse(Channel, body)
                return bool(self._channels.get(channel.id) == channel)
        except RecordError:
            return False
        return opcode != Opcode.HEADER

    def check_topics(self, *, cut: bool) -> None:
        """Refuse a file of which nothing could be read, at the end of the pass.

        Raises FileError if the file has none of fte-sniff's topics, or none that can be read.
        """
        if self.times is not None:
            return
        if self._refused is not None:
            raise self._refused
        topics = [channel.topic for channel in self._channels.values()]
        ours = self._ours or any(topic in TOPIC_BY_NAME for topic in topics)
        if not ours and (topics or not cut):
            raise without_our_topics(self._path, topics)

    def _read_message(self, body: bytes) -> Iterator[Row | PortEvent]:
        if len(body) < _MESSAGE_HEAD.size:
            self._add_loss(TranslatableText("a message without its head"))
            return
        channel_id, _, log_time, _ = _MESSAGE_HEAD.unpack_from(body)
        self.count(1, None)
        if channel_id not in self._readers:
            self._readers[channel_id] = self._reader_of(channel_id)
        reader = self._readers[channel_id]
        if reader is None:
            return
        try:
            entry = reader.entry(body[_MESSAGE_HEAD.size :], log_time)
        except ValueError as error:
            topic = self._channels[channel_id].topic
            self._add_loss(TranslatableText("{topic}: {why}", topic=topic, why=reason_in(error)))
            return
        self.count(0, (log_time, log_time))
        yield entry

    def _add_loss(self, text: str) -> None:
        """Note a loss; beyond a number of different ones they are only counted."""
        noted = text in self._losses or len(self._losses) < _MOST_LOSSES
        self._losses[text if noted else _OTHER_LOSSES] += 1

    def _define(self, opcode: int, body: bytes) -> None:
        try:
            if opcode == Opcode.SCHEMA:
                self._update(self._schemas, parse(Schema, body))
            elif opcode == Opcode.CHANNEL:
                self._update(self._channels, parse(Channel, body))
            elif opcode == Opcode.HEADER:
                self._ours = parse(Header, body).library.startswith(PROGRAM)
        except RecordError as error:
            self._add_loss(error.message)

    def _update(self, known: dict[int, _Definition], definition: _Definition) -> None:
        if known.get(definition.id) != definition:
            known[definition.id] = definition
            self.version += 1
            self._readers.clear()

    def _reader_of(self, channel_id: int) -> MessageReader | None:
        """The reader of a channel's messages; None if they are of another topic or unreadable."""
        channel = self._channels.get(channel_id)
        if channel is None:
            self._add_loss(
                TranslatableText(
                    "messages of channel {channel}, which nothing describes", channel=channel_id
                )
            )
            return None
        if channel.topic not in TOPIC_BY_NAME:
            return None
        try:
            return self._message_reader(channel)
        except FileError as error:
            refused = FileError("{path}: {why}", path=self._path, why=error.message)
            self._refused = self._refused or refused
            self._add_loss(error.message)
            return None

    def _message_reader(self, channel: Channel) -> MessageReader:
        schema = self._schemas.get(channel.schema_id)
        if channel.message_encoding != MessageEncoding.Protobuf or schema is None:
            encoding = channel.message_encoding if schema else "without schema"
            raise FileError(
                "{topic} is {encoding}; fte-sniff reads protobuf with schema",
                topic=channel.topic,
                encoding=repr(encoding),
            )
        port = self._port_of(channel).name
        return MessageReader(channel.topic, port, schema.name, schema.data)


def without_our_topics(path: Path, topics: Iterable[str]) -> FileError:
    """The error for an MCAP file without fte-sniff's topics; it lists the file's topics."""
    names = sorted(set(topics))
    has = TranslatableText("no topics at all")
    if names:
        has = TranslatableText("{listed}", listed=", ".join(map(repr, names[:_MOST_TOPICS])))
    if len(names) > _MOST_TOPICS:
        has = TranslatableText(
            "{listed} and {count} more", listed=has, count=len(names) - _MOST_TOPICS
        )
    return FileError(
        "{path} is an MCAP, but holds nothing of fte-sniff's (topics /fte/...): "
        "it has {topics}; if one of them holds serial bytes, name it with --topic",
        path=path,
        topics=has,
    )
