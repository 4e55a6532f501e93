"""Owns the table on the screen: keys, mouse and window, over the rows of a store.

It must not know where rows come from or what else is on the screen. Only the rows in view are ever
read from the store and drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from rich.segment import Segment
from rich.style import Style
from textual import events, on
from textual.binding import BindingType
from textual.geometry import Region, Size
from textual.message import Message
from textual.scroll_view import ScrollView
from textual.scrollbar import ScrollDown, ScrollTo, ScrollUp
from textual.strip import Strip

from fte_sniff.analysis.store import RowStore
from fte_sniff.protocol import Row
from fte_sniff.tui.fitting import fit
from fte_sniff.tui.keys import MOVING, bindings
from fte_sniff.tui.table.header import TableHeader
from fte_sniff.tui.table.layout import layout_for
from fte_sniff.tui.table.painter import Painter
from fte_sniff.tui.table.palette import DARK, LIGHT
from fte_sniff.tui.table.viewport import Viewport

REVERSE = Style(reverse=True, bold=True)
"""The cursor's row where there are no colours."""

WHEEL = 3
"""Rows that one notch of the mouse wheel moves the window."""


class RowTable(ScrollView, can_focus=True):
    """The rows that a store shows."""

    BINDINGS: ClassVar[list[BindingType]] = bindings(MOVING)
    COMPONENT_CLASSES: ClassVar[set[str]] = {"row-table--cursor", "row-table--cursor-away"}
    ALLOW_SELECT = False

    class Moved(Message):
        """The cursor, the window or what is in it changed."""

    def __init__(self, store: RowStore, header: TableHeader) -> None:
        super().__init__()
        self.viewport = Viewport()
        self.ports = 1
        """Ports seen so far; from two on, each row says its own."""
        self._empty_words = ""
        self._store = store
        self._cursor_index = 0
        self._paused_index = 0
        self._hidden = 0
        self._header = header
        self._rows: Sequence[Row] = ()

    @property
    def cursor_row(self) -> Row | None:
        """The row under the cursor, or None where there are no rows."""
        view = self.viewport
        if not view.count:
            return None
        return self._store.shown_row(view.cursor)

    @property
    def cursor_index(self) -> int | None:
        """Index in the store of the row under the cursor, or None where there are no rows."""
        view = self.viewport
        return self._store.shown_index(view.cursor) if view.count else None

    @property
    def near(self) -> int | None:
        """Index of the row that the user looks at; None while the end is followed."""
        return None if self.viewport.following else self._cursor_index

    def tell_empty(self, words: str) -> None:
        """What stands in the table while it has no rows."""
        if words != self._empty_words:
            self._empty_words = words
            if not self.viewport.count:
                self.refresh()

    def sync(self) -> None:
        """Draw what the store now shows, with the cursor on the row it was on."""
        store, view = self._store, self.viewport
        count = store.position_of(self._paused_index if view.paused else store.next)
        view.refit(count, store.position_of(self._cursor_index), store.shown_count - count)
        if view.following:
            self._keep_cursor()
        self._draw()

    def _keep_cursor(self) -> None:
        """Remember the cursor's row by its index, which stays when rows leave or are filtered."""
        if self.viewport.count:
            self._cursor_index = self._store.shown_index(self.viewport.cursor)

    def _moved(self) -> None:
        self._keep_cursor()
        self._draw()

    def _draw(self) -> None:
        view, painter = self.viewport, self._painter
        size = Size(painter.width, view.count)
        if size != self.virtual_size:
            self.virtual_size = size
        if round(self.scroll_y) != view.top:
            self.scroll_to(y=view.top, animate=False, force=True)
        end = min(view.top + view.height, view.count)
        self._rows = [row for _, row in self._store.shown_slice(view.top, end)]
        self._header.show(painter)
        self.refresh()
        self.post_message(self.Moved())

    @property
    def _painter(self) -> Painter:
        width = self.scrollable_size.width
        palette = DARK if self.app.current_theme.dark else LIGHT
        layout = layout_for(width, self.ports)
        self._hidden = min(max(0, self._hidden), layout.most_hidden(width))
        return Painter(layout, palette, width, self._hidden)

    def render_lines(self, crop: Region) -> list[Strip]:
        """The lines of a part of the window."""
        self._paint = self._painter
        return super().render_lines(crop)

    def render_line(self, y: int) -> Strip:
        """One line of the window: a row, or nothing, or the words for an empty table."""
        width, base = self.scrollable_size.width, self.rich_style
        if y < len(self._rows):
            line = self._paint.row(self._rows[y], self._line_style(y))
            at_cursor = self.viewport.top + y == self.viewport.cursor
            if at_cursor and self.app.no_color:
                return Strip([Segment(line.text, base + REVERSE)], width)
            return line
        if not self.viewport.count and y == self.viewport.height // 2:
            return Strip([Segment(fit(self._empty_words.center(width), width), base)], width)
        return Strip.blank(width, base)

    def _line_style(self, y: int) -> Style:
        if self.viewport.top + y != self.viewport.cursor:
            return self.rich_style
        part = "row-table--cursor" if self.has_focus else "row-table--cursor-away"
        return self.get_component_rich_style(part)

    def on_resize(self, event: events.Resize) -> None:
        """Keep the cursor in a window of another size."""
        self.viewport.resize(self.scrollable_size.height)
        self.sync()

    @on(ScrollTo)
    def _drag(self, event: ScrollTo) -> None:
        self._scroll(event, self.viewport.top if event.y is None else round(event.y))

    @on(ScrollUp)
    def _page_up(self, event: ScrollUp) -> None:
        self._scroll(event, self.viewport.top - self.viewport.height)

    @on(ScrollDown)
    def _page_down(self, event: ScrollDown) -> None:
        self._scroll(event, self.viewport.top + self.viewport.height)

    def on_mouse_scroll_up(self, event: events.MouseScrollUp) -> None:
        """Move the window with the wheel."""
        self._scroll(event, self.viewport.top - WHEEL)

    def on_mouse_scroll_down(self, event: events.MouseScrollDown) -> None:
        """Move the window with the wheel."""
        self._scroll(event, self.viewport.top + WHEEL)

    def on_mouse_scroll_left(self, event: events.MouseScrollLeft) -> None:
        """Move sideways with the wheel."""
        event.prevent_default().stop()
        self.action_aside(-1)

    def on_mouse_scroll_right(self, event: events.MouseScrollRight) -> None:
        """Move sideways with the wheel."""
        event.prevent_default().stop()
        self.action_aside(1)

    def _scroll(self, event: Message, top: int) -> None:
        """Move the window by hand: through the viewport, never past it."""
        event.prevent_default().stop()
        self.viewport.scroll(top)
        self._moved()

    def on_click(self, event: events.Click) -> None:
        """Put the cursor where the mouse is."""
        row = self.viewport.top + event.y
        if row < self.viewport.count:
            self.jump(row)

    def action_move(self, by: int) -> None:
        """Move the cursor by rows."""
        self.viewport.move(by)
        self._moved()

    def action_page(self, by: int) -> None:
        """Move the cursor by windows."""
        self.action_move(by * max(1, self.viewport.height - 1))

    def action_first(self) -> None:
        """Go to the first row."""
        self.jump(0)

    def action_follow(self) -> None:
        """Go to the last row and stay at the end."""
        self.viewport.follow()
        self.sync()

    def action_aside(self, by: int) -> None:
        """Move sideways by columns."""
        self._hidden += by
        self._draw()

    def jump(self, row: int) -> None:
        """Put the cursor on a row, counted from 0 among those shown."""
        self.viewport.jump(row)
        self._moved()

    def stay(self) -> None:
        """Leave the end, with the cursor on the row it is on."""
        self.jump(self.viewport.cursor)

    def jump_to_fault(self, by: int) -> bool:
        """Put the cursor on the nearest fault below (`by` 1) or above (-1), if there is one."""
        store, view = self._store, self.viewport
        index = store.fault_index(self._cursor_index, by)
        position = None if index is None else store.position_of(index)
        if position is None or position >= view.count:
            return False
        self.jump(position)
        return True

    def pause(self) -> None:
        """Freeze what is in view, or let in what came meanwhile."""
        self.viewport.paused = not self.viewport.paused
        self._paused_index = self._store.next
        self.sync()
