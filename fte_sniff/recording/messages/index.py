"""Message starts in an unpacked chunk.

Message record:

    opcode u8 | length u64 | channel u16 | sequence u32 | log time u64 | publish time u64 | message
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from mcap.opcode import Opcode

from fte_sniff.recording.mcap.records import HEAD, RecordError
from fte_sniff.row_batch import Array

MESSAGE_HEAD = HEAD.size + 2 + 4 + 8 + 8
"""Bytes of a message record before the message."""

PREFIX = 64
"""Bytes copied of each message record: the head, and every field of the common layout. Numpy copies
64 bytes hardly slower than one number."""

LENGTH_OFFSET, CHANNEL_OFFSET, LOG_TIME_OFFSET = 1, 9, 15
"""Offsets in a message record."""

_ENTRY = np.dtype("<u8")
_INDEX_HEAD = 2 + 4

_Others = list[tuple[int, bytes]]


@dataclass(frozen=True, slots=True)
class MessageIndex:
    """The messages of an unpacked chunk, or of several concatenated ones."""

    records: bytes
    """The unpacked chunks."""
    starts: Array
    """Where each message record begins, rising."""
    lengths: Array
    """Of the messages, without their heads."""
    prefixes: Array
    """The first bytes of each record as opaque values; those of a short record run into the next.
    """
    others: _Others
    """Opcode and body of each other record."""

    def __len__(self) -> int:
        return len(self.starts)

    def field(self, offset: int, kind: str | np.dtype[Any]) -> Array:
        """The numbers at an offset of the records."""
        return field_view(self.prefixes, offset, kind)


def at_every_byte(records: bytes, size: int, first: int = 0) -> Array:
    """Overlapping opaque values of `size` bytes, one for every byte from `first` on."""
    count = max(0, len(records) - first - size + 1)
    found: Array = np.ndarray((count,), f"V{size}", records, first, (1,))
    return found


def field_view(packed: Array, offset: int, kind: str | np.dtype[Any]) -> Array:
    """A view of the numbers at an offset of opaque values."""
    if not len(packed):
        return np.empty(0, kind)
    found: Array = np.ndarray((len(packed),), kind, packed, offset, (packed.dtype.itemsize,))
    return found


def message_count(indexes: Sequence[bytes]) -> int:
    """The number of messages in the message index records of a chunk."""
    return sum(len(body) for body in indexes) // (2 * _ENTRY.itemsize)


def indexed_starts(indexes: Sequence[bytes], size: int) -> Array | None:
    """The starts in the message index records of a chunk, rising; None if they are impossible.

    index record:  channel u16 | bytes u32 | (log time u64, start u64) for each message

    Args:
        indexes: the bodies of the records.
        size: bytes of the unpacked chunk.
    """
    entry = 2 * _ENTRY.itemsize
    if any(len(body) < _INDEX_HEAD or (len(body) - _INDEX_HEAD) % entry for body in indexes):
        return None
    named = [np.frombuffer(body, _ENTRY, offset=_INDEX_HEAD)[1::2] for body in indexes]
    # Chunks are smaller than 4 GiB, and numpy sorts short numbers much faster.
    starts = np.concatenate(named, dtype=np.uint32, casting="unsafe") if named else np.empty(0)
    if not len(starts) or starts.max() >= size:
        return None
    starts.sort()
    return starts.astype(np.int64)


def index_messages(records: bytes, starts: Array | None) -> MessageIndex:
    """The messages of an unpacked chunk, or of several concatenated ones.

    Args:
        records: the chunks.
        starts: where a message index says that messages begin, rising; ignored if that is wrong.

    Raises RecordError if the records exceed the chunk, or a message is too short.
    """
    found = None if starts is None else _confirmed(records, starts)
    if found is None:
        found = _walked(records)
    if len(found) and found.lengths.min() < 0:
        raise RecordError("a message without its head")
    return found


def _messages(records: bytes, starts: Array, others: _Others) -> MessageIndex:
    prefixes = _prefixes(records, starts)
    lengths = field_view(prefixes, LENGTH_OFFSET, "<i8") - (MESSAGE_HEAD - HEAD.size)
    return MessageIndex(records, starts, lengths, prefixes, others)


def _prefixes(records: bytes, starts: Array) -> Array:
    """The bytes from each start on, padded with zeros at the end of the records."""
    last = len(records) - PREFIX
    if last < 0:
        return _prefixes(records.ljust(PREFIX, b"\0"), starts)
    whole = int(np.searchsorted(starts, last, "right"))
    if whole == len(starts):
        return at_every_byte(records, PREFIX)[starts]
    found = at_every_byte(records, PREFIX)[np.minimum(starts, last)]
    for row in range(whole, len(starts)):
        found[row] = np.void(records[int(starts[row]) :].ljust(PREFIX, b"\0"))
    return found


def _confirmed(records: bytes, starts: Array) -> MessageIndex | None:
    """The index if the records are contiguous and messages begin at these starts only."""
    if not len(starts) or starts[0] < 0 or starts[-1] > len(records) - MESSAGE_HEAD:
        return None
    found = _messages(records, starts, [])
    if (found.field(0, "u1") != Opcode.MESSAGE).any():
        return None
    ends = starts + found.lengths
    ends += MESSAGE_HEAD
    gaps = [(0, int(starts[0])), (int(ends[-1]), len(records))]
    between = np.flatnonzero(ends[:-1] != starts[1:])
    gaps[1:1] = zip(ends[between].tolist(), starts[between + 1].tolist(), strict=True)
    for start, end in gaps:
        others = _others_between(records, start, end)
        if others is None:
            return None
        found.others.extend(others)
    return found


def _others_between(records: bytes, start: int, end: int) -> _Others | None:
    """The records from `start` to `end`; None if they do not fill it or one is a message."""
    found: _Others = []
    while 0 <= start <= end - HEAD.size:
        opcode, length = HEAD.unpack_from(records, start)
        body = start + HEAD.size
        if opcode == Opcode.MESSAGE or length > end - body:
            return None
        found.append((opcode, records[body : body + length]))
        start = body + length
    return found if start == end else None


def _walked(records: bytes) -> MessageIndex:
    starts: list[int] = []
    others: _Others = []
    at, end, message = 0, len(records), int(Opcode.MESSAGE)
    unpack = HEAD.unpack_from
    while at <= end - HEAD.size:
        opcode, length = unpack(records, at)
        after = at + HEAD.size + length
        if after > end:
            break
        if opcode == message:
            starts.append(at)
        else:
            others.append((opcode, records[at + HEAD.size : after]))
        at = after
    if at != end:
        raise RecordError("records that go beyond their chunk")
    return _messages(records, np.array(starts, np.int64), others)
