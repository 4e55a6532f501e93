"""Islands and gaps: which bytes are certain frames, and which are divided.

A frame is strict if each of its bytes is legal. A joint is an offset at which one strict frame ends
and the next one begins, and that no other strict frame contains: neither chance nor damage makes
one. Joints and silence bound the spans of a stream. A span that is one strict frame is certain;
every other one is a gap, which `gap.divide` divides:

    frame | frame | frame damage noise frame | frame | frame damage frame | frame
          joint   joint        gap         joint   joint      gap       joint

A wide gap is divided in windows at fixed offsets of the stream, each with a margin on both sides:

            margin |      core      | margin
                            margin  |      core      | margin

Nothing crosses a bound. So every decision depends on the bytes and on silence, never on how the
bytes were cut into chunks.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from fte_sniff.protocol.candidates import LEGAL, LONGEST
from fte_sniff.protocol.gap import DecidedSegments, Gaps, divide
from fte_sniff.protocol.rows import Bools, Codes, Ints
from fte_sniff.protocol.spec import FRAME_LENGTH, TAIL

WIDEST: Final = 96
"""Bytes of the widest gap that is divided as a whole."""
CORE: Final = 64
"""Bytes of a window whose segments are taken."""
MARGIN: Final = 2 * LONGEST
"""Bytes on each side of it that are divided with it."""

_FAR: Final = 2**62

_OFFSETS: Final = np.arange(FRAME_LENGTH)[:, None]
_TABLES: Final = _OFFSETS << 8
_LEGAL_IN: Final[Codes] = np.packbits(LEGAL, axis=0).reshape(FRAME_LENGTH << 8)
"""By offset in a frame * 256 + byte: the kinds, at most 8, in which it is legal, a bit each."""


def strict_frames(data: Codes) -> Ints:
    """The offsets at which a complete frame begins that is legal at every byte."""
    if len(data) < FRAME_LENGTH:
        return np.empty(0, np.int64)
    found = np.flatnonzero(data[FRAME_LENGTH - 1 :] == TAIL)
    kinds = _LEGAL_IN.take(data.take(found + _OFFSETS) + _TABLES)
    strict: Ints = found.compress(np.bitwise_and.reduce(kinds, axis=0) != 0)
    return strict


def is_start(raw: bytes) -> bool:
    """Whether these bytes, fewer than a frame has, can be the first ones of a strict frame."""
    own = np.frombuffer(raw, np.uint8)
    return bool(LEGAL[:, np.arange(len(own)), own].all(axis=1).any())


class Wall(NamedTuple):
    """An offset at which silence was."""

    at: int
    is_soft: bool
    """Whether a frame that has begun may go on."""


class State(NamedTuple):
    """How far a stream is decided."""

    at: int
    """Offset up to which all is decided."""
    bound: int
    """Offset of the last bound; less than `at` within a wide gap."""


def segments(
    data: Codes, base: int, state: State, walls: Sequence[Wall]
) -> tuple[DecidedSegments, State]:
    """All that can be decided from a state on, by offset, and the state after it.

    `base` is the stream offset of the first byte of the data; all other offsets are in the data.
    """
    strict, known = strict_frames(data), len(data) - FRAME_LENGTH
    ends = np.array(_ends(data.tobytes(), strict, state.bound, walls), np.int64)
    strict = strict[strict.searchsorted(state.bound) :]
    if walls:
        next_end = np.append(ends, _FAR).take(np.searchsorted(ends, strict, "right"))
        strict = strict[strict + FRAME_LENGTH <= next_end]
    joints = strict[1:][strict[1:] - strict[:-1] == FRAME_LENGTH]
    bounds = np.concatenate([[state.bound], joints, ends])
    bound = int(bounds[-1])
    # On a clean line all is frames in step: most drains of a capture end here.
    is_clean = state.at == state.bound and bound - state.at == FRAME_LENGTH * len(joints)
    if is_clean and not walls and known - bound < WIDEST:
        return DecidedSegments(bounds[:-1], joints, np.ones(len(joints))), State(bound, bound)
    bounds.sort()
    contested = np.array(_in_step(bounds, strict, known), np.int64)
    bounds = np.sort(np.concatenate([bounds, contested]))
    start, stop, bound = bounds[:-1], bounds[1:], int(bounds[-1])
    is_frame = (stop - start == FRAME_LENGTH) & _mask(strict, len(data)).take(start, mode="clip")
    frame, start, stop = start[is_frame], start[~is_frame], stop[~is_frame]
    if known - bound > WIDEST:
        start, stop = np.append(start, bound), np.append(stop, _FAR)
    windows = _windows(start, stop, state.at, base % CORE, known)
    at = int(windows.last.max(initial=0))
    is_sure = ~_mask(contested, len(data))[frame + FRAME_LENGTH]
    frames = DecidedSegments(frame, frame + FRAME_LENGTH, is_sure.astype(np.float64))
    bounds_of_silence = DecidedSegments(ends, ends, np.zeros(len(ends)))
    found = _in_order(state.at, bounds_of_silence, frames, *divide(data, windows))
    return found, State(max(state.at, bound, at, int(found.stop[-1:].max(initial=0))), bound)


def _mask(offsets: Ints, size: int) -> Bools:
    """By offset, 0 to size: whether it is one of these."""
    found = np.zeros(size + 1, np.bool_)
    found[offsets] = True
    return found


def _in_order(at: int, *parts: DecidedSegments) -> DecidedSegments:
    """The segments by offset, without those that begin within the one before, or before `at`."""
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    order = np.argsort(columns[0], kind="stable")
    start, stop, probability = (column[order] for column in columns)
    is_first = start >= np.maximum.accumulate(np.append(at, stop))[:-1]
    return DecidedSegments(start[is_first], stop[is_first], probability[is_first])


def _ends(raw: bytes, strict: Ints, bound: int, walls: Sequence[Wall]) -> list[int]:
    """The bounds that silence makes: walls, or the start of a frame before a soft one."""
    ends, frames = list[int](), set(strict.tolist()) if walls else set()
    for wall, is_soft in walls:
        low = max(bound, wall - FRAME_LENGTH + 1)
        if is_soft and (wall - FRAME_LENGTH < bound or wall - FRAME_LENGTH not in frames):
            starts = [at for at in range(low, wall + 1) if is_start(raw[at:wall])]
            in_step = (at for at in starts if at == bound or at - FRAME_LENGTH in frames)
            bound = next(in_step, starts[0])
        else:
            bound = wall
        ends.append(bound)
    return ends


def _in_step(bounds: Ints, strict: Ints, known: int) -> list[int]:
    """The ends of frames in step with the start of a wide gap, which other frames contest."""
    stops = np.append(bounds[1:], max(known + 1, bounds[-1]))
    wide = np.flatnonzero(stops - bounds > WIDEST)
    found, frames = list[int](), set(strict.tolist()) if len(wide) else set()
    for at, stop in zip(bounds[wide].tolist(), stops[wide].tolist(), strict=True):
        while stop - at > WIDEST and at in frames and at + FRAME_LENGTH in frames:
            at += FRAME_LENGTH
            found.append(at)
    return found


def _windows(start: Ints, stop: Ints, at: int, phase: int, known: int) -> Gaps:
    """The windows of gaps from an offset on; a narrow gap is one window."""
    is_wide = stop - start > WIDEST
    core = np.maximum(start, at)
    core -= (core + phase) % CORE * is_wide
    length = np.where(is_wide, CORE, WIDEST)
    counts = np.where(stop == _FAR, (known - MARGIN - core) // CORE, -((core - stop) // length))
    counts = np.maximum(counts, 0)
    start, stop, length = start.repeat(counts), stop.repeat(counts), length.repeat(counts)
    core = ranges(core, counts, CORE)
    low, high = np.maximum(core - MARGIN, start), np.minimum(core + length + MARGIN, stop)
    first, last = np.maximum(core, start), np.minimum(core + length, stop)
    return Gaps(low, high, first, last, low > start, high < stop)


def ranges(first: Ints, counts: Ints, step: int) -> Ints:
    """From each first number on, as many numbers as its count."""
    before = np.cumsum(counts) - counts
    return np.repeat(first - step * before, counts) + step * np.arange(int(counts.sum()))
