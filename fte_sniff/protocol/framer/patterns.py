"""Owns the regular expressions that find frames in bytes, built from the frame table.

They must not decide anything: the framer does. All of them look at whole frames of ten bytes.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from fte_sniff.protocol.structure import (
    HEADER_BYTES,
    LONGEST_OVERLONG,
    legal_bytes,
    places_regex,
    strict_regex,
)
from fte_sniff.protocol.table import FRAME_LENGTH, KINDS, MOTORS, NUM_PLACE, TAIL, FrameKind

_HEADER = b"[%b]" % re.escape(HEADER_BYTES)
_TAIL = re.escape(bytes([TAIL]))
_FRAMED = b"%b.{%d}%b" % (_HEADER, FRAME_LENGTH - 2, _TAIL)

_TAIL_AHEAD = b"(?=.{%d}%b)" % (FRAME_LENGTH - 2, _TAIL)


def _behind_header(header: int, frames: Iterable[bytes]) -> bytes:
    """The frames with that header, given place by place, from their second byte on."""
    own = re.escape(bytes([header]))
    return b"(?<=%b)(?:%b)" % (own, b"|".join(frame.partition(b"]")[2] for frame in frames))


_STRICT = b"%b%b(?:%b)" % (
    _HEADER,
    _TAIL_AHEAD,
    b"|".join(
        _behind_header(header, (strict_regex(kind) for kind in KINDS if kind.header == header))
        for header in HEADER_BYTES
    ),
)
_DIVIDING = b"%b%b|%b[%b][%b]" % (
    _TAIL,
    _HEADER,
    _HEADER,
    re.escape(bytes({cmd for kind in KINDS if kind.fields for cmd in kind.cmds})),
    re.escape(bytes([0, *MOTORS])),
)
_CALM = b"[^%b%b]{%d}" % (re.escape(HEADER_BYTES), _TAIL, FRAME_LENGTH - 2)


_NO_MARK = bytes(value for value in range(256) if value not in {*HEADER_BYTES, TAIL})


def _usual_flags(kind: FrameKind) -> bytes:
    """The flags that nearly every frame of a kind has, with which it ends; empty if it has none."""
    return bytes(field.default for field in kind.fields if field.default is not None)


USUAL_FLAGS = tuple({flags: None for kind in KINDS if (flags := _usual_flags(kind))})
"""What nearly every frame with flags ends with, before its tail."""


def ends_freely(kind: FrameKind) -> bool:
    """Whether a frame of that kind can end with what are another one's flags."""
    return legal_bytes(kind)[-2] is None


def no_flags_before(kind: FrameKind) -> bytes:
    """Matches behind the tail of a frame that does not end with another kind's usual flags; it may
    where a NUM that means nothing is 00, as usual, which speaks for the frame."""
    if not ends_freely(kind):
        return b""
    return b"".join(
        b"(?<!%b%b%b)" % (b"" if kind.names_motor else _other_num(flags), re.escape(flags), _TAIL)
        for flags in USUAL_FLAGS
    )


def _other_num(flags: bytes) -> bytes:
    """Any NUM but 00, and what stands between it and the flags at the end."""
    return rb"[^\x00].{%d}" % (FRAME_LENGTH - 2 - len(flags) - NUM_PLACE)


def _undivided_regex(kind: FrameKind) -> bytes:
    """As `strict_regex`, but nothing dividing begins in the free bytes, and a NUM that means
    nothing is no header or tail."""
    places = list(legal_bytes(kind))
    if places[NUM_PLACE] is None:
        places[NUM_PLACE] = _NO_MARK
    plain = b"(?:[^%b%b]{%d}|(?:(?!%b).){%d})"
    headers = re.escape(HEADER_BYTES)
    return re.sub(
        rb"\.{2,}",
        lambda dots: plain % (headers, _TAIL, len(dots[0]), _DIVIDING, len(dots[0])),
        places_regex(places),
    )


def _plain_regex(kind: FrameKind) -> bytes:
    """The same, and no free bytes before the tail are another frame's flags."""
    return _undivided_regex(kind) + no_flags_before(kind)


