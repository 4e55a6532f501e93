"""A protocol decoder for PulseView and sigrok-cli, stacked on `uart`.

A logic analyser sees both wires on one clock; the decoder shows frames, fields, faults and damage
of each wire. It runs in sigrok's Python, which has no fte-sniff, so the template has all its code.
"""

from __future__ import annotations

from importlib.resources import files
from pprint import pformat
from typing import Final

from fte_sniff.protocol.framer.framer import SETTLING_NS
from fte_sniff.protocol.spec import (
    CMD_OFFSET,
    DEFAULT_BAUD,
    DIRECTION_OF_HEADER,
    FRAME_LENGTH,
    KIND_BY_HEADER_AND_CMD,
    TAIL,
    Fault,
    FrameKind,
    byte_time_ns,
)

NO_KIND = "unknown"
"""The name of a frame whose CMD names no kind."""

SETTLING_BYTES: Final = SETTLING_NS // byte_time_ns(DEFAULT_BAUD)
"""Byte times of silence after which the begin of a frame is truncated, as in the framer."""


def decoder() -> str:
    """The source of the decoder, a Python module."""
    tables = {
        "LENGTH": FRAME_LENGTH,
        "TAIL": TAIL,
        "CMD": CMD_OFFSET,
        "SETTLING": SETTLING_BYTES,
        "DIRECTIONS": {header: str(way) for header, way in DIRECTION_OF_HEADER.items()},
        "UNKNOWN_CMD": str(Fault.UNKNOWN_CMD),
        "RESERVED_NONZERO": str(Fault.RESERVED_NONZERO),
        "LINE_ERROR": str(Fault.LINE_ERROR),
        "NO_KIND": NO_KIND,
        "KINDS": {head: _kind(kind) for head, kind in KIND_BY_HEADER_AND_CMD.items()},
    }
    lines = [f"{name} = {pformat(value, sort_dicts=False)}" for name, value in tables.items()]
    template = files(__package__).joinpath("sigrok_template.txt").read_text("utf-8")
    return template.replace("@TABLES@", "\n".join(lines))


def _kind(kind: FrameKind) -> dict[str, object]:
    """A kind as the template reads it; a field is name, start, size, signed, unit, flags, ..."""
    return {
        "name": kind.name,
        "reserved": [*kind.reserved],
        "reserve": kind.reserve,
        "fields": [
            (
                field.name,
                field.start,
                field.size,
                field.signed,
                field.unit,
                field.legal_bits is not None,
                (field.low, field.high, field.legal_bits),
                field.fault and str(field.fault),
            )
            for field in kind.fields
        ],
    }
