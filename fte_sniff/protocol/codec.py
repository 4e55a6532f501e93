"""Owns the way between one frame's bytes and its values, and the faults that one frame shows alone.

It must not know about streams: whether ten bytes are a frame at all is the framer's business.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from fte_sniff.errors import ValueRangeError
from fte_sniff.protocol.rows import Fault
from fte_sniff.protocol.table import (
    CMD_PLACE,
    FRAME_LENGTH,
    KIND_BY_HEADER_AND_CMD,
    TAIL,
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
    raw[0], raw[CMD_PLACE], raw[-1] = kind.header, chosen, TAIL
    for field in kind.fields:
        value = values.get(field.name, field.default)
        if value is None:
            raise ValueRangeError(f"{kind.name} needs {field.name} ({field.range_text})")
        raw[field.start : field.start + field.size] = field.to_bytes(value)
    return bytes(raw)


def frame_faults(raw: bytes) -> tuple[Fault, ...]:
    """The faults that ten framed bytes show by themselves (PROTOCOL.md, "What is left open")."""
    kind = KIND_BY_HEADER_AND_CMD.get((raw[0], raw[CMD_PLACE]))
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