STRICT = re.compile(_STRICT, re.DOTALL)
"""A frame that fits its kind at every place: no reserve byte set, no undefined flag."""

_RUN_FRAMES = 128

PLAIN = b"(?:%b)" % b"|".join(_plain_regex(kind) for kind in KINDS)
"""A frame that fits its kind at every place, and could not also be two truncated ones."""

PLAIN_FRAME = re.compile(PLAIN, re.DOTALL)

PLAIN_RUN = re.compile(b"%b{0,%d}+" % (PLAIN, _RUN_FRAMES), re.DOTALL)
"""Such frames in step, up to `LONG_RUN` bytes, none of which could also be two truncated ones."""

_UNDIVIDED = b"(?:%b)" % b"|".join(_undivided_regex(kind) for kind in KINDS)

UNDIVIDED_FRAME = re.compile(_UNDIVIDED, re.DOTALL)
"""A frame that fits its kind at every place, and could be two truncated ones only if the second
was cut by chance behind what tells it from the rest of this one."""

UNDIVIDED_RUN = re.compile(b"%b{0,%d}+" % (_UNDIVIDED, _RUN_FRAMES), re.DOTALL)
"""As `PLAIN_RUN`, of such frames."""

LONG_RUN = _RUN_FRAMES * FRAME_LENGTH
"""Bytes of the longest run that they match; behind it there may be more."""

DIVIDING = re.compile(_DIVIDING, re.DOTALL)
"""In a payload: here one truncated frame could end and another begin, or begin with its motor."""

STRICT_PAIR = re.compile(_STRICT * 2, re.DOTALL)
"""Two such frames in step."""

CALM = re.compile(b"%b%b%b" % (_HEADER, _CALM, _TAIL), re.DOTALL)
"""Ten bytes that hold no header but the first and no tail but the last."""

_NO_TAIL_BEHIND = b"(?=[^%b]{%d})" % (_TAIL, LONGEST_OVERLONG - FRAME_LENGTH)

FIRM = re.compile(b"%b%b%b%b" % (_HEADER, _CALM, _TAIL, _NO_TAIL_BEHIND), re.DOTALL)
"""The same, with no tail close behind it that could make it the beginning of an overlong frame."""


def _firm_regex(kind: FrameKind) -> bytes:
    """A frame that fits its kind, with NUM as usual, if it holds no header or tail inside."""
    places = list(legal_bytes(kind))
    if places[NUM_PLACE] is None:
        places[NUM_PLACE] = b"\x00"
    return places_regex(places) + no_flags_before(kind)


FIRM_FRAME = b"%b(?=%b%b%b)(?:%b)" % (
    _HEADER,
    _CALM,
    _TAIL,
    _NO_TAIL_BEHIND,
    b"|".join(
        _behind_header(header, (_firm_regex(kind) for kind in KINDS if kind.header == header))
        for header in HEADER_BYTES
    ),
)
"""A frame as in `PLAIN_RUN` that holds no second header or tail, with no tail close behind it."""

FIRM_FRAMES = re.compile(FIRM_FRAME, re.DOTALL)
"""Such a frame, to be searched for."""

HEADER = re.compile(_HEADER)

FRAMED = re.compile(_FRAMED, re.DOTALL)
"""Ten bytes between a header and a tail, whatever they hold."""

FRAMED_THREE = re.compile(_FRAMED * 3, re.DOTALL)
"""Three times ten bytes in step, each between a header and a tail, whatever they hold."""

ANCHOR_TAIL = re.compile(
    b"%b(?:(?<=%b)(?=.{%d})|(?<=%b)(?=%b))"
    % (
        _TAIL,
        b"|".join(strict_regex(kind) for kind in KINDS),
        *(FRAME_LENGTH, _FRAMED, _FRAMED),
    ),
    re.DOTALL,
)
"""The tail of what can end long noise: a frame that fits, or ten framed bytes before ten others."""

ANCHOR_REACH = 2 * FRAME_LENGTH - 1
"""An anchor that is not yet complete begins at most so many bytes before the end."""
