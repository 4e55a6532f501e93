"""The framer: chunks in, rows out, with every byte of a port's stream in exactly one row.

A chunk of n bytes was read at t. Its byte i began at `max(P, t - (n - i) * byte time)`, where P is
the latest time at which earlier bytes were read. So times never fall:

    read before        read at t
    P                  |          n bytes in one read
    |     [byte 0][byte 1] ... [byte n - 1]

Silence is the time between P and the first byte of a chunk; an empty chunk reports silence. 20 ms
of it end a gap, except the start of a frame, which may go on for 500 ms: the reading process may
have been held up.
"""

from __future__ import annotations

from itertools import chain
from typing import Final

import numpy as np

from fte_sniff.protocol.candidates import LEGAL
from fte_sniff.protocol.gap import DecidedSegments
from fte_sniff.protocol.islands import CORE, MARGIN, State, Wall, ranges, segments
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.rows import (
    FAULT_BITS,
    IS_HEADER,
    MOST_BYTES,
    NO_KIND,
    NO_ROWS,
    NO_TIME,
    Array,
    Bools,
    Codes,
    Ints,
    Rows,
    kind_of,
)
from fte_sniff.protocol.spec import (
    CMD_OFFSET,
    DEFAULT_BAUD,
    FRAME_LENGTH,
    KINDS,
    TAIL,
    Fault,
    byte_time_ns,
)

SETTLING_NS: Final = 20_000_000
"""Silence after which all bytes are decided, but the start of a frame."""
GIVING_UP_NS: Final = 500_000_000
"""Silence after which the start of a frame is truncated."""
CERTAIN: Final = 0.999
"""A frame in a gap that is less probable is `ambiguous`."""
KNOWN: Final = 8
"""Frames in a row with 00 in the reserve after which the line is known to have it."""


class _Times:
    """The arrival times of one port's bytes, chunk by chunk."""

    def __init__(self, byte_ns: int) -> None:
        self.byte_ns = byte_ns
        self._arrivals: list[tuple[int, int, int, int]] = []
        """Of each chunk: the offset behind it, its time, the earliest time at which one of its
        bytes can have begun (both `NO_TIME` without one), and the time of a byte; nanoseconds."""
        self._size = self._floor_ns = 0
        self._silent_since: int | None = None

    def append(self, chunk: Chunk) -> int:
        """Append a chunk; returns the silence before it, nanoseconds, 0 if unknown."""
        before, t_ns, size = self._silent_since, chunk.t_ns, len(chunk.data)
        if size:
            self._size += size
            if t_ns is None:
                self._silent_since = None
                self._arrivals.append((self._size, NO_TIME, NO_TIME, 0))
            else:
                byte_ns = 0 if chunk.at_once else self.byte_ns
                self._arrivals.append((self._size, t_ns, self._floor_ns, byte_ns))
                self._floor_ns = self._silent_since = max(self._floor_ns, t_ns)
        if t_ns is None or before is None or (size and chunk.is_late):
            return 0
        return max(0, t_ns - size * self.byte_ns - before)

    def began(self, offsets: Ints) -> tuple[Ints, Ints]:
        """When the bytes at these offsets, rising, began, and how long before they were read."""
        arrivals = np.fromiter(chain.from_iterable(self._arrivals), np.int64).reshape(-1, 4)
        of_byte = np.searchsorted(arrivals[:, 0], offsets, "right")
        stop, t_ns, floor_ns, byte_ns = arrivals[of_byte].T
        began = np.maximum(t_ns - (stop - offsets) * byte_ns, floor_ns)
        return began, np.where(t_ns == NO_TIME, NO_TIME, np.maximum(t_ns - began, 0))

    def first_ns(self, offset: int) -> int | None:
        """When the first byte that was not forgotten, at this offset, began."""
        stop, t_ns, floor_ns, byte_ns = self._arrivals[0]
        return None if t_ns == NO_TIME else max(t_ns - (stop - offset) * byte_ns, floor_ns)

    def forget(self, offset: int) -> None:
        """Drop the times of the bytes before an offset."""
        self._arrivals = [one for one in self._arrivals if one[0] > offset]


def _reserves() -> Array:
    """By kind: a mask of the bytes of the reserve that may be anything, as two words."""
    masks = np.zeros((NO_KIND + 1, MOST_BYTES), np.uint8)
    for code, kind in enumerate(KINDS):
        if kind.reserve is None:
            masks[code, kind.reserved.start : kind.reserved.stop] = 255
    return masks.view("<u8")


_RESERVES: Final = _reserves()
_HAS_RESERVE: Final[Bools] = np.any(_RESERVES, axis=1)


