"""Table widget: cursor, scrolling and search over the rows of a store, and its header line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from rich.cells import cell_len
from rich.segment import Segment
from rich.style import Style
from textual import events, on
from textual.binding import BindingType
from textual.geometry import Region, Size
from textual.message import Message
from textual.reactive import reactive
from textual.scroll_view import ScrollView
from textual.scrollbar import ScrollDown, ScrollTo, ScrollUp
from textual.strip import Strip
from textual.widget import Widget

from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.search import Search
from fte_sniff.errors import FteSniffError
from fte_sniff.formats.cell_text import fit
from fte_sniff.protocol import Row
from fte_sniff.tui.keys import MOVING, bindings, translate_keys
from fte_sniff.tui.table.columns import TableColumn, TableView, TimeStyle, layout_for
from fte_sniff.tui.table.painter import Painter, RowCell, Sign
from fte_sniff.tui.table.theme import palette_of
from fte_sniff.tui.table.viewport import RowMarks, Viewport

WHEEL_ROWS = 3
"""Rows that one notch of the mouse wheel scrolls."""

SCALE_STEPS = 64
"""Scroll bar units per row of the window, at most; the bar cannot show more."""

NO_COLOR_CURSOR = Style(reverse=True, bold=True)


class TableHeader(Widget):
    """The line of column names; scrolls sideways with the table."""

    class Clicked(Message):
        """The header was clicked."""

    painter: reactive[Painter | None] = reactive(None)

    def on_click(self) -> None:
        """Post the message."""
        self.post_message(self.Clicked())

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:
        """One line."""
        return 1

    def render_line(self, y: int) -> Strip:
        """The names."""
        if self.painter is None:
            return Strip.blank(self.size.width, self.rich_style)
        strip = self.painter.head(self.rich_style)
        return strip.adjust_cell_length(self.size.width, self.rich_style)


@dataclass(frozen=True, slots=True)
class ScrollScale:
    """Scroll bar units for `count` rows in a window of `height`; both ends are exact."""

    count: int
    height: int

    @property
    def total(self) -> int:
        """Units of all rows."""
        return min(self.count, max(1, self.height) * SCALE_STEPS)

    def unit_of(self, top: int) -> int:
        """Unit of the window's first row."""
        return self._scaled(top, self.count - self.height, self.total - self.height)

    def row_of(self, unit: float) -> int:
        """The window's first row at a unit."""
        return self._scaled(unit, self.total - self.height, self.count - self.height)

    @staticmethod
    def _scaled(value: float, span: int, to_span: int) -> int:
        return round(value * to_span / span) if span > 0 else 0


