"""RowTable widget: scroll, header."""

from __future__ import annotations

from abc import ABCMeta, abstractmethod
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
from textual.message_pump import _MessagePumpMeta
from textual.scroll_view import ScrollView
from textual.scrollbar import ScrollDown, ScrollTo, ScrollUp
from textual.strip import Strip
from textual.widget import Widget

from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.search import Search, find_fault, find_raised
from fte_sniff.errors import FteSniffError
from fte_sniff.protocol import Row
from fte_sniff.tui.keys import MOVING, bindings, say_keys
from fte_sniff.tui.table.columns import TableColumn, TableView, layout_for
from fte_sniff.tui.table.painter import CellPosition, Painter, Sign, places
from fte_sniff.tui.table.theme import palette_of
from fte_sniff.tui.table.viewport import RowMarks, Viewport
from fte_sniff.tui.text import fit


class TableHeader(Widget):
    """One line that moves sideways with the table and never up or down."""

    class Clicked(Message):
        """It was clicked."""

    def __init__(self) -> None:
        super().__init__()
        self._shown: Painter | None = None

    def show(self, painter: Painter) -> None:
        """Draw the painter's column names."""
        if self._shown != painter:
            self._shown = painter
            self.refresh()

    def on_click(self) -> None:
        """Tell it."""
        self.post_message(self.Clicked())

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:
        """One line."""
        return 1

    def render_line(self, y: int) -> Strip:
        """The names."""
        if self._shown is None:
            return Strip.blank(self.size.width, self.rich_style)
        strip = self._shown.head(self.rich_style)
        return strip.adjust_cell_length(self.size.width, self.rich_style)


STEPS = 64
"""Units of the scale for each row of the window, at most: many more than the bar can show."""


@dataclass(frozen=True, slots=True)
class Scale:
    """The measure for `count` rows in a window of `height`."""

    count: int
    height: int

    @property
    def total(self) -> int:
        """Units of all rows."""
        return min(self.count, max(1, self.height) * STEPS)

    def unit_of(self, top: int) -> int:
        """Where the window begins on the scale when `top` is its first row; the ends are exact."""
        return self._across(top, self.count - self.height, self.total - self.height)

    def row_of(self, unit: float) -> int:
        """The window's first row when it begins there on the scale; the ends are exact."""
        return self._across(unit, self.total - self.height, self.count - self.height)

    @staticmethod
    def _across(value: float, span: int, other: int) -> int:
        return round(value * other / span) if span > 0 else 0


class AbstractMeta(_MessagePumpMeta, ABCMeta):
    """The metaclass of Textual's classes that have abstract methods."""


WHEEL = 3
"""Rows that one notch of the mouse wheel moves the window."""


class Scrolling(ScrollView, metaclass=AbstractMeta):
    """What is scrolled by a viewport."""

    viewport: Viewport

    @abstractmethod
    def _moved(self) -> None:
        """Draw what the viewport shows now."""

    @abstractmethod
    def action_aside(self, by: int) -> None:
        """Move sideways by columns."""

    def watch_scroll_y(self, old_value: float, new_value: float) -> None:
        """Move the scroll bar alone; what is in view is drawn by `_draw`."""
        if self.show_vertical_scrollbar:
            self.vertical_scrollbar.position = new_value

    @on(ScrollTo)
    def _drag(self, event: ScrollTo) -> None:
        scale = Scale(self.viewport.count, self.viewport.height)
        self._scroll(event, self.viewport.top if event.y is None else scale.row_of(event.y))

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


REVERSE = Style(reverse=True, bold=True)
"""The cursor's row where there are no colours."""


