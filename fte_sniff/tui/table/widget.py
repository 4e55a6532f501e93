"""Owns the table on the screen: keys, mouse and window, over the rows of a store.

It must not know where rows come from or what else is on the screen. Only the rows in view are ever
read from the store and drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

from rich.cells import cell_len
from rich.segment import Segment
from rich.style import Style
from textual import events
from textual.binding import BindingType
from textual.geometry import Region, Size
from textual.message import Message
from textual.strip import Strip

from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.search import Search, find_fault, find_raised
from fte_sniff.errors import FteSniffError
from fte_sniff.protocol import Row
from fte_sniff.tui.fitting import fit
from fte_sniff.tui.keys import MOVING, bindings, say_keys
from fte_sniff.tui.table.columns import TableColumn
from fte_sniff.tui.table.header import TableHeader
from fte_sniff.tui.table.layout import layout_for
from fte_sniff.tui.table.look import Look
from fte_sniff.tui.table.marks import Marks
from fte_sniff.tui.table.painter import Painter, Place, Sign
from fte_sniff.tui.table.scale import Scale
from fte_sniff.tui.table.scrolling import Scrolling
from fte_sniff.tui.table.viewport import Viewport
from fte_sniff.tui.table.window import places
from fte_sniff.tui.themes import palette_of

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

    def __init__(self, store: RowStore, header: TableHeader, look: Look) -> None:
        super().__init__()
        say_keys(self)
        self.viewport = Viewport()
        self.look = look
        """How the user wants it to look."""
        self.marks = Marks()
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
        self._places: Sequence[Place] = ()
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
        """Let the table look otherwise; see `Look` for what can change."""
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
