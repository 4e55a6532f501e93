"""Owner of the focus: which widget receives the keys, and which keys may act now."""

from __future__ import annotations

from typing import Protocol

from textual.app import App
from textual.widget import Widget

from fte_sniff.tui.commands import Where
from fte_sniff.tui.panes.top import TopView
from fte_sniff.tui.table import RowTable, TableHeader


class TypedField(Protocol):
    """A field in which the user types."""

    @property
    def line(self) -> Widget:
        """What receives the keys."""

    def close(self) -> None:
        """Return the focus."""


class Focus:
    """The focus of the screen: the table, the top view, or the line of the open field.

    Exactly one of them can have the focus. So no click, no Tab, and no request that Textual handles
    later can move it, and a key that is typed ahead goes where the key before it led.
    """

    def __init__(self, app: App[None], table: RowTable, header: TableHeader, top: TopView) -> None:
        """The table has the focus once `start` is called."""
        self._app, self._table, self._header, self._top = app, table, header, top
        self._field: TypedField | None = None
        self._holder: Widget = table
        table.can_focus, top.can_focus = True, False

    def start(self) -> None:
        """Give the focus to its owner, once that is on the screen."""
        self._give()

    @property
    def owner(self) -> Widget:
        """The widget that receives the keys, when no page is open."""
        if self._field is not None:
            return self._field.line
        return self._top if self._top.display else self._table

    def show_top(self, shown: bool) -> None:
        """Show the top view in place of the table, or the table again."""
        self._top.display = shown
        self._header.display = self._table.display = not shown
        self._give()

    def open(self, field: TypedField) -> None:
        """Let the user type in a field; any other one is left."""
        if self._field is not None and self._field is not field:
            self._field.close()
        self._field = field
        self._give()

    def close(self, field: TypedField) -> None:
        """Return the focus from a field, if it is the open one."""
        if field is self._field:
            self._field = None
            self._give()

    def has_open(self, field: TypedField) -> bool:
        """Whether the user is typing in this field."""
        return field is self._field

    def clicked(self, widget: Widget | None) -> None:
        """Leave the open field where the table, its header or the top view was clicked."""
        views = (self._table, self._header, self._top)
        clicked = [] if widget is None else widget.ancestors_with_self
        if any(view in clicked for view in views):
            self.leave()

    def leave(self) -> None:
        """Leave the open field, if there is one."""
        if self._field is not None:
            self._field.close()

    def allows(self, where: Where) -> bool:
        """Whether such an action may act now: an open field and a page have their own keys."""
        is_page_open = len(self._app.screen_stack) > 1
        return where is Where.ANYWHERE or not (is_page_open or self._field)

    def prepare(self, where: Where) -> None:
        """Bring the table back for an action on rows that is allowed."""
        if where is Where.ROWS and self._top.display:
            self.show_top(False)

    def _give(self) -> None:
        """Move the focus at once and not by a message: the next key may be typed already."""
        self._holder.can_focus = False
        self._holder = self.owner
        self._holder.can_focus = True
        self._holder.screen.set_focus(self._holder)
