"""Condition of a line, from received bytes: sound, damaged, silent, low, unreadable."""

from __future__ import annotations

from enum import StrEnum
from typing import Final, NamedTuple

from fte_sniff.protocol.framer import Framer
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.rows import FAULT_BITS
from fte_sniff.protocol.spec import FEW_BYTES, Direction, Fault

SOUND_SHARE: Final = 0.9
"""Share of bytes in readable frames from which a line is sound."""

DAMAGED_SHARE: Final = 0.2
"""Share of bytes in readable frames from which the baud rate is right, but the line is bad."""

_LOW_SHARE: Final = 0.97


class LineCondition(StrEnum):
    """State of a line."""

    SOUND = "sound"
    DAMAGED = "damaged"
    """Its baud rate and polarity are right, as there are frames."""
    SILENT = "silent"
    LOW = "low"
    """Held low: only 00 is received."""
    TOO_LITTLE = "too little"
    UNREADABLE = "unreadable"


class LineDiagnosis(NamedTuple):
    """State of a line, and what was received."""

    condition: LineCondition
    size: int
    """Bytes."""
    share: float = 0.0
    """Share of them in readable frames, 0 to 1."""
    directions: frozenset[Direction] = frozenset()
    """Those of the frames."""


def diagnose(data: bytes) -> LineDiagnosis:
    """Diagnose a line from bytes that were received."""
    framer = Framer("line")
    framer.push(Chunk("line", None, data))
    rows = framer.finish()
    is_ambiguous = rows.faults & FAULT_BITS[Fault.AMBIGUOUS] != 0
    frames = rows.select(rows.framed & ~rows.is_malformed & ~is_ambiguous)
    share = int(frames.length.sum()) / max(1, len(data))
    conditions = {
        LineCondition.SOUND: share >= SOUND_SHARE,
        LineCondition.DAMAGED: share >= DAMAGED_SHARE and len(frames) > 1,
        LineCondition.SILENT: not data,
        LineCondition.LOW: data.count(0) >= _LOW_SHARE * len(data),
        LineCondition.TOO_LITTLE: len(data) < FEW_BYTES,
    }
    directions = frozenset(frame.direction for frame in frames if frame.direction)
    condition = next((one for one, holds in conditions.items() if holds), LineCondition.UNREADABLE)
    return LineDiagnosis(condition, len(data), share, directions)
