"""Owns the table's columns: their order, width, and the text of each cell of a row.

It must not know colours, the window, or where rows come from. Names come from the row contract and
widths from the ranges in the frame table; only the order, most useful first, is decided here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache

from fte_sniff.errors import shown
from fte_sniff.protocol import (
    COLUMN_BY_NAME,
    FRAME_LENGTH,
    VALUE_FIELDS,
    Field,
    Row,
    Status,
    Value,
    spaced_hex,
)
from fte_sniff.tui.fitting import fit, fit_right

MARKS = {Status.OK: " ", Status.SUSPECT: "?", Status.MALFORMED: "!"}
"""The sign of each status, so that colour is never the only one."""

ROOMY = 100
"""Cells from which on a table has room for full names and microseconds."""

BYTES_IN_TEXT = 16
"""Bytes of a long run of damage that a cell shows at most."""

_PORT_WIDTH = 12
_FAULTS_WIDTH = 20
_HEX_WIDTH = 3 * FRAME_LENGTH - 1
_COUNT_WIDTH = 10

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
    return _layout(width >= ROOMY, ports > 1)


@cache
def _layout(roomy: bool, several: bool) -> Layout:
    names = [name for name in ORDER if name != "port" or several]
    return Layout(tuple(_column(name, roomy) for name in names))


def damage_text(row: Row) -> str:
    """What is wrong and the bytes, for a row that has no values to show."""
    faults = ",".join(row.faults)
    return f"{faults}  {bytes_text(row.raw)}" if faults else bytes_text(row.raw)


def bytes_text(raw: bytes) -> str:
    """The bytes as hex; of a long run only the first ones, and how many there are."""
    if len(raw) <= BYTES_IN_TEXT:
        return spaced_hex(raw)
    return f"{spaced_hex(raw[:BYTES_IN_TEXT])} … {len(raw)} bytes"


def clock_text(t_ns: int, digits: int) -> str:
    """The time of day, UTC, with so many digits (1-9) behind the second."""
    seconds, nanoseconds = divmod(t_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%H:%M:%S}.{nanoseconds:09d}"[: 9 + digits]


def _column(name: str, roomy: bool) -> TableColumn:
    field = next((field for field in VALUE_FIELDS if field.name == name), None)
    if field is not None:
        return _value_column(field, field.name if roomy else field.option)
    if name == "time":
        digits = 6 if roomy else 3
        return TableColumn(name, name, 9 + digits, False, lambda v: _clock_cell(v, digits))
    if name == "raw":
        return TableColumn(name, name, _HEX_WIDTH, False, _hex_cell)
    if name == "faults":
        return TableColumn(name, name, _FAULTS_WIDTH, False, _words_cell)
    if name in ("offset", "length", "cmd"):
        width = _COUNT_WIDTH if name == "offset" else len(name)
        return TableColumn(name, name, width, True, str)
    widest = max((len(word) for word in COLUMN_BY_NAME[name].words), default=_PORT_WIDTH)
    return TableColumn(name, name, max(widest, len(name)), False, _text_cell)


def _value_column(field: Field, head: str) -> TableColumn:
    if field.defined_bits is not None:
        return TableColumn(field.name, head, max(len(head), 2), True, _flags_cell)
    widest = max(len(str(field.low)), len(str(field.high)), len(head))
    return TableColumn(field.name, head, widest, True, str)


def _clock_cell(value: Value, digits: int) -> str:
    return clock_text(value, digits) if isinstance(value, int) else ""


def _flags_cell(value: Value) -> str:
    return f"{value:02X}"


def _hex_cell(value: Value) -> str:
    return bytes_text(bytes.fromhex(str(value)))


def _words_cell(value: Value) -> str:
    return ",".join(value) if isinstance(value, list) else ""


def _text_cell(value: Value) -> str:
    return shown(str(value))
