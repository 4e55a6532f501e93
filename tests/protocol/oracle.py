"""An independent, slow, plain reckoning of what a whole stream can mean: the framer's touchstone.

It takes the numbers of the cost model from `likelihood`, and nothing else from the framer: no
windows, no streaming, no shortcuts. Every way in which a frame of every kind can have been damaged
is written out and weighed byte by byte; every place of the whole stream can begin any of them; and
the weights of all readings are added up over the whole stream, from both sides.

The model. A stream is whole frames, damaged frames and noise, one behind the other.

    whole      WHOLE         x the frame
    lost       LOST[n]       x the frame without some run of bytes, n left
    put in     PUT_IN        x the frame with 1-4 bytes (each weighing 1) behind one of its first 9
    changed    CHANGED[w]    x the frame with a run of w bytes (each weighing 1) changed
    broken     BROKEN        x as much as fits at the front, then as much as fits at the back
    unusual    UNUSUAL       x header, CMD, NUM and tail; what lies between weighs 1
    foreign    FOREIGN       x header and tail
    junk       JUNK          for each length up to 30, behind a frame and before a header or the end
    noise      NOISE_BEGINS, then NOISE_STAYS a byte, then NOISE_ENDS, before a header or the end

A frame weighs the share of its kind times, for each byte, 256 times the byte's probability there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import exp, inf, log

from fte_sniff.protocol import FRAME_LENGTH, HEADERS, KINDS, TAIL, FrameKind
from fte_sniff.protocol.framer.likelihood import (
    BROKEN,
    CHANGED,
    FOREIGN,
    JUNK,
    KIND_SHARE,
    LONGEST_JUNK,
    LOST,
    NOISE_BEGINS,
    NOISE_ENDS,
    NOISE_STAYS,
    PLACE_WEIGHTS,
    PUT_IN,
    UNUSUAL,
    WHOLE,
)

IS_HEADER = frozenset(HEADERS.values())


@dataclass(frozen=True)
class Piece:
    stop: int
    weight: float
    whole: bool = False


def sent(kind: FrameKind, data: Sequence[int], places: Sequence[int]) -> float:
    """The weight of these bytes being those places of a frame of that kind."""
    weight = KIND_SHARE[kind.name]
    for byte, place in zip(data, places, strict=True):
        weight *= PLACE_WEIGHTS[kind.name][place][byte]
    return weight


def is_whole(data: bytes) -> bool:
    return len(data) == FRAME_LENGTH and any(sent(kind, data, range(10)) for kind in KINDS)


def pieces(data: bytes, start: int) -> Iterator[Piece]:
    """Every frame, whole or damaged, that can begin at `start`."""
    left = len(data) - start
    if is_whole(data[start : start + 10]):
        weight = sum(sent(kind, data[start : start + 10], range(10)) for kind in KINDS)
        yield Piece(start + 10, WHOLE * weight, True)
    for length in range(1, min(14, left) + 1):
        own = data[start : start + length]
        if is_whole(own):
            continue
        weight = sum(damaged(kind, own) for kind in KINDS)
        if length == FRAME_LENGTH:
            weight += framed(own)
        if weight:
            yield Piece(start + length, weight)


def damaged(kind: FrameKind, own: bytes) -> float:
    """The weight of these bytes being one damaged frame of that kind."""
    length, weight = len(own), 0.0
    for head in range(FRAME_LENGTH):
        if length < FRAME_LENGTH and head <= length:
            places = [*range(head), *range(head + FRAME_LENGTH - length, FRAME_LENGTH)]
            weight += LOST[length] * sent(kind, own, places)
        if length == FRAME_LENGTH:
            for width in range(1, min(6, FRAME_LENGTH - head) + 1):
                places = [*range(head), *range(head + width, FRAME_LENGTH)]
                weight += CHANGED[width] * sent(kind, [own[place] for place in places], places)
        if length > FRAME_LENGTH and head:
            kept = own[:head] + own[head + length - FRAME_LENGTH :]
            weight += PUT_IN * sent(kind, kept, range(FRAME_LENGTH))
    return weight + broken(kind, own)


def fits(kind: FrameKind, byte: int, place: int) -> bool:
    return PLACE_WEIGHTS[kind.name][place][byte] > 0


def broken(kind: FrameKind, own: bytes) -> float:
    """Nothing of the head left, or header, CMD and more; something of the rest left."""
    if own[-1] != TAIL:
        return 0.0
    most = min(len(own), FRAME_LENGTH - 1)
    rest = next((n for n in range(most) if not fits(kind, own[-1 - n], 9 - n)), most)
    weight = BROKEN * sent(kind, own[len(own) - rest :], range(FRAME_LENGTH - rest, 10))
    most = min(len(own) - 1, FRAME_LENGTH - 2)
    head = next((n for n in range(most) if not fits(kind, own[n], n)), most)
    named = len(own) > 1 and fits(kind, own[0], 0) and fits(kind, own[1], 1)
    if named:
        if len(own) == 2:
            head = 1
        rest = min(rest, len(own) - head, FRAME_LENGTH - 1 - head)
        places = [*range(head), *range(FRAME_LENGTH - rest, FRAME_LENGTH)]
        kept = own[:head] + own[len(own) - rest :]
        if head >= 2:
            weight += BROKEN * sent(kind, kept, places)
    return weight


def framed(own: bytes) -> float:
    """The weight of ten bytes between header and tail, whatever they hold."""
    if own[0] not in IS_HEADER or own[-1] != TAIL:
        return 0.0
    named = sum(sent(kind, own[:3], range(3)) for kind in KINDS)
    return FOREIGN * 256 / len(IS_HEADER) * 256 + UNUSUAL * named * 256


def add(a: float, b: float) -> float:
    """log(e^a + e^b)."""
    low, high = min(a, b), max(a, b)
    return high if low == -inf else high + log(1 + exp(low - high))


def weigh(data: bytes) -> dict[int, float]:
    """Where a whole frame can begin in a stream that begins and ends between frames, and how
    probable that is, 0-1."""
    size = len(data)
    at = [list(pieces(data, start)) for start in range(size)]
    ends = [place for place in range(size + 1) if place == size or data[place] in IS_HEADER]
    before, after = _from_front(at, ends), _from_back(at, ends)
    total = after[0]
    return {
        start: exp(before[start] + log(piece.weight) + after_piece - total)
        for start in range(size)
        for piece in at[start]
        if piece.whole and before[start] > -inf and (after_piece := after[piece.stop]) > -inf
    }


def _noise(length: int) -> float:
    """The log weight of noise of that length, short or long, before a header."""
    junk = JUNK if length <= LONGEST_JUNK else 0.0
    return log(junk + NOISE_BEGINS * NOISE_STAYS ** (length - 1) * NOISE_ENDS)


def _from_front(at: list[list[Piece]], ends: list[int]) -> list[float]:
    """By place: all readings of what is before it, a frame or noise ending there."""
    size = len(at)
    frame, noise = [-inf] * (size + 1), [-inf] * (size + 1)
    frame[0] = 0.0
    for start in range(size):
        here = add(frame[start], noise[start])
        if here > -inf:
            for piece in at[start]:
                frame[piece.stop] = add(frame[piece.stop], here + log(piece.weight))
        if frame[start] > -inf:
            for end in ends:
                if end > start:
                    noise[end] = add(noise[end], frame[start] + _noise(end - start))
    return [add(a, b) for a, b in zip(frame, noise, strict=True)]


def _from_back(at: list[list[Piece]], ends: list[int]) -> list[float]:
    """By place: all readings of what is behind it, if a frame ended there."""
    size = len(at)
    behind, fresh = [-inf] * (size + 1), [-inf] * (size + 1)
    behind[size] = fresh[size] = 0.0
    for start in range(size - 1, -1, -1):
        for piece in at[start]:
            fresh[start] = add(fresh[start], log(piece.weight) + behind[piece.stop])
        behind[start] = fresh[start]
        for end in ends:
            if end > start:
                behind[start] = add(behind[start], _noise(end - start) + fresh[end])
    return behind
