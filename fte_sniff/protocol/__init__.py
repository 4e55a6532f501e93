"""What the bytes mean: the frame table, encoding and decoding one frame, and the framer.

This package does no I/O, reads no clock and needs the standard library alone; the framer, which is
compiled, its compiler's types too (`mypy_extensions`, `librt`). To read it, in this order:

    table        the frame table, from which all else here is derived
    rows         the vocabulary: Chunk in, Frame and Damage (a row) out, PortEvent beside them
    codec        one frame's bytes from its values, and the faults one frame shows alone
    columns      the row contract: names, order and types of what a row tells
    structure    what each byte of a frame must be
    framer/      a port's chunks to rows
    line_errors  rows marked where the UART reported errors
    dissection/  one row explained, byte by byte
"""

from fte_sniff.protocol.codec import encode, frame_faults
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
)
from fte_sniff.protocol.framer import Framer
from fte_sniff.protocol.line_errors import LineErrorMarker
from fte_sniff.protocol.rows import (
    FAULT_MEANINGS,
    SUSPECT_FAULTS,
    Chunk,
    Damage,
    Fault,
    Frame,
    LineErrorCounts,
    PortEvent,
    PortEventKind,
    Row,
    Status,
    status_of,
)
from fte_sniff.protocol.table import (
    DEFAULT_BAUD,
    FRAME_LENGTH,
    HEADERS,
    KIND_BY_NAME,
    KINDS,
    MOTORS,
    TAIL,
    VALUE_FIELDS,
    Direction,
    Field,
    FrameKind,
    byte_time_ns,
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
    "SUSPECT_FAULTS",
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
    "frame_faults",
    "iso_time",
    "record",
    "spaced_hex",
    "status_of",
]