def unusual_reserves(raw: Codes, is_frame: Bools, zeros: int) -> tuple[Ints, int]:
    """Find frames whose reserve is not 00 although it is 00 on the rest of the line.

    `raw` are rows in stream order; `zeros` is the number of frames in a row with 00 before them.
    Returns the indices of such frames, and that number after them.
    """
    kinds = kind_of(raw[:, 0], raw[:, CMD_OFFSET])
    at = np.flatnonzero(is_frame & _HAS_RESERVE.take(kinds))
    is_set = (raw.view("<u8")[at] & _RESERVES.take(kinds[at], axis=0)).any(axis=1)
    if not is_set.any():
        return at[:0], min(zeros + len(at), KNOWN)
    numbers = np.arange(len(at))
    last_set = np.maximum.accumulate(np.where(is_set, numbers, -1 - zeros))
    before = np.append(-1 - zeros, last_set[:-1])
    found = at[is_set & (numbers - 1 - before >= KNOWN)]
    return found, min(int(numbers[-1] - last_set[-1]), KNOWN)


class Framer:
    """Turns the chunks of one port into rows that cover its stream without gap or overlap."""

    def __init__(self, port: str, baud: int = DEFAULT_BAUD) -> None:
        """Frame the bytes of a port, which is named in every row, at `baud` bits per second.

        Raises ValueRangeError if `baud` is less than 1.
        """
        self._ports = (port,)
        self._times = _Times(byte_time_ns(baud))
        self._zeros = 0
        """Frames in a row with 00 in the reserve, up to now."""
        self._chunks: list[bytes] = []
        """The bytes that were pushed since the last drain."""
        self._data = b""
        """The bytes before them that are in no row yet, or have an influence on others."""
        self._base = 0
        """Stream offset of the first byte of `_data`; all other offsets are in the stream, too."""
        self._size = 0
        self._state = State(0, 0)
        self._emitted = 0
        """Where the first byte is that is in no row; from there to the state is noise."""
        self._walls: list[Wall] = []
        self._errors: list[tuple[int, int]] = []
        """Half-open ranges with errors of the UART, rising."""

    def set_baud(self, baud: int) -> None:
        """Set the bits per second of the line from the next chunk on; raises ValueRangeError."""
        self._times.byte_ns = byte_time_ns(baud)

    @property
    def pending_since_ns(self) -> int | None:
        """When the first byte that is in no row began; None without one."""
        return None if self._emitted == self._size else self._times.first_ns(self._emitted)

    def push(self, chunk: Chunk) -> None:
        """Take the bytes of a chunk; `drain` decides them. Never raises on wire data."""
        silence_ns = self._times.append(chunk)
        if silence_ns >= SETTLING_NS:
            self._walls.append(Wall(self._size, is_soft=True))
        if silence_ns >= GIVING_UP_NS:
            self.end()
        if chunk.has_line_errors:
            self._errors.append((self._size, self._size + len(chunk.data) + 1))
        if chunk.data:
            self._chunks.append(chunk.data)
            self._size += len(chunk.data)

    def end(self) -> None:
        """End the frame: `drain` decides all bytes so far, and further ones do not join them."""
        self._walls.append(Wall(self._size, is_soft=False))

    def finish(self) -> Rows:
        """Decide all bytes, and return the rows since the last `drain`: the stream ends here.

        Further bytes are a new stream whose offsets and times continue.
        """
        self.end()
        rows = self.drain()
        self._zeros = 0
        return rows

    def drain(self) -> Rows:
        """The rows that were decided since the last call."""
        if not self._chunks and not self._walls:
            return NO_ROWS
        self._data = b"".join([self._data, *self._chunks])
        self._chunks.clear()
        base, at, bound = self._base, *self._state
        walls = [wall._replace(at=wall.at - base) for wall in self._walls]
        data = np.frombuffer(self._data, np.uint8)
        found, state = segments(data, base, State(at - base, bound - base), walls)
        rows = self._rows(data, found, state.at)
        self._walls.clear()
        self._state = State(state.at + base, state.bound + base)
        self._forget()
        return rows

    def _forget(self) -> None:
        """Drop the bytes that have no influence any more."""
        at = self._state.at
        needed = max(self._state.bound, at - at % CORE - MARGIN)
        start = max(self._base, min(self._emitted, needed))
        self._data, self._base = self._data[start - self._base :], start
        self._times.forget(self._emitted)
        self._errors = [error for error in self._errors if error[1] > self._emitted]

    # Rows

    def _rows(self, data: Codes, found: DecidedSegments, at: int) -> Rows:
        """The rows of segments, and of the noise between them; offsets are in the data."""
        first, count = self._emitted - self._base, len(found.start)
        # Whole frames without noise between, as on a clean line, are the bytes in their order.
        if at - first == FRAME_LENGTH * count and (found.probability >= CERTAIN).all():
            raw = np.zeros((count, MOST_BYTES), np.uint8)
            raw[:, :FRAME_LENGTH] = data[first:at].reshape(count, FRAME_LENGTH)
            columns: dict[str, Array] = {"offset": found.start + self._base, "raw": raw}
            self._emitted = at + self._base
        else:
            columns = self._placed(data, found, at)
        offset = columns["offset"]
        if not len(offset):
            return NO_ROWS
        t_ns, delay_ns = self._times.began(offset)
        rows = Rows.blank(len(offset), self._ports, t_ns=t_ns, delay_ns=delay_ns, **columns)
        unusual, self._zeros = unusual_reserves(rows.raw, rows.faults == 0, self._zeros)
        rows.faults[unusual] |= FAULT_BITS[Fault.RESERVED_NONZERO]
        for error in self._errors:
            low, high = np.searchsorted(offset, error).tolist()
            if low == 0 or offset[low - 1] + rows.length[low - 1] > error[0]:
                low = max(0, low - 1)
            rows.faults[low:high] |= FAULT_BITS[Fault.LINE_ERROR]
        return rows

    def _placed(self, data: Codes, found: DecidedSegments, at: int) -> dict[str, Array]:
        """The columns of segments, and of the noise between them."""
        faults, framed, is_kept = judged(data, found)
        start, stop = found.start[is_kept], found.stop[is_kept]
        faults, framed = faults[is_kept], framed[is_kept]
        first, last = np.append(self._emitted - self._base, stop), np.append(start, at)
        last[-1] -= (last[-1] - first[-1]) % MOST_BYTES
        self._emitted = int(last[-1]) + self._base
        noise, noise_length = _cut(first, last)
        is_row, is_noise = stop > start, np.ones(len(noise), np.bool_)
        offset = np.concatenate([start[is_row], noise])
        order = np.argsort(offset, kind="stable")
        offset = offset[order]
        length = np.concatenate([(stop - start)[is_row], noise_length])[order]
        faults = np.concatenate([faults[is_row], is_noise * FAULT_BITS[Fault.NOISE]])[order]
        framed = np.concatenate([framed[is_row], ~is_noise])[order]
        raw = _bytes_of(data, offset, length)
        offset += self._base
        return {"offset": offset, "length": length, "faults": faults, "framed": framed, "raw": raw}


