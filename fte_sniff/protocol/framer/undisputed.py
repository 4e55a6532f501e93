"""Owns the short cut: damage that has one reading only, so that nothing needs weighing.

It must not read bytes otherwise than weighing does; it is only quicker, by far, for the damage that
is the most common: one piece before a frame, with no header or tail in it but its own. (Very rarely
weighing doubts that frame by a hair, where this does not.)

    damage frame ....      the frame is beyond doubt, as in `enclosed`

Pieces that together with the frame before or behind them could be one overlong frame are left to
weighing.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache

from fte_sniff.protocol.codec import frame_faults
from fte_sniff.protocol.framer.ends import CANONICAL
from fte_sniff.protocol.framer.likelihood import LONGEST_JUNK, WIDEST_CHANGE
from fte_sniff.protocol.framer.patterns import FIRM_FRAME
from fte_sniff.protocol.framer.reading import Stretch
from fte_sniff.protocol.rows import Fault
from fte_sniff.protocol.structure import (
    HEADER_BYTES,
    LONGEST_OVERLONG,
    head_fit,
    kinds_of,
    legal_bytes,
    places_regex,
    rest_fit,
)
from fte_sniff.protocol.table import FRAME_LENGTH, KINDS, TAIL, FrameKind

_HEADER = b"[%b]" % re.escape(HEADER_BYTES)
_TAIL = re.escape(bytes([TAIL]))
_CALM = b"[^%b%b]" % (re.escape(HEADER_BYTES), _TAIL)


def _calm_places(kind: FrameKind) -> list[bytes]:
    """By place, what fits the kind there and is no second header or tail."""
    return [_CALM if legal is None else b"[%b]" % re.escape(legal) for legal in legal_bytes(kind)]


def _cut_off(kind: FrameKind) -> bytes:
    """The first bytes of a frame, at least `_ALONE` of them and not all."""
    places, more = _calm_places(kind)[:-1], b""
    for place in reversed(places[_ALONE:]):
        more = b"(?:%b%b)?" % (place, more)
    return b"".join(places[:_ALONE]) + more


_ALONE = LONGEST_OVERLONG - FRAME_LENGTH + 1
"""Bytes that are too many for one overlong frame together with a whole one."""
_LEAST_LEFT = FRAME_LENGTH - WIDEST_CHANGE
_BEGINNING = b"|".join(places_regex(legal_bytes(kind)[:_LEAST_LEFT]) for kind in KINDS)
_ENDING = b"|".join(places_regex(legal_bytes(kind)[-_LEAST_LEFT:]) for kind in KINDS)

_NO_FRONT = b"%b(?![%b])" % (
    _HEADER,
    re.escape(bytes({cmd for kind in KINDS for cmd in kind.cmds})),
)
"""A header that no CMD follows, which begins nothing."""

_NOISE = b"%b{1,%d}+|%b(?:%b|%b){1,%d}%b{%d}|%b{%d,%d}+%b" % (
    *(_CALM, LONGEST_JUNK),
    *(_CALM, _CALM, _NO_FRONT, LONGEST_JUNK - _ALONE, _CALM, _ALONE - 1),
    *(_CALM, _ALONE - 1, FRAME_LENGTH - 2, _TAIL),
)
_STUB = b"%b%b?" % (_HEADER, _CALM)
"""Too few bytes to be alone, if the frame behind them can be the rest of theirs."""
_TRUNCATED = b"|".join(_cut_off(kind) for kind in KINDS)
_BAD_TAIL = b"(?=%b)%b%b{%d}" % (_BEGINNING, _HEADER, _CALM, FRAME_LENGTH - 1)
_BAD_HEADER = b"%b{%d}%b(?<=%b)" % (_CALM, FRAME_LENGTH - 1, _TAIL, _ENDING)
_BOTH = b"%b%b{%d,%d}+%b" % (_HEADER, _CALM, _ALONE - 2, LONGEST_OVERLONG - 2, _TAIL)
"""A header and a tail, with anything between them."""


def _shape(group: str, regex: bytes) -> bytes:
    return b"(?P<%b>%b)" % (group.encode(), regex)


_SHAPE = re.compile(
    b"(?:%b)%b"
    % (
        b"|".join(
            (
                _shape(Fault.NOISE, _NOISE),
                _shape("stub", _STUB),
                _shape(Fault.TRUNCATED, _TRUNCATED),
                _shape(Fault.BAD_TAIL, _BAD_TAIL),
                _shape(Fault.BAD_HEADER, _BAD_HEADER),
                _shape("both", _BOTH),
            )
        ),
        FIRM_FRAME,
    ),
    re.DOTALL,
)
_FAULTS: Mapping[str, tuple[Fault, ...]] = {
    fault.value: (fault,)
    for fault in (Fault.NOISE, Fault.TRUNCATED, Fault.BAD_TAIL, Fault.BAD_HEADER)
}
"""By shape, where it tells what the damage is."""
_LEAST = 1 + LONGEST_OVERLONG


def undisputed(data: bytes, at: int) -> Stretch | None:
    """The damage at `at`, where a frame ended beyond doubt; None if it needs weighing.

    Behind it another one begins. It is counted from `at`, as all parts of a reading are.
    """
    if len(data) - at < _LEAST:
        return None
    match = _SHAPE.match(data, at)
    if match is None:
        return None
    shape = match.lastgroup
    assert shape is not None
    size = match.end(shape) - at
    faults = _FAULTS.get(shape)
    if faults is None:
        raw = data[at : at + size]
        behind = data[at + size : at + size + FRAME_LENGTH]
        faults = _stub_faults(raw, behind) if shape == "stub" else _faults(raw.translate(CANONICAL))
        if not faults:
            return None
    return Stretch(0, size, size == FRAME_LENGTH and shape == "both", faults, 0.0)


def _stub_faults(stub: bytes, behind: bytes) -> tuple[Fault, ...]:
    """Truncated; none where the frame behind a stub can be the rest of one overlong frame."""
    missing = FRAME_LENGTH - len(stub)
    kinds = kinds_of(stub)
    if any(rest_fit(kind, behind) >= missing for kind in kinds):
        return ()
    return (Fault.TRUNCATED,) if len(stub) == 1 or len(kinds) == 1 else ()


@lru_cache(1 << 12)
def _faults(own: bytes) -> tuple[Fault, ...]:
    """What is wrong with bytes, made canonical, between a header and a tail; none if unclear."""
    if len(own) == FRAME_LENGTH:
        return frame_faults(own)
    kinds = kinds_of(own)
    head = head_fit(kinds[0], own[:-1]) if len(kinds) == 1 else 1
    whole = min(len(own), FRAME_LENGTH)
    if not any(min(head, whole - 1) + rest_fit(kind, own) >= whole for kind in kinds):
        return ()
    return (Fault.TRUNCATED,) if len(own) < FRAME_LENGTH else (Fault.OVERLONG,)
