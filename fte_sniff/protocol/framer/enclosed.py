"""Owns the reading of a stretch behind which a frame stands beyond doubt.

It must not know of chunks, times or rows, nor of what follows that frame.

    stretch frame ....    the frame fits its kind, holds no second header or tail, and no tail
                          stands so close behind it that it could begin an overlong one

Nothing behind such a frame can tell more of what stands before it. Where nothing is likely to run
over its beginning either, and a frame ended beyond doubt before the stretch too, the stretch is
read by itself; if no whole frame can stand in it, it is only divided, and nothing need be added up.
"""

from __future__ import annotations

from typing import Final

from mypy_extensions import i64

from fte_sniff.protocol.framer.carry import trusted
from fte_sniff.protocol.framer.choice import calmly, chosen
from fte_sniff.protocol.framer.ends import Back, Front, between
from fte_sniff.protocol.framer.gap import Gap
from fte_sniff.protocol.framer.likelihood import CERTAIN, JUNK
from fte_sniff.protocol.framer.noise import BOUNDARY
from fte_sniff.protocol.framer.pieces import Window
from fte_sniff.protocol.framer.places import HEADER, LENGTH, MARKS
from fte_sniff.protocol.framer.reading import Stretch
from fte_sniff.protocol.framer.shapes import BEHIND, strict, strict_from
from fte_sniff.protocol.framer.weighing import Weighing

_NEGLIGIBLE: Final = (1 - CERTAIN) / 4
_IN_STEP: Final = trusted()
_FRAME: Final = Stretch(0, LENGTH, True, 0, 1.0)
"""The frame behind the stretch, wherever it stands."""


def read_by_itself(data: bytes, start: i64, firm: i64, *, calm: bool) -> list[Stretch] | None:
    """The parts of the bytes between a frame beyond doubt and the one at `firm`, on a calm line or
    not; None where something could run over the beginning of that frame."""
    if _run_over(data, start, firm) > _NEGLIGIBLE:
        return None
    own = data[start:firm]
    if calm and len(own) >= LENGTH and strict(own, 0):
        weighing = Weighing(Window(own), _IN_STEP, BOUNDARY)
        return calmly(weighing, chosen(weighing, _FRAME))
    return _read(own)


def _read(own: bytes) -> list[Stretch]:
    window = Window(own)
    if strict_from(own, 0, window.size) < 0:
        parts = Gap(window, 0, window.size).parts()
        framed = False
        for part in parts:
            framed = framed or part.framed
            part.probability = 0.0
        if not framed:
            return parts
    return chosen(Weighing(window, _IN_STEP, BOUNDARY), _FRAME)


def _run_over(data: bytes, start: i64, firm: i64) -> float:
    """At most how probable it is that the frame at `firm` is none, because a damaged one before it
    reaches into it."""
    end = firm + LENGTH
    probability = 0.0
    whole: Front | None = None
    back: Back | None = None
    for place in range(max(start, firm - LENGTH + 1), firm):
        if MARKS[data[place]] != HEADER:
            continue
        front, length = Front(data, place, min(end, place + LENGTH)), firm - place
        if length > BEHIND and front.bad_tail == 0.0:
            continue
        if back is None or whole is None:
            back, whole = Back(data, firm, end), Front(data, firm, end)
        over = front.bad_tail * back.headless[length]
        if length <= BEHIND:
            over += between(front, back, length + LENGTH)
        probability += over / _least(front, length) / whole.whole
    return probability


def _least(front: Front, length: i64) -> float:
    """What a header and the bytes behind it weigh at least, if they go on for `length`."""
    if front.cut_to >= length:
        return max(JUNK, front.truncated(length))
    most = 1.0
    for cut in range(i64(1), front.cut_to + 1):
        most = max(most, front.truncated(cut))
    return JUNK * most
