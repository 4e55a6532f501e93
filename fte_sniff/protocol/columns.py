"""The column table, and how rows look: values as text, the signs and colours of a status.

Filters, CSV, JSON lines, Parquet, the screen's table, measures of `check`, help and docs derive
from `COLUMNS`: a new column whose value follows from its row is one entry there. Plain tables have
cells of their own (`formats/text_table.py`). Plain text, the screen and pages derive their signs
and colours from `LOOKS`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from enum import StrEnum
from functools import cache
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from fte_sniff.protocol.rows import NO_FACT, Row, Rows, faults_in
from fte_sniff.protocol.spec import (
    FAULT_MEANINGS,
    FRAME_LENGTH,
    KINDS,
    VALUE_FIELDS,
    Direction,
    Fault,
    Field,
    FrameKind,
    Status,
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
    of_row: Callable[[Row], Value] | None
    """The value in a row; None for a field of a frame, which `record` reads with all others."""
    of_rows: Callable[[Rows], ColumnData] | None
    """The values in a Rows, whose bytes are in `raw`; None for HEX."""
    words: tuple[str, ...] = ()
    """All possible words of a WORD or WORDS column."""
    unit: str = ""
    bits: int = 64
    """Bits of an INT column's values, which have a sign if `signed`."""
    signed: bool = True
    rank: int = 50
    """Place on the screen, from left to right, the most useful first."""
    width: int = 0
    """Cells on the screen; 0 where the values or words decide."""
    shown: bool = True
    """Whether the screen shows it if the user has not chosen columns."""
    derived: bool = False
    """Whether it depends on other rows, so that `analysis.facts` computes it."""


def _kind_name(row: Row) -> Value:
    return row.kind.name if row.kind else None


def _direction(row: Row) -> Value:
    return row.direction.value if row.direction else None


def _fault_sets(rows: Rows) -> ColumnData:
    """The faults of rows: an index into the sets that occur."""
    bits, codes = np.unique(rows.faults, return_inverse=True)
    return ColumnData(codes, words=[faults_in(one) for one in bits.tolist()])


def _field_column(field: Field) -> Column:
    fields = (one for kind in KINDS for one in kind.fields if one.name == field.name)
    meaning = ", or ".join(dict.fromkeys(one.meaning for one in fields))
    return Column(
        field.name,
        ColumnType.INT,
        f"{meaning} [{field.unit}]" if field.unit else meaning,
        None,
        lambda rows: ColumnData(*rows.field(field.name)),
        unit=field.unit,
        bits=8 * field.size,
        signed=field.signed,
        rank=30,
    )


def _milliseconds(nanoseconds: Any) -> Any:
    """Milliseconds with three decimals, which every format writes alike; also of an array."""
    return (nanoseconds + 500) // 1000 / 1000


