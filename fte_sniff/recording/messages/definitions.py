"""The channels of a recording, also of one whose own definitions are damaged.

The first chunk and the summary hold the definitions. If both are damaged, this program knows all
but the ports: `Channels` numbers the topics of the first port from 1, those of the second port
after them, and so on. Where a file says which ports it has:

    metadata fte-sniff.ports   copies with a checksum, between the chunks
    channel records            in what is left of the summary: a dozen for each port, all alike
    metadata fte-sniff         the ports at the beginning, without a checksum
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema
from mcap.well_known import MessageEncoding

from fte_sniff.errors import FileError, TranslatableText
from fte_sniff.platform import read_at
from fte_sniff.recording.mcap.records import HEAD, RecordError, parse
from fte_sniff.recording.mcap.writer import MOST_BETWEEN_COPIES
from fte_sniff.recording.messages.decode import ChannelReader, MessageReader
from fte_sniff.recording.messages.encode import Channels, port_metadata
from fte_sniff.recording.messages.schema import PACKAGE, TOPIC_BY_NAME, TOPICS, table_crc
from fte_sniff.recording.metadata import (
    PORTS_NAME,
    PortFacts,
    baud_in,
    ports_from_metadata,
    ports_in,
)

_MOST_DEFINITIONS = 2048
"""Changes of the definitions in one file."""
_SEARCHED = 2 * MOST_BETWEEN_COPIES
"""Bytes that are searched at the beginning and at the end of a file."""
_LONGEST = 1024 * 1024
"""Bytes of the longest record that is searched for."""
_RECORD = re.compile(
    # Opcode, a length below 16 MB, and the start of the record.
    rb"\x0c...\0{5}\x0f\0{3}fte-sniff\.ports|\x04...\0{5}....[\x05-\x40]\0{3}/fte/",
    re.DOTALL,
)
_MOST_RECORDS = 4096
"""Such records that are read of each end, so that a hostile file does not take long."""
_LEAST_ALIKE = 3
"""Channel records of a port that must agree: one damaged sector does not make three alike."""
_MOST_PORTS = 2**16 // len(TOPICS)
_CHANNELS = Channels().of_port(PortFacts(""))
"""Those of one port, whose numbers begin at 1."""


Definitions = Mapping[tuple[type[Schema | Channel], int], tuple[Schema | Channel, bool]]
"""Definitions by class and id, each with whether a checksum protects it."""

NOTHING: Definitions = {}


class ChannelReaders:
    """The definitions of a recording, and the reader of each channel.

    A definition that a checksum protects takes precedence over one of the same id without. Threads
    may read while one thread defines; what they read is then of no single version.
    """

    def __init__(
        self,
        port_of: Callable[[Channel], str],
        known: Definitions = NOTHING,
        lost: Callable[[int], tuple[Channel, Schema] | None] = lambda _channel_id: None,
    ) -> None:
        """Take the port's name for a channel, the definitions so far, and those of a channel that
        the file does not define, by its id.
        """
        self._port_of, self._lost = port_of, lost
        self._known = dict(known)
        self._readers: dict[int, ChannelReader] = {}
        self._updates = 0
        self.version = 0
        """Rises with every change of the definitions."""

    def update(self, opcode: int, body: bytes, *, trusted: bool) -> None:
        """Apply a schema or channel record.

        Raises RecordError if it is damaged, or there are too many.
        """
        definition = parse(Schema if opcode == Opcode.SCHEMA else Channel, body)
        known, _ = self._known.get((type(definition), definition.id), (None, False))
        if known != definition and _costs(definition, known):
            if self._updates >= _MOST_DEFINITIONS:
                raise RecordError("more definitions than a recording has")
            self._updates += 1
        self.define(definition, trusted=trusted)

    def define(self, definition: Schema | Channel, *, trusted: bool) -> None:
        """Apply a definition; `trusted` if a checksum protects it."""
        key = type(definition), definition.id
        known, was_trusted = self._known.get(key, (None, False))
        if known == definition:
            self._known[key] = definition, trusted or was_trusted
        elif trusted or not was_trusted:
            self._known[key] = definition, trusted
            self._readers = {}
            self.version += 1

    @property
    def definitions(self) -> Definitions:
        """A copy of the definitions so far."""
        return dict(self._known)

    @property
    def channels(self) -> list[Channel]:
        """The channels that are defined so far."""
        return [one for one, _ in self._known.values() if isinstance(one, Channel)]

    def get(self, channel_id: int) -> ChannelReader:
        """The reader of a channel."""
        readers = self._readers
        if channel_id not in readers:
            readers[channel_id] = self._reader_of(channel_id)
        return readers[channel_id]

    def _reader_of(self, channel_id: int) -> ChannelReader:
        channel, _ = self._known.get((Channel, channel_id), (None, False))
        schema: object = None
        if isinstance(channel, Channel):
            schema, _ = self._known.get((Schema, channel.schema_id), (None, False))
        if schema is None and (lost := self._lost(channel_id)):
            channel, schema = lost if channel is None else (channel, lost[1])
        if not isinstance(channel, Channel):
            return TranslatableText(
                "messages of channel {channel}, which has no description in the file",
                channel=channel_id,
            )
        if channel.topic not in TOPIC_BY_NAME:
            return None
        if channel.message_encoding != MessageEncoding.Protobuf or not isinstance(schema, Schema):
            encoding = channel.message_encoding if schema else "without schema"
            return TranslatableText(
                "{topic} is {encoding}; fte-sniff reads protobuf with schema",
                topic=channel.topic,
                encoding=repr(encoding),
            )
        try:
            return MessageReader(channel.topic, self._port_of(channel), schema.name, schema.data)
        except FileError as error:
            return error.message


def _costs(definition: Schema | Channel, known: object) -> bool:
    """True if rows may be read with the definition."""
    if isinstance(definition, Schema):
        return known is not None or definition.name.startswith(f"{PACKAGE}.")
    return definition.topic in TOPIC_BY_NAME


class Definition(NamedTuple):
    """A channel and its schema."""

    channel: Channel
    schema: Schema


class LostDefinitions:
    """The channels of a file as this program numbers them."""

    def __init__(self, known: Mapping[int, PortFacts], named: Mapping[int, PortFacts]) -> None:
        """Take the ports by number, from 0: those that are certain, and others.

        A port of neither is named by its number.
        """
        self._known, self._named = known, named
        self._schemas = {schema.id: schema for schema in Channels().schemas()}
        self._asked: set[int] = set()

    @property
    def ports(self) -> list[PortFacts]:
        """The ports that the file names."""
        ports = {**self._named, **self._known}
        return [ports[number] for number in sorted(ports)]

    def get(self, channel_id: int) -> Definition | None:
        """The definition of a channel; None if this program does not write such a number."""
        number = (channel_id - 1) // len(TOPICS)
        if not 0 <= number < _MOST_PORTS:
            return None
        self._asked.add(channel_id)
        unnamed = PortFacts(f"port {number + 1}")
        port = self._known.get(number) or self._named.get(number) or unnamed
        channel = _channel_of(port, channel_id)
        return Definition(channel, self._schemas[channel.schema_id])

    def doubts(self, defined: Mapping[int, object]) -> list[TranslatableText]:
        """What is not certain about the channels that were used and that no chunk defined."""
        numbers = {(id_ - 1) // len(TOPICS) for id_ in self._asked if id_ not in defined}
        doubtful = sorted(numbers - self._known.keys())
        lost = [number for number in doubtful if number not in self._named]
        found = []
        if len(lost) < len(doubtful):
            found.append(
                TranslatableText(
                    "the names of the ports are from a record that no checksum protects"
                )
            )
        if lost:
            found.append(
                TranslatableText(
                    "the names of {count} ports are lost; their rows have the names 'port N'",
                    count=len(lost),
                )
            )
        return found


def _channel_of(port: PortFacts, channel_id: int) -> Channel:
    like = _CHANNELS[(channel_id - 1) % len(TOPICS)]
    return replace(like, id=channel_id, metadata=port_metadata(port))


def lost_definitions(
    stream: BinaryIO, facts: Mapping[str, str], *, is_ours: bool
) -> LostDefinitions | None:
    """What can be found of the ports of a file whose summary is not certain.

    `facts` are those of its own metadata record, `is_ours` whether its header names this program.
    None if nothing shows that this program wrote it.
    """
    copies: list[PortFacts] = []
    channels: dict[int, Channel] = {}
    for record in _records_in(stream):
        if isinstance(record, Channel):
            channels[record.id] = record
        elif record.name == PORTS_NAME:
            copies = max(copies, ports_from_metadata(record.metadata, table_crc()), key=len)
    known = {**_agreed_ports(channels), **dict(enumerate(copies))}
    if not known and not is_ours:
        return None
    return LostDefinitions(known, dict(enumerate(ports_in(facts))))


def _agreed_ports(channels: Mapping[int, Channel]) -> dict[int, PortFacts]:
    """The ports, by number, of which enough channels agree with each other and with the table."""
    votes: dict[int, Counter[PortFacts]] = {}
    for id_, channel in channels.items():
        number = (id_ - 1) // len(TOPICS)
        facts = channel.metadata
        port = PortFacts(facts.get("port", ""), baud_in(facts.get("baud", "")))
        if number >= 0 and channel == _channel_of(port, id_):
            votes.setdefault(number, Counter())[port] += 1
    best = {number: ports.most_common(1)[0] for number, ports in votes.items()}
    return {number: port for number, (port, count) in best.items() if count >= _LEAST_ALIKE}


def _records_in(stream: BinaryIO) -> Iterator[Channel | Metadata]:
    """The channel records and copies of the ports at the beginning and end of a file."""
    size = os.fstat(stream.fileno()).st_size
    for start in sorted({0, max(0, size - _SEARCHED)}):
        data = read_at(stream.fileno(), min(size, _SEARCHED), start)
        for found in islice(_RECORD.finditer(data), _MOST_RECORDS):
            opcode, length = HEAD.unpack_from(data, found.start())
            first = found.start() + HEAD.size
            body = data[first : first + min(length, _LONGEST)]
            with suppress(RecordError):
                yield parse(Metadata, body) if opcode == Opcode.METADATA else parse(Channel, body)
