"""Owns the numbers of a recording's schemas and channels: one channel for each topic of each port.

It must not know files or messages.
"""

from __future__ import annotations

from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding

from fte_sniff.recording.encoding.facts import PortFacts
from fte_sniff.recording.encoding.messages import plain
from fte_sniff.recording.encoding.schema import schema_data, schema_name
from fte_sniff.recording.encoding.topics import TOPICS, Topic


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
