"""Owns what the shapes of frames are, as regular expressions: the touchstone of `shapes`.

It must not know how the framer finds them. Each is built from the frame table alone, and says what
the docstring of `shapes` says of the predicate that has its name.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from fte_sniff.protocol import FRAME_LENGTH, KINDS, TAIL, FrameKind
from fte_sniff.protocol.codec import HEADER_BYTES, LONGEST_OVERLONG, legal_bytes
from fte_sniff.protocol.spec import MOTORS, NUM_OFFSET

_INSIDE = FRAME_LENGTH - 2
"""Bytes between the header and the tail."""

_HEADER = b"[%b]" % re.escape(HEADER_BYTES)
_TAIL = re.escape(bytes([TAIL]))
_MARKS = re.escape(bytes([*HEADER_BYTES, TAIL]))
_FRAMED = b"%b.{%d}%b" % (_HEADER, _INSIDE, _TAIL)
_CALM = b"%b[^%b]{%d}%b" % (_HEADER, _MARKS, _INSIDE, _TAIL)
_NO_TAIL_BEHIND = b"(?=[^%b]{%d})" % (_TAIL, LONGEST_OVERLONG - FRAME_LENGTH)

_DIVIDING = b"(?:%b%b|%b[%b][%b])" % (
    _TAIL,
    _HEADER,
    _HEADER,
    re.escape(bytes({cmd for kind in KINDS if kind.fields for cmd in kind.cmds})),
    re.escape(bytes([0, *MOTORS])),
)

_NO_MARK = bytes(value for value in range(256) if value not in {*HEADER_BYTES, TAIL})


def _compiled(pattern: bytes) -> re.Pattern[bytes]:
    return re.compile(pattern, re.DOTALL)


def _any_kind(patterns: Iterable[bytes]) -> bytes:
    return b"(?:%b)" % b"|".join(patterns)


def _places(places: Iterable[bytes | None]) -> bytes:
    return b"".join(b"." if legal is None else b"[%b]" % re.escape(legal) for legal in places)


def _with_num(kind: FrameKind, meaningless: bytes) -> list[bytes | None]:
    """What fits each place, and such a NUM where it means nothing."""
    places = list(legal_bytes(kind))
    if places[NUM_OFFSET] is None:
        places[NUM_OFFSET] = meaningless
    return places


def _undivided(kind: FrameKind) -> bytes:
    """Nothing dividing begins in the free bytes, and a NUM that means nothing is no mark."""
    places = _with_num(kind, _NO_MARK)
    return b"".join(
        _places([legal]) if legal is not None else b"(?!%b)." % _DIVIDING for legal in places
    )


def _usual_flags(kind: FrameKind) -> bytes:
    """The flags that nearly every frame of a kind has, with which it ends; empty if it has none."""
    return bytes(field.default for field in kind.fields if field.default is not None)


USUAL_FLAGS = tuple({flags: None for kind in KINDS if (flags := _usual_flags(kind))})
"""What nearly every frame with flags ends with, before its tail."""


def _not_as_flags(kind: FrameKind) -> bytes:
    """Matches behind a frame that does not end with another kind's usual flags; it may where a NUM
    that means nothing is 00, as usual, which speaks for the frame."""
    if legal_bytes(kind)[-2] is not None:
        return b""
    return b"".join(
        b"(?<!%b%b%b)" % (b"" if kind.names_motor else _other_num(flags), re.escape(flags), _TAIL)
        for flags in USUAL_FLAGS
    )


def _other_num(flags: bytes) -> bytes:
    """Any NUM but 00, and what stands between it and the flags at the end."""
    return rb"[^\x00].{%d}" % (_INSIDE - len(flags) - NUM_OFFSET)


_STRICT = _any_kind(_places(legal_bytes(kind)) for kind in KINDS)
_PLAIN = _any_kind(_undivided(kind) + _not_as_flags(kind) for kind in KINDS)
_UNDIVIDED = _any_kind(_undivided(kind) for kind in KINDS)
_USUAL_NUM = _any_kind(_places(_with_num(kind, b"\x00")) + _not_as_flags(kind) for kind in KINDS)

FRAMED = _compiled(_FRAMED)
FRAMED_THREE = _compiled(_FRAMED * 3)
STRICT = _compiled(_STRICT)
STRICT_PAIR = _compiled(_STRICT * 2)
UNDIVIDED = _compiled(_UNDIVIDED)
PLAIN = _compiled(_PLAIN)
UNDIVIDED_RUN = _compiled(b"%b*" % _UNDIVIDED)
PLAIN_RUN = _compiled(b"%b*" % _PLAIN)
CALM = _compiled(_CALM)
FIRM = _compiled(_CALM + _NO_TAIL_BEHIND)
DOUBTLESS = _compiled(b"(?=%b%b)%b" % (_CALM, _NO_TAIL_BEHIND, _USUAL_NUM))
DIVIDING = _compiled(_DIVIDING)
ANCHOR = _compiled(b"(?:%b.{%d}|%b%b)" % (_STRICT, FRAME_LENGTH, _FRAMED, _FRAMED))


def _as_far_as(places: Iterable[bytes | None]) -> re.Pattern[bytes]:
    """Matches as many bytes as fit these places, one after the other."""
    pattern = b""
    for legal in reversed(list(places)):
        pattern = b"(?:%b%b)?" % (b"." if legal is None else b"[%b]" % re.escape(legal), pattern)
    return re.compile(pattern, re.DOTALL)


_FITTING = {
    kind.name: (_as_far_as(legal_bytes(kind)), _as_far_as(legal_bytes(kind)[::-1]))
    for kind in KINDS
}


def head_fit(kind: FrameKind, raw: bytes) -> int:
    """How many of the first bytes of `raw` (0-10) fit the first places of `kind`."""
    match = _FITTING[kind.name][0].match(raw)
    return match.end() if match else 0


def rest_fit(kind: FrameKind, raw: bytes) -> int:
    """How many of the last bytes of `raw` (0-10) fit the last places of `kind`."""
    match = _FITTING[kind.name][1].match(raw[::-1])
    return match.end() if match else 0
