"""Owns the line of column names over the table.

It must not know rows; what it draws, the table tells it.
"""

from __future__ import annotations

from textual.geometry import Size
from textual.message import Message
from textual.strip import Strip
from textual.widget import Widget

from fte_sniff.tui.table.painter import Painter


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
