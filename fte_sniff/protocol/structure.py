"""Owns what each byte of a frame must be for the framing to fit: place by place, kind by kind.

It must not know of streams, costs or rows. It serves the framer, which weighs readings, and the
dissection, which explains them. All of it is derived from the frame table.

A damaged frame is read as a *head*, its first bytes where they still fit, and a *rest*, its last
bytes where they fit again:

    AA 01 01 03 E8 00 00 00 00 EE    a speed frame
    AA 01 01 -- -- -- 00 00 00 EE    three bytes lost: head of 3, rest of 4, `truncated`
    AA 01 01 03 xx yy E8 00 00 ...   two bytes put in: head of 4, rest of 6, `overlong`
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

from fte_sniff.protocol.table import (
    CMD_PLACE,
    FRAME_LENGTH,
    HEADERS,
    KIND_BY_HEADER_AND_CMD,
    KINDS,
    TAIL,
    Field,
    FrameKind,
)

HEADER_BYTES = bytes(HEADERS.values())
"""Every byte that can begin a frame."""

LONGEST_OVERLONG = 14
"""Bytes that an overlong frame has at most: four too many."""


def _field_bytes(field: Field) -> bytes:
    """The bytes that a one-byte field may have."""
    if field.defined_bits is not None:
        return bytes(value for value in range(256) if not value & ~field.defined_bits)
    return bytes(range(field.low, field.high + 1))


@cache
def legal_bytes(kind: FrameKind) -> tuple[bytes | None, ...]:
    """For each of the ten places the bytes that fit it; None where every byte does.

    "Fit" is strict: reserve is 00, and no undefined flag is set (PROTOCOL.md, "What the document
    leaves open").
    """
    places: list[bytes | None] = [None] * FRAME_LENGTH
    places[0], places[CMD_PLACE], places[-1] = bytes([kind.header]), bytes(kind.cmds), bytes([TAIL])
    for place in kind.reserved:
        places[place] = b"\x00"
    for field in kind.fields:
        if field.size == 1:
            places[field.start] = _field_bytes(field)
    return tuple(places)


def strict_regex(kind: FrameKind) -> bytes:
    """A regular expression (bytes, DOTALL) for ten bytes that fit `kind` at every place."""
    return places_regex(legal_bytes(kind))


def places_regex(places: Iterable[bytes | None]) -> bytes:
    """The same for any places, given as `legal_bytes` gives them."""
    return b"".join(b"." if legal is None else b"[%b]" % re.escape(legal) for legal in places)


def _as_far_as(places: Iterable[bytes | None]) -> re.Pattern[bytes]:
    """Matches as many bytes as fit these places, one after the other."""
    pattern = b""
    for legal in reversed(list(places)):
        pattern = b"(?:%b%b)?" % (b"." if legal is None else b"[%b]" % re.escape(legal), pattern)
    return re.compile(pattern, re.DOTALL)


_FITTING: Mapping[str, tuple[re.Pattern[bytes], re.Pattern[bytes]]] = MappingProxyType(
    {
        kind.name: (_as_far_as(legal_bytes(kind)), _as_far_as(legal_bytes(kind)[::-1]))
        for kind in KINDS
    }
)


def head_fit(kind: FrameKind, raw: bytes) -> int:
    """How many of the first bytes of `raw` (0-10) fit the first places of `kind`."""
    match = _FITTING[kind.name][0].match(raw)
    return match.end() if match else 0


def rest_fit(kind: FrameKind, raw: bytes) -> int:
    """How many of the last bytes of `raw` (0-10) fit the last places of `kind`."""
    match = _FITTING[kind.name][1].match(raw[::-1])
    return match.end() if match else 0


@dataclass(frozen=True, slots=True)
class Split:
    """A damaged frame as the head and the rest of a frame of one kind."""

    kind: FrameKind
    head: int
    """Bytes at the front that fit the frame's first places."""
    rest: int
    """Bytes at the back that fit the frame's last places."""


def kinds_of(raw: bytes) -> tuple[FrameKind, ...]:
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
    for kind in (*kinds_of(raw), *(kind for kind in KINDS if kind.header == raw[0])):
        fitting, ending = head_fit(kind, raw), rest_fit(kind, raw)
        whole = min(len(raw), FRAME_LENGTH)
        head = min(fitting, whole if len(raw) < FRAME_LENGTH else whole - 1)
        if head and head + ending >= whole and (best is None or head > best.head):
            best = Split(kind, head, whole - head)
    return best
