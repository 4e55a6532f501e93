"""Message starts in an unpacked chunk.

fronts:   opcode u8 | length u64 | channel u16 | sequence u32 | log time u64 | publish time u64
          | the message, or as much of it as there is room for
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
"""Bytes of a message record before the message: opcode, length, channel, sequence, two times."""

FRONT = 64
"""Bytes of a front, whole words: room for all that makes the row of a sound frame, whatever the
schema. To pick out so many takes hardly longer than to pick out one number."""

LENGTH_PLACE, CHANNEL_PLACE, LOG_TIME_PLACE = 1, 9, 15
"""Where these numbers stand in a front."""

_ENTRY = np.dtype("<u8")
_INDEX_HEAD = 2 + 4

_Others = list[tuple[int, bytes]]


@dataclass(frozen=True, slots=True)
class MessageIndex:
    """The messages of an unpacked chunk, or of several one behind the other."""

    records: bytes
    """What they stand in."""
    starts: Array
    """Where each message record begins, rising."""
    lengths: Array
    """Of the messages, without their heads."""
    fronts: Array
    """What each begins with, as so many opaque bytes; what follows a short message belongs to it
    no more."""
    others: _Others
    """Opcode and body of each other record."""

    def __len__(self) -> int:
        return len(self.starts)

    def number(self, place: int, kind: str) -> Array:
        """The number at that place of every front."""
        return numbers(self.fronts, place, kind)


def at_every_byte(records: bytes, size: int, first: int = 0) -> Array:
    """The `size` bytes that stand `first` behind every byte, as overlapping opaque values."""
    count = max(0, len(records) - first - size + 1)
    found: Array = np.ndarray((count,), f"V{size}", records, first, (1,))
    return found


def numbers(packed: Array, place: int, kind: str | np.dtype[Any]) -> Array:
    """What stands at that place of each of equally many bytes."""
    if not len(packed):
        return np.empty(0, kind)
    found: Array = np.ndarray((len(packed),), kind, packed, place, (packed.dtype.itemsize,))
    return found.copy()


def named_messages(indexes: Sequence[bytes]) -> int:
    """How many messages the message index records of a chunk name."""
    return sum(len(body) for body in indexes) // (2 * _ENTRY.itemsize)


def indexed_places(indexes: Sequence[bytes], size: int) -> Array | None:
    """The places that the message index records of a chunk name, rising; None where they cannot be.

    index record:  channel u16 | bytes u32 | (log time u64, place u64) for each message

    Args:
        indexes: the bodies of the records.
        size: bytes of the unpacked chunk.
    """
    entry = 2 * _ENTRY.itemsize
    if any(len(body) < _INDEX_HEAD or (len(body) - _INDEX_HEAD) % entry for body in indexes):
        return None
    named = [np.frombuffer(body, _ENTRY, offset=_INDEX_HEAD)[1::2] for body in indexes]
    # No chunk is so large that a place needs more; and numpy sorts short numbers much quicker.
    places = np.concatenate(named, dtype=np.uint32, casting="unsafe") if named else np.empty(0)
    if not len(places) or places.max() >= size:
        return None
    places.sort()
    return places.astype(np.int64)


def message_starts(records: bytes, places: Array | None) -> MessageIndex:
    """The messages of an unpacked chunk, or of several one behind the other.

    Args:
        records: the chunks.
        places: where an index says that messages begin, rising; taken only if that is so.

    Raises:
        RecordError: the records go beyond the end, or a message is too short to be one.
    """
    found = None if places is None else _confirmed(records, places)
    if found is None:
        found = _walked(records)
    if len(found) and found.lengths.min() < 0:
        raise RecordError("a message without its head")
    return found


def _messages(records: bytes, starts: Array, others: _Others) -> MessageIndex:
    fronts = _fronts(records, starts)
    lengths = numbers(fronts, LENGTH_PLACE, "<i8")
    lengths -= MESSAGE_HEAD - HEAD.size
    return MessageIndex(records, starts, lengths, fronts, others)


def _fronts(records: bytes, starts: Array) -> Array:
    """What stands from each start on, with zeros behind the end of the records."""
    last = len(records) - FRONT
    if last < 0:
        return _fronts(records.ljust(FRONT, b"\0"), starts)
    whole = int(np.searchsorted(starts, last, "right"))
    if whole == len(starts):
        return at_every_byte(records, FRONT)[starts]
    found = at_every_byte(records, FRONT)[np.minimum(starts, last)]
    for row in range(whole, len(starts)):
        rest = records[int(starts[row]) :].ljust(FRONT, b"\0")
        found[row] = np.void(rest)
    return found


def _confirmed(records: bytes, places: Array) -> MessageIndex | None:
    """The same, if the records tile the chunk with messages at these places and nowhere else."""
    if not len(places) or places[0] < 0 or places[-1] > len(records) - MESSAGE_HEAD:
        return None
    found = _messages(records, places, [])
    if (found.number(0, "u1") != Opcode.MESSAGE).any():
        return None
    ends = places + found.lengths
    ends += MESSAGE_HEAD
    gaps = [(0, int(places[0])), (int(ends[-1]), len(records))]
    between = np.flatnonzero(ends[:-1] != places[1:])
    gaps[1:1] = zip(ends[between].tolist(), places[between + 1].tolist(), strict=True)
    for start, end in gaps:
        walked = _between(records, start, end)
        if walked is None:
            return None
        found.others.extend(walked)
    return found


def _between(records: bytes, start: int, end: int) -> _Others | None:
    """The records from `start` to `end` if they tile it and none is a message."""
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
    """From record to record, as it must be done where no index helps."""
    starts: list[int] = []
    others: _Others = []
    place, end, message = 0, len(records), int(Opcode.MESSAGE)
    unpack = HEAD.unpack_from
    while place <= end - HEAD.size:
        opcode, length = unpack(records, place)
        after = place + HEAD.size + length
        if after > end:
            break
        if opcode == message:
            starts.append(place)
        else:
            others.append((opcode, records[place + HEAD.size : after]))
        place = after
    if place != end:
        raise RecordError("records that go beyond their chunk")
    return _messages(records, np.array(starts, np.int64), others)
