"""The protocol: frame table, framer, explanations. No I/O and no clock.

Modules:

    dissect     Explain a row: its bytes field by field, and the readings of damage.
    framer      The framer: chunks in, rows out.
    islands     The framer in numpy: islands and gaps; takes the place of `framer`.
    columns     The column table; values as text; signs and colours of each status.
    rows        Rows: the one container; a row.
    table       Rows: the container of rows as fixed-size numpy columns; takes the place of `rows`.
    items       Chunks, port events, gaps.
    spec        The frame table: kinds, fields, faults, constants; encodes a frame.
"""

from fte_sniff.protocol.columns import (
    COLUMN_BY_NAME as COLUMN_BY_NAME,
)
from fte_sniff.protocol.columns import (
    COLUMNS as COLUMNS,
)
from fte_sniff.protocol.columns import (
    Column as Column,
)
from fte_sniff.protocol.columns import (
    ColumnType as ColumnType,
)
from fte_sniff.protocol.columns import (
    Value as Value,
)
from fte_sniff.protocol.columns import (
    faults_text as faults_text,
)
from fte_sniff.protocol.columns import (
    iso_time as iso_time,
)
from fte_sniff.protocol.columns import (
    record as record,
)
from fte_sniff.protocol.columns import (
    spaced_hex as spaced_hex,
)
from fte_sniff.protocol.columns import (
    zone_at as zone_at,
)
from fte_sniff.protocol.framer import Framer as Framer
from fte_sniff.protocol.items import (
    Chunk as Chunk,
)
from fte_sniff.protocol.items import (
    Gap as Gap,
)
from fte_sniff.protocol.items import (
    GapKind as GapKind,
)
from fte_sniff.protocol.items import (
    LineErrorCounts as LineErrorCounts,
)
from fte_sniff.protocol.items import (
    PortEvent as PortEvent,
)
from fte_sniff.protocol.items import (
    PortEventKind as PortEventKind,
)
from fte_sniff.protocol.rows import (
    Damage as Damage,
)
from fte_sniff.protocol.rows import (
    Frame as Frame,
)
from fte_sniff.protocol.rows import (
    LineErrorMarker as LineErrorMarker,
)
from fte_sniff.protocol.rows import (
    Row as Row,
)
from fte_sniff.protocol.rows import (
    Rows as Rows,
)
from fte_sniff.protocol.spec import (
    DEFAULT_BAUD as DEFAULT_BAUD,
)
from fte_sniff.protocol.spec import (
    FAULT_MEANINGS as FAULT_MEANINGS,
)
from fte_sniff.protocol.spec import (
    FRAME_LENGTH as FRAME_LENGTH,
)
from fte_sniff.protocol.spec import (
    HEADERS as HEADERS,
)
from fte_sniff.protocol.spec import (
    KIND_BY_NAME as KIND_BY_NAME,
)
from fte_sniff.protocol.spec import (
    KINDS as KINDS,
)
from fte_sniff.protocol.spec import (
    MOTORS as MOTORS,
)
from fte_sniff.protocol.spec import (
    TAIL as TAIL,
)
from fte_sniff.protocol.spec import (
    VALUE_FIELDS as VALUE_FIELDS,
)
from fte_sniff.protocol.spec import (
    Direction as Direction,
)
from fte_sniff.protocol.spec import (
    Fault as Fault,
)
from fte_sniff.protocol.spec import (
    Field as Field,
)
from fte_sniff.protocol.spec import (
    FrameKind as FrameKind,
)
from fte_sniff.protocol.spec import (
    Status as Status,
)
from fte_sniff.protocol.spec import (
    byte_time_ns as byte_time_ns,
)
from fte_sniff.protocol.spec import (
    encode as encode,
)
from fte_sniff.protocol.spec import (
    status_of as status_of,
)
