"""Owns single columns of the table: their head, width, and the text of a value.

It must not know which columns stand side by side, nor colours. Names come from the row contract and
widths from the ranges in the frame table.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import timezone

from rich.cells import cell_len

from fte_sniff.errors import shown
from fte_sniff.protocol import COLUMN_BY_NAME, FRAME_LENGTH, VALUE_FIELDS, Field, Value
from fte_sniff.tui.fitting import fit, fit_right
from fte_sniff.tui.language import _, later
from fte_sniff.tui.table.cells import bytes_text, clock_text, kind_text, span_text
from fte_sniff.tui.table.look import Look, TimeStyle, ahead_of_utc_ns
from fte_sniff.tui.table.ports import short_names

VALUES = "values"
"""The column in which all values of a row stand, where there is no room for one each."""

VALUE_NAMES = tuple(field.name for field in VALUE_FIELDS)
"""The columns that have a value of a row each."""

ORDER = (
    "time",
    "port",
    "kind",
    *VALUE_NAMES,
    "raw",
    "faults",
    "offset",
    "length",
    "status",
    "direction",
    "cmd",
)
"""The columns of the contract, the most useful first."""

ZONED = later("time {zone}")
"""Over local times."""

LEAST, MOST = 3, 200
"""Cells that a column may have."""

HOURS_WIDTH = len("12:00:00.000")
"""Cells of a time of day in milliseconds."""

MINUTES_WIDTH = len("00:00.000")
"""Cells of a time without its hour."""

LONG_VALUES_WIDTH = 45
"""Cells for the longest values of a row in one column."""

_MICROSECONDS_WIDTH = len("12:00:00.000000")
_PORT_WIDTH = 12
_FAULTS_WIDTH = 19
_HEX_WIDTH = 3 * FRAME_LENGTH - 1
_COUNT_WIDTH = 10


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
    text: Callable[[Value, int], str]
    """A value as the cell shows it, and the cells there are; never called with None."""

    def cell(self, value: Value) -> str:
        """The cell, exactly `width` cells wide; nothing where there is no value."""
        if value is None:
            return " " * self.width
        return (fit_right if self.number else fit)(self.text(value, self.width), self.width)

    @property
    def head_cell(self) -> str:
        """The column's name, set as its cells are."""
        head = _(self.head) if self.name == "time" else self.head
        if self.name == "time" and cell_len(head) > self.width:
            # What the times are of is more than that they are times.
            head = head.rpartition(" ")[2]
        return (fit_right if self.number else fit)(head, self.width)

    def sized(self, width: int) -> TableColumn:
        """The same column with another width."""
        return replace(self, width=min(max(width, LEAST), MOST))


def column_of(name: str, look: Look) -> TableColumn:
    """The column of that name as wide as it is where there is room."""
    field = next((field for field in VALUE_FIELDS if field.name == name), None)
    if field is not None:
        return _value_column(field)
    if name == "time":
        return _time_column(look)
    if name == "port":
        return _port_column(look.ports)
    if name == VALUES:
        return TableColumn(name, name, LONG_VALUES_WIDTH, False, _plain_cell)
    if name == "raw":
        return TableColumn(name, name, _HEX_WIDTH, False, _hex_cell)
    if name == "faults":
        return TableColumn(name, name, _FAULTS_WIDTH, False, _words_cell)
    if name in ("offset", "length", "cmd"):
        width = _COUNT_WIDTH if name == "offset" else len(name)
        return TableColumn(name, name, width, True, _plain_cell)
    widest = max(len(word) for word in COLUMN_BY_NAME[name].words)
    text = _kind_cell if name == "kind" else _plain_cell
    return TableColumn(name, name, max(widest, len(name)), False, text)


def _time_column(look: Look) -> TableColumn:
    head: str = look.times
    if look.times is TimeStyle.LOCAL:
        head = _(ZONED).format(zone=str(look.zone).removeprefix("UTC"))
    text = _span_cell if look.times.counts else _clock_cell_in(look.shown_zone)
    return TableColumn("time", head, _MICROSECONDS_WIDTH, False, text)


def _value_column(field: Field) -> TableColumn:
    head = field.name
    if field.defined_bits is not None:
        return TableColumn(field.name, head, max(len(head), 2), True, _flags_cell)
    widest = max(len(str(field.low)), len(str(field.high)), len(head))
    return TableColumn(field.name, head, widest, True, _plain_cell)


def _port_column(ports: tuple[str, ...]) -> TableColumn:
    """Port names so short that they fit, and yet not alike."""

    def cell(value: Value, width: int) -> str:
        name = shown(str(value))
        known = tuple(dict.fromkeys(map(shown, ports)))
        return short_names(known if name in known else (*known, name), width)[name]

    names = tuple(dict.fromkeys(map(shown, ports)))
    widest = max((len(name) for name in short_names(names, _PORT_WIDTH).values()), default=0)
    return TableColumn("port", "port", max(widest, len("port")), False, cell)


def _clock_cell_in(zone: timezone) -> Callable[[Value, int], str]:
    """The time of day in a zone; where it does not fit, without the hour."""
    ahead_ns = ahead_of_utc_ns(zone)

    def cell(value: Value, width: int) -> str:
        if not isinstance(value, int):
            return ""
        clock = clock_text(value + ahead_ns, 9)
        return clock[:width] if width >= HOURS_WIDTH else clock[3:][:width]

    return cell


def _span_cell(value: Value, width: int) -> str:
    return span_text(value, width) if isinstance(value, int) else ""


def _kind_cell(value: Value, width: int) -> str:
    return kind_text(str(value), width)


def _flags_cell(value: Value, width: int) -> str:
    return f"{value:02X}"


def _hex_cell(value: Value, width: int) -> str:
    return bytes_text(bytes.fromhex(str(value)), width)


def _words_cell(value: Value, width: int) -> str:
    return ",".join(value) if isinstance(value, list) else ""


def _plain_cell(value: Value, width: int) -> str:
    return shown(str(value))
