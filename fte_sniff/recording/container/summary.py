"""Owns what a file's summary tells before its rows are read.

It must not know rows, and must not trust: a summary that does not match its checksum, or that
contradicts the file, is as good as none.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, Schema, Statistics

from fte_sniff.recording.container.checksum import crc32
from fte_sniff.recording.container.records import (
    HEAD,
    LARGEST,
    MAGIC,
    RecordError,
    parse,
    records_in,
)

_FOOTER_LENGTH = 8 + 8 + 4
_END_LENGTH = HEAD.size + _FOOTER_LENGTH + len(MAGIC)
_DATA_END_LENGTH = HEAD.size + 4


@dataclass(slots=True)
class Summary:
    """The part of a summary that reading makes use of."""

    schemas: list[Schema] = field(default_factory=list)
    channels: list[Channel] = field(default_factory=list)
    statistics: Statistics | None = None
    starts: list[int] = field(default_factory=list)
    """Where chunks and the data's end begin, rising."""
    guarded: bool = False
    """Whether a checksum is over it."""


def read_summary(stream: BinaryIO) -> Summary | None:
    """The summary of a seekable file, or None where it has none that can be trusted."""
    size = stream.seek(0, os.SEEK_END)
    if size < len(MAGIC) + _END_LENGTH:
        return None
    stream.seek(size - _END_LENGTH)
    end = stream.read(_END_LENGTH)
    body = end[HEAD.size : -len(MAGIC)]
    if not end.endswith(MAGIC) or HEAD.unpack_from(end) != (Opcode.FOOTER, len(body)):
        return None
    footer = parse(Footer, body)
    length = size - _END_LENGTH - footer.summary_start
    if not footer.summary_start or not 0 < length <= LARGEST:
        return None
    stream.seek(footer.summary_start)
    records = stream.read(length)
    if footer.summary_crc not in (0, crc32(end[: HEAD.size + 16], crc32(records))):
        return None
    try:
        summary = _summary_of(records, footer.summary_start)
    except RecordError:
        return None
    summary.guarded = bool(footer.summary_crc)
    return summary


def _summary_of(records: bytes, start: int) -> Summary:
    summary = Summary()
    for opcode, body in records_in(records):
        if opcode == Opcode.SCHEMA:
            summary.schemas.append(parse(Schema, body))
        elif opcode == Opcode.CHANNEL:
            summary.channels.append(parse(Channel, body))
        elif opcode == Opcode.STATISTICS:
            summary.statistics = parse(Statistics, body)
        elif opcode == Opcode.CHUNK_INDEX:
            summary.starts.append(parse(ChunkIndex, body).chunk_start_offset)
    summary.starts.append(start - _DATA_END_LENGTH)
    summary.starts.sort()
    return summary
