"""Owns which pieces can begin at a place of a window, where each ends, and how much it weighs.

It must not know which pieces make the best reading, nor what came before the window. A piece is a
whole frame, or a damaged one: truncated, overlong, or ten bytes of which some are wrong. (Noise is
no piece: it fills what lies between.)

Three things give a piece its weight, and `ends` knows them: the header at its front, the tail at
its back, and both together. So a window is told by its headers and its tails:

    at a header   pieces cut off behind it (truncated, or the tail wrong), and those to each tail
    at a tail     pieces that reach it from places where no header stands
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, final

from librt.vecs import vec
from mypy_extensions import i64

from fte_sniff.protocol.framer.ends import LONGEST, Back, Front, between
from fte_sniff.protocol.framer.likelihood import PAUSE_WITHIN, UNPAUSED
from fte_sniff.protocol.framer.places import HEADER, LENGTH, MARKS

_MOST_ENDS: Final[i64] = 1 + LONGEST
"""Pieces that begin with one header and are not truncated: ten bytes, and one for each tail."""


@final
class Start:
    """A header in a window, and the pieces that begin with it."""

    def __init__(self, place: i64, front: Front) -> None:
        self.place = place
        self.front = front
        self.truncated = vec[float]([0.0] * LENGTH)
        """By length from 1 to what the front is cut to: the weight of the frame going on no
        further."""
        for length in range(1, front.cut_to + 1):
            self.truncated[length] = front.truncated(length)
        self.count: i64 = 0
        """How many other pieces there are; a whole frame is the first."""
        self.stops = vec[i64]([i64(0)] * _MOST_ENDS)
        """Where each of them stops."""
        self.weights = vec[float]([0.0] * _MOST_ENDS)
        """What each of them weighs."""

    def add(self, stop: i64, weight: float) -> None:
        """One more piece."""
        self.stops[self.count], self.weights[self.count] = stop, weight
        self.count += 1


@final
class Stop:
    """A tail in a window, and the pieces that reach it from places where no header stands."""

    def __init__(self, place: i64, back: Back) -> None:
        self.place = place
        """Behind the tail."""
        self.back = back
        self.first = max(i64(0), place - LONGEST)
        """The first place from which one can reach it."""
        self.weights = vec[float]([0.0] * LONGEST)
        """By place from `first` to the tail: the weight of the piece; 0 where a header stands."""
        for start in range(self.first, place):
            self.weights[start - self.first] = back.headless[place - start]


@final
class Mark:
    """A header or a tail in a window."""

    def __init__(self, start: Start | None, stop: Stop | None) -> None:
        self.start = start
        self.stop = stop


@final
class Window:
    """A stretch of bytes, and the pieces that can stand in it."""

    def __init__(self, data: bytes, pauses: Sequence[i64] = ()) -> None:
        """`pauses` are the places in `data` before which the line was silent for a while."""
        self.data = data
        self.pauses = pauses
        self.paused = len(pauses) > 0
        self.size: i64 = len(data)
        self.starts: list[Start] = []
        """Every header, from left to right."""
        self.stops: list[Stop] = []
        """Every tail, from left to right."""
        self.marks: list[Mark] = []
        """Both, in the order of their places; where a tail ends and a header stands, the tail."""
        for place in range(self.size):
            mark = MARKS[data[place]]
            if mark == HEADER:
                self._add_start(place)
            elif mark != 0:
                self._add_stop(place + 1)

    def _add_start(self, place: i64) -> None:
        start = Start(place, Front(self.data, place, min(self.size, place + LENGTH)))
        front = start.front
        if front.whole > 0.0:
            start.add(place + LENGTH, self._paused(place, place + LENGTH, front.whole))
        elif front.bad_tail > 0.0:
            start.add(place + LENGTH, self._paused(place, place + LENGTH, front.bad_tail))
        if self.paused:
            for length in range(1, front.cut_to + 1):
                own = start.truncated[length]
                start.truncated[length] = self._paused(place, place + length, own)
        self.starts.append(start)
        self.marks.append(Mark(start, None))

    def _add_stop(self, place: i64) -> None:
        stop = Stop(place, Back(self.data, max(i64(0), place - LENGTH), place))
        number: i64 = len(self.starts) - 1
        while number >= 0:
            start = self.starts[number]
            length = place - start.place
            if length > LONGEST:
                break
            stop.weights[start.place - stop.first] = 0.0
            if length > 1 and not (length == LENGTH and start.front.whole > 0.0):
                own = between(start.front, stop.back, length)
                start.add(place, self._paused(start.place, place, own))
            number -= 1
        if self.paused:
            for at in range(stop.first, place):
                own = self._paused(at, place, stop.weights[at - stop.first]) * self.meeting(at)
                stop.weights[at - stop.first] = own
        self.stops.append(stop)
        self.marks.append(Mark(None, stop))

    def _paused(self, start: i64, stop: i64, weight: float) -> float:
        """The weight of a piece, seeing where the line paused within."""
        if not self.paused:
            return weight
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
                weights[stop.place] = self._paused(0, stop.place, stop.back.rest(stop.place))
        return weights
