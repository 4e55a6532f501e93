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

import re
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

from fte_sniff.protocol.framer.ends import CANONICAL, Back, Front, back_of, between, front_of
from fte_sniff.protocol.framer.likelihood import PAUSE_WITHIN, UNPAUSED
from fte_sniff.protocol.structure import HEADER_BYTES, LONGEST_OVERLONG
from fte_sniff.protocol.table import FRAME_LENGTH, TAIL

Piece: TypeAlias = tuple[int, float, bool]
"""Where it stops, its weight, and whether it is a frame that fits its kind at every place."""


class Start(NamedTuple):
    """A header in a window, and the pieces that begin with it."""

    place: int
    front: Front
    truncated: Sequence[float]
    """By length from 1: the weight of the frame going on no further."""
    ends: list[Piece]
    """All other pieces, a whole frame first."""


class Stop(NamedTuple):
    """A tail in a window, and the pieces that reach it from places where no header stands."""

    place: int
    """Behind the tail."""
    first: int
    """The first place from which one can reach it."""
    headless: Sequence[float]
    """By place from `first` to the tail: the weight of the piece; 0 where a header stands."""
    back: Back


_MARK = re.compile(b"[%b%b]" % (re.escape(HEADER_BYTES), re.escape(bytes([TAIL]))))


class Window:
    """A stretch of bytes, and the pieces that can stand in it."""

    def __init__(self, data: bytes, pauses: Sequence[int] = ()) -> None:
        """`pauses` are the places in `data` before which the line was silent for a while."""
        self.data = data
        self.pauses = pauses
        own = data.translate(CANONICAL)
        self.starts: list[Start] = []
        """Every header, from left to right."""
        self.stops: list[Stop] = []
        """Every tail, from left to right."""
        self.marks: list[Start | Stop] = []
        """Both, in the order of their places; where a tail ends and a header stands, the tail."""
        for mark in _MARK.finditer(data):
            place = mark.start()
            if data[place] != TAIL:
                self._add_start(place, front_of(own[place : place + FRAME_LENGTH]))
            else:
                first = max(0, place + 1 - FRAME_LENGTH)
                self._add_stop(place + 1, back_of(own[first : place + 1]))

    def _add_start(self, place: int, front: Front) -> None:
        ends: list[Piece] = []
        truncated: Sequence[float] = front.truncated
        if front.whole:
            ends.append((place + FRAME_LENGTH, front.whole, True))
        elif front.bad_tail:
            ends.append((place + FRAME_LENGTH, front.bad_tail, False))
        if self.pauses:
            ends = [(stop, self._paused(place, stop, own), whole) for stop, own, whole in ends]
            truncated = [
                self._paused(place, stop, own)
                for stop, own in enumerate(truncated, start=place + 1)
            ]
        start = Start(place, front, truncated, ends)
        self.starts.append(start)
        self.marks.append(start)

    def _add_stop(self, place: int, back: Back) -> None:
        first = max(0, place - LONGEST_OVERLONG)
        headless = list(back.headless[first - place :])
        for start in reversed(self.starts):
            at, front, _, ends = start
            length = place - at
            if length > LONGEST_OVERLONG:
                break
            headless[at - first] = 0.0
            if length > 1 and not (front.whole and length == FRAME_LENGTH):
                own = between(front, back, length)
                if self.pauses:
                    own = self._paused(at, place, own)
                ends.append((place, own, False))
        if self.pauses:
            headless = [
                self._paused(start, place, own) * self.meeting(start)
                for start, own in enumerate(headless, start=first)
            ]
        stop = Stop(place, first, headless, back)
        self.stops.append(stop)
        self.marks.append(stop)

    def _paused(self, start: int, stop: int, weight: float) -> float:
        """The weight of a piece, seeing where the line paused within."""
        within = sum(start < pause < stop for pause in self.pauses)
        return weight * PAUSE_WITHIN**within

    def meeting(self, place: int) -> float:
        """The weight of two pieces meeting there, of which the second begins with a header.

        (It is within the weight of one that begins with none. Noise meets a frame for nothing: junk
        stands right before it.)
        """
        return UNPAUSED if self.pauses and place and place not in self.pauses else 1.0

    def pieces_at(self, place: int) -> list[Piece]:
        """Every piece that can begin at `place`."""
        if self.data[place] in HEADER_BYTES:
            start = next(start for start in self.starts if start.place == place)
            cut = enumerate(start.truncated, start=place + 1)
            return [*((stop, own, False) for stop, own in cut), *start.ends]
        return [
            (stop, headless[place - first], False)
            for stop, first, headless, _ in self.stops
            if first <= place < stop
        ]

    def rests_from_first(self, longest: int) -> list[float]:
        """By length, from 1 to `longest`: the weight of the first bytes being a frame's last."""
        weights = [0.0] * min(longest, len(self.data))
        for place, _, _, back in self.stops:
            if place <= longest:
                weights[place - 1] = self._paused(0, place, back.rest(place))
        return weights
