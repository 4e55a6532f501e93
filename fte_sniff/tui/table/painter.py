"""Painter of table rows: a row becomes a line of styled segments."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import takewhile

from rich.segment import Segment
from rich.style import Style
from textual.strip import Strip

from fte_sniff.analysis.search import Search
from fte_sniff.formats.text_layout import mark_of
from fte_sniff.protocol import VALUE_FIELDS, Frame, Row, Status, Value, record
from fte_sniff.tui.i18n import ExplainedWord
from fte_sniff.tui.table.columns import (
    MARKS,
    RAISED_MARK,
    VALUES,
    TableColumn,
    TableLayout,
    TimeStyle,
)
from fte_sniff.tui.table.theme import Palette
from fte_sniff.tui.text import faulty_text, is_raised, short_values

FAULT_COLUMNS = ("kind", VALUES, *(field.name for field in VALUE_FIELDS), "raw")
"""Columns that a row without values uses to show its faults."""


class Sign(ExplainedWord):
    """The sign in the first cell after the status."""

    NONE = " ", ""
    MARKED = "*", "marked by m"
    SELECTED = "|", "selected by v"


@dataclass(frozen=True, slots=True)
class RowCell:
    """A row with its sign, as a line of the window shows it."""

    row: Row
    sign: Sign = Sign.NONE
    since_ns: int | None = None
    """The time from which the row's time is counted, if any."""


@dataclass(frozen=True, slots=True)
class Painter:
    """Paints rows for one layout, palette and width."""

    layout: TableLayout
    palette: Palette
    width: int
    """Cells of the window."""
    hidden: int = 0
    """Columns after the first that are scrolled out at the left."""
    times: TimeStyle = TimeStyle.CLOCK
    search: Search | None = None
    """Its hits are highlighted."""

    def row(self, cell: RowCell, line: Style) -> Strip:
        """The row, over the style of its line."""
        row, columns = cell.row, self._columns
        values = self._values(cell)
        spanned = self._spanned(row)
        segments = [self._mark(row), Segment(cell.sign, self.palette.signs)]
        for number, column in enumerate(columns):
            if number not in spanned:
                text = self._text(column, row, values)
                segments += self._highlighted(text, self._style(column, row))
            elif number == spanned[0]:
                width = sum(columns[one].width + 1 for one in spanned) - 1
                style = self.palette.statuses[row.status]
                segments += self._highlighted(faulty_text(row, width), style)
            if number + 1 < len(columns) and number + 1 not in spanned[1:]:
                segments.append(Segment(" ", Style.null()))
        return self._strip(segments, line)

    def _mark(self, row: Row) -> Segment:
        if row.status is Status.OK and is_raised(row):
            return Segment(RAISED_MARK, self.palette.raised_mark)
        return Segment(mark_of(row), self.palette.marks[row.status])

    def head(self, line: Style) -> Strip:
        """The column names, with `<` and `>` where there are more columns."""
        segments = [Segment(MARKS[Status.OK], Style.null())]
        for number, column in enumerate(self._columns):
            edge = "<" if number == 1 and self.hidden else " "
            segments.append(Segment(edge + column.head_cell, Style.null()))
        strip = self._strip(segments, line)
        if self.shown.width > self.width > 0:
            strip = Strip([*strip.crop(0, self.width - 1), Segment(">", line)], self.width)
        return strip

    @property
    def shown(self) -> TableLayout:
        """The columns that are not scrolled out."""
        return self.layout.without(self.hidden)

    @property
    def _columns(self) -> tuple[TableColumn, ...]:
        return self.shown.within(self.width).columns

    def _values(self, cell: RowCell) -> dict[str, Value]:
        values = {**record(cell.row), VALUES: ""}
        if self.times.is_elapsed:
            known = cell.row.t_ns is not None and cell.since_ns is not None
            values["time"] = (cell.row.t_ns or 0) - (cell.since_ns or 0) if known else None
        return values

    def _text(self, column: TableColumn, row: Row, values: dict[str, Value]) -> str:
        if column.name == "raw" and row.faults and self._faults_cut:
            return faulty_text(row, column.width)
        if column.name == VALUES:
            return column.cell(short_values(row, column.width))
        return column.cell(values[column.name])

    def _spanned(self, row: Row) -> list[int]:
        """Numbers of the adjacent columns that show the faults of a row without values."""
        if (isinstance(row, Frame) and row.kind is not None) or not self._faults_cut:
            return []
        numbers = [n for n, column in enumerate(self._columns) if column.name in FAULT_COLUMNS]
        adjacent = takewhile(lambda pair: pair[0] + numbers[0] == pair[1], enumerate(numbers))
        return [number for _, number in adjacent]

    @property
    def _faults_cut(self) -> bool:
        """Whether the column of faults is not wholly in the window."""
        names = {column.name for column in self.shown.columns}
        return "faults" not in names or self.shown.end_of("faults") > self.width

    def _highlighted(self, text: str, style: Style) -> list[Segment]:
        """The text with the hits of the search."""
        segments, end = [], 0
        for start, stop in self.search.spans(text) if self.search else ():
            segments.append(Segment(text[end:start], style))
            segments.append(Segment(text[start:stop], self.palette.found))
            end = stop
        return [*segments, Segment(text[end:], style)]

    def _strip(self, segments: list[Segment], line: Style) -> Strip:
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