class RowTable(Scrolling, can_focus=True):
    """The rows that a store shows."""

    BINDINGS: ClassVar[list[BindingType]] = bindings(MOVING)
    COMPONENT_CLASSES: ClassVar[set[str]] = {
        "row-table--cursor",
        "row-table--cursor-away",
        "row-table--selected",
    }
    ALLOW_SELECT = False

    class Moved(Message):
        """The cursor, the window or what is in it changed."""

    class Opened(Message):
        """A row was clicked twice."""

    class Failed(Message):
        """Rows cannot be read any more."""

        def __init__(self, failure: FteSniffError) -> None:
            super().__init__()
            self.failure = failure

    def __init__(self, store: RowStore, header: TableHeader, look: TableView) -> None:
        super().__init__()
        say_keys(self)
        self.viewport = Viewport()
        self.look = look
        """How the user wants it to look."""
        self.marks = RowMarks()
        self.selecting_from: int | None = None
        """Index of the row at which a selection began; None where there is none."""
        self.search: Search | None = None
        """What is set off in the rows."""
        self.column: str | None = None
        """Name of the column that was clicked last."""
        self.start_ns: int | None = None
        """The time of the first row of all, if it has one."""
        self._empty_words = ""
        self._store = store
        self._cursor_index = 0
        self._paused_index = 0
        self._hidden = 0
        self._header = header
        self._places: Sequence[CellPosition] = ()
        self._drawn: tuple[object, ...] = ()

    @property
    def cursor_row(self) -> Row | None:
        """The row under the cursor, or None where there are no rows."""
        view = self.viewport
        if not view.count:
            return None
        return self._store.shown.row(view.cursor)

    @property
    def cursor_index(self) -> int | None:
        """Index in the store of the row under the cursor, or None where there are no rows."""
        view = self.viewport
        return self._store.shown.index(view.cursor) if view.count else None

    @property
    def near(self) -> int | None:
        """Index of the row that the user looks at; None while the end is followed."""
        return None if self.viewport.following else self._cursor_index

    @property
    def index_here(self) -> int:
        """Index of the row that the cursor is on, or was on when there were rows."""
        return self._cursor_index

    @property
    def selected(self) -> range:
        """Indices from the one at which the selection began to the cursor's; empty without one."""
        if self.selecting_from is None or not self.viewport.count:
            return range(0)
        low, high = sorted((self.selecting_from, self._cursor_index))
        return range(max(low, self._store.first), high + 1)

    def tell_empty(self, words: str) -> None:
        """What stands in the table while it has no rows."""
        if words != self._empty_words:
            self._empty_words = words
            if not self.viewport.count:
                self.refresh()

    def sync(self) -> None:
        """Draw what the store now shows, with the cursor on the row it was on."""
        store, view = self._store, self.viewport
        count = store.shown.position_of(self._paused_index if view.paused else store.next)
        view.refit(count, store.shown.position_of(self._cursor_index), store.shown.count - count)
        if view.following:
            self._keep_cursor()
        self._draw()

    def _keep_cursor(self) -> None:
        """Remember the cursor's row by its index, which stays when rows leave or are filtered."""
        if self.viewport.count:
            self._cursor_index = self._store.shown.index(self.viewport.cursor)

    def _moved(self) -> None:
        self._keep_cursor()
        self._draw()

    @property
    def columns(self) -> tuple[TableColumn, ...]:
        """The columns of the table, those moved out of the window included."""
        return self._painter.layout.columns

    def set_look(self, **changes: object) -> None:
        """Let the table look otherwise; see `TableView` for what can change."""
        look = replace(self.look, **changes)  # type: ignore[arg-type]
        if look != self.look:
            self.look = look
            self._draw()

    def set_search(self, search: Search | None) -> None:
        """Set off what is looked for."""
        self.search = search
        self._draw()

    def _draw(self) -> None:
        view, painter = self.viewport, self._painter
        self.marks.forget_before(self._store.first)
        scale = Scale(view.count, view.height)
        size = Size(painter.width, scale.total)
        if size != self.virtual_size:
            self.virtual_size = size
        unit = scale.unit_of(view.top)
        if round(self.scroll_y) != unit:
            self.scroll_to(y=unit, animate=False, force=True)
        try:
            self._places = places(
                self._store, view, self.marks, self.selected, self.look.times, self.start_ns
            )
        except FteSniffError as failure:
            self.post_message(self.Failed(failure))
            return
        self._header.show(painter)
        drawn = (painter, self._places, view.cursor - view.top, self.scrollable_size)
        if drawn != self._drawn:
            self._drawn = drawn
            self.refresh(self.scrollable_size.region)
        self.post_message(self.Moved())

    @property
    def _painter(self) -> Painter:
        width = self.scrollable_size.width
        layout = layout_for(width, self.look)
        self._hidden = min(max(0, self._hidden), layout.most_hidden(width))
        palette = palette_of(self.app.current_theme)
        return Painter(layout, palette, width, self._hidden, self.look.times, self.search)

    def render_lines(self, crop: Region) -> list[Strip]:
        """The lines of a part of the window."""
        # Once for all lines: each time they are asked for, all styles around are put together anew.
        self._paint, self._base = self._painter, self.rich_style
        return super().render_lines(crop)

    def render_line(self, y: int) -> Strip:
        """One line of the window: a row, or nothing, or the words for an empty table."""
        width, base = self.scrollable_size.width, self._base
        if y < len(self._places):
            return self._paint.row(self._places[y], self._line_style(y))
        if not self.viewport.count and y == self.viewport.height // 2:
            return Strip([Segment(fit(_centred(self._empty_words, width), width), base)], width)
        return Strip.blank(width, base)

    def _line_style(self, y: int) -> Style:
        if self.viewport.top + y != self.viewport.cursor:
            selected = self._places[y].sign is Sign.SELECTED
            return self._style_of("selected") if selected else self._base
        if self.app.no_color:
            return self._base + REVERSE
        return self._style_of("cursor" if self.has_focus else "cursor-away")

    def _style_of(self, part: str) -> Style:
        return self.get_component_rich_style(f"row-table--{part}")

    def on_resize(self, event: events.Resize) -> None:
        """Keep the cursor in a window of another size."""
        self.viewport.resize(self.scrollable_size.height)
        self.sync()

    def on_click(self, event: events.Click) -> None:
        """Put the cursor where the mouse is; a second click opens the row."""
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
        index = find_fault(self._store, self._cursor_index, by)
        return index is not None and self.jump_to_index(index)

    def jump_to_raised(self, by: int) -> bool:
        """The same of the nearest row with a flag byte that is not in order."""
        index = find_raised(self._store, self._cursor_index, by)
        return index is not None and self.jump_to_index(index)

    def jump_to_mark(self, by: int) -> bool:
        """Put the cursor on the nearest mark below (`by` 1) or above (-1) that is shown."""
        shown = filter(self._store.shown.has, self.marks.beyond(self._cursor_index, by))
        index = next(shown, None)
        return index is not None and self.jump_to_index(index)

    def jump_to_index(self, index: int) -> bool:
        """Put the cursor on a shown row by its index; False where a pause keeps it out of view."""
        position = self._store.shown.position_of(index)
        if position >= self.viewport.count:
            return False
        self.jump(position)
        return True

    def pause(self) -> None:
        """Freeze what is in view, or let in what came meanwhile."""
        self.viewport.paused = not self.viewport.paused
        self._paused_index = self._store.next
        self.sync()


def _centred(words: str, width: int) -> str:
    return " " * ((width - cell_len(words)) // 2) + words
