"""The column table, and values as text.

Filters, CSV, JSON lines, Parquet, the screen's table, measures of `check`, help and docs derive
from `COLUMNS`: a new column whose value follows from its row is one entry there. Plain tables have
cells of their own (`formats/text_table.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from enum import StrEnum
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from fte_sniff.protocol.rows import NO_FACT, Row, Rows, faults_in
from fte_sniff.protocol.spec import (
    CMD_OFFSET,
    KIND_BY_NAME,
    VALUE_FIELDS,
    Direction,
    Fault,
    Field,
    Status,
    meaning_of,
)

Value: TypeAlias = int | float | str | list[str] | None
"""The value of a column: a number, a text, a truth, the list of faults, or None."""


class ColumnType(StrEnum):
    """The type of a column's values; a row may have none in most columns, which is null then."""

    TIME = "time"
    """Nanoseconds since 1970 UTC."""
    TEXT = "text"
    WORD = "word"
    WORDS = "words"
    INT = "int"
    REAL = "real"
    """A fraction with three decimals."""
    BOOL = "bool"
    HEX = "hex"
    """The row's bytes as hex digits, upper case, no spaces."""


class ColumnData(NamedTuple):
    """The values of a column in many rows."""

    values: Any
    """A numpy array: numbers, of any width, for they are cast to the column's; or indices into
    `words`."""
    known: Any = None
    """A mask of the rows that have a value; None if all have one."""
    words: Sequence[object] | None = None
    """Texts, or sequences of texts; None stands for no value."""


@dataclass(frozen=True, slots=True)
class Column:
    """One column of the row contract."""

    name: str
    type: ColumnType
    meaning: str
    of_rows: Callable[[Rows], ColumnData] | None
    """The values in a Rows, whose bytes are in `raw`; None for HEX."""
    words: tuple[str, ...] = ()
    """All possible words of a WORD or WORDS column."""
    unit: str = ""
    integer: str = "Int64"
    """The polars type of an INT column's values."""
    derived: bool = False
    """Whether it depends on other rows, so that `analysis.table` computes it."""


def _fault_sets(rows: Rows) -> ColumnData:
    """The faults of rows: an index into the sets that occur."""
    bits, codes = np.unique(rows.faults, return_inverse=True)
    return ColumnData(codes, words=[faults_in(one) for one in bits.tolist()])


def _field_column(field: Field) -> Column:
    meaning = meaning_of(field.name)
    return Column(
        field.name,
        ColumnType.INT,
        f"{meaning} [{field.unit}]" if field.unit else meaning,
        lambda rows: ColumnData(*rows.field(field.name)),
        unit=field.unit,
        integer=f"{'' if field.signed else 'U'}Int{8 * field.size}",
    )


def _milliseconds(nanoseconds: Any) -> Any:
    """Milliseconds with three decimals, which every format writes alike; also of an array."""
    return (nanoseconds + 500) // 1000 / 1000


COLUMNS: tuple[Column, ...] = (
    Column(
        "time", ColumnType.TIME, "when the first byte began on the wire, UTC",
        lambda rows: ColumnData(rows.t_ns, rows.timed),
    ),
    Column(
        "port", ColumnType.TEXT, "which wire: the port's name, or the file's",
        lambda rows: ColumnData(rows.port, words=rows.ports),
    ),
    Column(
        "offset", ColumnType.INT, "of the first byte in that port's stream",
        lambda rows: ColumnData(rows.offset),
    ),
    Column(
        "length", ColumnType.INT, "bytes",
        lambda rows: ColumnData(rows.length), integer="UInt32",
    ),
    Column(
        "direction", ColumnType.WORD, "which way the frame goes",
        lambda rows: ColumnData(rows.directions, words=(*Direction, None)), tuple(Direction),
    ),
    Column(
        "kind", ColumnType.WORD, "kind of frame",
        lambda rows: ColumnData(rows.kinds, words=(*KIND_BY_NAME, None)), tuple(KIND_BY_NAME),
    ),
    Column(
        "cmd", ColumnType.INT, "CMD as on the wire",
        lambda rows: ColumnData(rows.raw[:, CMD_OFFSET], rows.framed), integer="UInt8",
    ),
    *map(_field_column, VALUE_FIELDS),
    Column(
        "status", ColumnType.WORD, "how far the row can be believed",
        lambda rows: ColumnData(rows.statuses, words=tuple(Status)), tuple(Status),
    ),
    Column("faults", ColumnType.WORDS, "what is wrong with the row", _fault_sets, tuple(Fault)),
    Column("raw", ColumnType.HEX, "the bytes", None),
    Column(
        "answer_ms", ColumnType.REAL,
        "from a command to the feedback that answers it, the slowest motor's [ms]",
        lambda rows: ColumnData(_milliseconds(rows.answer_ns), rows.answer_ns != NO_FACT),
        unit="ms", derived=True,
    ),
    Column(
        "unanswered", ColumnType.BOOL,
        "whether a command had no answer by the deadline; null where that is not known",
        lambda rows: ColumnData(rows.unanswered > 0, rows.unanswered != NO_FACT), derived=True,
    ),
    Column(
        "motor_hint", ColumnType.INT, "the motor that a damaged row probably belonged to",
        lambda rows: ColumnData(rows.motor_hint, rows.motor_hint != NO_FACT),
        integer="Int8", derived=True,
    ),
)  # fmt: skip
"""The columns in order (JSONL keys, CSV columns, filter fields; never translated)."""

