"""Owns which pieces can begin at a place of a window, where each ends, and how much it weighs.

It must not know which pieces make the best reading, nor what came before the window. A piece is a
whole frame, or a damaged one: truncated, overlong, or ten bytes of which some are wrong. (Noise is
no piece: it fills what lies between.)

Three things give a piece its weight, and `ends` knows them: the header at its front, the tail at
its back, and both together. So a window is told by its headers and its tails:

    at a header   pieces that end behind it where no tail need be: truncated, or the tail wrong;
                  and the whole frame
    at a tail     all other pieces that reach it: from headers, and from places without one
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, final

from librt.vecs import append, vec
from mypy_extensions import i64, mypyc_attr

from fte_sniff.protocol.framer.ends import LONGEST, Back, Front, between
from fte_sniff.protocol.framer.likelihood import PAUSE_WITHIN, UNPAUSED
from fte_sniff.protocol.framer.places import HEADER, LENGTH, MARKS


@final
@mypyc_attr(acyclic=True)
class Stop:
    """A tail in a window, and the pieces that reach it."""

    def __init__(self, place: i64, back: Back) -> None:
        self.place = place
        """Behind the tail."""
        self.back = back
        self.first = max(i64(0), place - LONGEST)
        """The first place from which one can reach it."""
        self.weights = vec[float]([0.0] * LONGEST)
        """By place from `first` to the tail: the weight of the piece that is no whole frame."""


AT_TAIL: Final[i64] = 1
"""In a mark: it is a tail, not a header."""


@final
@mypyc_attr(acyclic=True, free_list_len=1)
class Window:
    """A stretch of bytes, and the pieces that can stand in it."""

    def __init__(self, data: bytes, pauses: Sequence[i64] = ()) -> None:
        """`pauses` are the places in `data` before which the line was silent for a while."""
        self.data = data
        self.pauses = pauses
        self.paused = len(pauses) > 0
        self.size: i64 = len(data)
        self.starts: list[Front] = []
        """Every header, from left to right."""
        self.stops: list[Stop] = []
        """Every tail, from left to right."""
        self.marks = vec[i64]()
        """Both, in the order of their places; where a tail ends and a header stands, the tail. Each
        is twice its number among its like, and `AT_TAIL`."""
        for place in range(self.size):
            mark = MARKS[data[place]]
            if mark == HEADER:
                self.marks = append(self.marks, 2 * i64(len(self.starts)))
                self.starts.append(Front(data, place, min(self.size, place + LENGTH)))
            elif mark != 0:
                self.marks = append(self.marks, 2 * i64(len(self.stops)) + AT_TAIL)
                self.stops.append(self._stop(place + 1))

    def _stop(self, place: i64) -> Stop:
        """A tail, with all that reaches the place behind it."""
        back = Back(self.data, max(i64(0), place - LENGTH), place)
        stop = Stop(place, back)
        weights, first, headless = stop.weights, stop.first, back.headless
        for at in range(first, place):
            weights[at - first] = headless[place - at]
        number: i64 = len(self.starts) - 1
        while number >= 0 and self.starts[number].place >= first:
            front = self.starts[number]
            length = place - front.place
            whole = length == LENGTH and front.whole > 0.0
            weights[front.place - first] = 0.0 if whole else between(front, back, length)
            number -= 1
        if self.paused:
            for at in range(first, place):
                weights[at - first] *= self.unpaused(at, place)
                if MARKS[self.data[at]] != HEADER:
                    weights[at - first] *= self.meeting(at)
        return stop

    def truncated(self, front: Front, length: i64) -> float:
        """The weight of a frame cut off at that length."""
        weight = front.truncated(length)
        return weight * self.unpaused(front.place, front.place + length) if self.paused else weight

    def whole(self, front: Front) -> float:
        """The weight of a whole frame; 0 where none stands."""
        return self._ten(front, front.whole)

    def bad_tail(self, front: Front) -> float:
        """The weight of ten bytes of which the last are wrong; 0 where none stand."""
        return self._ten(front, front.bad_tail)

    def _ten(self, front: Front, weight: float) -> float:
        if self.paused and weight > 0.0:
            return weight * self.unpaused(front.place, front.place + LENGTH)
        return weight

    def unpaused(self, start: i64, stop: i64) -> float:
        """What a piece weighs the less, seeing where the line paused within."""
        weight = 1.0
        for pause in self.pauses:
            if start < pause < stop:
                weight *= PAUSE_WITHIN
        return weight

    def meeting(self, place: i64) -> float:
        """The weight of two pieces meeting there, of which the second begins with a header.

        (It is within the weight of one that begins with none. Noise meets a frame for nothing: junk
        stands right before it.)
        """
        if not self.paused or place == 0 or place in self.pauses:
            return 1.0
        return UNPAUSED

    def rests_from_first(self, longest: i64) -> vec[float]:
        """By length, up to `longest`: the weight of the first bytes being a frame's last."""
        weights = vec[float]([0.0] * (longest + 1))
        for stop in self.stops:
            if stop.place <= longest:
                weights[stop.place] = stop.back.rest(stop.place) * self.unpaused(0, stop.place)
        return weights
