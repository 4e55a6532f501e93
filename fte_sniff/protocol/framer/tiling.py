"""Owns decided bytes as tiles: which stretches of the stream are one row each, and which are runs.

It must not decide anything, nor hold bytes or times: the framer says what each stretch is, in
stream order and without gaps, and a tile is where it starts and what it is.
"""

from __future__ import annotations

from typing import Final, final

from librt.vecs import append, vec
from mypy_extensions import i64

from fte_sniff.protocol.framer.fault_sets import NOISE
from fte_sniff.protocol.framer.places import LENGTH

LONGEST_ROW: Final[i64] = 1024
"""Bytes in a row of noise."""

_NONE: Final[i64] = -1


@final
class Tiles:
    """What was decided since the last time, side by side: a number in each list for every tile."""

    def __init__(self, start: i64 = 0) -> None:
        """Tiles of a stream from that offset on."""
        self.starts = vec[i64]()
        """Offsets of the first bytes."""
        self.counts = vec[i64]()
        """How many rows each one is."""
        self.codes = vec[i64]()
        """What each row of it is: twice a number of `fault_sets`, and one more for a frame."""
        self.end = start
        """Offset behind the last tile."""
        self.noise_from: i64 = _NONE
        """Where the noise begins that is in no tile yet: more may follow;
        -1 where there is none."""
        self._noise_to: i64 = _NONE

    def run(self, start: i64, stop: i64) -> None:
        """Frames in step with nothing wrong."""
        self._add(start, (stop - start) // LENGTH, 1)
        self.end = stop

    def row(self, start: i64, stop: i64, faults: i64, framed: bool) -> None:
        """One row, behind whatever noise has been ended."""
        self._add(start, 1, 2 * faults + (1 if framed else 0))
        self.end = stop

    def noise(self, start: i64, stop: i64) -> None:
        """Noise, which goes on what noise stood before; it may go on behind."""
        if self.noise_from == _NONE:
            self.noise_from = start
        self._noise_to = stop
        while stop - self.noise_from > LONGEST_ROW:
            cut = self.noise_from + LONGEST_ROW
            self.row(self.noise_from, cut, NOISE, False)
            self.noise_from = cut

    def end_noise(self) -> None:
        """Noise that follows is another row, as anything else is."""
        if self.noise_from != _NONE:
            self.row(self.noise_from, self._noise_to, NOISE, False)
            self.noise_from = _NONE

    def following(self) -> Tiles:
        """Where the tiles behind these go to, and the noise that is in none."""
        behind = Tiles(self.end)
        behind.noise_from, behind._noise_to = self.noise_from, self._noise_to
        return behind

    def _add(self, start: i64, count: i64, code: i64) -> None:
        self.starts = append(self.starts, start)
        self.counts = append(self.counts, count)
        self.codes = append(self.codes, code)
