"""Owns what each byte of a frame must be for the framing to fit: place by place, kind by kind.

It must not know of streams, costs or rows. It serves the framer, which weighs readings, and the
dissection, which explains them. All of it is derived from the frame table.
"""

from __future__ import annotations

from functools import cache

from fte_sniff.protocol.table import (
    CMD_PLACE,
    FRAME_LENGTH,
    HEADERS,
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
