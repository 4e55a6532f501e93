"""Owns how bytes in which no whole frame is shown are divided: into the pieces that weigh most.

It must not know of chunks, times or rows, nor how probable its pieces are: `weighing` does. What
lies in such a gap is damaged frames and noise; it begins and ends where a frame ends or begins.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from fte_sniff.protocol.codec import frame_faults
from fte_sniff.protocol.framer.likelihood import (
    JUNK,
    LONGEST_JUNK,
    NOISE_BEGINS,
    NOISE_ENDS,
    NOISE_STAYS,
)
from fte_sniff.protocol.framer.pieces import Piece, Start, Window
from fte_sniff.protocol.framer.reading import Stretch
from fte_sniff.protocol.rows import Fault
from fte_sniff.protocol.structure import HEADER_BYTES
from fte_sniff.protocol.table import FRAME_LENGTH, TAIL

_Best: TypeAlias = dict[int, tuple[float, int, Piece | None]]
"""By place: the weight of the best reading up to it, where its last part begins, and the piece
that this is; None for noise."""

_NOTHING = (0.0, 0, None)
"""A place that no reading has reached."""


class Gap:
    """What lies between two shown frames, or behind the last."""

    def __init__(self, window: Window, start: int, stop: int) -> None:
        """From `start` to `stop` in the window."""
        self._window = window
        self._start, self._stop = start, stop
        self._headers = [header.place for header in window.starts if start < header.place < stop]
        self._best: _Best = {start: (1.0, start, None)}
        for place in range(start, stop):
            if place in self._best:
                self._extend(place)

    def end_with_cut_off(self, cut_off: Callable[[Start], float]) -> None:
        """Let the gap end with a frame that goes on behind it, where that is best.

        `cut_off` weighs such a frame by its header.
        """
        for start in self._window.starts:
            place, own = start.place, cut_off(start)
            if place in self._best:
                weight = self._best[place][0] * own
                if weight > self._best.get(self._stop, _NOTHING)[0]:
                    self._best[self._stop] = weight, place, (self._stop, own, False)

    def parts(self) -> list[tuple[Stretch, float]]:
        """The parts from left to right, and the weight of each piece among them."""
        parts: list[tuple[Stretch, float]] = []
        place = self._stop
        while place > self._start:
            _, begin, piece = self._best[place]
            raw = self._window.data[begin:place]
            parts.append((_part(begin, raw, piece), piece[1] if piece else 0.0))
            place = begin
        return parts[::-1]

    def _extend(self, place: int) -> None:
        best, end = self._best, self._stop
        weight, begin, last = best[place]
        window = self._window
        meeting = weight if last is None and begin != place else weight * window.meeting(place)
        for piece in window.pieces_at(place):
            stop, own, whole = piece
            if stop <= end and not whole and meeting * own > best.get(stop, _NOTHING)[0]:
                best[stop] = meeting * own, place, piece
        if last is None and begin != place:
            return
        for stop in (*self._headers, end):
            if place < stop:
                noise = weight * _NOISE_WEIGHT[stop - place]
                if noise > best.get(stop, _NOTHING)[0]:
                    best[stop] = noise, place, None


def _part(start: int, raw: bytes, piece: Piece | None) -> Stretch:
    """What these bytes are, as the piece or, without one, as noise."""
    fault = _named(raw) if piece else Fault.NOISE
    framed = fault is None
    return Stretch(start, start + len(raw), framed, (fault,) if fault else frame_faults(raw), 0.0)


def _named(raw: bytes) -> Fault | None:
    """What is wrong with the bytes of a piece; None where they are framed."""
    if len(raw) != FRAME_LENGTH:
        if raw[0] not in HEADER_BYTES:
            return Fault.NOISE
        return Fault.TRUNCATED if len(raw) < FRAME_LENGTH else Fault.OVERLONG
    if raw[0] not in HEADER_BYTES:
        return Fault.BAD_HEADER
    return None if raw[-1] == TAIL else Fault.BAD_TAIL


def _noise_weight(length: int) -> float:
    if length <= LONGEST_JUNK:
        return JUNK
    return NOISE_BEGINS * NOISE_ENDS * NOISE_STAYS ** (length - 1)


_NOISE_WEIGHT = tuple(_noise_weight(length) for length in range(512))
"""By length in bytes: the weight of one run of noise."""
