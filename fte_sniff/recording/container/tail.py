"""Owns what stands behind the data of an MCAP file: data end, summary, footer, magic.

It must not know how a file grows. A tail can be put at any place: its offsets follow.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import DataEnd, Footer, McapRecord, SummaryOffset
from mcap.writer import MCAP0_MAGIC

from fte_sniff.recording.container.checksum import crc32

_FOOTER = struct.Struct("<BQQQ")
_FOOTER_LENGTH = 8 + 8 + 4

END_LENGTH = 9 + _FOOTER_LENGTH + len(MCAP0_MAGIC)
"""Bytes of a footer and the magic behind it."""

DATA_END_LENGTH = 9 + 4
"""Bytes of the record that ends the data."""

_OFFSET_LENGTH = 9 + 1 + 8 + 8


@dataclass(frozen=True, slots=True)
class Tail:
    """One tail, wherever it is going to stand."""

    data_crc: int
    """The checksum over all bytes before it."""
    groups: tuple[tuple[Opcode, bytes], ...]
    """The summary's records by opcode; no group is empty."""
    indexed: bool = True
    """Whether the summary is written out; a tail without makes tools scan the file."""

    @property
    def index_length(self) -> int:
        """Bytes of `index_at`."""
        records = sum(len(records) for _, records in self.groups)
        return records + _OFFSET_LENGTH * len(self.groups) + END_LENGTH

    def at(self, start: int) -> bytes:
        """The tail for data that ends at `start`."""
        data_end = bytes_of(DataEnd(self.data_crc))
        if not self.indexed:
            return data_end + bare_end()
        return data_end + self.index_at(start + len(data_end))

    def index_at(self, start: int) -> bytes:
        """The summary, footer and magic for a summary that begins at `start`."""
        parts, offsets, place = [], [], start
        for opcode, records in self.groups:
            offsets.append(SummaryOffset(opcode, place, len(records)))
            parts.append(records)
            place += len(records)
        parts.append(bytes_of(*offsets))
        summary = b"".join(parts)
        guarded = _FOOTER.pack(Opcode.FOOTER, _FOOTER_LENGTH, start, place)
        crc = crc32(guarded, crc32(summary))
        return summary + _end(start, place, crc)

    def end_for(self, start: int) -> bytes:
        """Footer and magic that point back at the summary of this tail, which stands at `start`.

        They hold no checksum: what stands between is not to be read.
        """
        return _end(start + DATA_END_LENGTH, 0, 0) if self.indexed else bare_end()


def bare_end() -> bytes:
    """Footer and magic of a file without summary."""
    return _end(0, 0, crc32(_FOOTER.pack(Opcode.FOOTER, _FOOTER_LENGTH, 0, 0)))


def _end(summary: int, offsets: int, crc: int) -> bytes:
    return bytes_of(Footer(summary, offsets, crc)) + MCAP0_MAGIC


def bytes_of(*records: McapRecord) -> bytes:
    """The records as they stand in a file."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def groups_of(*groups: tuple[Opcode, bytes]) -> tuple[tuple[Opcode, bytes], ...]:
    """The groups that are not empty."""
    return tuple((opcode, records) for opcode, records in groups if records)
