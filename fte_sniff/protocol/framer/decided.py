"""Owns what becomes of decided parts: the rows that they are, and what they tell of the line.

It must not decide what the bytes are; the framer does, with `calm` before it.
"""

from __future__ import annotations

from collections.abc import Iterable

from fte_sniff.protocol.framer.choice import DOUBT
from fte_sniff.protocol.framer.reading import Stretch
from fte_sniff.protocol.framer.tiling import NOISE, Tiles
from fte_sniff.protocol.rows import Fault
from fte_sniff.protocol.table import FRAME_LENGTH

CALM_STREAK = 100
"""Frames without damage after which a calm frame needs no further one to be believed."""

STUB = FRAME_LENGTH // 2
"""A truncated frame of fewer bytes tells little."""

MOST_STUBS = 4
"""So many of them in a row are told one by one; more, with nothing better between, are noise."""

_TRUNCATED = (Fault.TRUNCATED,)


class Decided:
    """Hands what is decided to the tiles, in stream order."""

    def __init__(self, tiles: Tiles) -> None:
        self._tiles = tiles
        self._first_frame_to = FRAME_LENGTH
        """Offset behind the first frame, at most. A stream may begin within a frame: that is no
        damage of the line."""
        self._stubs = 0
        """Stubs since the last better row."""
        self._streak = CALM_STREAK
        """Frames since the last damage; a line that has shown none yet is calm."""

    def join(self, offset: int) -> None:
        """The stream begins anew there: what comes joins nothing that came before."""
        self._first_frame_to = offset + FRAME_LENGTH
        self._streak, self._stubs = CALM_STREAK, 0

    def calm(self, frames: int = 0) -> bool:
        """Whether the line has shown no damage for long, once so many more frames are taken."""
        return self._streak + frames >= CALM_STREAK

    def run(self, offset: int, data: bytes, start: int, stop: int) -> None:
        """Frames in step, from `start` to `stop` in `data`."""
        self._tiles.end_noise()
        self._tiles.run(offset, data, start, stop)
        self._streak += (stop - start) // FRAME_LENGTH
        self._stubs = 0

    def parts(self, offset: int, raw: bytes, reading: Iterable[Stretch]) -> None:
        """The parts of a reading of these bytes, from left to right and without gaps."""
        for part in reading:
            start, stop, framed, faults, _ = part
            own = raw[start:stop]
            if faults == NOISE or self._one_stub_too_many(part):
                self._tiles.noise(offset + start, own)
            else:
                self._tiles.end_noise()
                self._tiles.row(offset + start, own, faults, framed=framed)
            if part.certain or offset + stop <= self._first_frame_to:
                self._streak += 1
            elif faults != DOUBT:
                self._streak = 0

    def _one_stub_too_many(self, part: Stretch) -> bool:
        """Whether this is one more of the short truncated frames that really are noise."""
        if part.faults != _TRUNCATED or part.stop - part.start >= STUB:
            self._stubs = 0
            return False
        self._stubs += 1
        return self._stubs > MOST_STUBS
