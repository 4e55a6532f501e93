"""Names, types and order of a row's columns; time formats."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from typing import TypeAlias

from fte_sniff.protocol.rows import Frame, Row
from fte_sniff.protocol.spec import FAULT_MEANINGS, KINDS, VALUE_FIELDS, Direction, Fault, Status

Value: TypeAlias = int | str | list[str] | None
"""What a column holds: a number, a text, the list of faults, or nothing."""


class ColumnType(StrEnum):
    """The type of a column's values; any value may be null but those of `offset` and `raw`."""

    TIME = "time"
    """Nanoseconds since 1970 UTC."""
    TEXT = "text"
    WORD = "word"
    """One of the column's `words`."""
    WORDS = "words"
    """A list of the column's `words`."""
    INT = "int"
    HEX = "hex"
    """Bytes as hex digits, upper case, no spaces."""


@dataclass(frozen=True, slots=True)
class Column:
    """One column of the row contract."""

    name: str
    type: ColumnType
    meaning: str
    words: tuple[str, ...] = ()
    """For WORD and WORDS: every value there can be."""


def _meaning(name: str, unit: str) -> str:
    """What a value is in every kind that has it, with its unit."""
    fields = (field for kind in KINDS for field in kind.fields if field.name == name)
    meanings = ", or ".join(dict.fromkeys(field.meaning for field in fields))
    return f"{meanings} [{unit}]" if unit else meanings


COLUMNS: tuple[Column, ...] = (
    Column("time", ColumnType.TIME, "when the first byte began on the wire, UTC"),
    Column("port", ColumnType.TEXT, "which wire: the port's name, or the file's"),
    Column("offset", ColumnType.INT, "of the first byte in that port's stream"),
    Column("length", ColumnType.INT, "bytes"),
    Column("direction", ColumnType.WORD, "which way the frame goes", tuple(Direction)),
    Column("kind", ColumnType.WORD, "kind of frame", tuple(kind.name for kind in KINDS)),
    Column("cmd", ColumnType.INT, "CMD as on the wire"),
    *(
        Column(field.name, ColumnType.INT, _meaning(field.name, field.unit))
        for field in VALUE_FIELDS
    ),
    Column("status", ColumnType.WORD, "how far the row can be believed", tuple(Status)),
    Column("faults", ColumnType.WORDS, "what is wrong with the row", tuple(FAULT_MEANINGS)),
    Column("raw", ColumnType.HEX, "the bytes"),
)
"""The row contract, in order (JSONL keys, CSV columns, filter fields; never translated)."""

COLUMN_BY_NAME = {column.name: column for column in COLUMNS}

_NOTHING: dict[str, Value] = dict.fromkeys(COLUMN_BY_NAME)


def record(row: Row) -> dict[str, Value]:
    """The row as a dict of the contract's names, in their order.

    `time` is in nanoseconds since 1970 UTC, the values are in the units of their `COLUMNS`, `raw`
    is hex; what the row has not is None.
    """
    found: dict[str, Value] = {
        **_NOTHING,
        "time": row.t_ns,
        "port": row.port,
        "offset": row.offset,
        "length": len(row.raw),
        "status": row.status.value,
        "faults": [fault.value for fault in row.faults],
        "raw": row.raw.hex().upper(),
    }
    if isinstance(row, Frame):
        found["direction"] = row.direction.value
        found["cmd"] = row.cmd
        kind = row.kind
        if kind is not None:
            found["kind"] = kind.name
            found.update(row.values)
    return found


def iso_time(t_ns: int) -> str:
    """A time as ISO 8601 in UTC with nine digits: `2026-01-31T12:00:00.000000001Z`."""
    seconds, nanoseconds = divmod(t_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{nanoseconds:09d}Z"


def faults_text(faults: tuple[Fault, ...]) -> str:
    """The faults as one text, joined by commas; empty where there are none."""
    return ",".join(faults)


def spaced_hex(raw: bytes) -> str:
    """Bytes as people read them: `AA 01 01 03 E8 00 00 00 00 EE`."""
    return raw.hex(" ").upper()


TIME_FORMAT = "%Y-%m-%dT%H:%M:%S%.9fZ"
"""ISO 8601 in UTC with nine digits: `2026-01-31T12:00:00.000000001Z`."""
