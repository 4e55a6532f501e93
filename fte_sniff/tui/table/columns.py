"""Visible columns and widths."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from enum import StrEnum
from functools import cache

from rich.cells import cell_len

from fte_sniff.errors import printable
from fte_sniff.protocol import COLUMN_BY_NAME, FRAME_LENGTH, VALUE_FIELDS, Field, Status, Value
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.text import (
    bytes_text,
    clock_text,
    fit,
    fit_right,
    kind_text,
    short_names,
)
from fte_sniff.tui.text import (
    elapsed_text as span_text,
)


class TimeStyle(StrEnum):
    """What the times of rows are told from; the text stands over the column."""

    CLOCK = "time UTC"
    LOCAL = "time local"
    START = "+ start"
    BEFORE = "+ before"
    MARK = "+ mark"

    @property
    def meaning(self) -> str:
        """In words."""
        return _MEANINGS[self]

    @property
    def counts(self) -> bool:
        """Whether they are distances in time from something."""
        return self not in (TimeStyle.CLOCK, TimeStyle.LOCAL)


_MEANINGS = {
    TimeStyle.CLOCK: "times are the time of day, UTC",
    TimeStyle.LOCAL: "times are the time of day in the zone of --zone, or else of this machine",
    TimeStyle.START: "times count from the first row",
    TimeStyle.BEFORE: "times count from the row before",
    TimeStyle.MARK: "times count from the last mark that was set",
}


@dataclass(frozen=True, slots=True)
class ColumnChoice:
    """The columns that the user wants, and how wide."""

    names: tuple[str, ...]
    """Shown from left to right; at least one."""
    widths: tuple[tuple[str, int], ...] = ()
    """Cells of the columns that have another width than their own."""


@dataclass(frozen=True, slots=True)
class TableView:
    """All of it."""

    ports: tuple[str, ...] = ()
    """Ports seen so far; from two on, each row says its own."""
    times: TimeStyle = TimeStyle.CLOCK
    choice: ColumnChoice | None = None
    """None where the width of the window decides."""
    zone: timezone = UTC
    """That of local times."""

    @property
    def shown_zone(self) -> timezone:
        """The zone of the times of day that are shown."""
        return self.zone if self.times is TimeStyle.LOCAL else UTC


def ahead_of_utc_ns(zone: timezone) -> int:
    """Nanoseconds that clocks of a zone are ahead of UTC."""
    return zone.utcoffset(None) // timedelta(microseconds=1) * 1000


def zone_at(t_ns: int, zone: tzinfo | None) -> timezone:
    """How far a zone is from UTC at a time; None is this machine's.

    One distance holds for a whole table, whose head names it: also where clocks are changed later.
    """
    moment = datetime.fromtimestamp(t_ns // 1_000_000_000, UTC).astimezone(zone)
    return timezone(moment.utcoffset() or timedelta(0))


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


def column_of(name: str, look: TableView) -> TableColumn:
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


def _time_column(look: TableView) -> TableColumn:
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
        name = printable(str(value))
        known = tuple(dict.fromkeys(map(printable, ports)))
        return short_names(known if name in known else (*known, name), width)[name]

    names = tuple(dict.fromkeys(map(printable, ports)))
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
    return printable(str(value))


MARKS = {Status.OK: " ", Status.SUSPECT: "?", Status.MALFORMED: "!"}
"""The sign of each status, so that colour is never the only one."""

RAISED_MARK = "^"
"""The sign of a row that is in order, and whose flag bytes tell that a motor is not."""

ROOMY = 149
"""Cells from which on a table has a column for each value, and microseconds."""

SPACIOUS = 128
"""Cells from which on the kind and the column of values are as wide as their longest."""

NARROW = 49
"""Cells below which times, kinds and values are shortened to stand side by side."""

_SPACIOUS_WIDTHS = {"time": HOURS_WIDTH, VALUES: LONG_VALUES_WIDTH}
_USUAL_WIDTHS = {"time": HOURS_WIDTH, "kind": 11, VALUES: 22}
_NARROW_WIDTHS = {"time": MINUTES_WIDTH, "kind": 8, VALUES: 18}
_NARROW_PORT_WIDTHS = {"time": MINUTES_WIDTH, "port": 4, "kind": 7, VALUES: 14}
"""The widths that differ from a column's own, by how much room there is."""


@dataclass(frozen=True, slots=True)
class TableLayout:
    """The columns of a table, side by side with one cell between them."""

    columns: tuple[TableColumn, ...]

    @property
    def width(self) -> int:
        """Cells that the mark and all columns take."""
        return len(MARKS[Status.OK]) + sum(column.width + 1 for column in self.columns)

    def without(self, hidden: int) -> TableLayout:
        """The layout moved sideways by so many columns; the first stays at the left."""
        return TableLayout((self.columns[0], *self.columns[1 + hidden :]))

    def within(self, width: int) -> TableLayout:
        """What is seen of it in `width` cells: the last column is narrowed, not cut by the edge.

        A cell then says itself that it is cut; where that takes too much room, it is left out.
        """
        if self.width <= width:
            return self
        whole: list[TableColumn] = []
        room = width - len(MARKS[Status.OK])
        for column in self.columns:
            room -= column.width + 1
            if room < 0:
                left = room + column.width
                return TableLayout((*whole, column.sized(left)) if left >= LEAST else tuple(whole))
            whole.append(column)
        return self

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

    def column_at(self, cell: int) -> TableColumn | None:
        """The column that a cell of the line belongs to, the gap before it included."""
        return next((column for column in self.columns if cell < self.end_of(column.name)), None)

    @property
    def choice(self) -> ColumnChoice:
        """These columns as a choice, from which another can be made."""
        return ColumnChoice(tuple(column.name for column in self.columns))


@cache
def layout_for(width: int, look: TableView) -> TableLayout:
    """The layout for a table of `width` cells that is to look like that."""
    if look.choice is not None:
        return _chosen(look.choice, look)
    names = tuple(name for name in ORDER if name != "port" or len(look.ports) > 1)
    if width >= ROOMY:
        return TableLayout(tuple(column_of(name, look) for name in names))
    at = names.index(VALUE_NAMES[0])
    names = tuple(name for name in names if name not in VALUE_NAMES)
    widths = tuple(_widths_for(width, "port" in names).items())
    return _chosen(ColumnChoice((*names[:at], VALUES, *names[at:]), widths), look)


def _widths_for(width: int, ports: bool) -> dict[str, int]:
    if width >= NARROW:
        return _SPACIOUS_WIDTHS if width >= SPACIOUS else _USUAL_WIDTHS
    return _NARROW_PORT_WIDTHS if ports else _NARROW_WIDTHS


def _chosen(choice: ColumnChoice, look: TableView) -> TableLayout:
    widths = dict(choice.widths)
    columns = (column_of(name, look) for name in choice.names)
    return TableLayout(tuple(c.sized(widths[c.name]) if c.name in widths else c for c in columns))
