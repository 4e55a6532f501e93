"""Encode one frame; find the faults of one."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from fte_sniff.errors import ValueRangeError
from fte_sniff.protocol.spec import (
    CMD_OFFSET,
    FRAME_LENGTH,
    FTE_FORMAT,
    HEADERS,
    KIND_BY_HEADER_AND_CMD,
    TAIL,
    Fault,
    FrameKind,
)


def encode(kind: FrameKind, values: Mapping[str, int], cmd: int | None = None) -> bytes:
    """Encode a frame of `kind` (PROTOCOL.md, "Control frames", "Feedback frames").

    `values` are by row name; fields with a default are optional. `cmd` is by default the first of
    the kind's CMDs. Raises ValueRangeError if a value is missing, illegal, or not of this kind.
    """
    if cmd is None:
        cmd = kind.cmds[0]
    elif cmd not in kind.cmds:
        legal = " or ".join(map(str, kind.cmds))
        raise ValueRangeError(f"cmd {cmd} is out of range: {kind.name} has cmd {legal}")
    unknown = set(values) - {field.name for field in kind.fields}
    if unknown:
        raise ValueRangeError(f"{kind.name} has no {', '.join(sorted(unknown))}")
    raw = bytearray(FRAME_LENGTH)
    raw[0], raw[CMD_OFFSET], raw[-1] = kind.header, cmd, TAIL
    for field in kind.fields:
        value = values.get(field.name, field.default)
        if value is None:
            raise ValueRangeError(f"{kind.name} needs {field.name} ({field.range_text})")
        raw[field.start : field.start + field.size] = field.to_bytes(value)
    return bytes(raw)


def frame_faults(raw: bytes) -> tuple[Fault, ...]:
    """The faults visible in ten framed bytes (PROTOCOL.md, "What is left open")."""
    kind = KIND_BY_HEADER_AND_CMD.get((raw[0], raw[CMD_OFFSET]))
    return (Fault.UNKNOWN_CMD,) if kind is None else kind_faults(raw, kind)


def kind_faults(raw: bytes, kind: FrameKind) -> tuple[Fault, ...]:
    """The faults visible in the bytes of a frame of `kind`."""
    fields = (field for field in kind.fields if not field.is_legal(field.read(raw)))
    faults = [field.fault for field in fields if field.fault]
    if any(raw[offset] for offset in kind.reserved):
        faults.append(Fault.RESERVED_NONZERO)
    return tuple(dict.fromkeys(faults))


HEADER_BYTES = bytes(HEADERS.values())
"""Every byte that can begin a frame."""


@cache
def legal_bytes(kind: FrameKind) -> tuple[bytes | None, ...]:
    """For each offset in a frame of `kind` the legal bytes; see `FrameFormat.legal_bytes`."""
    return tuple(FTE_FORMAT.legal_bytes(kind))
