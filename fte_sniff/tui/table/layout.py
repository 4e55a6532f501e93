"""Owns which columns stand side by side in a table of a given width.

It must not know colours, the window, or where rows come from. Without a choice of the user the
width decides: a column for each value; or all values of a row in one, by their short names;

    time UTC     kind        values                 raw                           > faults, offset
    12:00:00.000 speed       motor=1 rpm=1000       AA 01 01 03 E8 00 00 00 00 EE

or, on a narrow window, the same with short times, kinds and values, so that they stand together:

    time UTC  kind     values
    00:00.000 speed fb M1 rpm=1000
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from fte_sniff.protocol import Status
from fte_sniff.tui.table.columns import (
    HOURS_WIDTH,
    LEAST,
    LONG_VALUES_WIDTH,
    MINUTES_WIDTH,
    ORDER,
    VALUE_NAMES,
    VALUES,
    TableColumn,
    column_of,
)
from fte_sniff.tui.table.look import ColumnChoice, Look

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
class Layout:
    """The columns of a table, side by side with one cell between them."""

    columns: tuple[TableColumn, ...]

    @property
    def width(self) -> int:
        """Cells that the mark and all columns take."""
        return len(MARKS[Status.OK]) + sum(column.width + 1 for column in self.columns)

    def without(self, hidden: int) -> Layout:
        """The layout moved sideways by so many columns; the first stays at the left."""
        return Layout((self.columns[0], *self.columns[1 + hidden :]))

    def within(self, width: int) -> Layout:
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
                return Layout((*whole, column.sized(left)) if left >= LEAST else tuple(whole))
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
def layout_for(width: int, look: Look) -> Layout:
    """The layout for a table of `width` cells that is to look like that."""
    if look.choice is not None:
        return _chosen(look.choice, look)
    names = tuple(name for name in ORDER if name != "port" or len(look.ports) > 1)
    if width >= ROOMY:
        return Layout(tuple(column_of(name, look) for name in names))
    at = names.index(VALUE_NAMES[0])
    names = tuple(name for name in names if name not in VALUE_NAMES)
    widths = tuple(_widths_for(width, "port" in names).items())
    return _chosen(ColumnChoice((*names[:at], VALUES, *names[at:]), widths), look)


def _widths_for(width: int, ports: bool) -> dict[str, int]:
    if width >= NARROW:
        return _SPACIOUS_WIDTHS if width >= SPACIOUS else _USUAL_WIDTHS
    return _NARROW_PORT_WIDTHS if ports else _NARROW_WIDTHS


def _chosen(choice: ColumnChoice, look: Look) -> Layout:
    widths = dict(choice.widths)
    columns = (column_of(name, look) for name in choice.names)
    return Layout(tuple(c.sized(widths[c.name]) if c.name in widths else c for c in columns))