COLUMNS: tuple[Column, ...] = (
    Column(
        "time",
        ColumnType.TIME,
        "when the first byte began on the wire, UTC",
        lambda row: row.t_ns,
        lambda rows: ColumnData(rows.t_ns, rows.timed),
        rank=10,
    ),
    Column(
        "port",
        ColumnType.TEXT,
        "which wire: the port's name, or the file's",
        lambda row: row.port,
        lambda rows: ColumnData(rows.port, words=rows.ports),
        rank=15,
    ),
    Column(
        "offset",
        ColumnType.INT,
        "of the first byte in that port's stream",
        lambda row: row.offset,
        lambda rows: ColumnData(rows.offset),
        rank=60,
        width=10,
    ),
    Column(
        "length",
        ColumnType.INT,
        "bytes",
        lambda row: len(row.raw),
        lambda rows: ColumnData(rows.length),
        bits=32,
        signed=False,
        rank=65,
    ),
    Column(
        "direction",
        ColumnType.WORD,
        "which way the frame goes",
        _direction,
        lambda rows: ColumnData(rows.directions, words=(*Direction, None)),
        tuple(Direction),
        rank=75,
    ),
    Column(
        "kind",
        ColumnType.WORD,
        "kind of frame",
        _kind_name,
        lambda rows: ColumnData(rows.kinds, words=(*(kind.name for kind in KINDS), None)),
        tuple(kind.name for kind in KINDS),
        rank=20,
    ),
    Column(
        "cmd",
        ColumnType.INT,
        "CMD as on the wire",
        lambda row: row.cmd,
        lambda rows: ColumnData(rows.cmds, rows.framed),
        bits=8,
        signed=False,
        rank=80,
    ),
    *map(_field_column, VALUE_FIELDS),
    Column(
        "status",
        ColumnType.WORD,
        "how far the row can be believed",
        lambda row: row.status.value,
        lambda rows: ColumnData(rows.statuses, words=tuple(Status)),
        tuple(Status),
        rank=70,
    ),
    Column(
        "faults",
        ColumnType.WORDS,
        "what is wrong with the row",
        lambda row: [fault.value for fault in row.faults],
        _fault_sets,
        tuple(FAULT_MEANINGS),
        rank=55,
        width=19,
    ),
    Column(
        "raw",
        ColumnType.HEX,
        "the bytes",
        lambda row: row.raw.hex().upper(),
        None,
        rank=50,
        width=3 * FRAME_LENGTH - 1,
    ),
    Column(
        "answer_ms",
        ColumnType.REAL,
        "from a command to the feedback that answers it, the slowest motor's [ms]",
        lambda row: None if row.answer_ns is None else _milliseconds(row.answer_ns),
        lambda rows: ColumnData(_milliseconds(rows.answer_ns), rows.answer_ns != NO_FACT),
        unit="ms",
        rank=85,
        width=9,
        shown=False,
        derived=True,
    ),
    Column(
        "unanswered",
        ColumnType.BOOL,
        "whether a command had no answer by the deadline; null where that is not known",
        lambda row: row.unanswered,
        lambda rows: ColumnData(rows.unanswered > 0, rows.unanswered != NO_FACT),
        rank=86,
        shown=False,
        derived=True,
    ),
    Column(
        "motor_hint",
        ColumnType.INT,
        "the motor that a damaged row probably belonged to",
        lambda row: row.motor_hint,
        lambda rows: ColumnData(rows.motor_hint, rows.motor_hint != NO_FACT),
        bits=8,
        rank=87,
        shown=False,
        derived=True,
    ),
)
"""The columns in order (JSONL keys, CSV columns, filter fields; never translated)."""

COLUMN_BY_NAME = {column.name: column for column in COLUMNS}

RANKED = tuple(sorted(COLUMNS, key=lambda column: column.rank))
"""The columns as the screen shows them."""

_OF_ROW = tuple((column.name, column.of_row) for column in COLUMNS)


def record(row: Row) -> dict[str, Value]:
    """The row as a dict of `COLUMNS`, in order: UTC time in ns, `raw` as hex, None if absent."""
    values = {name: None if of_row is None else of_row(row) for name, of_row in _OF_ROW}
    values.update(row.values)
    return values


def _previous_column(field: Field) -> Column:
    return Column(
        f"previous({field.name})",
        ColumnType.INT,
        f"{field.name} of the frame before of the same port, motor and kind",
        None,
        lambda rows: ColumnData(*rows.previous_field(field.name)),
        bits=8 * field.size,
        signed=field.signed,
        derived=True,
    )


PREVIOUS = {field.name: _previous_column(field) for field in VALUE_FIELDS}
"""By field, the column that only filters read, as the function `previous`."""

DERIVED = frozenset(column.name for column in (*COLUMNS, *PREVIOUS.values()) if column.derived)
"""The columns that `analysis.facts` computes."""


class Ground(StrEnum):
    """What text is shown on."""

    DARK = "dark"
    LIGHT = "light"
    DARK_16 = "dark, 16 colours"
    LIGHT_16 = "light, 16 colours"


class Ink(NamedTuple):
    """Colours on one ground, as `#rrggbb`; tests/tui/test_painter.py checks their contrast."""

    text: str
    """Its contrast by WCAG 2 is at least 4.5 on the background of each theme, and of a page."""
    sign: str
    """Colour of a sign that has its own background, with a contrast of at least 4.5."""
    sign_ground: str


