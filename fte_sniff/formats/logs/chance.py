"""Whole frames in bytes, and how many there would be by chance."""

from __future__ import annotations

import re
from functools import cache
from typing import Final

from fte_sniff.protocol.spec import FRAME_LENGTH, KINDS, TAIL, FrameKind

_WRONG_LENGTHS: Final = (7, 8, 9, 11, 12, 13)


def _start(kind: FrameKind) -> bytes:
    cmds = b"".join(b"\\x%02x" % cmd for cmd in kind.cmds)
    return b"\\x%02x[%b]%b" % (kind.header, cmds, rb"[\1-\4]" if kind.names_motor else b".")


@cache
def _pattern(length: int) -> re.Pattern[bytes]:
    starts = b"|".join(map(_start, KINDS))
    return re.compile(rb"(?s)(?:%b).{%d}\x%02x" % (starts, length - 4, TAIL))


def frames_in(data: bytes) -> list[bytes]:
    """The whole frames in these bytes, from left to right."""
    return _pattern(FRAME_LENGTH).findall(data)


def chance_level(data: bytes) -> float:
    """The mean number of patterns like frames, but of a wrong length."""
    found = [len(_pattern(length).findall(data)) for length in _WRONG_LENGTHS]
    return sum(found) / len(found)