def _cut(first: Ints, last: Ints) -> tuple[Ints, Ints]:
    """The starts and lengths of rows of noise; every run of noise is cut each 16 bytes."""
    is_noise = last > first
    first, last = first[is_noise], last[is_noise]
    counts = -((first - last) // MOST_BYTES)
    start = ranges(first, counts, MOST_BYTES)
    return start, np.minimum(np.repeat(last, counts) - start, MOST_BYTES)


_OF_ROW: Final = np.arange(MOST_BYTES)


def _bytes_of(data: Codes, offset: Ints, length: Ints) -> Codes:
    """The bytes of rows, padded with zeros."""
    padded = np.concatenate([data, np.zeros(MOST_BYTES, np.uint8)])
    found: Codes = padded.take(offset[:, None] + _OF_ROW)
    found *= length[:, None] > _OF_ROW
    return found


# What is wrong with a segment

_DAMAGES: Final = [
    FAULT_BITS[fault]
    for fault in (Fault.TRUNCATED, Fault.OVERLONG, Fault.BAD_HEADER, Fault.BAD_TAIL)
]
_OFFSETS: Final = np.arange(FRAME_LENGTH)


def _field_faults() -> Array:
    """By kind and offset: the fault of an illegal byte there."""
    found = np.zeros((len(KINDS), FRAME_LENGTH), np.uint16)
    for code, kind in enumerate(KINDS):
        found[code, kind.reserved.start : kind.reserved.stop] = FAULT_BITS[Fault.RESERVED_NONZERO]
        for field in kind.fields:
            found[code, field.start] = FAULT_BITS[field.fault] if field.fault else 0
    return found


_FIELD_FAULTS: Final = _field_faults()


def judged(data: Codes, segments: DecidedSegments) -> tuple[Array, Bools, Bools]:
    """By segment: its faults, whether it is a frame, and whether it is not noise after all."""
    faults = np.zeros(len(segments.start), np.uint16)
    framed, is_kept = np.ones(len(faults), np.bool_), np.ones(len(faults), np.bool_)
    odd = np.flatnonzero((segments.probability < CERTAIN) & (segments.stop > segments.start))
    start, stop = segments.start[odd], segments.stop[odd]
    length = stop - start
    headed, tailed, is_ten = IS_HEADER[data[start]], data[stop - 1] == TAIL, length == FRAME_LENGTH
    is_kept[odd] = headed | is_ten
    framed[odd] = is_frame = headed & tailed & is_ten
    damage = [length < FRAME_LENGTH, length > FRAME_LENGTH, ~headed, ~tailed]
    faults[odd] = np.select(damage, _DAMAGES)
    faults[odd[is_frame]] = frame_faults(data[start[is_frame][:, None] + _OFFSETS])
    return faults, framed, is_kept


def frame_faults(raw: Codes) -> Array:
    """The faults of framed bytes, shape (frames, 10); those of legal ones have another reading."""
    kinds = kind_of(raw[:, 0], raw[:, CMD_OFFSET])
    known = np.minimum(kinds, NO_KIND - 1)
    is_illegal = ~LEGAL[known[:, None], _OFFSETS, raw]
    found = np.bitwise_or.reduce(np.where(is_illegal, _FIELD_FAULTS[known], 0), axis=1)
    found[kinds == NO_KIND] = FAULT_BITS[Fault.UNKNOWN_CMD]
    found[found == 0] = FAULT_BITS[Fault.AMBIGUOUS]
    faults: Array = found.astype(np.uint16)
    return faults
