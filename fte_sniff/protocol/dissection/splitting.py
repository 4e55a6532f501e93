"""Owns the reading of a damaged frame as one that lost bytes or got some put in.

It must not know which rows are damaged, nor how they are shown. Such a frame is a *head*, its first
bytes where they still fit, and a *rest*, its last bytes where they fit again:

    AA 01 01 03 E8 00 00 00 00 EE    a speed frame
    AA 01 01 -- -- -- 00 00 00 EE    three bytes lost: head of 3, rest of 4, `truncated`
    AA 01 01 03 xx yy E8 00 00 ...   two bytes put in: head of 4, rest of 6, `overlong`
"""

from __future__ import annotations

from dataclasses import dataclass

from fte_sniff.protocol.framer.shapes import head_fit, rest_fit
from fte_sniff.protocol.table import (
    CMD_PLACE,
    FRAME_LENGTH,
    KIND_BY_HEADER_AND_CMD,
    KINDS,
    FrameKind,
)


@dataclass(frozen=True, slots=True)
class Split:
    """A damaged frame as the head and the rest of a frame of one kind."""

    kind: FrameKind
    head: int
    """Bytes at the front that fit the frame's first places."""
    rest: int
    """Bytes at the back that fit the frame's last places."""


def _kinds_of(raw: bytes) -> tuple[FrameKind, ...]:
    """The kinds that bytes starting with a header can be of, from what is left of header and CMD.

    With a CMD that the header knows this is one kind; otherwise every kind with this header.
    """
    named = KIND_BY_HEADER_AND_CMD.get((raw[0], raw[CMD_PLACE])) if len(raw) > 1 else None
    return (named,) if named else tuple(kind for kind in KINDS if kind.header == raw[0])


def split_damaged(raw: bytes) -> Split | None:
    """The best reading of `raw` as one frame that lost bytes or got some put in.

    The head is at least the header, and is taken as long as it fits; the rest is what remains,
    for a truncated frame, and as much of a frame as is missing, for an overlong one.
    """
    best: Split | None = None
    for kind in (*_kinds_of(raw), *(kind for kind in KINDS if kind.header == raw[0])):
        number = KINDS.index(kind)
        fitting = int(head_fit(raw, 0, len(raw), number))
        ending = int(rest_fit(raw, 0, len(raw), number))
        whole = min(len(raw), FRAME_LENGTH)
        head = min(fitting, whole if len(raw) < FRAME_LENGTH else whole - 1)
        if head and head + ending >= whole and (best is None or head > best.head):
            best = Split(kind, head, whole - head)
    return best
