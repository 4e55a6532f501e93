"""Owns the reading of a stretch behind which a frame stands beyond doubt.

It must not know of chunks, times or rows, nor of what follows that frame.

    stretch frame ....    the frame fits its kind, holds no second header or tail, and no tail
                          stands so close behind it that it could begin an overlong one

Nothing behind such a frame can tell more of what stands before it. Where nothing is likely to run
over its beginning either, and a frame ended beyond doubt before the stretch too, the stretch is
read by itself; if no whole frame can stand in it, it is only divided, and nothing need be added up.
What was read so is remembered: damage that leaves a few bytes leaves the same ones often.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

from fte_sniff.protocol.framer.choice import calmly, chosen
from fte_sniff.protocol.framer.ends import CANONICAL, Front, back_of, between, front_of
from fte_sniff.protocol.framer.gap import Gap
from fte_sniff.protocol.framer.likelihood import CERTAIN, JUNK
from fte_sniff.protocol.framer.patterns import FIRM_FRAMES, HEADER, STRICT
from fte_sniff.protocol.framer.pieces import Window
from fte_sniff.protocol.framer.reading import Stretch
from fte_sniff.protocol.framer.weighing import Ending, Weighing, trusted
from fte_sniff.protocol.structure import LONGEST_OVERLONG
from fte_sniff.protocol.table import FRAME_LENGTH

BEHIND = LONGEST_OVERLONG - FRAME_LENGTH
"""Bytes behind the frame that must be known."""

_REMEMBERED: Final = 1 << 12
_NEGLIGIBLE: Final = (1 - CERTAIN) / 4
_IN_STEP = trusted()
_FRAME = Stretch(0, FRAME_LENGTH, True, (), 1.0)
"""The frame behind the stretch, wherever it stands."""


def firm_frame(data: bytes, start: int, stop: int) -> int | None:
    """Where the next frame beyond doubt stands, with what must be known behind it."""
    found = FIRM_FRAMES.search(data, start, stop)
    return None if found is None else found.start()


def read_by_itself(data: bytes, start: int, firm: int, *, calm: bool) -> tuple[Stretch, ...] | None:
    """The parts of the bytes between a frame beyond doubt and the one at `firm`, on a calm line or
    not; None where something could run over the beginning of that frame."""
    own = data[start : firm + FRAME_LENGTH].translate(CANONICAL)
    if _run_over(own) > _NEGLIGIBLE:
        return None
    return (_read_calmly if calm else _read)(own[:-FRAME_LENGTH])


def _run_over(own: bytes) -> float:
    """At most how probable it is that the frame at the end of these bytes is none, because a
    damaged one before it reaches into it."""
    size = len(own) - FRAME_LENGTH
    probability, back = 0.0, None
    for header in HEADER.finditer(own, max(0, size - FRAME_LENGTH + 1), size):
        place = header.start()
        front, length = front_of(own[place : place + FRAME_LENGTH]), size - place
        if length > BEHIND and not front.bad_tail:
            continue
        back = back or back_of(own[size:])
        over = front.bad_tail * back.headless[-length]
        if length <= BEHIND:
            over += between(front, back, length + FRAME_LENGTH)
        probability += over / _least(front, length) / front_of(own[size:]).whole
    return probability


def _least(front: Front, length: int) -> float:
    """What a header and the bytes behind it weigh at least, if they go on for `length`."""
    truncated = front.truncated
    if len(truncated) >= length:
        return max(JUNK, truncated[length - 1])
    return JUNK * max(1.0, *truncated)


@lru_cache(_REMEMBERED)
def _read(own: bytes) -> tuple[Stretch, ...]:
    window = Window(own)
    if STRICT.search(own) is None:
        parts = tuple([part for part, _ in Gap(window, 0, len(own)).parts()])
        if not any(part.framed for part in parts):
            return parts
    return tuple(chosen(Weighing(window, _IN_STEP, Ending.BOUNDARY), _FRAME))


@lru_cache(_REMEMBERED)
def _read_calmly(own: bytes) -> tuple[Stretch, ...]:
    if STRICT.match(own) is None:
        return _read(own)
    weighing = Weighing(Window(own), _IN_STEP, Ending.BOUNDARY)
    return tuple(calmly(weighing, chosen(weighing, _FRAME)))