class RowTable(ScrollView, can_focus=True):
    """The rows that a store shows."""

    BINDINGS: ClassVar[list[BindingType]] = bindings(MOVING)
    COMPONENT_CLASSES: ClassVar[set[str]] = {
        "row-table--cursor",
        "row-table--cursor-away",
        "row-table--selected",
    }
    ALLOW_SELECT = False

    class Moved(Message):
        """The cursor, the window or the rows in it changed."""

    class Opened(Message):
        """A row was double-clicked."""

    class Failed(Message):
        """Rows cannot be read any more."""

        def __init__(self, failure: FteSniffError) -> None:
            super().__init__()
            self.failure = failure

    def __init__(self, store: RowStore, header: TableHeader, view: TableView) -> None:
        super().__init__()
        translate_keys(self)
        self.viewport = Viewport()
        self.view = view
        self.marks = RowMarks()
        self.selection_start: int | None = None
        """Index of the row at which the selection began; None without one."""
        self.search: Search | None = None
        """Its hits are highlighted."""
        self.column: str | None = None
        """Name of the column that was clicked last."""
        self.start_ns: int | None = None
        """Time of the first row of all, if it has one."""
        self._empty_text = ""
        self._store = store
        self._header = header
        self._cursor_index = 0
        self._pause_index = 0
        self._hidden = 0
        self._cells: Sequence[RowCell] = ()
        self._drawn: tuple[object, ...] = ()

    @property
    def cursor_row(self) -> Row | None:
        """The row under the cursor; None where there are no rows."""
        viewport = self.viewport
        return self._store.view.row(viewport.cursor) if viewport.count else None

    @property
    def cursor_index(self) -> int | None:
        """Index of the row under the cursor; None where there are no rows."""
        viewport = self.viewport
        return self._store.view.index(viewport.cursor) if viewport.count else None

    @property
    def last_index(self) -> int:
        """Index of the row under the cursor, now or when there last were rows."""
        return self._cursor_index

    @property
    def near(self) -> int | None:
        """Index of the row that the user reads; None while the end is followed."""
        return None if self.viewport.following else self._cursor_index

    @property
    def selected(self) -> range:
        """Indices from the start of the selection to the cursor; empty without one."""
        if self.selection_start is None or not self.viewport.count:
            return range(0)
        low, high = sorted((self.selection_start, self._cursor_index))
        return range(max(low, self._store.first), high + 1)

    @property
    def columns(self) -> tuple[TableColumn, ...]:
        """All columns, with those outside the window."""
        return self._painter.layout.columns

    def set_empty_text(self, text: str) -> None:
        """Set the text that is shown while there are no rows."""
        if text != self._empty_text:
            self._empty_text = text
            if not self.viewport.count:
                self.refresh()

    def set_view(self, **changes: object) -> None:
        """Change fields of the `TableView`."""
        view = replace(self.view, **changes)  # type: ignore[arg-type]
        if view != self.view:
            self.view = view
            self._draw()

    def set_search(self, search: Search | None) -> None:
        """Highlight the hits of a search."""
        self.search = search
        self._draw()

    def sync(self) -> None:
        """Draw the rows that the store shows now; the cursor stays on its row."""
        shown, viewport = self._store.view, self.viewport
        count = shown.position_of(self._pause_index if viewport.paused else self._store.next)
        viewport.refit(count, shown.position_of(self._cursor_index), shown.count - count)
        if viewport.following:
            self._update_cursor_index()
        self._draw()

    def _update_cursor_index(self) -> None:
        """Note the index of the cursor's row, which stays the same when rows are filtered."""
        if self.viewport.count:
            self._cursor_index = self._store.view.index(self.viewport.cursor)

    def _on_moved(self) -> None:
        self._update_cursor_index()
        self._draw()

    def _draw(self) -> None:
        viewport, painter = self.viewport, self._painter
        self.marks.forget_before(self._store.first)
        scale = ScrollScale(viewport.count, viewport.height)
        size = Size(painter.width, scale.total)
        if size != self.virtual_size:
            self.virtual_size = size
        unit = scale.unit_of(viewport.top)
        if round(self.scroll_y) != unit:
            self.scroll_to(y=unit, animate=False, force=True)
        try:
            self._cells = self._row_cells()
        except FteSniffError as failure:
            self.post_message(self.Failed(failure))
            return
        self._header.painter = painter
        drawn = (painter, self._cells, viewport.cursor - viewport.top, self.scrollable_size)
        if drawn != self._drawn:
            self._drawn = drawn
            self.refresh(self.scrollable_size.region)
        self.post_message(self.Moved())

    def _row_cells(self) -> list[RowCell]:
        """Rows in the window, from top to bottom."""
        viewport, selected, since_ns = self.viewport, self.selected, self._since_ns
        end = min(viewport.top + viewport.height, viewport.count)
        cells = []
        for index, row in self._store.view.slice(viewport.top, end):
            sign = Sign.SELECTED if index in selected else Sign.NONE
            cells.append(RowCell(row, Sign.MARKED if index in self.marks else sign, since_ns))
            if self.view.times is TimeStyle.BEFORE:
                since_ns = row.t_ns
        return cells

    @property
    def _since_ns(self) -> int | None:
        """The time from which that of the window's first row is counted."""
        store, top, latest = self._store, self.viewport.top, self.marks.latest
        match self.view.times:
            case TimeStyle.START:
                return self.start_ns
            case TimeStyle.BEFORE if 0 < top <= store.view.count:
                return store.view.row(top - 1).t_ns
            case TimeStyle.MARK if latest is not None and latest >= store.first:
                return store.row(latest).t_ns
        return None

    @property
    def _painter(self) -> Painter:
        width = self.scrollable_size.width
        layout = layout_for(width, self.view)
        self._hidden = min(max(0, self._hidden), layout.max_hidden(width))
        palette = palette_of(self.app.current_theme)
        return Painter(layout, palette, width, self._hidden, self.view.times, self.search)

    def render_lines(self, crop: Region) -> list[Strip]:
        """Lines of a part of the window."""
        # Once for all lines: `rich_style` combines all styles of the parents at each call.
        self._line_painter, self._base = self._painter, self.rich_style
        return super().render_lines(crop)

    def render_line(self, y: int) -> Strip:
        """A row, a blank line, or the text of an empty table."""
        width, base = self.scrollable_size.width, self._base
        if y < len(self._cells):
            return self._line_painter.row(self._cells[y], self._line_style(y))
        if not self.viewport.count and y == self.viewport.height // 2:
            indent = " " * ((width - cell_len(self._empty_text)) // 2)
            return Strip([Segment(fit(indent + self._empty_text, width), base)], width)
        return Strip.blank(width, base)

    def _line_style(self, y: int) -> Style:
        if self.viewport.top + y != self.viewport.cursor:
            selected = self._cells[y].sign is Sign.SELECTED
            return self._component_style("selected") if selected else self._base
        if self.app.no_color:
            return self._base + NO_COLOR_CURSOR
        return self._component_style("cursor" if self.has_focus else "cursor-away")

    def _component_style(self, name: str) -> Style:
        return self.get_component_rich_style(f"row-table--{name}")

    def on_resize(self, event: events.Resize) -> None:
        """Keep the cursor in view."""
        self.viewport.resize(self.scrollable_size.height)
        self.sync()

    def watch_scroll_y(self, old_value: float, new_value: float) -> None:
        """Move only the scroll bar; `_draw` draws the rows."""
        if self.show_vertical_scrollbar:
            self.vertical_scrollbar.position = new_value

    @on(ScrollTo)
    def _on_drag(self, event: ScrollTo) -> None:
        scale = ScrollScale(self.viewport.count, self.viewport.height)
        self._scroll(event, self.viewport.top if event.y is None else scale.row_of(event.y))

    @on(ScrollUp)
    def _on_page_up(self, event: ScrollUp) -> None:
        self._scroll(event, self.viewport.top - self.viewport.height)

    @on(ScrollDown)
    def _on_page_down(self, event: ScrollDown) -> None:
        self._scroll(event, self.viewport.top + self.viewport.height)

    def on_mouse_scroll_up(self, event: events.MouseScrollUp) -> None:
        """Scroll up."""
        self._scroll(event, self.viewport.top - WHEEL_ROWS)

    def on_mouse_scroll_down(self, event: events.MouseScrollDown) -> None:
        """Scroll down."""
        self._scroll(event, self.viewport.top + WHEEL_ROWS)

    def on_mouse_scroll_left(self, event: events.MouseScrollLeft) -> None:
        """Scroll by a column to the left."""
        event.prevent_default().stop()
        self.action_aside(-1)

    def on_mouse_scroll_right(self, event: events.MouseScrollRight) -> None:
        """Scroll by a column to the right."""
        event.prevent_default().stop()
        self.action_aside(1)

    def _scroll(self, event: Message, top: int) -> None:
        """Scroll the viewport in place of Textual's scroll position."""
        event.prevent_default().stop()
        self.viewport.scroll(top)
        self._on_moved()

    def on_click(self, event: events.Click) -> None:
        """Put the cursor on the clicked row; a double click opens it."""
        row = self.viewport.top + event.y
        if row < self.viewport.count:
            column = self._painter.shown.column_at(event.x)
            self.column = column.name if column else None
            self.jump(row)
            if event.chain == 2:
                self.post_message(self.Opened())

    def action_move(self, by: int) -> None:
        """Move the cursor by rows."""
        self.viewport.move(by)
        self._on_moved()

    def action_page(self, by: int) -> None:
        """Move the cursor by windows."""
        self.action_move(by * max(1, self.viewport.height - 1))

    def action_first(self) -> None:
        """Go to the first row."""
        self.jump(0)

    def action_follow(self) -> None:
        """Go to the last row and follow the end."""
        self.viewport.follow()
        self.sync()

    def action_aside(self, by: int) -> None:
        """Scroll sideways by columns."""
        self._hidden += by
        self._draw()

    def toggle_pause(self) -> None:
        """Freeze the view, or show the rows that came meanwhile."""
        self.viewport.paused = not self.viewport.paused
        self._pause_index = self._store.next
        self.sync()

    def stop_following(self) -> None:
        """Leave the end; the cursor stays on its row."""
        self.jump(self.viewport.cursor)

    def jump(self, position: int) -> None:
        """Put the cursor on a row by its position among those shown."""
        self.viewport.jump(position)
        self._on_moved()

    def jump_to_index(self, index: int | None) -> bool:
        """Put the cursor on a row by its index; False where there is none or a pause hides it."""
        position = self.viewport.count if index is None else self._store.view.position_of(index)
        if position >= self.viewport.count:
            return False
        self.jump(position)
        return True

    def next_mark(self, by: int) -> int | None:
        """Index of the nearest shown mark below (`by` 1) or above (-1)."""
        return next(filter(self._store.view.has, self.marks.beyond(self._cursor_index, by)), None)
