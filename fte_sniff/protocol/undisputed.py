"""Owns the short cut: damage that has one reading only, so that nothing needs weighing.

It must not read bytes otherwise than weighing does; it is only quicker, by far, for the damage that
is the most common: one piece before plain frames, with no header or tail in it but its own. (Very
rarely weighing doubts one of those frames by a hair, where this does not.)

    damage frame frame      the first fits its kind, and holds no second header or tail

Pieces that together with the frame before or behind them could be one overlong frame are left to
weighing.
"""

from __future__ import annotations

import re

from fte_sniff.protocol.codec import frame_faults
from fte_sniff.protocol.likelihood import LONGEST_JUNK, WIDEST_CHANGE
from fte_sniff.protocol.patterns import PLAIN, no_flags_before
from fte_sniff.protocol.reading import Stretch
from fte_sniff.protocol.rows import Fault
from fte_sniff.protocol.structure import (
    HEADER_BYTES,
    LONGEST_OVERLONG,
    head_fit,
    kinds_of,
    legal_bytes,
    rest_fit,
)
from fte_sniff.protocol.table import FRAME_LENGTH, KINDS, NUM_PLACE, TAIL, FrameKind

_HEADER = b"[%b]" % re.escape(HEADER_BYTES)
_TAIL = re.escape(bytes([TAIL]))
_CALM = b"[^%b%b]" % (re.escape(HEADER_BYTES), _TAIL)


def _plain(kind: FrameKind) -> bytes:
    """A frame that fits its kind, with NUM as usual and no header or tail inside."""
    places = [_CALM if legal is None else b"[%b]" % re.escape(legal) for legal in legal_bytes(kind)]
    if legal_bytes(kind)[NUM_PLACE] is None:
        places[NUM_PLACE] = rb"\x00"
    return b"".join(places) + no_flags_before(kind)


_PLAIN = b"(?:%b)" % b"|".join(_plain(kind) for kind in KINDS)
_ALONE = LONGEST_OVERLONG - FRAME_LENGTH + 1
"""Bytes that are too many for one overlong frame together with a whole one."""
_LEAST_LEFT = FRAME_LENGTH - WIDEST_CHANGE

_NO_FRONT = b"%b(?![%b])" % (
    _HEADER,
    re.escape(bytes({cmd for kind in KINDS for cmd in kind.cmds})),
)
"""A header that no CMD follows, which begins nothing."""

_NOISE = b"(?P<noise>%b{1,%d}|%b(?:%b|%b){1,%d}%b{%d}|%b{%d,%d}%b)" % (
    *(_CALM, LONGEST_JUNK),
    *(_CALM, _CALM, _NO_FRONT, LONGEST_JUNK - _ALONE, _CALM, _ALONE - 1),
    *(_CALM, _ALONE - 1, FRAME_LENGTH - 2, _TAIL),
)
_STUB = b"(?P<stub>%b%b?)" % (_HEADER, _CALM)
"""Too few bytes to be alone, if the frame behind them can be the rest of theirs."""

_HEADED = b"(?P<headed>%b%b{%d,%d})" % (_HEADER, _CALM, _ALONE - 1, FRAME_LENGTH - 1)
_TAILED = b"(?P<tailed>%b{%d}%b)" % (_CALM, FRAME_LENGTH - 1, _TAIL)
_BOTH = b"(?P<both>%b%b{%d,%d}%b)" % (*(_HEADER, _CALM, _ALONE - 2, LONGEST_OVERLONG - 2, _TAIL),)
_SHAPE = re.compile(
    b"(?:%b)%b%b" % (b"|".join((_NOISE, _STUB, _HEADED, _TAILED, _BOTH)), _PLAIN, PLAIN), re.DOTALL
)


def undisputed(data: bytes, at: int) -> Stretch | None:
    """The damage at `at`, where a frame ended beyond doubt; None if it needs weighing.

    Behind it the stream is in step: two plain frames follow. It is counted from `at`, as all
    parts of a reading are.
    """
    match = _SHAPE.match(data, at)
    if match is None or match.lastgroup is None:
        return None
    raw = match[match.lastgroup]
    if match.lastgroup == "stub" and _goes_on(raw, match[0][len(raw) :][:FRAME_LENGTH]):
        return None
    damage = _named(match.lastgroup, raw)
    if damage is None:
        return None
    return Stretch(0, len(raw), damage is _FRAMED, _faults(damage, raw), 0.0)


_FRAMED = Fault.UNKNOWN_CMD
"""Stands for whatever faults ten framed bytes show by themselves."""


def _faults(damage: Fault, raw: bytes) -> tuple[Fault, ...]:
    return frame_faults(raw) if damage is _FRAMED else (damage,)


def _goes_on(stub: bytes, behind: bytes) -> bool:
    """Whether the frame behind a stub can be the rest of one overlong frame."""
    missing = FRAME_LENGTH - len(stub)
    return any(rest_fit(kind, behind) >= missing for kind in kinds_of(stub))


def _named(shape: str, raw: bytes) -> Fault | None:
    """What this damage is; None where that is not plain."""
    if shape == "noise":
        return Fault.NOISE
    if shape == "tailed":
        fits = any(rest_fit(kind, raw) >= _LEAST_LEFT for kind in KINDS)
        return Fault.BAD_HEADER if fits else None
    if shape == "both":
        return _framed_damage(raw)
    kinds = kinds_of(raw)
    if len(kinds) != 1:
        return Fault.TRUNCATED if len(raw) == 1 else None
    fitting = head_fit(kinds[0], raw)
    if len(raw) == FRAME_LENGTH:
        return Fault.BAD_TAIL if fitting >= _LEAST_LEFT else None
    return Fault.TRUNCATED if fitting == len(raw) else None


def _framed_damage(raw: bytes) -> Fault | None:
    """What is wrong with bytes that begin with a header and end with a tail."""
    if len(raw) == FRAME_LENGTH:
        return _FRAMED if frame_faults(raw) else None
    kinds = kinds_of(raw)
    head = head_fit(kinds[0], raw[:-1]) if len(kinds) == 1 else 1
    whole = min(len(raw), FRAME_LENGTH)
    if not any(min(head, whole - 1) + rest_fit(kind, raw) >= whole for kind in kinds):
        return None
    return Fault.TRUNCATED if len(raw) < FRAME_LENGTH else Fault.OVERLONG
