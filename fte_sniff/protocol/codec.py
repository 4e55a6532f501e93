"""Encode and decode one frame; validate fields."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache

from fte_sniff.errors import ValueRangeError
from fte_sniff.protocol.spec import (
    CMD_OFFSET,
    FRAME_LENGTH,
    HEADERS,
    KIND_BY_HEADER_AND_CMD,
    TAIL,
    Fault,
    Field,
    FrameKind,
)


def encode(kind: FrameKind, values: Mapping[str, int], cmd: int | None = None) -> bytes:
    """The ten bytes of a frame of `kind` (PROTOCOL.md, "Control frames", "Feedback frames").

    Args:
        kind: the entry of the frame table.
        values: every field's value by row name; fields with a default may be left out.
        cmd: which of the kind's CMDs to write, where it has several; by default the first.

    Raises:
        ValueRangeError: a value is missing, out of range, or not of this kind.
    """
    chosen = kind.cmds[0] if cmd is None else cmd
    if chosen not in kind.cmds:
        legal = " or ".join(map(str, kind.cmds))
        raise ValueRangeError(f"cmd {chosen} is out of range: {kind.name} has cmd {legal}")
    unknown = set(values) - {field.name for field in kind.fields}
    if unknown:
        raise ValueRangeError(f"{kind.name} has no {', '.join(sorted(unknown))}")
    raw = bytearray(FRAME_LENGTH)
    raw[0], raw[CMD_OFFSET], raw[-1] = kind.header, chosen, TAIL
    for field in kind.fields:
        value = values.get(field.name, field.default)
        if value is None:
            raise ValueRangeError(f"{kind.name} needs {field.name} ({field.range_text})")
        raw[field.start : field.start + field.size] = field.to_bytes(value)
    return bytes(raw)


def frame_faults(raw: bytes) -> tuple[Fault, ...]:
    """The faults that ten framed bytes show by themselves (PROTOCOL.md, "What is left open")."""
    kind = KIND_BY_HEADER_AND_CMD.get((raw[0], raw[CMD_OFFSET]))
    if kind is None:
        return (Fault.UNKNOWN_CMD,)
    return tuple(dict.fromkeys(_faults_in(raw, kind)))


def _faults_in(raw: bytes, kind: FrameKind) -> Iterator[Fault]:
    for field in kind.fields:
        if field.defined_bits is not None:
            if field.read(raw) & ~field.defined_bits:
                yield Fault.UNDEFINED_FLAGS
        elif not field.low <= field.read(raw) <= field.high:
            yield Fault.BAD_MOTOR
    if any(raw[place] for place in kind.reserved):
        yield Fault.RESERVED_NONZERO


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
    places[0], places[CMD_OFFSET], places[-1] = (
        bytes([kind.header]),
        bytes(kind.cmds),
        bytes([TAIL]),
    )
    for place in kind.reserved:
        places[place] = b"\x00"
    for field in kind.fields:
        if field.size == 1:
            places[field.start] = _field_bytes(field)
    return tuple(places)
