"""Owns which schemas and channels of a damaged file are believed, of all that were found in it.

It must not know how they were found, nor what is made of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

from mcap.records import Channel, Schema

from fte_sniff.errors import FileError
from fte_sniff.recording.container.salvage import Descriptions
from fte_sniff.recording.encoding.message_reader import MessageReader
from fte_sniff.recording.encoding.schema import schema_name
from fte_sniff.recording.encoding.topics import TOPIC_BY_NAME

_Definition = TypeVar("_Definition", Schema, Channel)


def believed(
    inside: Descriptions, outside: Descriptions
) -> tuple[dict[int, Channel], dict[int, Schema]]:
    """The channel and the schema of each number, and none that cannot be used.

    What a chunk defines is guarded by its checksum; of the rest what was found most often is
    believed first.

    Args:
        inside: what whole chunks define.
        outside: what stands outside of chunks.
    """
    channels: dict[int, Channel] = {}
    schemas: dict[int, Schema] = {}
    likely_schemas = _preferred(inside.schemas, outside.schemas)
    for channel in _preferred(inside.channels, outside.channels):
        if channel.id in channels:
            continue
        for schema in likely_schemas:
            settled = schemas.get(schema.id, schema)
            if schema.id == channel.schema_id and settled == schema and _usable(channel, schema):
                channels[channel.id] = channel
                schemas[schema.id] = schema
                break
    return channels, schemas


def _preferred(guarded: Sequence[_Definition], others: Sequence[_Definition]) -> list[_Definition]:
    """The definitions, those to be believed most first."""
    numbers = {one.id for one in guarded}
    unguarded: list[_Definition] = [one for one in others if one.id not in numbers]
    unguarded.sort(key=list(unguarded).count, reverse=True)
    return list(guarded) + unguarded


def _usable(channel: Channel, schema: Schema) -> bool:
    """Whether messages of ours can be read by this channel and schema."""
    if channel.topic not in TOPIC_BY_NAME:
        return False
    try:
        MessageReader(channel.topic, "", schema.name, schema.data)
    except FileError:
        return False
    return schema.name == schema_name(TOPIC_BY_NAME[channel.topic])
