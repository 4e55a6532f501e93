"""Owns how bytes in which no whole frame is shown are divided: into the pieces that weigh most.

It must not know of chunks, times or rows, nor how probable its pieces are: `weighing` does. What
lies in such a gap is damaged frames and noise; it begins and ends where a frame ends or begins.
"""

from __future__ import annotations

from typing import Final, final

from librt.vecs import vec
from mypy_extensions import i64, mypyc_attr

from fte_sniff.protocol.framer.ends import Front
from fte_sniff.protocol.framer.fault_sets import BAD_HEADER, BAD_TAIL, NOISE, OVERLONG, TRUNCATED
from fte_sniff.protocol.framer.noise import noise_run
from fte_sniff.protocol.framer.pieces import Window
from fte_sniff.protocol.framer.places import ENDING, HEADER, LENGTH, MARKS
from fte_sniff.protocol.framer.reading import Stretch
from fte_sniff.protocol.framer.shapes import faults_of_framed

_NOISE: Final = -1.0
"""Stands for the weight of a piece where the last part is noise."""


@final
@mypyc_attr(acyclic=True, free_list_len=1)
class Gap:
    """What lies between two shown frames, or behind the last."""

    def __init__(self, window: Window, start: i64, stop: i64) -> None:
        """From `start` to `stop` in the window."""
        self._window = window
        self._start = start
        self._stop = stop
        size = stop - start + 1
        self._best = vec[float]([0.0] * size)
        """By place from the start on: the weight of the best reading up to it; 0 where none is."""
        self._begins = vec[i64]([i64(0)] * size)
        """Where the last part of that reading begins."""
        self._pieces = vec[float]([0.0] * size)
        """What the piece weighs that this part is; `_NOISE` where it is none."""
        self._best[0] = 1.0
        self._begins[0] = start
        self._extend_all()

    def _extend_all(self) -> None:
        window = self._window
        first_header: i64 = 0
        headers: i64 = len(window.starts)
        for place in range(self._start, self._stop):
            while first_header < headers and window.starts[first_header].place < place:
                first_header += 1
            if self._best[place - self._start] > 0.0:
                self._extend(place, first_header)

    def _extend(self, place: i64, number: i64) -> None:
        """Go on from a place with all that can begin there; `number` is that of the next header."""
        at = place - self._start
        weight, window = self._best[at], self._window
        behind_noise = self._pieces[at] == _NOISE
        headed = MARKS[window.data[place]] == HEADER
        meeting = weight if behind_noise else weight * window.meeting(place)
        if headed:
            self._extend_from_header(window.starts[number], meeting)
            number += 1
        self._extend_to_tails(place, meeting)
        if behind_noise:
            return
        while number < len(window.starts) and window.starts[number].place < self._stop:
            stop = window.starts[number].place
            self._reach(stop, place, weight * noise_run(stop - place), _NOISE)
            number += 1
        self._reach(self._stop, place, weight * noise_run(self._stop - place), _NOISE)

    def _extend_from_header(self, front: Front, weight: float) -> None:
        window, place = self._window, front.place
        for length in range(i64(1), front.cut_to + 1):
            own = window.truncated(front, length)
            self._reach(place + length, place, weight * own, own)
        own = window.bad_tail(front)
        if own > 0.0:
            self._reach(place + LENGTH, place, weight * own, own)

    def _extend_to_tails(self, place: i64, weight: float) -> None:
        for stop in self._window.stops:
            if stop.first <= place < stop.place:
                own = stop.weights[place - stop.first]
                self._reach(stop.place, place, weight * own, own)

    def _reach(self, stop: i64, begin: i64, weight: float, piece: float) -> None:
        """A reading that reaches `stop` with a part from `begin` on."""
        if stop > self._stop:
            return
        at = stop - self._start
        if weight > self._best[at]:
            self._best[at], self._begins[at], self._pieces[at] = weight, begin, piece

    def end_with_cut_off(self, front: Front, own: float) -> None:
        """Let the gap end with a frame that begins there and goes on, where that is best."""
        if front.place >= self._start and own > 0.0:
            weight = self._best[front.place - self._start] * own
            self._reach(self._stop, front.place, weight, own)

    def parts(self) -> list[Stretch]:
        """The parts from left to right; the probability of each is the weight of its piece."""
        parts: list[Stretch] = []
        place = self._stop
        while place > self._start:
            at = place - self._start
            parts.append(_part(self._window.data, self._begins[at], place, self._pieces[at]))
            place = self._begins[at]
        parts.reverse()
        return parts


def _part(data: bytes, start: i64, stop: i64, piece: float) -> Stretch:
    """What these bytes are, as the piece or as noise."""
    if piece == _NOISE:
        return Stretch(start, stop, False, NOISE, 0.0)
    fault = _named(data, start, stop)
    if fault:
        return Stretch(start, stop, False, fault, piece)
    return Stretch(start, stop, True, faults_of_framed(data, start), piece)


def _named(data: bytes, start: i64, stop: i64) -> i64:
    """What is wrong with the bytes of a piece; 0 where they are framed."""
    size = stop - start
    headed = MARKS[data[start]] == HEADER
    if size != LENGTH:
        if not headed:
            return NOISE
        return TRUNCATED if size < LENGTH else OVERLONG
    if not headed:
        return BAD_HEADER
    return i64(0) if MARKS[data[stop - 1]] == ENDING else BAD_TAIL
