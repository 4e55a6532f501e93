"""The protocol: frame table, framer, explanations. No I/O and no clock.

Modules:

    dissect     Explain the bytes of a row field by field.
    framer      The framer: chunks in, rows out.
    row_schema  Names, types and order of a row's columns; time formats.
    rows        Chunks, rows, port events, gaps.
    spec        The frame table: kinds, fields, faults, constants; encodes a frame.
"""

from fte_sniff.protocol.framer import Framer
from fte_sniff.protocol.row_schema import (
    COLUMN_BY_NAME,
    COLUMNS,
    Column,
    ColumnType,
    Value,
    faults_text,
    iso_time,
    record,
    spaced_hex,
)
from fte_sniff.protocol.rows import (
    Chunk,
    Damage,
    Frame,
    Gap,
    GapKind,
    LineErrorCounts,
    LineErrorMarker,
    PortEvent,
    PortEventKind,
    Row,
)
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

__all__ = [
    "COLUMNS",
    "COLUMN_BY_NAME",
    "DEFAULT_BAUD",
    "FAULT_MEANINGS",
    "FRAME_LENGTH",
    "HEADERS",
    "KINDS",
    "KIND_BY_NAME",
    "MOTORS",
    "TAIL",
    "VALUE_FIELDS",
    "Chunk",
    "Column",
    "ColumnType",
    "Damage",
    "Direction",
    "Fault",
    "Field",
    "Frame",
    "FrameKind",
    "Framer",
    "Gap",
    "GapKind",
    "LineErrorCounts",
    "LineErrorMarker",
    "PortEvent",
    "PortEventKind",
    "Row",
    "Status",
    "Value",
    "byte_time_ns",
    "encode",
    "faults_text",
    "iso_time",
    "record",
    "spaced_hex",
    "status_of",
]
