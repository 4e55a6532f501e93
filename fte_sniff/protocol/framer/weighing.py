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

from typing import Final, final

from librt.vecs import vec
from mypy_extensions import i64

from fte_sniff.protocol.framer.carry import Carry, trusted
from fte_sniff.protocol.framer.likelihood import (
    JUNK,
    LONGEST_JUNK,
    NOISE_BEGINS,
    NOISE_ENDS,
    NOISE_STAYS,
    WHOLE,
)
from fte_sniff.protocol.framer.noise import (
    BOUNDARY,
    OPEN,
    noise_to_end,
    noise_to_header,
    staying,
    unending,
)
from fte_sniff.protocol.framer.pieces import Start, Stop, Window
from fte_sniff.protocol.framer.places import LENGTH

_JUNK_REACH: Final[i64] = LONGEST_JUNK
_TRUSTED: Final = trusted()


@final
class Passed:
    """What the pieces and the noise before some end lay on every place of a window."""

    def __init__(self, size: i64) -> None:
        self.after_piece = vec[float]([0.0] * (size + 1))
        """By place: the weight of all readings of the bytes before it whose last piece ends
        there."""
        self.after_noise = vec[float]([0.0] * (size + 1))
        """The same for readings that end there with noise."""
        self.in_noise = 0.0
        """The weight of those that are in long noise at the end."""


@final
class Weighing:
    """The readings of a window, weighed; places are counted from the window's first byte."""

    def __init__(self, window: Window, carry: Carry, ending: i64) -> None:
        """`ending` is one of those that `noise` names."""
        self.window = window
        self.size = window.size
        self.ending = ending
        self._carried = carry.joining(window) if carry.within else carry
        self._passed = self._forward(self._carried, self.size)
        self._to_end = vec[float]([0.0] * (self.size + 1))
        """By place: the weight of all readings from there on."""
        self._at_header = vec[float]([0.0] * len(window.starts))
        """By header: that of those that begin with a frame there."""
        self._backward()
        self._total = self._in_all(self._carried)

    # The two passes

    def _forward(self, carry: Carry, end: i64) -> Passed:
        """The weights that the pieces and the noise before `end` lay on every place."""
        passed = Passed(self.size)
        after_piece, after_noise = passed.after_piece, passed.after_noise
        _fill(after_piece, carry.after_piece)
        _fill(after_noise, carry.after_noise)
        noise, noisy_to = carry.in_noise, i64(0)
        for mark in self.window.marks:
            stop = mark.stop
            if stop is not None:
                after_piece[stop.place] += _reaching(stop, after_piece, end)
                continue
            start = mark.start
            assert start is not None
            place = start.place
            junk = _junk_up_to(place, min(place, end), after_piece)
            if place >= end:
                after_noise[place] += junk
                continue
            while noisy_to < place:
                noise = noise * NOISE_STAYS + NOISE_BEGINS * after_piece[noisy_to]
                noisy_to += 1
            after_noise[place] += junk + noise * NOISE_ENDS
            weight = after_piece[place] * self.window.meeting(place) + after_noise[place]
            if weight > 0.0:
                _lay(start, weight, after_piece)
        while noisy_to < end:
            noise = noise * NOISE_STAYS + NOISE_BEGINS * after_piece[noisy_to]
            noisy_to += 1
        passed.in_noise = noise
        return passed

    def _backward(self) -> None:
        """The weights of all readings from each place on."""
        to_end, size, window = self._to_end, self.size, self.window
        for place in range(size + 1):
            to_end[place] = noise_to_end(self.ending, size - place)
        number: i64 = len(window.marks) - 1
        header: i64 = len(window.starts) - 1
        while number >= 0:
            mark = window.marks[number]
            number -= 1
            stop, start = mark.stop, mark.start
            if stop is not None:
                weight = to_end[stop.place]
                for at in range(stop.first, stop.place):
                    to_end[at] += weight * stop.weights[at - stop.first]
            elif start is not None:
                weight = self._from_header(start)
                to_end[start.place] += weight * window.meeting(start.place)
                self._at_header[header] = weight
                header -= 1
                for at in range(start.place):
                    to_end[at] += weight * noise_to_header(start.place - at)

    def _from_header(self, start: Start) -> float:
        """The weight of all readings that begin with a frame there."""
        to_end, place, weight = self._to_end, start.place, 0.0
        for length in range(i64(1), min(start.front.cut_to, self.size - place) + 1):
            weight += start.truncated[length] * to_end[place + length]
        for number in range(start.count):
            weight += start.weights[number] * to_end[start.stops[number]]
        if place > self.size - LENGTH:
            weight += self.cut_off(start)
        return weight

    def _in_all(self, carry: Carry) -> float:
        """The weight of all readings, if this was before them."""
        total = 0.0
        for place in range(min(i64(len(carry.after_piece)), self.size + 1)):
            total += carry.after_piece[place] * self._to_end[place]
        noise = staying(self.size) * unending(self.ending)
        number: i64 = 0
        for start in self.window.starts:
            weight = self._at_header[number]
            noise += staying(start.place) * NOISE_ENDS * weight
            if start.place < len(carry.after_noise):
                total += carry.after_noise[start.place] * weight
            number += 1
        return total + carry.in_noise * noise

    def cut_off(self, start: Start) -> float:
        """The weight of a frame that begins there and goes on behind the window's end."""
        length = self.size - start.place
        if length >= LENGTH or start.front.fit < length or self.ending == BOUNDARY:
            return 0.0
        left = start.front.head[length] * WHOLE
        return left if self.ending == OPEN else left / float(LENGTH)

    # What they tell

    def probability(self, start: i64, stop: i64, weight: float) -> float:
        """The probability (0-1) of a piece of that weight at `start`."""
        return self._before(self._passed, start) * weight * self._to_end[stop] / self._total

    def _before(self, passed: Passed, place: i64) -> float:
        """The weight of all readings of what is before a place at which a piece begins."""
        meeting = self.window.meeting(place)
        return passed.after_piece[place] * meeting + passed.after_noise[place]

    def boundary(self, place: i64) -> float:
        """The probability (0-1) that no frame, whole or damaged, goes on over that place."""
        before = self._passed.after_piece[place] + self._passed.after_noise[place]
        return before * self._to_end[place] / self._total

    def whole_frames(self) -> vec[float]:
        """By header: how probable a whole frame there is (0-1); 0 where none can stand."""
        return self._whole_frames(self._passed, self._total)

    def whole_frames_behind_rows(self) -> vec[float]:
        """The same, if all rows so far are taken for granted, where that is a matter."""
        if not self._carried.ends_frame:
            return self.whole_frames()
        return self._whole_frames(self._forward(_TRUSTED, self.size), self._in_all(_TRUSTED))

    def _whole_frames(self, passed: Passed, total: float) -> vec[float]:
        starts = self.window.starts
        probable = vec[float]([0.0] * len(starts))
        number: i64 = 0
        for start in starts:
            if start.front.whole > 0.0:
                weight = self._before(passed, start.place) * start.weights[0]
                probable[number] = weight * self._to_end[start.place + LENGTH] / total
            number += 1
        return probable

    def carry(self, place: i64, *, ends_frame: bool) -> Carry:
        """What the bytes before `place`, where a row ends, say of those behind it."""
        passed = self._forward(self._carried, place)
        total = passed.in_noise
        for at in range(place, self.size + 1):
            total += passed.after_piece[at] + passed.after_noise[at]
        return Carry(
            _share(passed.after_piece, place, total),
            _share(passed.after_noise, place, total),
            passed.in_noise / total,
            ends_frame,
        )