class Look(NamedTuple):
    """How a status is shown."""

    mark: str
    """Sign in front of a row; colour must never be the only difference."""
    color: str = "green"
    """Colour on a terminal whose ground is unknown, by its ANSI name."""
    bold: bool = False
    plot: str = "#3a7bd5"
    """Colour in plots, with a contrast of about 3, at least 2.9, on light and dark ground."""
    inks: Mapping[Ground, Ink] = MappingProxyType({})
    """The colours by ground; empty for those of plain text."""

    @property
    def style(self) -> str:
        """Style on a terminal whose ground is unknown, as rich writes it."""
        return f"bold {self.color}" if self.bold else self.color


LOOKS: Mapping[Status, Look] = MappingProxyType(
    {
        Status.OK: Look(" "),
        Status.SUSPECT: Look(
            "?",
            "yellow",
            plot="#d9822b",
            inks={
                Ground.DARK: Ink("#f0e442", "#101010", "#f0e442"),
                Ground.LIGHT: Ink("#6b5e00", "#101010", "#e0d030"),
                Ground.DARK_16: Ink("#ffff55", "#000000", "#ffff55"),
                # The nearest of the 16 to the colour of a light theme is not seen on white.
                Ground.LIGHT_16: Ink("#aa00aa", "#000000", "#ffff55"),
            },
        ),
        Status.MALFORMED: Look(
            "!",
            "red",
            bold=True,
            plot="#d03b3b",
            inks={
                Ground.DARK: Ink("#ff8f50", "#ffffff", "#b84a00"),
                Ground.LIGHT: Ink("#a33c00", "#ffffff", "#b84a00"),
                Ground.DARK_16: Ink("#ff5555", "#ffffff", "#aa0000"),
                Ground.LIGHT_16: Ink("#aa0000", "#ffffff", "#aa0000"),
            },
        ),
    }
)
"""The look of each status, its only definition."""


ORDER_MARK = "~"
"""The mark of an `ok` row whose order with rows of another port is uncertain."""


def mark_of(row: Row) -> str:
    """One character for the status of a row, or an uncertain order."""
    if row.unordered and row.status is Status.OK:
        return ORDER_MARK
    return LOOKS[row.status].mark


def iso_time(t_ns: int, zone: tzinfo = UTC) -> str:
    """Format nanoseconds since 1970 UTC as ISO 8601: `2026-01-31T12:00:00.000000001Z`.

    In other zones the offset takes the place of `Z`: `2026-01-31T20:00:00.000000001+08:00`.
    """
    seconds, nanoseconds = divmod(t_ns, 1_000_000_000)
    if zone == UTC:
        return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{nanoseconds:09d}Z"
    moment = datetime.fromtimestamp(seconds, zone_at(t_ns, zone)).isoformat()
    return f"{moment[:19]}.{nanoseconds:09d}{moment[19:]}"


ISO_TIME = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{9}(?:Z|[+-]\d\d:\d\d)"
"""The regular expression of the texts of `iso_time`."""


def iso_time_ns(text: str) -> int | None:
    """The nanoseconds since 1970 UTC of a text of `iso_time`; None for other texts and dates."""
    if re.fullmatch(ISO_TIME, text, re.ASCII) is None:
        return None
    try:
        second = datetime.fromisoformat(text[:19] + text[29:])
    except ValueError:
        return None
    return int(second.timestamp()) * 1_000_000_000 + int(text[20:29])


def zone_at(t_ns: int, zone: tzinfo) -> timezone:
    """Fixed offset of a zone at a time, in whole minutes, since ISO 8601 has no seconds there."""
    if zone == UTC:
        return UTC
    moment = datetime.fromtimestamp(t_ns // 1_000_000_000, UTC).astimezone(zone)
    offset = moment.utcoffset() or timedelta(0)
    return timezone(timedelta(minutes=offset // timedelta(minutes=1)))


def faults_text(faults: tuple[Fault, ...]) -> str:
    """Join the faults by commas; empty if there are none."""
    return ",".join(faults)


def spaced_hex(raw: bytes) -> str:
    """Format bytes as hex with spaces: `AA 01 01 03 E8 00 00 00 00 EE`."""
    return raw.hex(" ").upper()


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
            (
                name[:size]
                for size in range(1, len(name))
                if sum(other.startswith(name[:size]) for other in names) == 1
            ),
            name,
        )
        for name in names
    }
