"""Owns how probable frames are in one disputed stretch: the weights of all its readings at once.

It must not know of chunks, times or rows, nor choose a reading: `choice` does. Every way to divide
the stretch into whole frames, damaged ones and noise is a reading; its weight is the product of its
pieces' weights. Two passes, one from each side, add up the weights of all readings at once, so that
each frame's probability is that of the readings that contain it.

The passes go from header to header and from tail to tail, since nothing begins a frame or ends one
anywhere else; what lies between is reckoned as a whole. They take time and memory in proportion to
the stretch, which the framer bounds.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum
from operator import add, mul

from fte_sniff.protocol.framer.likelihood import (
    JUNK,
    LONGEST_JUNK,
    NOISE_BEGINS,
    NOISE_ENDS,
    NOISE_STAYS,
    WHOLE,
)
from fte_sniff.protocol.framer.pieces import Start, Stop, Window
from fte_sniff.protocol.table import FRAME_LENGTH

_LONGEST = 512
"""Bytes of the longest stretch that is weighed; the framer never asks for as many."""

_STAYING = tuple(NOISE_STAYS**length for length in range(_LONGEST, -1, -1))
"""The weight of noise going on for so many bytes, from `_LONGEST` down to 0."""

_TO_HEADER = tuple(
    (JUNK if length <= LONGEST_JUNK else 0.0)
    + NOISE_BEGINS * NOISE_STAYS ** (length - 1) * NOISE_ENDS
    for length in range(_LONGEST, 0, -1)
)
"""The weight of noise, short or long, up to a header, from `_LONGEST` bytes down to 1."""


class Ending(Enum):
    """What is known of the line behind a stretch."""

    OPEN = "bytes may follow at once"
    CLOSED = "silence, or the end of the stream"
    BOUNDARY = "no frame goes on behind it"


@dataclass(slots=True)
class Carry:
    """What the bytes before a place say about the places from there on."""

    after_piece: list[float] = field(default_factory=lambda: [1.0])
    """By place: the weight of all readings of the bytes before it whose last piece ends there."""
    after_noise: list[float] = field(default_factory=list)
    """The same for readings that end there with noise."""
    in_noise: float = 0.0
    """The weight of readings with long noise going on at the first place."""
    ends_frame: bool = False
    """Whether the rows so far end here with a frame, or with something else of known length."""
    within: float = 0.0
    """The weight of the first place being anywhere within a frame; only where a stream begins."""


def trusted() -> Carry:
    """A frame ends here beyond doubt."""
    return Carry()


def joined() -> Carry:
    """The stream begins here: between two frames, or anywhere within one, or in noise."""
    return Carry([0.5], [], 0.01, within=0.5)


def lost() -> Carry:
    """Long noise is going on."""
    return Carry([], [], 1.0)


class Weighing:
    """The readings of a window, weighed; places are counted from the window's first byte."""

    def __init__(self, window: Window, carry: Carry, ending: Ending) -> None:
        self.window = window
        self.size = len(window.data)
        self.ending = ending
        self._carried = _joining(window, carry) if carry.within else carry
        self._after_piece, self._after_noise, _ = self._forward(self._carried, self.size)
        self._to_end, self._at_header = self._backward()
        self._total = self._in_all(self._carried)

    # The two passes

    def _forward(self, carry: Carry, end: int) -> tuple[list[float], list[float], float]:
        """The weights that the pieces and the noise before `end` lay on every place."""
        after_piece = _padded(carry.after_piece, self.size)
        after_noise = _padded(carry.after_noise, self.size)
        noise, noisy_to = carry.in_noise, 0
        for mark in self.window.marks:
            if isinstance(mark, Stop):
                place, first, headless, _ = mark
                till = place if place < end else end
                after_piece[place] += sum(map(mul, after_piece[first:till], headless))
                continue
            place, _, truncated, ends = mark
            before = place - LONGEST_JUNK if place > LONGEST_JUNK else 0
            if place >= end:
                after_noise[place] += sum(after_piece[before:end]) * JUNK
                continue
            noise = _gone_on(noise, after_piece[noisy_to:place])
            noisy_to = place
            after_noise[place] += sum(after_piece[before:place]) * JUNK + noise * NOISE_ENDS
            weight = after_piece[place] * self.window.meeting(place) + after_noise[place]
            if weight:
                first, last = place + 1, place + 1 + len(truncated)
                more = map(weight.__mul__, truncated)
                after_piece[first:last] = map(add, after_piece[first:last], more)
                for at, own, _ in ends:
                    after_piece[at] += weight * own
        return after_piece, after_noise, _gone_on(noise, after_piece[noisy_to:end])

    def _backward(self) -> tuple[list[float], list[tuple[int, float]]]:
        """The weights of all readings from a place on: by place; and of those that begin with a
        frame there, at every header."""
        size = self.size
        to_end = list(_TO_END[self.ending][-size - 1 :])
        at_header: list[tuple[int, float]] = []
        for mark in reversed(self.window.marks):
            if isinstance(mark, Stop):
                place, first, others, _ = mark
                weight = to_end[place]
            else:
                place, _, truncated, ends = mark
                weight = sum(map(mul, truncated, to_end[place + 1 : place + FRAME_LENGTH]))
                for at, own, _ in ends:
                    weight += own * to_end[at]
                if place > size - FRAME_LENGTH:
                    weight += self.cut_off(mark)
                to_end[place] += weight * self.window.meeting(place)
                at_header.append((place, weight))
                first, others = 0, _TO_HEADER[_LONGEST - place :]
            to_end[first:place] = map(add, to_end[first:place], map(weight.__mul__, others))
        return to_end, at_header

    def _in_all(self, carry: Carry) -> float:
        """The weight of all readings, if this was before them."""
        total: float = sum(map(mul, carry.after_piece, self._to_end))
        if carry.in_noise:
            noise = NOISE_STAYS**self.size * _NOISE_GOES_ON[self.ending]
            for place, weight in self._at_header:
                noise += NOISE_STAYS**place * NOISE_ENDS * weight
            total += carry.in_noise * noise
        if carry.after_noise:
            for place, weight in self._at_header:
                if place < len(carry.after_noise):
                    total += carry.after_noise[place] * weight
        return total

    def cut_off(self, start: Start) -> float:
        """The weight of a frame that begins there and goes on behind the window's end."""
        length = self.size - start.place
        if length >= FRAME_LENGTH or start.front.length < length or self.ending is Ending.BOUNDARY:
            return 0.0
        left = start.front.head[length] * WHOLE
        return left if self.ending is Ending.OPEN else left / FRAME_LENGTH

    # What they tell

    def probability(self, start: int, stop: int, weight: float) -> float:
        """The probability (0-1) of a piece of that weight at `start`."""
        before = self._after_piece[start] * self.window.meeting(start) + self._after_noise[start]
        return before * weight * self._to_end[stop] / self._total

    def boundary(self, place: int) -> float:
        """The probability (0-1) that no frame, whole or damaged, goes on over that place."""
        before = self._after_piece[place] + self._after_noise[place]
        return before * self._to_end[place] / self._total

    def whole_frames(self) -> dict[int, float]:
        """Where whole frames can stand, from left to right, and how probable they are (0-1)."""
        return self._whole_frames(self._after_piece, self._after_noise, self._total)

    def whole_frames_behind_rows(self) -> dict[int, float] | None:
        """The same, if all rows so far are taken for granted; None where that is no matter."""
        if not self._carried.ends_frame:
            return None
        after_piece, after_noise, _ = self._forward(_TRUSTED, self.size)
        return self._whole_frames(after_piece, after_noise, self._in_all(_TRUSTED))

    def _whole_frames(
        self, after_piece: list[float], after_noise: list[float], total: float
    ) -> dict[int, float]:
        to_end, meeting = self._to_end, self.window.meeting
        return {
            place: (after_piece[place] * meeting(place) + after_noise[place])
            * ends[0][1]
            * to_end[place + FRAME_LENGTH]
            / total
            for place, front, _, ends in self.window.starts
            if front.whole
        }

    def carry(self, place: int, *, ends_frame: bool) -> Carry:
        """What the bytes before `place`, where a row ends, say of those behind it."""
        after_piece, after_noise, in_noise = self._forward(self._carried, place)
        after_piece, after_noise = after_piece[place:], after_noise[place:]
        total = sum(after_piece) + sum(after_noise) + in_noise
        return Carry(
            [weight / total for weight in after_piece],
            [weight / total for weight in after_noise],
            in_noise / total,
            ends_frame=ends_frame,
        )


