"""Owns how one row becomes a line of styled text, cut to the window's width.

It must not know which rows are in view. Every segment has a style: one without would crash where
colours are turned off.
"""

from __future__ import annotations

from dataclasses import dataclass

from rich.segment import Segment
from rich.style import Style
from textual.strip import Strip

from fte_sniff.formats.layout import mark_of
from fte_sniff.protocol import VALUE_FIELDS, Frame, Row, Status, record
from fte_sniff.tui.table.layout import MARKS, VALUES, Layout, TableColumn, faulty_text, values_text
from fte_sniff.tui.table.palette import Palette

SPANNED = ("kind", VALUES, *(field.name for field in VALUE_FIELDS), "raw")
"""Columns in whose place a row without values says what is wrong with it."""


@dataclass(frozen=True, slots=True)
class Painter:
    """Paints rows for one layout, palette and width."""

    layout: Layout
    palette: Palette
    width: int
    """Cells in the window."""
    hidden: int = 0
    """Columns behind the time that are moved out at the left."""

    def row(self, row: Row, line: Style) -> Strip:
        """The row over the style of its line."""
        columns, values = self._columns, {**record(row), VALUES: values_text(row)}
        has_values = isinstance(row, Frame) and row.kind is not None
        cuts_faults = self._cuts_faults
        spans = not has_values and cuts_faults
        segments = [Segment(mark_of(row), self.palette.marks[row.status])]
        room = sum(column.width + 1 for column in columns if column.name in SPANNED) - 1
        for column in columns:
            if not (spans and column.name in SPANNED):
                text = column.cell(values[column.name])
                if column.name == "raw" and row.faults and cuts_faults:
                    text = faulty_text(row, column.width)
                segments.append(Segment(" " + text, self._style(column, row)))
            elif room > 0:
                text = faulty_text(row, room)
                segments.append(Segment(" " + text, self.palette.statuses[row.status]))
                room = 0
        return self._window(segments, line)

    def head(self, line: Style) -> Strip:
        """The names of the columns, with a sign at each edge behind which there are more."""
        segments = [Segment(MARKS[Status.OK], Style.null())]
        for place, column in enumerate(self._columns):
            edge = "<" if place == 1 and self.hidden else " "
            segments.append(Segment(edge + column.head_cell, Style.null()))
        strip = self._window(segments, line)
        if self._shown.width > self.width > 0:
            strip = Strip([*strip.crop(0, self.width - 1), Segment(">", line)], self.width)
        return strip

    @property
    def _shown(self) -> Layout:
        return self.layout.without(self.hidden)

    @property
    def _columns(self) -> tuple[TableColumn, ...]:
        return self._shown.columns

    @property
    def _cuts_faults(self) -> bool:
        """Whether the column of faults does not fit into the window, or is moved out of it."""
        names = {column.name for column in self._columns}
        return "faults" not in names or self._shown.end_of("faults") > self.width

    def _window(self, segments: list[Segment], line: Style) -> Strip:
        return Strip(segments).adjust_cell_length(self.width, Style.null()).apply_style(line)

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
                return self.palette.of_values(row)
