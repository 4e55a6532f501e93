"""The table of rows, and its header line.

In place of Textual's DataTable, which keeps and measures every cell: 100,000 rows take 11 s and
1,100 bytes each there. Here a window of rows is read from the store each time that it is drawn.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np
from rich.cells import cell_len
from rich.segment import Segment
from rich.style import Style
from textual import events, on
from textual.filter import ANSIToTruecolor
from textual.geometry import Region
from textual.message import Message
from textual.scroll_view import ScrollView
from textual.scrollbar import ScrollDown, ScrollTo, ScrollUp
from textual.strip import Strip
from textual.widget import Widget

from fte_sniff.formats.cell_text import fit
from fte_sniff.protocol.dissect import dissect
from fte_sniff.protocol.rows import NO_TIME, Row, Rows
from fte_sniff.protocol.spec import FRAME_LENGTH, NUM_OFFSET
from fte_sniff.tui.cells import TableColumn, TableView, TimeStyle, landmark_text, layout_for
from fte_sniff.tui.painter import DARK, LIGHT, Painter, Palette, RowCell, Sign, painter_for
from fte_sniff.tui.view import View
from fte_sniff.tui.viewport import Viewport

WHEEL_ROWS: Final = 3


@dataclass(frozen=True, slots=True)
class TableLine:
    """A line of the window."""

    cell: RowCell | str
    """A row, or the text of a port event or a gap."""
    position: int | None
    """Of its row among those shown; None for an event."""


class TableHeader(Widget):
    """The line of column names; it scrolls sideways with the table."""

    painter: Painter | None = None

    def render_line(self, y: int) -> Strip:
        """The names."""
        if self.painter is None:
            return Strip.blank(self.size.width, self.rich_style)
        head = self.painter.head(self.rich_style)
        return head.adjust_cell_length(self.size.width, self.rich_style)


class RowTable(ScrollView, can_focus=True, inherit_bindings=False):
    """The rows that the filter shows."""

    COMPONENT_CLASSES: ClassVar[set[str]] = {
        "row-table--cursor",
        "row-table--cursor-away",
        "row-table--selected",
        "row-table--paired",
    }
    ALLOW_SELECT = False

    class Moved(Message):
        """The cursor or the window was moved."""

    def __init__(self, view: View, header: TableHeader, look: TableView) -> None:
        super().__init__()
        self.viewport = Viewport()
        self.look = look
        self.marks: dict[int, str] = {}
        """Texts of the marked rows, which may be empty, by index; the oldest mark is the first."""
        self.selection_start: int | None = None
        """Index of the row at which the selection began; None without one."""
        self.field: int | None = None
        """Number in `dissect` of the field that the user looks at in the cursor's row."""
        self.last_index = 0
        """Index of the row under the cursor, now or when there last were rows."""
        self.empty_text = ""
        self._view, self._shown, self._header = view, view.shown, header
        self._hidden = 0
        self._lines: Sequence[TableLine] = ()
        self._drawn: tuple[object, ...] = ()
        self._thumb = (0.0, 0.0)
        """Length and top of the scroll bar's thumb, in eighths of a cell."""

    # What is under the cursor

    @property
    def cursor_index(self) -> int | None:
        """Index of the row under the cursor; None without rows."""
        return self._shown.index(self.viewport.cursor) if self.viewport.count else None

    @property
    def cursor_row(self) -> Row | None:
        """The row under the cursor; None without rows."""
        index = self.cursor_index
        return None if index is None else self._view.row(index)

    @property
    def selected(self) -> range:
        """Indices from the start of the selection to the cursor; empty without one."""
        if self.selection_start is None or not self.viewport.count:
            return range(0)
        low, high = sorted((self.selection_start, self.last_index))
        return range(low, high + 1)

    @property
    def palette(self) -> Palette:
        """The styles under the current theme."""
        return DARK if self.app.current_theme.dark else LIGHT

    # Changes

    def set_look(self, **changes: object) -> None:
        """Change fields of the `TableView`."""
        self.look = replace(self.look, **changes)  # type: ignore[arg-type]
        self.draw()

    def sync(self) -> None:
        """Draw the rows that are shown now; the cursor stays on its row and in view."""
        shown, viewport = self._shown, self.viewport
        if viewport.height != self.scrollable_size.height:
            viewport.resize(self.scrollable_size.height)
        viewport.refit(shown.count, shown.position_of(self.last_index))
        if viewport.following:
            self._note_cursor()
        self.draw()

    def _note_cursor(self) -> None:
        """Note the index of the cursor's row, which stays the same when rows are filtered."""
        if self.viewport.count:
            self.last_index = self._shown.index(self.viewport.cursor)

    def _moved(self) -> None:
        self._note_cursor()
        self.draw()
        self.post_message(self.Moved())

    def move(self, by: int) -> None:
        """Move the cursor by rows."""
        self.viewport.move(by)
        self._moved()

    def page(self, by: int) -> None:
        """Move the cursor by windows."""
        self.move(by * max(1, self.viewport.height - 1))

    def follow(self) -> None:
        """Go to the last row and follow the end."""
        self.viewport.follow()
        self.sync()

    def aside(self, by: int) -> None:
        """Scroll sideways by columns."""
        self._hidden += by
        self.draw()

    def pause(self) -> None:
        """Leave the end, or follow it again."""
        self.stop_following() if self.viewport.following else self.follow()

    def stop_following(self) -> None:
        """Leave the end; the cursor stays on its row."""
        self.jump(self.viewport.cursor)

    def jump(self, position: int) -> None:
        """Put the cursor on a row by its position among those shown."""
        self.viewport.jump(position)
        self._moved()

    def stay_at(self, index: int) -> None:
        """Put the cursor on the row with that index, or on the next one that is shown."""
        self.viewport.following = False
        self.last_index = index
        self.sync()
        self.jump(self._shown.position_of(index))

    def jump_to_index(self, index: int | None) -> bool:
        """Put the cursor on a shown row by its index; False where a filter hides it."""
        if index is None or not self._shown.has(index):
            return False
        self.jump(self._shown.position_of(index))
        return True

    def look_at(self, field: int | None) -> None:
        """Highlight the bytes of a field of the cursor's row, by its number in `dissect`."""
        self.field = field
        self.draw()

    # Drawing

    def draw(self) -> None:
        """Draw the window, where it has changed."""
        viewport, painter = self.viewport, self._painter
        self._draw_bar()
        self._lines = self._window_lines()
        drawn = (painter, self._lines, viewport.cursor, self.scrollable_size, self.empty_text)
        if drawn != self._drawn:
            self._drawn = drawn
            if painter != self._header.painter:
                self._header.painter = painter
                self._header.refresh()
            self.refresh(self.scrollable_size.region)

    def _draw_bar(self) -> None:
        """Draw the scroll bar, where its thumb has moved by an eighth of a cell."""
        viewport, bar = self.viewport, self.vertical_scrollbar
        eighth = max(1, viewport.count) / max(1, 8 * viewport.height)
        thumb = viewport.height // eighth, viewport.top // eighth
        if thumb != self._thumb:  # a virtual size of the table would be laid out at each row
            self._thumb, bar.window_virtual_size = thumb, viewport.count
            bar.window_size, bar.position = viewport.height, viewport.top

    def _window_lines(self) -> Sequence[TableLine]:
        viewport = self.viewport
        end = min(viewport.top + viewport.height, viewport.count)
        indices, rows = self._shown.rows(viewport.top, end)
        last = self._view.store.next
        after = int(indices[0]) if len(indices) else last
        lines: list[TableLine] = []
        cells = self._cells(indices.tolist(), rows)
        has_events = any(self._shown.landmarks_between(after, last + 1))
        for position, (index, cell) in enumerate(cells, viewport.top):
            lines += self._event_lines(after, index + 1) if has_events else ()
            lines.append(TableLine(cell, position))
            after = index + 1
        if end == viewport.count:
            lines += self._event_lines(after, last + 1)
        return self._in_window(lines)

    def _in_window(self, lines: list[TableLine]) -> Sequence[TableLine]:
        """The lines that fit, with the cursor's row among them."""
        viewport, height = self.viewport, self.viewport.height
        last = next((n for n, line in enumerate(lines) if line.position == viewport.cursor), 0)
        at_end = viewport.cursor == viewport.count - 1 or viewport.top == viewport.last_top
        first = len(lines) - height if at_end else last + 1 - height
        first = max(0, min(first, last))
        return lines[first : first + height]

    def _event_lines(self, start: int, end: int) -> Iterator[TableLine]:
        for landmark in self._shown.landmarks_between(start, end):
            yield TableLine(landmark_text(landmark.what, self.look.shown_zone), None)

    def _cells(self, indices: Sequence[int], rows: Rows) -> Iterator[tuple[int, RowCell]]:
        """Index and cell of the rows in the window, from top to bottom."""
        zero_ns, deltas = self._zero_ns, self._deltas(rows)
        changed = _changed(rows) if self.look.changes else [None] * len(rows)
        paired, selected, raised = self._paired, self.selected, rows.raised().tolist()
        for number, (index, row) in enumerate(zip(indices, rows, strict=True)):
            sign = Sign.UNANSWERED if row.unanswered else Sign.NONE
            sign = Sign.SELECTED if index in selected else sign
            sign = Sign.PAIRED if index in paired else sign
            if index in self.marks:
                sign = Sign.NOTED if self.marks[index] else Sign.MARKED
            is_at = index == self.last_index and self.field is not None
            yield (
                index,
                RowCell(
                    row,
                    sign,
                    None if row.t_ns is None or zero_ns is None else row.t_ns - zero_ns,
                    deltas[number],
                    changed[number],
                    self._field_offsets(row) if is_at else None,
                    raised[number],
                ),
            )

    def _field_offsets(self, row: Row) -> range | None:
        fields = dissect(row)
        return None if self.field is None else fields[self.field % len(fields)].offsets

    def _deltas(self, rows: Rows) -> list[int | None]:
        """The time since the row above of each row in the window; None where it is unknown."""
        t_ns, top = rows.t_ns, self.viewport.top
        above = self._view.row(self._shown.index(top - 1)).t_ns if top and len(rows) else None
        before = np.append([NO_TIME if above is None else above], t_ns[:-1])[: len(t_ns)]
        known = (before != NO_TIME) & (t_ns != NO_TIME)
        found = zip(known.tolist(), (t_ns - before).tolist(), strict=True)
        return [ns if is_known else None for is_known, ns in found]

    @property
    def _paired(self) -> frozenset[int]:
        """Indices of the rows that belong to the cursor's row, unless the end is followed."""
        if self.viewport.following or not self.viewport.count:
            return frozenset()
        return frozenset(self._view.related(self.last_index))

    @property
    def _zero_ns(self) -> int | None:
        """The time from which times are counted, 0 for times of day; None if it is unknown."""
        match self.look.times:
            case TimeStyle.START:
                return self._view.first_ns
            case TimeStyle.MARK:
                return self._view.row([*self.marks][-1]).t_ns if self.marks else None
        return 0

    @property
    def _painter(self) -> Painter:
        width = self.scrollable_size.width
        layout = layout_for(width, self.look)
        self._hidden = min(max(0, self._hidden), max(0, len(layout.columns) - 2))
        return painter_for(layout, self.palette, width, self._hidden)

    @property
    def columns(self) -> tuple[TableColumn, ...]:
        """All columns, with those outside the window."""
        return self._painter.layout.columns

    def render_lines(self, crop: Region) -> list[Strip]:
        """Lines of a part of the window; the styles are computed once for all of them."""
        if self.viewport.height != self.scrollable_size.height:
            self.call_later(self.sync)  # a layout may come without a Resize
        base, painter = self.rich_style, self._painter
        lines = [self._strip(y, base, painter) for y in crop.line_range]
        _behind, background = self.background_colors
        for line_filter in self.get_line_filters():
            if not isinstance(line_filter, ANSIToTruecolor):  # all colours are true
                lines = [line.apply_filter(line_filter, background) for line in lines]
        return [line.crop(crop.x, crop.right) for line in lines]

    def _strip(self, y: int, base: Style, painter: Painter) -> Strip:
        """A row, an event, a blank line, or the text of an empty table."""
        if y < len(self._lines):
            line = self._lines[y]
            if isinstance(line.cell, str):
                return painter.event(line.cell, base)
            return painter.row(line.cell, self._line_style(line, line.cell.sign, base))
        if not self.viewport.count and y == self.viewport.height // 2:
            indent = " " * ((painter.width - cell_len(self.empty_text)) // 2)
            text = fit(indent + self.empty_text, painter.width)
            return Strip([Segment(text, base)], painter.width)
        return Strip.blank(painter.width, base)

    def _line_style(self, line: TableLine, sign: Sign, base: Style) -> Style:
        if line.position == self.viewport.cursor:
            if self.app.no_color:
                return base + Style(reverse=self.has_focus, bold=True)
            name = "cursor" if self.has_focus else "cursor-away"
        elif sign is Sign.SELECTED:
            name = "selected"
        elif sign is Sign.PAIRED:
            name = "paired"
        else:
            return base
        return self.get_component_rich_style(f"row-table--{name}")

    # Size and mouse

    def on_resize(self, event: events.Resize) -> None:
        """Draw as many rows as fit now."""
        self.sync()
        self.post_message(self.Moved())

    @on(ScrollTo)
    @on(ScrollUp)
    @on(ScrollDown)
    def _on_bar(self, event: ScrollTo | ScrollUp | ScrollDown) -> None:
        """Scroll the viewport in place of Textual's scroll position."""
        event.prevent_default().stop()
        top, page = self.viewport.top, self.viewport.height
        if isinstance(event, ScrollTo):
            top = top if event.y is None else round(event.y)
        else:
            top += page if isinstance(event, ScrollDown) else -page
        self.viewport.scroll(top)
        self._moved()

    @on(events.MouseScrollUp)
    @on(events.MouseScrollDown)
    def _on_wheel(self, event: events.MouseEvent) -> None:
        """Scroll by a few rows."""
        event.prevent_default().stop()
        down = isinstance(event, events.MouseScrollDown)
        self.viewport.scroll(self.viewport.top + (WHEEL_ROWS if down else -WHEEL_ROWS))
        self._moved()

    async def on_click(self, event: events.Click) -> None:
        """Put the cursor on the clicked row; a double click explains it, or no longer."""
        line = self._lines[event.y] if 0 <= event.y < len(self._lines) else None
        if line is None or line.position is None or isinstance(line.cell, str):
            return
        self.jump(line.position)
        if event.chain == 2:
            await self.run_action("app.command(\"app.switch('detail')\")")


def _changed(rows: Rows) -> list[tuple[bool, ...] | None]:
    """By row and byte, whether a frame differs from the one before; None if unknown."""
    differing = np.where(rows.previous >= 0, rows.previous ^ rows.payloads, -1)
    return [
        None
        if bits < 0
        else tuple(
            NUM_OFFSET < at < FRAME_LENGTH - 1 and bits >> 8 * (FRAME_LENGTH - 2 - at) & 255 > 0
            for at in range(FRAME_LENGTH)
        )
        for bits in differing.tolist()
    ]