def _to_end(ending: Ending) -> tuple[float, ...]:
    """By place, from `_LONGEST` bytes before the end up to it: noise to the end, or nothing."""

    def weight(length: int) -> float:
        lengths = LONGEST_JUNK + 1 - length if ending is Ending.OPEN else 1
        junk = JUNK * lengths if length <= LONGEST_JUNK else 0.0
        return junk + NOISE_BEGINS * NOISE_STAYS ** (length - 1) * _NOISE_GOES_ON[ending]

    return (*(weight(length) for length in range(_LONGEST, 0, -1)), 1.0)


_NOISE_GOES_ON = {Ending.OPEN: 1.0, Ending.CLOSED: NOISE_ENDS, Ending.BOUNDARY: NOISE_ENDS}
"""The weight of long noise at the end of a stretch."""

_TO_END = {ending: _to_end(ending) for ending in Ending}


def _gone_on(noise: float, after_piece: list[float]) -> float:
    """The weight of long noise behind some places, where it may have begun at each of them."""
    length = len(after_piece)
    begun: float = sum(map(mul, after_piece, _STAYING[_LONGEST + 1 - length :]))
    return noise * _STAYING[_LONGEST - length] + NOISE_BEGINS * begun


def _joining(window: Window, carry: Carry) -> Carry:
    """What is before the window, where its first piece may be the rest of a frame begun before."""
    rests = window.rests_from_first(FRAME_LENGTH - 1)
    weights = _padded(carry.after_piece, len(rests))
    for place, rest in enumerate(rests, start=1):
        weights[place] += carry.within / (FRAME_LENGTH - 1) * rest
    return replace(carry, after_piece=weights)


def _padded(weights: list[float], size: int) -> list[float]:
    return weights + [0.0] * (size + 1 - len(weights))


_TRUSTED = trusted()
