"""Owns the reading of a stretch behind which a frame stands beyond doubt.

It must not know of chunks, times or rows, nor of what follows that frame.

    stretch frame ....    the frame fits its kind, holds no second header or tail, and no tail
                          stands so close behind it that it could begin an overlong one

Nothing behind such a frame can tell more of what stands before it. Only what can run over its
beginning is weighed together with it: a header so close before it that one overlong frame could
reach its tail. Else, and if a frame ended beyond doubt before the stretch too, the stretch is read
by itself; and if no whole frame can stand in it, it is only divided, and nothing need be added up.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

from fte_sniff.protocol.framer.ends import CANONICAL
from fte_sniff.protocol.framer.gap import Gap
from fte_sniff.protocol.framer.patterns import FIRM_FRAMES, HEADER, STRICT
from fte_sniff.protocol.framer.pieces import Window
from fte_sniff.protocol.framer.reading import Stretch
from fte_sniff.protocol.structure import LONGEST_OVERLONG
from fte_sniff.protocol.table import FRAME_LENGTH

BEHIND = LONGEST_OVERLONG - FRAME_LENGTH
"""Bytes behind the frame that must be known."""

_REMEMBERED: Final = 1 << 12


def firm_frame(data: bytes, start: int, stop: int) -> int | None:
    """Where the next frame beyond doubt stands, with what must be known behind it."""
    found = FIRM_FRAMES.search(data, start, stop)
    return None if found is None else found.start()


def simply_divided(data: bytes, start: int, stop: int) -> tuple[Stretch, ...] | None:
    """The parts of the bytes between a frame beyond doubt and another, if no frame is in them."""
    if HEADER.search(data, max(start, stop - BEHIND), stop) or STRICT.search(data, start, stop):
        return None
    return _divided(data[start:stop].translate(CANONICAL))


@lru_cache(_REMEMBERED)
def _divided(own: bytes) -> tuple[Stretch, ...] | None:
    parts = tuple([part for part, _ in Gap(Window(own), 0, len(own)).parts()])
    return None if any(part.framed for part in parts) else parts
