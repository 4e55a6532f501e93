"""Rows to styled strips."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from itertools import takewhile

from rich.segment import Segment
from rich.style import Style
from textual.strip import Strip

from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.search import Search
from fte_sniff.formats.text_layout import mark_of
from fte_sniff.protocol import VALUE_FIELDS, Frame, Row, Status, Value, record
from fte_sniff.tui.table.columns import (
    MARKS,
    RAISED_MARK,
    VALUES,
    TableColumn,
    TableLayout,
    TimeStyle,
)
from fte_sniff.tui.table.theme import Palette
from fte_sniff.tui.table.viewport import RowMarks, Viewport
from fte_sniff.tui.text import faulty_text, is_raised, values_text

SPANNED = ("kind", VALUES, *(field.name for field in VALUE_FIELDS), "raw")
"""Columns in whose place a row without values says what is wrong with it."""


class Sign(StrEnum):
    """What stands before a row's columns, beside the sign of its status."""

    NONE = " "
    MARKED = "*"
    SELECTED = "|"

    @property
    def meaning(self) -> str:
        """In words."""
        return _MEANINGS[self]


_MEANINGS = {
    Sign.NONE: "",
    Sign.MARKED: "marked by m",
    Sign.SELECTED: "selected by v",
}


@dataclass(frozen=True, slots=True)
class CellPosition:
    """A row, and what stands around it."""

    row: Row
    sign: Sign = Sign.NONE
    since_ns: int | None = None
    """The time that the row's time counts from, where it does."""


@dataclass(frozen=True, slots=True)
class Painter:
    """Paints rows for one layout, palette and width."""

    layout: TableLayout
    palette: Palette
    width: int
    """Cells in the window."""
    hidden: int = 0
    """Columns behind the first that are moved out at the left."""
    times: TimeStyle = TimeStyle.CLOCK
    search: Search | None = None
    """What is looked for, to be set off."""

    def row(self, place: CellPosition, line: Style) -> Strip:
        """The row over the style of its line."""
        row, columns = place.row, self._columns
        values = self._values(place)
        spanned = self._spanned(row)
        segments = [
            self._mark(row),
            Segment(place.sign, self.palette.signs),
        ]
        for at, column in enumerate(columns):
            if at in spanned:
                if at == spanned[0]:
                    room = sum(columns[one].width + 1 for one in spanned) - 1
                    style = self.palette.statuses[row.status]
                    segments += self._set_off(faulty_text(row, room), style)
            else:
                segments += self._set_off(self._text(column, row, values), self._style(column, row))
            if at + 1 < len(columns) and at + 1 not in spanned[1:]:
                segments.append(Segment(" ", Style.null()))
        return self._window(segments, line)

    def _mark(self, row: Row) -> Segment:
        if row.status is Status.OK and is_raised(row):
            return Segment(RAISED_MARK, self.palette.raised_mark)
        return Segment(mark_of(row), self.palette.marks[row.status])

    def head(self, line: Style) -> Strip:
        """The names of the columns, with a sign at each edge behind which there are more."""
        segments = [Segment(MARKS[Status.OK], Style.null())]
        for place, column in enumerate(self._columns):
            edge = "<" if place == 1 and self.hidden else " "
            segments.append(Segment(edge + column.head_cell, Style.null()))
        strip = self._window(segments, line)
        if self.shown.width > self.width > 0:
            strip = Strip([*strip.crop(0, self.width - 1), Segment(">", line)], self.width)
        return strip

    @property
    def shown(self) -> TableLayout:
        """The columns in view, the first of those at the left."""
        return self.layout.without(self.hidden)

    @property
    def _columns(self) -> tuple[TableColumn, ...]:
        return self.shown.within(self.width).columns

    def _values(self, place: CellPosition) -> dict[str, Value]:
        values = {**record(place.row), VALUES: ""}
        if self.times.counts:
            known = place.row.t_ns is not None and place.since_ns is not None
            values["time"] = (place.row.t_ns or 0) - (place.since_ns or 0) if known else None
        return values

    def _text(self, column: TableColumn, row: Row, values: dict[str, Value]) -> str:
        if column.name == "raw" and row.faults and self._cuts_faults:
            return faulty_text(row, column.width)
        if column.name == VALUES:
            return column.cell(values_text(row, column.width))
        return column.cell(values[column.name])

    def _spanned(self, row: Row) -> list[int]:
        """Columns side by side in whose place stands what is wrong with a row without values."""
        if (isinstance(row, Frame) and row.kind is not None) or not self._cuts_faults:
            return []
        places = [at for at, column in enumerate(self._columns) if column.name in SPANNED]
        steps = takewhile(lambda pair: pair[0] + places[0] == pair[1], enumerate(places))
        return [at for _, at in steps]

    @property
    def _cuts_faults(self) -> bool:
        """Whether the column of faults does not fit into the window, or is moved out of it."""
        names = {column.name for column in self.shown.columns}
        return "faults" not in names or self.shown.end_of("faults") > self.width

    def _set_off(self, text: str, style: Style) -> list[Segment]:
        """The text, with what is looked for set off in it."""
        segments, at = [], 0
        for start, end in self.search.places(text) if self.search else ():
            segments.append(Segment(text[at:start], style))
            segments.append(Segment(text[start:end], self.palette.found))
            at = end
        return [*segments, Segment(text[at:], style)]

    def _window(self, segments: list[Segment], line: Style) -> Strip:
        kept = [segment for segment in segments if segment.text]
        return Strip(kept).adjust_cell_length(self.width, Style.null()).apply_style(line)

    def _style(self, column: TableColumn, row: Row) -> Style:
        match column.name:
            case "kind":
                return self.palette.of_kind(row)
            case "faults" | "status":
                return self.palette.statuses[row.status]
            case "time" | "port" | "offset" | "length" | "direction" | "cmd":
                return self.palette.muted
            case "raw" if row.status is Status.OK:
                return self.palette.muted
            case "raw":
                return self.palette.statuses[row.status]
            case _:
                return self.palette.raised if is_raised(row) else self.palette.of_values(row)


def places(
    store: RowStore,
    view: Viewport,
    marks: RowMarks,
    selected: range,
    times: TimeStyle,
    start_ns: int | None,
) -> list[CellPosition]:
    """What the window holds, from top to bottom.

    Args:
        store: where the rows are.
        view: which of those shown are in view.
        marks: the rows that are marked.
        selected: the indices that are selected.
        times: what the rows' times count from.
        start_ns: the time of the first row of all, if it has one.
    """
    end = min(view.top + view.height, view.count)
    since = _since(store, view.top, times, marks, start_ns)
    made = []
    for index, row in store.shown.slice(view.top, end):
        made.append(CellPosition(row, _sign(index, marks, selected), since))
        if times is TimeStyle.BEFORE:
            since = row.t_ns
    return made


def _sign(index: int, marks: RowMarks, selected: range) -> Sign:
    if index in marks:
        return Sign.MARKED
    return Sign.SELECTED if index in selected else Sign.NONE


def _since(
    store: RowStore, top: int, times: TimeStyle, marks: RowMarks, start_ns: int | None
) -> int | None:
    """The time that the window's first row counts from."""
    if times is TimeStyle.BEFORE:
        return store.shown.row(top - 1).t_ns if 0 < top <= store.shown.count else None
    if times is TimeStyle.MARK:
        latest = marks.latest
        return None if latest is None or latest < store.first else store.row(latest).t_ns
    return start_ns if times is TimeStyle.START else None
