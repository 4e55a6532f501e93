"""The table of rows: its visible range, cursor and marks, the widget, and its header line."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC
from itertools import repeat
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
from textual.timer import Timer
from textual.widget import Widget

from fte_sniff.analysis.relations import RowRelations
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.search import Search, find_fault, find_raised, find_unanswered
from fte_sniff.errors import FteSniffError
from fte_sniff.formats.cell_text import fit
from fte_sniff.protocol import Row
from fte_sniff.protocol.dissect import dissect
from fte_sniff.tui.cells import (
    DELTA,
    Delta,
    TableColumn,
    TableView,
    TimeStyle,
    landmark_text,
    layout_for,
)
from fte_sniff.tui.commands import MOVING, OPENING, action_of, bindings
from fte_sniff.tui.i18n import _, choice_after
from fte_sniff.tui.painter import (
    NO_ANSWER,
    REVERSED,
    BarSign,
    ColorRules,
    Colors,
    OverviewBar,
    OverviewRender,
    Painter,
    Palette,
    RowCell,
    Sign,
    palette_of,
)
from fte_sniff.tui.status_bar import NoticeLine


class Viewport:
    """A window of `height` rows onto `count` rows, which follows the end at first.

    Rows are positions among those shown.
    """

    def __init__(self) -> None:
        self.count = 0
        """Rows that can be shown."""
        self.height = 0
        self.top = 0
        self.cursor = 0
        """The row under the cursor; 0 without rows."""
        self.following = True
        """Whether the window stays at the end when rows come."""
        self.paused = False
        """Whether new rows are kept out of the window."""
        self.waiting = 0
        """Rows that came since the pause."""

    @property
    def last_top(self) -> int:
        """The greatest `top`, at which the window ends with the last row."""
        return max(0, self.count - max(1, self.height))

    @property
    def below(self) -> int:
        """Rows below the window."""
        return max(0, self.count - self.top - self.height)

    def refit(self, count: int, cursor: int, waiting: int) -> None:
        """Update to the number of rows now, the cursor's new position and the rows since a pause.

        The window moves with the cursor's row, unless it follows the end.
        """
        self.top += cursor - self.cursor
        self.count, self.cursor, self.waiting = count, cursor, waiting
        self._clamp()

    def resize(self, height: int) -> None:
        """Change the height; the cursor stays in the window."""
        self.height = max(0, height)
        self._clamp()
        self._reveal()

    def move(self, by: int) -> None:
        """Move the cursor; up stops following the end, down onto the last row follows it again."""
        target = self.cursor + by
        self.following = by > 0 and target >= self.count - 1 and not self.paused
        self._put(target)

    def jump(self, row: int) -> None:
        """Put the cursor on a row; a far one is shown in the middle of the window."""
        self.following = False
        self._put(row)

    def scroll(self, top: int) -> None:
        """Scroll the window; the cursor moves only as far as it has to."""
        self.top = min(max(0, top), self.last_top)
        self.following = self.top >= self.last_top and not self.paused
        self.cursor = min(max(self.cursor, self.top), max(self.top, self.top + self.height - 1))
        self._clamp()

    def follow(self) -> None:
        """Follow the end; ends a pause."""
        self.paused = False
        self.following = True
        self._clamp()

    def _put(self, cursor: int) -> None:
        outside = not self.top <= cursor < self.top + self.height
        far = abs(cursor - self.cursor) > self.height
        self.cursor = cursor
        if outside and far:
            self.top = cursor - self.height // 2
        self._clamp()
        self._reveal()

    def _clamp(self) -> None:
        last = max(0, self.count - 1)
        if self.following and not self.paused:
            self.cursor, self.top = last, self.last_top
        self.cursor = min(max(0, self.cursor), last)
        self.top = min(max(0, self.top), self.last_top)

    def _reveal(self) -> None:
        lowest = self.cursor - max(1, self.height) + 1
        self.top = min(max(self.top, lowest, 0), self.cursor)


class RowMarks(dict[int, str]):
    """Texts of the marked rows, which may be empty, by index; the oldest mark is the first."""

    @property
    def latest(self) -> int | None:
        """The mark that was set last."""
        return next(reversed(self), None)

    def forget_before(self, first: int) -> None:
        """Remove the marks of rows that left the store."""
        for index in [index for index in self if index < first]:
            del self[index]

    def beyond(self, index: int, by: int) -> list[int]:
        """Marks after an index (`by` 1) or before it (-1), the nearest first."""
        return sorted((mark for mark in self if (mark - index) * by > 0), reverse=by < 0)


WHEEL_ROWS = 3

SCALE_STEPS = 64
"""Scroll bar units per row of the window, at most; the bar cannot show more."""

OVERVIEW_S = 1.0
"""Shortest time between two drawings of the overview while rows come, seconds."""


@dataclass(frozen=True, slots=True)
class TableLine:
    """A line of the window."""

    cell: RowCell | str
    """A row, or the text of a port event or a gap."""
    position: int | None
    """Of its row among those shown; None for an event."""


class TableHeader(Widget):
    """The line of column names; scrolls sideways with the table, of which it is not a part."""

    painter: reactive[Painter | None] = reactive(None)

    async def on_click(self) -> None:
        """Choose columns."""
        await self.run_action(action_of("app.columns"))

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


class RowTable(ScrollView):
    """The rows that a store shows.

    In place of Textual's DataTable (8.2), which keeps and measures every cell: 100,000 rows take
    11 s and 1,100 bytes each there, 50 bytes here; 115 more rows take 240 ms there, 13 ms here.
    """

    BINDINGS: ClassVar[list[BindingType]] = bindings(MOVING, (OPENING,))
    COMPONENT_CLASSES: ClassVar[set[str]] = {
        "row-table--cursor",
        "row-table--cursor-away",
        "row-table--selected",
        "row-table--paired",
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

    def __init__(
        self, store: RowStore, header: TableHeader, notice: NoticeLine, view: TableView
    ) -> None:
        super().__init__()
        self.viewport = Viewport()
        self.relations = RowRelations(store)
        self.view = view
        self.marks = RowMarks()
        self._overview = OverviewBar(store, self.marks)
        self._overview_drawn: tuple[object, ...] = ()
        self._overview_timer: Timer | None = None
        self._bar_signs: Mapping[int, BarSign] = {}
        self.selection_start: int | None = None
        """Index of the row at which the selection began; None without one."""
        self.search: Search | None = None
        self.column: str | None = None
        self.start_ns: int | None = None
        self.field: int | None = None
        """Number in `dissect` of the field that the user looks at in the cursor's row."""
        self.rules: ColorRules | None = None
        self._empty_text = ""
        self._store = store
        self._header = header
        self._notice = notice
        self.last_index = 0
        """Index of the row under the cursor, now or when there last were rows."""
        self._pause_index = 0
        self._hidden = 0
        self._lines: Sequence[TableLine] = ()
        self._latest_painter: Painter | None = None
        self._drawn: tuple[object, ...] = ()
        self._strips: Mapping[tuple[RowCell, Style], Strip] = {}
        """Rows as they were drawn last; most are the same after a key, or with few new rows."""
        self._new_strips: dict[tuple[RowCell, Style], Strip] = {}

    @property
    def cursor_row(self) -> Row | None:
        """The row under the cursor; None without rows."""
        viewport = self.viewport
        return self._store.view.row(viewport.cursor) if viewport.count else None

    @property
    def cursor_index(self) -> int | None:
        """Index of the row under the cursor; None without rows."""
        viewport = self.viewport
        return self._store.view.index(viewport.cursor) if viewport.count else None

    @property
    def near(self) -> int | None:
        """Index of the row that the user reads; None while the end is followed."""
        return None if self.viewport.following else self.last_index

    @property
    def selected(self) -> range:
        """Indices from the start of the selection to the cursor; empty without one."""
        if self.selection_start is None or not self.viewport.count:
            return range(0)
        low, high = sorted((self.selection_start, self.last_index))
        return range(max(low, self._store.first), high + 1)

    @property
    def columns(self) -> tuple[TableColumn, ...]:
        """All columns, with those outside the window."""
        return self._painter.layout.columns

    def set_empty_text(self, text: str) -> None:
        """Set the text that is shown without rows."""
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
        """Draw the rows that the store shows now; the cursor stays on its row and in view."""
        shown, viewport = self._store.view, self.viewport
        if viewport.height != self.scrollable_size.height:
            viewport.resize(self.scrollable_size.height)
        count = shown.position_of(self._pause_index if viewport.paused else self._store.next)
        viewport.refit(count, shown.position_of(self.last_index), shown.count - count)
        if viewport.following:
            self._update_cursor_index()
        self._draw()

    def _update_cursor_index(self) -> None:
        """Note the index of the cursor's row, which stays the same when rows are filtered."""
        if self.viewport.count:
            self.last_index = self._store.view.index(self.viewport.cursor)

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
            self._lines = self._window_lines()
        except FteSniffError as failure:
            self.post_message(self.Failed(failure))
            return
        self._header.painter = painter
        self._draw_overview()
        drawn = (painter, self._lines, viewport.cursor, self.scrollable_size)
        if drawn != self._drawn:
            self._drawn = drawn
            self.refresh(self.scrollable_size.region)
        self.post_message(self.Moved())

    def _draw_overview(self) -> None:
        """Update the signs in the scroll bar; while rows come, once a second."""
        store, height, palette = self._store, self.scrollable_size.height, self.palette
        rows = (store.first, store.next, store.known, store.view.count)
        wanted = (store.view.filter, height, tuple(self.marks), palette, len(store.landmarks))
        if (wanted, rows) == self._overview_drawn or self._overview_timer is not None:
            return
        self._overview_drawn = (wanted, rows)
        self._overview_timer = self.set_timer(OVERVIEW_S, self.end_overview_pause)
        signs = self._overview.signs(height, palette)
        bar = self.vertical_scrollbar
        if signs != self._bar_signs:
            self._bar_signs = signs
            bar.renderer = OverviewRender.with_signs(signs)  # type: ignore[misc]
            bar.refresh()

    def end_overview_pause(self) -> None:
        """Draw the overview now if it has changed."""
        self._overview_timer = None
        self._draw_overview()

    def jump_to_cell(self, cell: int) -> None:
        """Put the cursor on the most important row of a cell of the overview."""
        position = self._overview.position_at(cell)
        if position is not None:
            self.jump(position)

    def _window_lines(self) -> Sequence[TableLine]:
        viewport = self.viewport
        end = min(viewport.top + viewport.height, viewport.count)
        rows = self._store.view.slice(viewport.top, end)
        lines: list[TableLine] = []
        after = rows[0][0] if rows else self._end_index
        for position, (index, cell) in enumerate(self._row_cells(rows), viewport.top):
            lines += self._event_lines(after, index + 1)
            lines.append(TableLine(cell, position))
            after = index + 1
        if end == viewport.count:
            lines += self._event_lines(after, self._end_index + 1)
        return self._in_window(lines)

    def _in_window(self, lines: list[TableLine]) -> Sequence[TableLine]:
        """The lines that fit, with the cursor's row among them."""
        viewport, height = self.viewport, self.viewport.height
        last = next((n for n, line in enumerate(lines) if line.position == viewport.cursor), 0)
        at_end = viewport.cursor == viewport.count - 1 or viewport.top == viewport.last_top
        first = len(lines) - height if at_end else last + 1 - height
        first = max(0, min(first, last))
        return lines[first : first + height]

    @property
    def _end_index(self) -> int:
        """Index after the last row that can be shown."""
        return self._pause_index if self.viewport.paused else self._store.next

    def _event_lines(self, start: int, end: int) -> Iterator[TableLine]:
        if not self.view.events:
            return
        for landmark in self._store.landmarks.between(start, end):
            yield TableLine(landmark_text(landmark.what, self.view.shown_zone), None)

    def _row_cells(self, rows: Sequence[tuple[int, Row]]) -> Iterator[tuple[int, RowCell]]:
        """Index and cell of rows in the window, from top to bottom."""
        selected, zero_ns, pair, view = self.selected, self._zero_ns, self._paired, self.view
        needs_past = view.changes or (view.delta is not Delta.ROW and self._shows_delta)
        pasts = self.relations.pasts([index for index, _row in rows]) if needs_past else {}
        above_ns = self._above_ns if self._shows_delta else None
        styles = self.rules.styles(rows) if self.rules else repeat(None)
        for (index, row), style in zip(rows, styles, strict=False):
            past, field = pasts.get(index), None
            before_ns = above_ns
            if view.delta is not Delta.ROW:
                in_frames = view.delta is Delta.FRAME
                before_ns = None
                if past is not None:
                    before_ns = past.frame_ns if in_frames else past.command_ns
            known = before_ns is not None and row.t_ns is not None
            if index == self.last_index and self.field is not None:
                field = self._field_offsets(row)
            sign = Sign.UNANSWERED if row.unanswered else Sign.NONE
            sign = Sign.SELECTED if index in selected else sign
            sign = Sign.PAIRED if index in pair else sign
            if index in self.marks:
                sign = Sign.NOTED if self.marks[index] else Sign.MARKED
            yield (
                index,
                RowCell(
                    row,
                    sign,
                    None if row.t_ns is None or zero_ns is None else row.t_ns - zero_ns,
                    (row.t_ns or 0) - (before_ns or 0) if known else None,
                    past.ages if past and view.changes and row.framed else None,
                    field,
                    style,
                ),
            )
            above_ns = row.t_ns

    @property
    def _shows_delta(self) -> bool:
        return any(column.name == DELTA for column in self.columns)

    @property
    def _above_ns(self) -> int | None:
        store, top = self._store, self.viewport.top
        return store.view.row(top - 1).t_ns if 0 < top <= store.view.count else None

    def _field_offsets(self, row: Row) -> range | None:
        fields = dissect(row)
        if self.field is None or self.field >= len(fields):
            return None
        return fields[self.field].offsets

    @property
    def _paired(self) -> frozenset[int]:
        """Indices of the rows that belong to the cursor's row, unless the end is followed."""
        if self.viewport.following or not self.viewport.count:
            return frozenset()
        return frozenset(self.relations.related(self.last_index))

    @property
    def _zero_ns(self) -> int | None:
        """The time from which times are counted, 0 for times of day; None if it is unknown."""
        store, latest = self._store, self.marks.latest
        match self.view.times:
            case TimeStyle.START:
                return self.start_ns
            case TimeStyle.MARK:
                if latest is None or not store.first <= latest < store.next:
                    return None
                return store.row(latest).t_ns
        return 0

    @property
    def _painter(self) -> Painter:
        width = self.scrollable_size.width
        layout = layout_for(width, self.view)
        self._hidden = min(max(0, self._hidden), layout.max_hidden(width))
        palette = self.palette
        painter = Painter(layout, palette, width, self._hidden, self.search)
        if painter != self._latest_painter:
            self._latest_painter, self._strips = painter, {}
        return self._latest_painter

    @property
    def palette(self) -> Palette:
        """The styles under the current theme and the colours of the terminal."""
        few = Colors.SIXTEEN if self.app.console.color_system == "standard" else Colors.ALL
        colors = Colors.NONE if self.app.no_color else few
        return palette_of(self.app.current_theme, colors)

    def render_lines(self, crop: Region) -> list[Strip]:
        """Lines of a part of the window.

        Textual's own method also draws borders, padding and opacity, which the table does not have;
        they take as long as the rows.
        """
        # Textual sends no Resize if the table is scrolled while the layout changes.
        if self.viewport.height != self.scrollable_size.height:
            self.call_later(self.sync)
        # Once for all lines: `rich_style` combines all styles of the parents at each call, and the
        # width and the palette are as expensive.
        self._base, self._line_painter = self.rich_style, self._painter
        self._new_strips = {}
        lines = [
            self.render_line(y).crop_extend(crop.x, crop.right, self._base) for y in crop.line_range
        ]
        self._strips = self._new_strips
        filters, (_behind, background) = self.get_line_filters(), self.background_colors
        for line_filter in filters:
            lines = [line.apply_filter(line_filter, background) for line in lines]
        return lines

    def render_line(self, y: int) -> Strip:
        """A row, an event, a blank line, or the text of an empty table."""
        base, painter = self._base, self._line_painter
        if y < len(self._lines):
            cell = self._lines[y].cell
            if isinstance(cell, str):
                return painter.event(cell, base)
            key = cell, self._line_style(self._lines[y])
            self._new_strips[key] = self._strips.get(key) or painter.row(*key)
            return self._new_strips[key]
        if not self.viewport.count and y == self.viewport.height // 2:
            indent = " " * ((painter.width - cell_len(self._empty_text)) // 2)
            text = fit(indent + self._empty_text, painter.width)
            return Strip([Segment(text, base)], painter.width)
        return Strip.blank(painter.width, base)

    def _line_style(self, line: TableLine) -> Style:
        # Among 16 colours, backgrounds would equal one another and hide colours of text.
        few_colors = self._line_painter.palette.few_colors
        if line.position != self.viewport.cursor:
            sign = line.cell.sign if isinstance(line.cell, RowCell) else Sign.NONE
            if few_colors or sign not in (Sign.SELECTED, Sign.PAIRED):
                return self._base
            return self._component_style("paired" if sign is Sign.PAIRED else "selected")
        if few_colors:
            return self._base + REVERSED
        return self._component_style("cursor" if self.has_focus else "cursor-away")

    def _component_style(self, name: str) -> Style:
        return self.get_component_rich_style(f"row-table--{name}")

    def on_resize(self, event: events.Resize) -> None:
        """Draw as many rows as fit now."""
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
        """Put the cursor on the clicked row and look at its field; a double click opens it."""
        position = self._lines[event.y].position if 0 <= event.y < len(self._lines) else None
        if position is not None:
            column = self._painter.shown.column_at(event.x)
            self.column = column.name if column else None
            self.jump(position)
            self._point(event)
            if event.chain == 2:
                self.post_message(self.Opened())

    def on_mouse_move(self, event: events.MouseMove) -> None:
        """Look at the field under the mouse, in the cursor's row."""
        position = self._lines[event.y].position if 0 <= event.y < len(self._lines) else None
        if position == self.viewport.cursor and not self.viewport.following:
            self._point(event)

    def _point(self, event: events.MouseEvent) -> None:
        row = self.cursor_row
        at = None if row is None else self._painter.byte_at(row, event.x)
        if row is None or at is None:
            return
        fields = enumerate(dissect(row))
        self.look_at(next((n for n, field in fields if at in field.offsets), None))

    def look_at(self, field: int | None) -> None:
        """Highlight the bytes of a field of the cursor's row, by its number in `dissect`."""
        if field != self.field:
            self.field = field
            self._draw()

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

    def end_selection(self) -> bool:
        """End the selection; returns whether there was one."""
        if self.selection_start is None:
            return False
        self.selection_start = None
        self.sync()
        return True

    def stop_following(self) -> None:
        """Leave the end; the cursor stays on its row."""
        self.jump(self.viewport.cursor)

    def jump(self, position: int) -> None:
        """Put the cursor on a row by its position among those shown."""
        self.viewport.jump(position)
        self._on_moved()

    def stay_at(self, index: int) -> None:
        """Put the cursor on the row with that index, or on the next one that is shown."""
        self.viewport.jump(self.viewport.cursor)
        self.last_index = index
        self.sync()
        self.viewport.jump(self.viewport.cursor)
        self._draw()

    def jump_to_index(self, index: int | None) -> bool:
        """Put the cursor on a row by its index; False where there is none or a pause hides it."""
        position = self.viewport.count if index is None else self._store.view.position_of(index)
        if position >= self.viewport.count:
            return False
        self.jump(position)
        return True

    def next_mark(self, by: int) -> int | None:
        """Index of the nearest shown mark below (`by` 1) or above (-1)."""
        return next(filter(self._store.view.has, self.marks.beyond(self.last_index, by)), None)

    def go_to_fault_between(self, start_ns: int, end_ns: int) -> None:
        """Go to the first shown row with a fault in a span of time, else to its first row."""
        store = self._store
        self.stop_following()
        self.jump(store.view.position_of(store.index_from(start_ns)))
        row = self.cursor_row
        if row is None or not row.faults:
            index = find_fault(store, self.last_index, 1)
            t_ns = None if index is None else store.row(index).t_ns
            if t_ns is not None and t_ns < end_ns:
                self.jump_to_index(index)

    def action_fault(self, by: int) -> None:
        """Go to the next fault, or to the previous one."""
        store, start = self._store, self.last_index
        if self.jump_to_index(find_fault(store, start, by)):
            return
        text, other = _("no row with a fault below this one"), _("{key} goes to the previous one")
        if by < 0:
            text, other = _("no row with a fault above this one"), _("{key} goes to the next one")
        if find_fault(store, start, -by) is not None:
            text += "; " + other.format(key="E" if by > 0 else "e")
        if find_raised(store, start, by) is not None:
            hint = _("{key} goes to a row whose ERROR or ONLINE is not in order")
            text += "; " + hint.format(key="a" if by > 0 else "A")
        self._notice.inform(text)

    def action_raised(self, by: int) -> None:
        """Go to the next row with a raised flag byte, or to the previous one."""
        below = _("no row below this one whose ERROR or ONLINE is not in order")
        above = _("no row above this one whose ERROR or ONLINE is not in order")
        index = find_raised(self._store, self.last_index, by)
        self._jump_or_inform(index, below if by > 0 else above)

    def action_unanswered(self, by: int) -> None:
        """Go to the next command without an answer, or to the previous one."""
        below = _("no command without an answer below this row")
        above = _("no command without an answer above this row")
        index = find_unanswered(self._store, self.last_index, by)
        self._jump_or_inform(index, below if by > 0 else above)

    def _jump_or_inform(self, index: int | None, otherwise: str) -> None:
        if not self.jump_to_index(index):
            self._notice.inform(otherwise)

    def action_landmark(self, by: int) -> None:
        """Go to the next lost port or gap, or to the previous one."""
        store, last = self._store, self.last_index
        beyond = store.landmarks.beyond(last, by)
        index = next((one.index for one in beyond if store.first <= one.index), None)
        if index is None:
            below = _("no port was lost and no rows are missing below this row")
            above = _("no port was lost and no rows are missing above this row")
            self._notice.inform(below if by > 0 else above)
            return
        self.jump(store.view.position_of(index))

    def action_related(self) -> None:
        """Go from a command to its answer, or from an answer to its command."""
        if not self.viewport.count:
            return
        index = self.last_index
        related = self.relations.related(index)
        text = _("this row is neither a command that awaits an answer nor an answer")
        states = {one.state for one in self.relations.answers(index)}
        text = next((_(NO_ANSWER[one]) for one in NO_ANSWER if one in states), text)
        if related:
            text = _(
                "the filter hides row {number:,}, to which this one belongs; F shows all",
                number=related[0] + 1,
            )
        shown = (one for one in related if self._store.view.has(one))
        self.stop_following()
        self._jump_or_inform(next(shown, None), text)

    def action_select(self) -> None:
        """Begin a selection at the cursor's row, or end it."""
        if not self.end_selection() and self.viewport.count:
            self.stop_following()
            self.selection_start = self.last_index
            self.sync()
            self._notice.inform(_("selecting: move, then y or Y copies, w saves, esc ends it"))

    def action_times(self) -> None:
        """Switch to the next time style; without a mark or another zone, two are skipped."""
        if self.start_ns is None and len(self._store):
            self._notice.inform(_("no row here has a time"))
            return
        view, styles = self.view, list(TimeStyle)
        if self.marks.latest is None:
            styles.remove(TimeStyle.MARK)
        if view.zone == UTC:
            styles.remove(TimeStyle.LOCAL)
        style = choice_after(view.times, styles)
        self.set_view(times=style)
        self._notice.inform(_(style.meaning))

    def action_changes(self) -> None:
        """Highlight the bytes that changed, or no longer."""
        changes = not self.view.changes
        self.set_view(changes=changes)
        on = _("bytes that differ from the frame before of the same kind and motor are highlighted")
        self._notice.inform(on if changes else _("changed bytes are not highlighted"))

    def action_events(self) -> None:
        """Show the lines of port events and gaps, or hide them."""
        events = not self.view.events
        self.set_view(events=events)
        self._notice.inform(_("port events are shown") if events else _("port events are hidden"))
