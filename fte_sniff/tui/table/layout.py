"""Owns the table's columns: their order, width, and the text of each cell of a row.

It must not know colours, the window, or where rows come from. Names come from the row contract and
widths from the ranges in the frame table; only the order, most useful first, is decided here.

Where all columns do not fit side by side, the values of a row stand in one, by their short names:

    time UTC     kind        values                 raw                           > faults, offset
    12:00:00.000 speed       motor=1 rpm=1000       AA 01 01 03 E8 00 00 00 00 EE
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cache

from fte_sniff.errors import shown
from fte_sniff.protocol import (
    COLUMN_BY_NAME,
    FRAME_LENGTH,
    VALUE_FIELDS,
    Field,
    Frame,
    Row,
    Status,
    Value,
    spaced_hex,
)
from fte_sniff.tui.fitting import fit, fit_path, fit_right

MARKS = {Status.OK: " ", Status.SUSPECT: "?", Status.MALFORMED: "!"}
"""The sign of each status, so that colour is never the only one."""

VALUES = "values"
"""The column in which all values of a row stand, where there is no room for one each."""

ROOMY = 149
"""Cells from which on a table has a column for each value, and microseconds."""

SPACIOUS = 128
"""Cells from which on the kind and the column of values are as wide as their longest."""

_PORT_WIDTH = 12
_FAULTS_WIDTH = 19
_HEX_WIDTH = 3 * FRAME_LENGTH - 1
_COUNT_WIDTH = 10
_MILLISECONDS, _MICROSECONDS = 3, 6
_VALUE_NAMES = frozenset(field.name for field in VALUE_FIELDS)
_SHORT_KIND_WIDTH = 11
_SHORT_VALUES_WIDTH = 22
_LONG_VALUES_WIDTH = 45

ORDER = (
    "time",
    "port",
    "kind",
    *(field.name for field in VALUE_FIELDS),
    "raw",
    "faults",
    "offset",
    "length",
    "status",
    "direction",
    "cmd",
)
"""The columns of the contract, the most useful first."""


@dataclass(frozen=True, slots=True)
class TableColumn:
    """One column of the table."""

    name: str
    """The name in the row contract."""
    head: str
    """What stands over it."""
    width: int
    """Cells."""
    number: bool
    """Numbers stand at the right of their column."""
    text: Callable[[Value], str]
    """A value as the cell shows it; never called with None."""

    def cell(self, value: Value) -> str:
        """The cell, exactly `width` cells wide; nothing where there is no value."""
        if value is None:
            return " " * self.width
        return (fit_right if self.number else fit)(self.text(value), self.width)

    @property
    def head_cell(self) -> str:
        """The column's name, set as its cells are."""
        return (fit_right if self.number else fit)(self.head, self.width)


@dataclass(frozen=True, slots=True)
class Layout:
    """The columns of a table, side by side with one cell between them."""

    columns: tuple[TableColumn, ...]

    @property
    def width(self) -> int:
        """Cells that the mark and all columns take."""
        return len(MARKS[Status.OK]) + sum(column.width + 1 for column in self.columns)

    def without(self, hidden: int) -> Layout:
        """The layout moved sideways by so many columns; the time stays at the left."""
        return Layout((self.columns[0], *self.columns[1 + hidden :]))

    def most_hidden(self, width: int) -> int:
        """Columns that must be hidden for the last one to be seen in `width` cells."""
        movable = len(self.columns) - 1
        fitting = (n for n in range(movable) if self.without(n).width <= width)
        return next(fitting, max(0, movable - 1))

    def end_of(self, name: str) -> int:
        """The cell behind the column of that name."""
        at = len(MARKS[Status.OK])
        for column in self.columns:
            at += column.width + 1
            if column.name == name:
                break
        return at


def layout_for(width: int, ports: int) -> Layout:
    """The layout for a table of `width` cells whose rows come from so many ports."""
    names = tuple(name for name in ORDER if name != "port" or ports > 1)
    if width >= ROOMY:
        return _one_each(names)
    return _compact(names, width >= SPACIOUS)


@cache
def _one_each(names: tuple[str, ...]) -> Layout:
    return Layout(tuple(_column(name) for name in names))


