"""Whole frames in bytes, and how many there would be by chance."""

from __future__ import annotations

import re
from typing import Final

from fte_sniff.protocol.spec import FRAME_LENGTH, KINDS, TAIL, FrameKind

_CONTROL_LENGTHS: Final = (7, 8, 9, 11, 12, 13)


def _start_of(kind: FrameKind) -> bytes:
    cmds = b"".join(b"\\x%02x" % cmd for cmd in kind.cmds)
    number = rb"[\x01-\x04]" if kind.names_motor else rb"."
    return b"\\x%02x[%b]%b" % (kind.header, cmds, number)


def _pattern(length: int) -> re.Pattern[bytes]:
    starts = b"|".join(_start_of(kind) for kind in KINDS)
    return re.compile(rb"(?s)(?:%b).{%d}\x%02x" % (starts, length - 4, TAIL))


_FRAME: Final = _pattern(FRAME_LENGTH)
_CONTROLS: Final = [_pattern(length) for length in _CONTROL_LENGTHS]


def frames_in(data: bytes) -> list[bytes]:
    """The whole frames in these bytes, from left to right."""
    return _FRAME.findall(data)


def chance_level(data: bytes) -> float:
    """The mean number of patterns like frames, but of a wrong length."""
    return sum(len(control.findall(data)) for control in _CONTROLS) / len(_CONTROLS)
