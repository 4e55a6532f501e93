"""Read rows in order, in one process.

A later definition takes the place of an earlier one of the same number. So what a chunk defines,
under its checksum, is believed more than the head of the file, which nothing guards: a flipped bit
there would put rows on another port.
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


class SequentialReading:
    """One pass; what it found is valid when `entries` has come to its end."""

    def __init__(
        self,
        path: Path,
        port_of: Callable[[Channel], PortFacts],
        known: Definitions | None = None,
    ) -> None:
        """Begin a pass.

        Args:
            path: the file, for messages.
            port_of: the port that a channel's rows belong to.
            known: what is known of the channels where it does not begin with the file.
        """
        self._path, self._port_of = path, port_of
        self._schemas: dict[int, Schema] = dict(known.schemas) if known else {}
        self._channels: dict[int, Channel] = dict(known.channels) if known else {}
        self._definitions: tuple[int, Definitions] | None = None
        self._readers: dict[int, MessageReader | None] = {}
        self._refused: FileError | None = None
        self._ours = False
        self._lost: Counter[str] = Counter()
        self.version = 0
        """Rises whenever a definition changes what is known of the channels."""
        self.messages = 0
        """Messages seen, of any topic."""
        self.times: tuple[int, int] | None = None
        """First and last log time of our messages."""

    @property
    def losses(self) -> tuple[str, ...]:
        """What could not be read, one line each."""
        return tuple(
            text
            if count == 1
            else TranslatableText("{loss} ({count} times)", loss=text, count=count)
            for text, count in self._lost.items()
        )

    @property
    def lost(self) -> int:
        """How often something could not be read."""
        return self._lost.total()

    @property
    def definitions(self) -> Definitions:
        """What is known of the channels so far."""
        if self._definitions is None or self._definitions[0] != self.version:
            known = Definitions(dict(self._schemas), dict(self._channels))
            self._definitions = self.version, known
        return self._definitions[1]

    def entries(self, records: RecordStream) -> Iterator[Row | PortEvent]:
        """The rows and events of the records, in their order.

        Raises:
            FileError: the file has none of our topics, or none that can be read.
        """
        for record in records:
            if record.opcode == Opcode.CHUNK:
                yield from self.chunk_entries(record)
            else:
                yield from self.entries_of(record.opcode, record.body)
        self.check_topics(cut=records.cut)

    def chunk_entries(self, record: RawRecord) -> Iterator[Row | PortEvent]:
        """The rows and events of one chunk, in their order; what it defines is taken on the way."""
        try:
            for opcode, body in records_in(unpack(record.body)):
                yield from self.entries_of(opcode, body)
        except RecordError as error:
            told = TranslatableText(
                "{error} at byte {position} ({size} bytes)",
                error=error.message,
                position=record.position,
                size=len(record.body),
            )
            self.lose(told)

    def entries_of(self, opcode: int, body: bytes) -> Iterator[Row | PortEvent]:
        """What one record outside the chunks, or inside one, brings; definitions are taken."""
        if opcode == Opcode.MESSAGE:
            yield from self._message_entries(body)
        else:
            self._define(opcode, body)

    def count(self, messages: int, times: tuple[int, int] | None) -> None:
        """Take note of messages that were read elsewhere, and of their log times."""
        self.messages += messages
        if times is not None:
            first, last = self.times or times
            self.times = (min(first, times[0]), max(last, times[1]))

    def readers(self) -> dict[int, MessageReader | None]:
        """What reads each channel described so far; None for those of no interest.

        Channels that cannot be read are left out: that is a loss only if they have messages.
        """
        for channel_id, channel in self._channels.items():
            if channel_id not in self._readers:
                with suppress(FileError):
                    ours = channel.topic in TOPIC_BY_NAME
                    self._readers[channel_id] = self._our_reader(channel) if ours else None
        return dict(self._readers)

    def knows(self, opcode: int, body: bytes) -> bool:
        """Whether a record defines nothing but what is known already."""
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

    def _message_entries(self, body: bytes) -> Iterator[Row | PortEvent]:
        """The row or event of one message, if it is one of ours."""
        if len(body) < _MESSAGE_HEAD.size:
            self.lose(TranslatableText("a message without its head"))
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
            self.lose(TranslatableText("{topic}: {why}", topic=topic, why=reason_in(error)))
            return
        self.count(0, (log_time, log_time))
        yield entry

    def lose(self, text: str) -> None:
        """Note a loss; a file can hold any number of different ones, so most are only counted."""
        told = text in self._lost or len(self._lost) < _MOST_LOSSES
        self._lost[text if told else _OTHER_LOSSES] += 1

    def _define(self, opcode: int, body: bytes) -> None:
        """Take a schema or channel, and who wrote the file; other records say nothing of rows."""
        try:
            if opcode == Opcode.SCHEMA:
                self._take(parse(Schema, body), self._schemas)
            elif opcode == Opcode.CHANNEL:
                self._take(parse(Channel, body), self._channels)
            elif opcode == Opcode.HEADER:
                self._ours = parse(Header, body).library.startswith(PROGRAM)
        except RecordError as error:
            self.lose(error.message)

    def _take(self, record: _Definition, known: dict[int, _Definition]) -> None:
        if known.get(record.id) == record:
            return
        known[record.id] = record
        self.version += 1
        self._readers.clear()

    def _reader_of(self, channel_id: int) -> MessageReader | None:
        """What reads a channel's messages; None where nothing can or needs to."""
        channel = self._channels.get(channel_id)
        if channel is None:
            self.lose(
                TranslatableText(
                    "messages of channel {channel}, which nothing describes", channel=channel_id
                )
            )
            return None
        if channel.topic not in TOPIC_BY_NAME:
            return None
        try:
            return self._our_reader(channel)
        except FileError as error:
            refused = FileError("{path}: {why}", path=self._path, why=error.message)
            self._refused = self._refused or refused
            self.lose(error.message)
            return None

    def _our_reader(self, channel: Channel) -> MessageReader:
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

    def check_topics(self, *, cut: bool) -> None:
        """Refuse a file of which nothing could be read, at the end of the pass.

        Raises:
            FileError: the file has none of our topics, or none that can be read.
        """
        if self.times is not None:
            return
        if self._refused is not None:
            raise self._refused
        topics = [channel.topic for channel in self._channels.values()]
        ours = self._ours or any(topic in TOPIC_BY_NAME for topic in topics)
        if not ours and (topics or not cut):
            raise without_our_topics(self._path, topics)


def without_our_topics(path: Path, topics: Iterable[str]) -> FileError:
    """What to tell the user about an MCAP that is not ours; names the topics that it has."""
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
