"""Owns the scroll bar and the mouse wheel of the table: both move the window, never the bar alone.

It must not know rows.
"""

from __future__ import annotations

from abc import abstractmethod

from textual import events, on
from textual.message import Message
from textual.scroll_view import ScrollView
from textual.scrollbar import ScrollDown, ScrollTo, ScrollUp

from fte_sniff.tui.abstract import AbstractMeta
from fte_sniff.tui.table.scale import Scale
from fte_sniff.tui.table.viewport import Viewport

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