def _fill(places: vec[float], known: vec[float]) -> None:
    for place in range(min(i64(len(known)), i64(len(places)))):
        places[place] = known[place]


def _reaching(stop: Stop, after_piece: vec[float], end: i64) -> float:
    """What the pieces that begin before `end` lay on the place behind a tail."""
    weight, weights, first = 0.0, stop.weights, stop.first
    for at in range(first, min(stop.place, end)):
        weight += after_piece[at] * weights[at - first]
    return weight


def _junk_up_to(header: i64, end: i64, after_piece: vec[float]) -> float:
    """What junk that begins before `end` lays on the place of a header."""
    weight = 0.0
    for at in range(max(i64(0), header - _JUNK_REACH), end):
        weight += after_piece[at]
    return weight * JUNK


def _lay(start: Start, weight: float, after_piece: vec[float]) -> None:
    """Lay what all readings up to a header weigh on where its pieces end."""
    truncated, place = start.truncated, start.place
    for length in range(i64(1), start.front.cut_to + 1):
        after_piece[place + length] += weight * truncated[length]
    for number in range(start.count):
        after_piece[start.stops[number]] += weight * start.weights[number]


def _share(weights: vec[float], start: i64, total: float) -> vec[float]:
    """The weights from `start` on, as shares of the total."""
    shares = vec[float]([0.0] * (len(weights) - start))
    for place in range(start, i64(len(weights))):
        shares[place - start] = weights[place] / total
    return shares
