"""Owns the short cut: damage that has one reading only, so that nothing needs weighing.

It must not read bytes otherwise than weighing does; it is only quicker, by far, for the damage that
is the most common: one piece between plain frames, with no header or tail in it but its own. (Very
rarely weighing doubts one of those frames by a hair, where this does not.)

    [frame] damage frame frame      each frame fits its kind, and holds no header or tail inside

Pieces that together with the frame before or behind them could be one overlong frame are left to
weighing.
"""

from __future__ import annotations

import re

from fte_sniff.protocol.codec import frame_faults
from fte_sniff.protocol.likelihood import LONGEST_JUNK, WIDEST_CHANGE
from fte_sniff.protocol.reading import Stretch
from fte_sniff.protocol.rows import Fault
from fte_sniff.protocol.structure import (
    HEADER_BYTES,
    LONGEST_OVERLONG,
    head_fit,
    kinds_of,
    legal_bytes,
    rest_fit,
    split_damaged,
)
from fte_sniff.protocol.table import CMD_PLACE, FRAME_LENGTH, KINDS, NUM_PLACE, TAIL, FrameKind

_HEADER = b"[%b]" % re.escape(HEADER_BYTES)
_TAIL = re.escape(bytes([TAIL]))
_CALM = b"[^%b%b]" % (re.escape(HEADER_BYTES), _TAIL)


def _plain(kind: FrameKind) -> bytes:
    """A frame that fits its kind, with NUM as usual and no header or tail inside."""
    places = [_CALM if legal is None else b"[%b]" % re.escape(legal) for legal in legal_bytes(kind)]
    if legal_bytes(kind)[NUM_PLACE] is None:
        places[NUM_PLACE] = rb"\x00"
    return b"".join(places)


_PLAIN = b"(?:%b)" % b"|".join(_plain(kind) for kind in KINDS)
_ALONE = LONGEST_OVERLONG - FRAME_LENGTH + 1
"""Bytes that are too many for one overlong frame together with a whole one."""
_LEAST_LEFT = FRAME_LENGTH - WIDEST_CHANGE

_NOISE = b"(?P<noise>%b{1,%d}|%b{%d,%d}%b)" % (
    *(_CALM, LONGEST_JUNK),
    *(_CALM, _ALONE - 1, FRAME_LENGTH - 2, _TAIL),
)
_HEADED = b"(?P<headed>%b%b{%d,%d})" % (_HEADER, _CALM, _ALONE - 1, FRAME_LENGTH - 1)
_TAILED = b"(?P<tailed>%b{%d}%b)" % (_CALM, FRAME_LENGTH - 1, _TAIL)
_BOTH = b"(?P<both>%b%b{%d,%d}%b)" % (*(_HEADER, _CALM, _ALONE - 2, LONGEST_OVERLONG - 2, _TAIL),)
_SHAPE = re.compile(
    b"(?:%b)?(?:%b)%b{2}" % (_PLAIN, b"|".join((_NOISE, _HEADED, _TAILED, _BOTH)), _PLAIN),
    re.DOTALL,
)
_FRAMED_BETWEEN = re.compile(
    b"%b%b%b{%d}%b%b" % (_PLAIN, _HEADER, _CALM, FRAME_LENGTH - 2, _TAIL, _PLAIN), re.DOTALL
)


def undisputed(window: bytes) -> list[Stretch] | None:
    """What is decided of a window that begins where a frame ended; None if it needs weighing.

    Behind it, a frame ends as well: the stream is in step.
    """
    if _FRAMED_BETWEEN.fullmatch(window):
        return [_whole(0)]
    match = _SHAPE.fullmatch(window)
    if match is None or match.lastgroup is None:
        return None
    start, stop = match.span(match.lastgroup)
    raw = window[start:stop]
    damage = _named(match.lastgroup, raw)
    if damage is None:
        return None
    named = Stretch(start, stop, damage is _FRAMED, _faults(damage, raw), 0.0)
    return [*([_whole(0)] if start else []), named, _whole(stop)]


_FRAMED = Fault.UNKNOWN_CMD
"""Stands for whatever faults ten framed bytes show by themselves."""


def _faults(damage: Fault, raw: bytes) -> tuple[Fault, ...]:
    return frame_faults(raw) if damage is _FRAMED else (damage,)


def _whole(start: int) -> Stretch:
    return Stretch(start, start + FRAME_LENGTH, True, (), 1.0)


def _named(shape: str, raw: bytes) -> Fault | None:
    """What this damage is; None where that is not plain."""
    if shape == "noise":
        return Fault.NOISE
    if shape == "tailed":
        fits = max(rest_fit(kind, raw) for kind in KINDS) >= _LEAST_LEFT
        return Fault.BAD_HEADER if fits else None
    if shape == "both" and len(raw) == FRAME_LENGTH:
        return _FRAMED
    kinds = kinds_of(raw)
    if len(kinds) != 1:
        return None
    if shape == "headed":
        fitting = head_fit(kinds[0], raw)
        if len(raw) == FRAME_LENGTH:
            return Fault.BAD_TAIL if fitting >= _LEAST_LEFT else None
        return Fault.TRUNCATED if fitting == len(raw) else None
    split = split_damaged(raw)
    if split is None or split.head <= CMD_PLACE:
        return None
    return Fault.TRUNCATED if len(raw) < FRAME_LENGTH else Fault.OVERLONG
