"""Where the messages of a chunk begin, with its message indexes or by walking over its records.

    opcode u8 | length u64 | channel u16 | sequence u32 | log time u64 | publish time u64 | message

An index is a hint: it is used only if the records between the messages that it names are whole, and
none of them is a message.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from mcap.opcode import Opcode

from fte_sniff.recording.mcap.records import BEYOND_CHUNK, HEAD, NO_RECORD, RecordError

Array: TypeAlias = npt.NDArray[Any]

MESSAGE_HEAD = HEAD.size + 2 + 4 + 8 + 8
"""Bytes of a message record before the message."""

PREFIX = 64
"""Bytes copied of each message record: the head, and every field of the common layout. Numpy copies
64 bytes hardly slower than one number."""

LENGTH_OFFSET, CHANNEL_OFFSET, SEQUENCE_OFFSET, LOG_TIME_OFFSET = 1, 9, 11, 15
"""Offsets in a message record."""

_ENTRY = np.dtype("<u8")
_INDEX_HEAD = 2 + 4

Definition = tuple[int, bytes]
"""Opcode and body of a schema or channel record."""

DEFINITIONS = frozenset({int(Opcode.SCHEMA), int(Opcode.CHANNEL)})


@dataclass(frozen=True, slots=True)
class MessageIndex:
    """The messages of an unpacked chunk, or of several concatenated ones."""

    records: bytes
    starts: Array
    """Where each message record begins, rising."""
    lengths: Array
    """Of the messages, without their heads."""
    prefixes: Array
    """The first bytes of each record as opaque values; those of a short record run into the next.
    """
    definitions: list[Definition] = field(default_factory=list)
    without_head: int = 0
    """Number of messages that are too short to be one; they are not in the index."""

    def __len__(self) -> int:
        return len(self.starts)

    def slices(self, most: int, size: int) -> Iterator[MessageIndex]:
        """The messages; if they have more than `most` bytes, in slices of about `size` bytes."""
        cuts = [0, len(self)]
        if len(self.records) > most:
            bounds = np.arange(size, len(self.records), size)
            cuts[1:1] = np.searchsorted(self.starts, bounds).tolist()
        for first, end in pairwise(cuts):
            lengths, prefixes = self.lengths[first:end], self.prefixes[first:end]
            if first < end:
                starts = self.starts[first:end]
                yield MessageIndex(self.records, starts, lengths, prefixes)

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


def indexed_starts(indexes: Sequence[bytes], size: int) -> Array | None:
    """The starts in the message index records of a chunk, rising; None if they are impossible.

    index record:  channel u16 | bytes u32 | (log time u64, start u64) for each message

    `indexes` are the bodies of the records, `size` the bytes of the unpacked chunk.
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


def index_messages(records: bytes, starts: Array | None, most: int) -> MessageIndex:
    """The messages of an unpacked chunk, or of several concatenated ones.

    `starts` are those of a message index, rising; they are ignored if they are wrong. `most` is the
    largest number of records.

    Raises RecordError if the records exceed the chunk, are none, or are too many.
    """
    found = None if starts is None else _confirmed(records, starts, most)
    if found is None:
        walked, definitions, _ = _walked(records, 0, len(records), most)
        found = _messages(records, np.array(walked, np.int64))
        found.definitions.extend(definitions)
    if len(found) and found.lengths.min() < 0:
        whole = found.lengths >= 0
        starts = found.starts[whole]
        short = len(found) - len(starts)
        definitions = found.definitions
        found = replace(_messages(records, starts), definitions=definitions)
        found = replace(found, without_head=short)
    return found


def _messages(records: bytes, starts: Array) -> MessageIndex:
    prefixes = _prefixes(records, starts)
    lengths = field_view(prefixes, LENGTH_OFFSET, "<i8") - (MESSAGE_HEAD - HEAD.size)
    return MessageIndex(records, starts, lengths, prefixes)


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


def _confirmed(records: bytes, starts: Array, most: int) -> MessageIndex | None:
    """The index if the records are contiguous and messages begin at these starts only."""
    if not len(starts) or starts[0] < 0 or starts[-1] > len(records) - MESSAGE_HEAD:
        return None
    found = _messages(records, starts)
    if (found.field(0, "u1") != Opcode.MESSAGE).any():
        return None
    ends = starts + found.lengths
    ends += MESSAGE_HEAD
    gaps = [(0, int(starts[0])), (int(ends[-1]), len(records))]
    between = np.flatnonzero(ends[:-1] != starts[1:])
    gaps[1:1] = zip(ends[between].tolist(), starts[between + 1].tolist(), strict=True)
    for start, end in gaps:
        try:
            messages, definitions, count = _walked(records, start, end, most)
        except RecordError:
            return None
        if messages:
            return None
        most -= count
        found.definitions.extend(definitions)
    return found


def _walked(
    records: bytes, start: int, end: int, most: int
) -> tuple[list[int], list[Definition], int]:
    """Message starts, definitions and the number of all records from `start` to `end`."""
    starts: list[int] = []
    definitions: list[Definition] = []
    at, count, message = start, 0, int(Opcode.MESSAGE)
    unpack = HEAD.unpack_from
    for _ in range(most + 1):
        if not 0 <= at <= end - HEAD.size:
            break
        opcode, length = unpack(records, at)
        after = at + HEAD.size + length
        if opcode == 0:
            raise RecordError(NO_RECORD)
        if after > end:
            break
        if opcode == message:
            starts.append(at)
        elif opcode in DEFINITIONS:
            definitions.append((opcode, records[at + HEAD.size : after]))
        at, count = after, count + 1
    else:
        raise RecordError("a chunk of more records than its size can hold")
    if at != end:
        raise RecordError(BEYOND_CHUNK)
    return starts, definitions, count
