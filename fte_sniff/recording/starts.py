"""Owns where the messages of an unpacked chunk begin.

It must not know what is in them, and must not believe an index: its places count only if each
record ends where the next begins, so that they are the chunk's records and no others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mcap.opcode import Opcode

from fte_sniff.recording.columns import Array
from fte_sniff.recording.records import HEAD, RecordError

MESSAGE_HEAD = HEAD.size + 2 + 4 + 8 + 8
"""Bytes of a message record before the message: opcode, length, channel, sequence, two times."""

_ENTRY = np.dtype("<u8")
_INDEX_HEAD = 2 + 4
_LENGTH_PLACE = 1


def indexed_places(indexes: Sequence[bytes]) -> Array | None:
    """The places that the message index records of a chunk name, rising; None without any.

    index record:  channel u16 | bytes u32 | (log time u64, place u64) for each message
    """
    found = []
    for body in indexes:
        if (len(body) - _INDEX_HEAD) % (2 * _ENTRY.itemsize) or len(body) < _INDEX_HEAD:
            return None
        found.append(np.frombuffer(body, _ENTRY, offset=_INDEX_HEAD)[1::2])
    return np.sort(np.concatenate(found)).view(np.int64) if found else None


def message_starts(
    records: bytes, places: Array | None
) -> tuple[Array, Array, list[tuple[int, bytes]]]:
    """Where each message record begins, rising, and the other records between them.

    Args:
        records: an unpacked chunk, or several one behind the other.
        places: where an index says that messages begin; taken only if that is so.

    Returns:
        The places; the lengths of the messages without their heads; opcode and body of each
        other record.

    Raises:
        RecordError: the records go beyond the end, or a message is too short to be one.
    """
    found = None if places is None else _confirmed(records, places)
    starts, lengths, others = _walked(records) if found is None else found
    lengths -= MESSAGE_HEAD - HEAD.size
    if len(lengths) and lengths.min() < 0:
        raise RecordError("a message without its head")
    return starts, lengths, others


def _lengths(records: bytes, starts: Array) -> Array:
    at_every_byte: Array = np.ndarray(
        (max(0, len(records) - HEAD.size + 1),), "<i8", records, _LENGTH_PLACE, (1,)
    )
    return at_every_byte[starts]


def _confirmed(
    records: bytes, places: Array
) -> tuple[Array, Array, list[tuple[int, bytes]]] | None:
    """The same, if the records tile the chunk with messages at these places and nowhere else."""
    if not len(places) or places.min() < 0 or places.max() > len(records) - MESSAGE_HEAD:
        return None
    if (np.frombuffer(records, np.uint8)[places] != Opcode.MESSAGE).any():
        return None
    ends = np.empty(len(places) + 1, np.int64)
    ends[0] = 0
    lengths = _lengths(records, places)
    np.add(places, lengths, out=ends[1:])
    ends[1:] += HEAD.size
    starts = np.append(places, len(records))
    others: list[tuple[int, bytes]] = []
    for gap in np.flatnonzero(ends != starts).tolist():
        walked = _between(records, int(ends[gap]), int(starts[gap]))
        if walked is None:
            return None
        others += walked
    return places, lengths, others


def _between(records: bytes, start: int, end: int) -> list[tuple[int, bytes]] | None:
    """The records from `start` to `end` if they tile it and none is a message."""
    found: list[tuple[int, bytes]] = []
    while 0 <= start <= end - HEAD.size:
        opcode, length = HEAD.unpack_from(records, start)
        body = start + HEAD.size
        if opcode == Opcode.MESSAGE or length > end - body:
            return None
        found.append((opcode, records[body : body + length]))
        start = body + length
    return found if start == end else None


def _walked(records: bytes) -> tuple[Array, Array, list[tuple[int, bytes]]]:
    """From record to record, as it must be done where no index helps."""
    starts: list[int] = []
    others: list[tuple[int, bytes]] = []
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
    found = np.array(starts, np.int64)
    return found, _lengths(records, found), others