COLUMN_BY_NAME = {column.name: column for column in COLUMNS}


def record(row: Row) -> dict[str, Value]:
    """The row as a dict of `COLUMNS`, in order: UTC time in ns, `raw` as hex, None if absent."""
    return {
        "time": row.t_ns,
        "port": row.port,
        "offset": row.offset,
        "length": len(row.raw),
        "direction": row.direction and row.direction.value,
        "kind": row.kind.name if row.kind else None,
        "cmd": row.cmd,
        **_NO_VALUES,
        **row.values,
        "status": row.status.value,
        "faults": [fault.value for fault in row.faults],
        "raw": row.raw.hex().upper(),
        "answer_ms": None if row.answer_ns is None else _milliseconds(row.answer_ns),
        "unanswered": row.unanswered,
        "motor_hint": row.motor_hint,
    }


_NO_VALUES: dict[str, Value] = dict.fromkeys(field.name for field in VALUE_FIELDS)


def _previous_column(field: Field) -> Column:
    return replace(
        _field_column(field),
        name=f"previous({field.name})",
        meaning=f"{field.name} of the frame before of the same port, motor and kind",
        of_rows=lambda rows: ColumnData(*rows.previous_field(field.name)),
        unit="",
        derived=True,
    )


PREVIOUS = {field.name: _previous_column(field) for field in VALUE_FIELDS}
"""By field, the column that only filters read, as the function `previous`."""

DERIVED = frozenset(column.name for column in (*COLUMNS, *PREVIOUS.values()) if column.derived)
"""The columns that `analysis.table` computes."""


def iso_time(t_ns: int, zone: tzinfo = UTC) -> str:
    """Format nanoseconds since 1970 UTC as ISO 8601: `2026-01-31T12:00:00.000000001Z`.

    In other zones the offset takes the place of `Z`: `2026-01-31T20:00:00.000000001+08:00`.
    """
    seconds, nanoseconds = divmod(t_ns, 1_000_000_000)
    moment = datetime.fromtimestamp(seconds, zone_at(t_ns, zone)).isoformat()
    return f"{moment[:19]}.{nanoseconds:09d}{'Z' if zone == UTC else moment[19:]}"


def iso_time_ns(text: str) -> int | None:
    """The nanoseconds since 1970 UTC of a text of `iso_time`; None for other texts and dates."""
    try:
        second, nanoseconds = datetime.fromisoformat(text[:19] + text[29:]), int(text[20:29])
    except ValueError:
        return None
    return None if second.tzinfo is None else int(second.timestamp()) * 10**9 + nanoseconds


def zone_at(t_ns: int, zone: tzinfo) -> timezone:
    """Fixed offset of a zone at a time, in whole minutes, since ISO 8601 has no seconds there."""
    if zone == UTC:
        return UTC
    moment = datetime.fromtimestamp(t_ns // 1_000_000_000, UTC).astimezone(zone)
    offset = moment.utcoffset() or timedelta(0)
    return timezone(timedelta(minutes=offset // timedelta(minutes=1)))


def spaced_hex(raw: bytes) -> str:
    """Format bytes as hex with spaces: `AA 01 01 03 E8 00 00 00 00 EE`."""
    return raw.hex(" ").upper()
