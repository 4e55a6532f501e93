"""Owns the quick look for frames in step: where in many bytes runs of plain frames stand.

It must not decide what a frame is: `PLAIN_RUN` does, and what is found here is never more than
that finds. It may be less.

Bytes that a header begins and a tail ends, nine bytes on, are looked at as two numbers, the first
eight bytes and the last two, thousands at a time. Slabs of the bytes are independent of each other
and are searched at once, since numpy lets go of the interpreter.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from typing import Final

import numpy as np

from fte_sniff.analysis.columns.fields import KIND_OF, NO_KIND, Array
from fte_sniff.protocol import FRAME_LENGTH, HEADERS, KINDS, TAIL
from fte_sniff.protocol.framer.patterns import USUAL_FLAGS, ends_freely
from fte_sniff.protocol.structure import legal_bytes
from fte_sniff.protocol.table import MOTORS, NUM_PLACE

SLAB: Final = 1 << 20
"""Bytes that one thread looks at, or turns into columns, at once."""

_BLOCK: Final = 1 << 14
"""Frames whose numbers stay in the cache."""


def _forbidden_bits() -> tuple[Array, Array, Array]:
    """By kind: what to take from the front of a frame, and which of its bits, and of the back's
    without the tail, must not be set then.

    Motors begin with 1 and are a power of two many: NUM less 1 must not have higher bits. (Where
    NUM is 0, more than its own bits change; the frame is not plain then anyhow.) Where NUM means
    nothing, it must be 00.
    """
    first = np.zeros(NO_KIND + 1, np.uint64)
    masks = np.zeros((NO_KIND + 1, FRAME_LENGTH), np.uint8)
    masks[:, FRAME_LENGTH - 1] = 0xFF
    for code, kind in enumerate(KINDS):
        if kind.names_motor:
            first[code] = MOTORS.start << 8 * NUM_PLACE
        masks[code, NUM_PLACE] = 0x100 - len(MOTORS) if kind.names_motor else 0xFF
        for place in range(NUM_PLACE + 1, FRAME_LENGTH - 1):
            legal = legal_bytes(kind)[place]
            if legal is not None:
                masks[code, place] = 0xFF ^ np.bitwise_or.reduce(list(legal))
    return (
        first,
        np.ascontiguousarray(masks[:, :8]).view("<u8").reshape(-1),
        np.ascontiguousarray(masks[:, 8:]).view("<u2").reshape(-1),
    )


_FRAME: Final = np.dtype([("front", "<u8"), ("back", "<u2")])
_NEARLY_ALL: Final = 0.97
"""Share of frames in step above which nothing is looked for elsewhere."""

_FIRST, _FRONT_MASK, _BACK_MASK = _forbidden_bits()
_LOW_BITS: Final = np.uint64(0x7F7F7F7F7F7F7F7F)
_HIGH_BITS: Final = ~_LOW_BITS
_EVERY_BYTE: Final = np.uint64(0x0101010101010101)
_HEADERS: Final = tuple(np.uint64(header) * _EVERY_BYTE for header in HEADERS.values())
_TAIL_HIGH: Final = np.uint16(TAIL << 8)
_TAILS: Final = np.uint64(TAIL) * _EVERY_BYTE
_ABOVE_CMDS: Final = np.uint64(0xFC) * _EVERY_BYTE
_ABOVE_NUMS: Final = np.uint64(0xF8) * _EVERY_BYTE
_NO_PAYLOAD: Final = np.uint64(0xFF << 56)
_ENDS_AS_IT_MUST: Final = np.array(
    [not (kind.names_motor and ends_freely(kind)) for kind in KINDS] + [True]
)
_ENDINGS: Final = tuple(
    (
        np.uint64(8 * (FRAME_LENGTH - 3 - len(flags))),
        np.uint64(int.from_bytes(flags + b"\xff", "little")),
    )
    for flags in USUAL_FLAGS
)
"""What nothing else may end with: how far a payload is to be shifted, and what is left then."""


class PlainRuns:
    """Where runs of plain frames stand in some bytes; to be asked from left to right."""

    def __init__(self, data: bytes, threads: Executor) -> None:
        slabs = range(0, max(0, len(data) - FRAME_LENGTH + 1), SLAB)
        self._runs = _joined(threads.map(lambda at: _runs(data, at), slabs))
        self._start, self._stop = next(self._runs, _NEVER)

    def __call__(self, place: int) -> int:
        """How many plain frames are found in step from `place` on."""
        while self._stop <= place:
            self._start, self._stop = next(self._runs, _NEVER)
        count, rest = divmod(self._stop - place, FRAME_LENGTH)
        return 0 if rest or place < self._start else count


_NEVER: Final = (1 << 62, 1 << 63)


def _joined(found: Iterator[tuple[list[int], list[int]]]) -> Iterator[tuple[int, int]]:
    """The runs of all slabs, those that go on from slab to slab as one."""
    first = last = 0
    for starts, stops in found:
        for start, stop in zip(starts, stops, strict=True):
            if start == last:
                last = stop
                continue
            if last:
                yield first, last
            first, last = start, stop
    if last:
        yield first, last


def _runs(data: bytes, at: int) -> tuple[list[int], list[int]]:
    """Where in one slab runs of plain frames start and stop."""
    places = _in_step(data, at)
    if places is None:
        places = _anywhere(data, at)
    if not len(places):
        return [], []
    ends = (np.diff(places) != FRAME_LENGTH).nonzero()[0]
    starts = places[np.concatenate([[0], ends + 1])]
    stops = places[np.concatenate([ends, [len(places) - 1]])] + FRAME_LENGTH
    return starts.tolist(), stops.tolist()


def _in_step(data: bytes, at: int) -> Array | None:
    """Where plain frames stand in one slab, if nearly all of it is in step; None if it is not."""
    behind_tail = data.find(TAIL, max(0, at - 1), at + 4 * FRAME_LENGTH) + 1
    first = at + (behind_tail - at) % FRAME_LENGTH
    last = min(at + SLAB, len(data) - FRAME_LENGTH + 1)
    count = len(range(first, last, FRAME_LENGTH))
    places = np.arange(first, first + count * FRAME_LENGTH, FRAME_LENGTH)
    plain = np.empty(count, np.bool_)
    for block in range(0, count, _BLOCK):
        size = min(_BLOCK, count - block)
        frames = np.frombuffer(data, _FRAME, size, first + block * FRAME_LENGTH)
        front, back = np.ascontiguousarray(frames["front"]), np.ascontiguousarray(frames["back"])
        own = plain[block : block + size]
        own[:] = _plain(front, back)
        if np.count_nonzero(own) < _NEARLY_ALL * size:
            return None
    return np.asarray(places if plain.all() else places[plain])


def _anywhere(data: bytes, at: int) -> Array:
    """Where plain frames stand in one slab, in step or not."""
    size = min(SLAB, len(data) - FRAME_LENGTH + 1 - at)
    raw = np.frombuffer(data, np.uint8, size + FRAME_LENGTH - 1, at)
    heads = raw[:size]
    headers = iter(HEADERS.values())
    framed = heads == next(headers)
    for header in headers:
        framed |= heads == header
    framed &= raw[FRAME_LENGTH - 1 :] == TAIL
    places = framed.nonzero()[0]
    fronts = np.ndarray((size,), "<u8", raw, 0, (1,))
    backs = np.ndarray((size,), "<u2", raw, 8, (1,))
    found = [places[:0]]
    for block in range(0, len(places), _BLOCK):
        own = places[block : block + _BLOCK]
        found.append(own[_plain(fronts[own], backs[own])])
    return np.asarray(np.concatenate(found) + at)


def _plain(front: Array, back: Array) -> Array:
    """Which frames are plain, by their first eight bytes and their last two."""
    kinds = KIND_OF.take(front.astype(np.uint16), mode="clip")
    bits = (front - _FIRST.take(kinds, mode="clip")) & _FRONT_MASK.take(kinds, mode="clip")
    plain = bits == 0
    plain &= (back ^ _TAIL_HIGH) & _BACK_MASK.take(kinds, mode="clip") == 0
    plain &= kinds != NO_KIND
    payload = front >> np.uint64(16) | back.astype(np.uint64) << np.uint64(48) | _NO_PAYLOAD
    plain[_dividing(payload)] = False
    for shift, flags in _ENDINGS:
        plain &= (payload >> shift != flags) | _ENDS_AS_IT_MUST.take(kinds, mode="clip")
    return np.asarray(plain)


def _dividing(payload: Array) -> Array:
    """Where a header follows a tail, or stands before what can be a CMD and a motor."""
    somewhere = _any_zero(payload ^ _HEADERS[0])
    for header in _HEADERS[1:]:
        somewhere |= _any_zero(payload ^ header)
    somewhere &= _HIGH_BITS
    with_header = (somewhere != 0).nonzero()[0]
    payload = payload[with_header]
    headers = _zeros(payload ^ _HEADERS[0])
    for header in _HEADERS[1:]:
        headers |= _zeros(payload ^ header)
    tails = _zeros(payload ^ _TAILS)
    cmds = _zeros(payload & _ABOVE_CMDS) & ~_zeros(payload)
    nums = _zeros(payload & _ABOVE_NUMS)
    named = headers & cmds >> np.uint64(8) & nums >> np.uint64(16)
    return np.asarray(with_header[(tails & headers >> np.uint64(8) | named) != 0])


def _any_zero(numbers: Array) -> Array:
    """Some byte's highest bit is set if a byte is 0, and none is if no byte is 0."""
    less = numbers - _EVERY_BYTE
    np.invert(numbers, out=numbers)
    less &= numbers
    return np.asarray(less)


def _zeros(numbers: Array) -> Array:
    """The highest bit of every byte that is 0."""
    return np.asarray(~((numbers & _LOW_BITS) + _LOW_BITS | numbers | _LOW_BITS))
