"""The row contract: names, types and order of a row's columns; text forms of its values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from functools import cache
from typing import TypeAlias

from fte_sniff.protocol.rows import Frame, Row
from fte_sniff.protocol.spec import (
    FAULT_MEANINGS,
    KINDS,
    VALUE_FIELDS,
    Direction,
    Fault,
    Field,
    FrameKind,
    Status,
)

Value: TypeAlias = int | str | list[str] | None
"""The value of a column: a number, a text, the list of faults, or None."""


class ColumnType(StrEnum):
    """The type of a column's values; all columns but `offset` and `raw` may be null."""

    TIME = "time"
    """Nanoseconds since 1970 UTC."""
    TEXT = "text"
    WORD = "word"
    WORDS = "words"
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
    """All possible words of a WORD or WORDS column."""


def _meaning(name: str, unit: str) -> str:
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
"""The columns in order (JSONL keys, CSV columns, filter fields; never translated)."""

COLUMN_BY_NAME = {column.name: column for column in COLUMNS}

_NO_VALUES: dict[str, Value] = dict.fromkeys(COLUMN_BY_NAME)


def record(row: Row) -> dict[str, Value]:
    """The row as a dict of `COLUMNS`, in order: UTC time in ns, `raw` as hex, None if absent."""
    values: dict[str, Value] = {
        **_NO_VALUES,
        "time": row.t_ns,
        "port": row.port,
        "offset": row.offset,
        "length": len(row.raw),
        "status": row.status.value,
        "faults": [fault.value for fault in row.faults],
        "raw": row.raw.hex().upper(),
    }
    if isinstance(row, Frame):
        values["direction"] = row.direction.value
        values["cmd"] = row.cmd
        kind = row.kind
        if kind is not None:
            values["kind"] = kind.name
            values.update(row.values)
    return values


def iso_time(t_ns: int) -> str:
    """Format nanoseconds since 1970 UTC as ISO 8601: `2026-01-31T12:00:00.000000001Z`."""
    seconds, nanoseconds = divmod(t_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{nanoseconds:09d}Z"


def faults_text(faults: tuple[Fault, ...]) -> str:
    """Join the faults by commas; empty if there are none."""
    return ",".join(faults)


def spaced_hex(raw: bytes) -> str:
    """Format bytes as hex with spaces: `AA 01 01 03 E8 00 00 00 00 EE`."""
    return raw.hex(" ").upper()


TIME_FORMAT = "%Y-%m-%dT%H:%M:%S%.9fZ"
"""The format of `iso_time` for polars."""

FEEDBACK = "fb"
"""Abbreviation of "feedback" where a kind's name does not fit."""

VALUE_FORMS = 4
"""Number of forms of `value_heads`."""


def short_feedback(kind: FrameKind, width: int) -> str | None:
    """A feedback kind's name shortened to at most `width` cells; None for a command."""
    if kind.direction is not Direction.FEEDBACK:
        return None
    stem = kind.name.removesuffix(f"_{Direction.FEEDBACK}")
    return f"{stem[: max(0, width - len(FEEDBACK) - 1)]} {FEEDBACK}"[: max(0, width)]


@cache
def value_heads(kind: FrameKind) -> tuple[tuple[str, ...], ...]:
    """The labels of a kind's fields, in forms of falling length."""
    fields = kind.fields
    short = _shortest([field.option for field in fields])
    return (
        tuple(f"{field.option}=" for field in fields),
        tuple(_letter(field) or f"{field.option}=" for field in fields),
        tuple(_letter(field) or f"{short[field.option]}=" for field in fields),
        tuple(_letter(field) for field in fields),
    )


def short_names_of(name: str) -> tuple[str, ...]:
    """The labels of a field in `value_heads`, the longest first."""
    heads = [
        forms[at]
        for kind in KINDS
        for at, field in enumerate(kind.fields)
        if field.name == name
        for forms in value_heads(kind)
    ]
    return tuple(sorted({*filter(None, heads)}, key=len, reverse=True))


def _letter(field: Field) -> str:
    return "" if field.unit else field.option[0].upper()


def _shortest(names: Sequence[str]) -> dict[str, str]:
    """The shortest unique prefix of each name."""
    return {
        name: next(
            name[:size]
            for size in range(1, len(name) + 1)
            if size == len(name) or sum(other.startswith(name[:size]) for other in names) == 1
        )
        for name in names
    }
