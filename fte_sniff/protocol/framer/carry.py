"""Owns what the bytes before a place say about the places from there on.

It must not know which reading is chosen, nor weigh one.
"""

from __future__ import annotations

from typing import final

from librt.vecs import vec
from mypy_extensions import i64, mypyc_attr

from fte_sniff.protocol.framer.pieces import Window
from fte_sniff.protocol.framer.places import LENGTH


@final
@mypyc_attr(acyclic=True, free_list_len=1)
class Carry:
    """The weights of the readings so far, by where they end."""

    def __init__(
        self,
        after_piece: vec[float],
        after_noise: vec[float],
        in_noise: float,
        ends_frame: bool = False,
        within: float = 0.0,
    ) -> None:
        self.after_piece = after_piece
        """By place: the weight of all readings of the bytes before it whose last piece ends
        there."""
        self.after_noise = after_noise
        """The same for readings that end there with noise."""
        self.in_noise = in_noise
        """The weight of readings with long noise going on at the first place."""
        self.ends_frame = ends_frame
        """Whether the rows so far end here with a frame, or with something else of known length."""
        self.within = within
        """The weight of the first place being anywhere within a frame; only where a stream
        begins."""

    def joining(self, window: Window) -> Carry:
        """The same for a window whose first piece may be the rest of a frame begun before."""
        rests = window.rests_from_first(LENGTH - 1)
        weights = vec[float]([0.0] * (max(len(rests), len(self.after_piece))))
        for place in range(i64(len(self.after_piece))):
            weights[place] = self.after_piece[place]
        for place in range(i64(1), i64(len(rests))):
            weights[place] += self.within / float(LENGTH - 1) * rests[place]
        return Carry(weights, self.after_noise, self.in_noise, self.ends_frame, self.within)


def trusted() -> Carry:
    """A frame ends here beyond doubt."""
    return Carry(vec[float]([1.0]), vec[float](), 0.0)


def joined() -> Carry:
    """The stream begins here: between two frames, or anywhere within one, or in noise."""
    return Carry(vec[float]([0.5]), vec[float](), 0.01, within=0.5)


def settled() -> Carry:
    """The line was silent here: something ended, or long noise goes on."""
    return Carry(vec[float]([1.0]), vec[float](), 0.05)


def lost() -> Carry:
    """Long noise is going on."""
    return Carry(vec[float](), vec[float](), 1.0)
