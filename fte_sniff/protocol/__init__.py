"""The protocol: frame table, framer, rows, explanations. No I/O and no clock.

Modules:

    dissect     Explain a row: its bytes field by field.
    columns     The column table; values as text.
    framer      Framer: chunks in, rows out; times and silence.
    islands     Frames in step and the gaps between them.
    gap         How gaps are divided into frames, damage and noise.
    rows        Rows: the one container, as numpy columns; a row.
    items       Chunks, port events, gaps.
    spec        The frame table: kinds, fields, faults, constants; encodes a frame.
"""

from fte_sniff.protocol.columns import (
    COLUMN_BY_NAME,
    COLUMNS,
    Column,
    ColumnType,
    Value,
    faults_text,
    iso_time,
    record,
    spaced_hex,
    zone_at,
)
from fte_sniff.protocol.framer import Framer
from fte_sniff.protocol.items import (
    Chunk,
    Gap,
    GapKind,
    LineErrorCounts,
    PortEvent,
    PortEventKind,
)
from fte_sniff.protocol.rows import Row, Rows
from fte_sniff.protocol.spec import (
    DEFAULT_BAUD,
    FAULT_MEANINGS,
    FRAME_LENGTH,
    HEADERS,
    KIND_BY_NAME,
    KINDS,
    MOTORS,
    TAIL,
    VALUE_FIELDS,
    Direction,
    Fault,
    Field,
    FrameKind,
    Status,
    byte_time_ns,
    encode,
    status_of,
)

# fmt: off
__all__ = [
    "COLUMNS", "COLUMN_BY_NAME", "DEFAULT_BAUD", "FAULT_MEANINGS", "FRAME_LENGTH", "HEADERS",
    "KINDS", "KIND_BY_NAME", "MOTORS", "TAIL", "VALUE_FIELDS", "Chunk", "Column", "ColumnType",
    "Direction", "Fault", "Field", "FrameKind", "Framer", "Gap", "GapKind", "LineErrorCounts",
    "PortEvent", "PortEventKind", "Row", "Rows", "Status", "Value", "byte_time_ns", "encode",
    "faults_text", "iso_time", "record", "spaced_hex", "status_of", "zone_at",
]
