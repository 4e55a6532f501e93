"""Owns what becomes of decided parts: the rows that they are, and what they tell of the line.

It must not decide what the bytes are; the framer does, with `calm` before it.
"""

from __future__ import annotations

from typing import Final, final

from mypy_extensions import i64

from fte_sniff.protocol.framer.fault_sets import AMBIGUOUS, NOISE, TRUNCATED
from fte_sniff.protocol.framer.places import LENGTH
from fte_sniff.protocol.framer.reading import Stretch
from fte_sniff.protocol.framer.tiling import Tiles

CALM_STREAK: Final[i64] = 100
"""Frames without damage after which a calm frame needs no further one to be believed."""

STUB: Final[i64] = LENGTH // 2
"""A truncated frame of fewer bytes tells little."""

MOST_STUBS: Final[i64] = 4
"""So many of them in a row are told one by one; more, with nothing better between, are noise."""


@final
class Line:
    """Hands what is decided to the tiles, in stream order."""

    def __init__(self) -> None:
        self.tiles = Tiles()
        """The rows since the last time."""
        self._first_frame_to = LENGTH
        """Offset behind the first frame, at most. A stream may begin within a frame: that is no
        damage of the line."""
        self._stubs: i64 = 0
        """Stubs since the last better row."""
        self._streak = CALM_STREAK
        """Frames since the last damage; a line that has shown none yet is calm."""

    def join(self, offset: i64) -> None:
        """The stream begins anew there: what comes joins nothing that came before."""
        self._first_frame_to = offset + LENGTH
        self._streak, self._stubs = CALM_STREAK, 0

    def calm(self, frames: i64 = 0) -> bool:
        """Whether the line has shown no damage for long, once so many more frames are taken."""
        return self._streak + frames >= CALM_STREAK

    def run(self, start: i64, stop: i64) -> None:
        """Frames in step, from one offset to another."""
        self.tiles.end_noise()
        self.tiles.run(start, stop)
        self._streak += (stop - start) // LENGTH
        self._stubs = 0

    def parts(self, offset: i64, reading: list[Stretch]) -> None:
        """The parts of a reading, from left to right and without gaps; counted from `offset`."""
        for part in reading:
            start, stop = offset + part.start, offset + part.stop
            if part.faults == NOISE or self._one_stub_too_many(part):
                self.tiles.noise(start, stop)
            else:
                self.tiles.end_noise()
                self.tiles.row(start, stop, part.faults, part.framed)
            if part.certain or stop <= self._first_frame_to:
                self._streak += 1
            elif part.faults != AMBIGUOUS:
                self._streak = 0

    def take(self) -> Tiles:
        """The tiles since the last time."""
        tiles, self.tiles = self.tiles, self.tiles.following()
        return tiles

    def _one_stub_too_many(self, part: Stretch) -> bool:
        """Whether this is one more of the short truncated frames that really are noise."""
        if part.faults != TRUNCATED or part.stop - part.start >= STUB:
            self._stubs = 0
            return False
        self._stubs += 1
        return self._stubs > MOST_STUBS