@cache
def _compact(names: tuple[str, ...], spacious: bool) -> Layout:
    """The columns with those of values in one, where the first of them would be."""
    columns = {name: _column(name) for name in names if name not in _VALUE_NAMES}
    if not spacious:
        columns["kind"] = replace(columns["kind"], width=_SHORT_KIND_WIDTH)
    columns["time"] = _time_column(_MILLISECONDS)
    at = names.index(next(name for name in names if name in _VALUE_NAMES))
    width = _LONG_VALUES_WIDTH if spacious else _SHORT_VALUES_WIDTH
    values = TableColumn(VALUES, VALUES, width, False, str)
    ordered = list(columns.values())
    return Layout((*ordered[:at], values, *ordered[at:]))


def values_text(row: Row) -> str:
    """The row's values by their short names: `motor=1 rpm=1000`.

    Flag bytes are left out where they have the value of the protocol's examples, that all is in
    order; they stand among the raw bytes at any rate.
    """
    kind = row.kind if isinstance(row, Frame) else None
    if kind is None:
        return ""
    texts = []
    for field in kind.fields:
        value = field.read(row.raw)
        if field.defined_bits is None:
            texts.append(f"{field.option}={value}")
        elif value != field.default:
            texts.append(f"{field.option}={_flags_cell(value)}")
    return " ".join(texts)


def faulty_text(row: Row, width: int) -> str:
    """What is wrong, then the bytes, for where there is no room for a column of each."""
    faults = ",".join(row.faults)
    words = f"{faults}  " if faults else ""
    return fit(words + bytes_text(row.raw, width - len(words)), width)


def bytes_text(raw: bytes, width: int) -> str:
    """The bytes as hex; of a run too long for the width, the first ones and how many there are."""
    if len(raw) <= max(FRAME_LENGTH, (width + 1) // 3):
        return spaced_hex(raw)
    count = f" … {len(raw)} bytes"
    return spaced_hex(raw[: max(0, (width - len(count) + 1) // 3)]) + count


def clock_text(t_ns: int, digits: int) -> str:
    """The time of day, UTC, with so many digits (1-9) behind the second."""
    seconds, nanoseconds = divmod(t_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%H:%M:%S}.{nanoseconds:09d}"[: 9 + digits]


def _time_column(digits: int) -> TableColumn:
    return TableColumn("time", "time UTC", 9 + digits, False, lambda v: _clock_cell(v, digits))


def _column(name: str) -> TableColumn:
    field = next((field for field in VALUE_FIELDS if field.name == name), None)
    if field is not None:
        return _value_column(field)
    if name == "time":
        return _time_column(_MICROSECONDS)
    if name == "port":
        return TableColumn(name, name, _PORT_WIDTH, False, _port_cell)
    if name == "raw":
        return TableColumn(name, name, _HEX_WIDTH, False, _hex_cell)
    if name == "faults":
        return TableColumn(name, name, _FAULTS_WIDTH, False, _words_cell)
    if name in ("offset", "length", "cmd"):
        width = _COUNT_WIDTH if name == "offset" else len(name)
        return TableColumn(name, name, width, True, str)
    widest = max(len(word) for word in COLUMN_BY_NAME[name].words)
    return TableColumn(name, name, max(widest, len(name)), False, _text_cell)


def _value_column(field: Field) -> TableColumn:
    head = field.name
    if field.defined_bits is not None:
        return TableColumn(field.name, head, max(len(head), 2), True, _flags_cell)
    widest = max(len(str(field.low)), len(str(field.high)), len(head))
    return TableColumn(field.name, head, widest, True, str)


def _clock_cell(value: Value, digits: int) -> str:
    return clock_text(value, digits) if isinstance(value, int) else ""


def _flags_cell(value: Value) -> str:
    return f"{value:02X}"


def _hex_cell(value: Value) -> str:
    return bytes_text(bytes.fromhex(str(value)), _HEX_WIDTH)


def _words_cell(value: Value) -> str:
    return ",".join(value) if isinstance(value, list) else ""


def _port_cell(value: Value) -> str:
    """The end of the name, which is what tells ports and files apart."""
    return fit_path(shown(str(value)), _PORT_WIDTH)


def _text_cell(value: Value) -> str:
    return shown(str(value))
