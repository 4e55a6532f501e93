"""Owns what records of any MCAP file look like, and how large one may be to be believed.

It must not know where records come from, nor what they mean to fte-sniff.

    magic | opcode, length, body | opcode, length, body | ... | footer | magic
      8        1      8
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from io import BytesIO
from typing import Protocol, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.writer import MCAP0_MAGIC

from fte_sniff.errors import Said

MAGIC = MCAP0_MAGIC
"""The eight bytes that begin and end every MCAP file."""

LARGEST = 256 * 1024 * 1024
"""Bytes of the largest record that is read, and of the largest chunk that is unpacked."""

HEAD = struct.Struct("<BQ")
"""What stands before the body of each record: opcode and length."""


class RecordError(ValueError):
    """A record that cannot be what it claims to be; the text says why, in few words."""

    @property
    def said(self) -> Said:
        """The text."""
        text = self.args[0]
        return text if isinstance(text, Said) else Said("{text}", text=text)


_Record = TypeVar("_Record", covariant=True)


class _Readable(Protocol[_Record]):
    @staticmethod
    def read(stream: ReadDataStream) -> _Record: ...


def parse(record: _Readable[_Record], body: bytes) -> _Record:
    """The mcap package's `record` in `body`.

    Raises:
        RecordError: the body is no such record.
    """
    try:
        return record.read(ReadDataStream(BytesIO(body)))
    except (McapError, struct.error, ValueError) as error:
        raise RecordError(Said("a record that contradicts itself")) from error


def records_in(records: bytes) -> Iterator[tuple[int, bytes]]:
    """Opcode and body of each record in an unpacked chunk, or in a summary.

    Raises:
        RecordError: the last of them goes beyond the end.
    """
    place, end = 0, len(records)
    while place < end:
        if end - place < HEAD.size:
            raise RecordError(Said("records that go beyond their chunk"))
        opcode, length = HEAD.unpack_from(records, place)
        place += HEAD.size
        if length > end - place:
            raise RecordError(Said("records that go beyond their chunk"))
        yield opcode, records[place : place + length]
        place += length
