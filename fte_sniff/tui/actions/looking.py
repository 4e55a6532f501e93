"""Owns the keys that say how rows are looked at: pause, times, columns, colours, panes, help.

It must not know what a row is.
"""

from __future__ import annotations

from datetime import UTC

from textual import on

from fte_sniff.tui.actions.parts import Parts
from fte_sniff.tui.choosing import Chosen, ColumnChooser
from fte_sniff.tui.help import HelpPage
from fte_sniff.tui.keys import COMMANDS, key_names
from fte_sniff.tui.language import _
from fte_sniff.tui.picking import Entry, Picker
from fte_sniff.tui.table.columns import column_of
from fte_sniff.tui.table.header import TableHeader
from fte_sniff.tui.table.look import TimeStyle
from fte_sniff.tui.table.widget import RowTable
from fte_sniff.tui.theme_names import theme_after


class Looking(Parts):
    """Ways to look."""

    def action_pause(self) -> None:
        """Freeze the view, or let it go on."""
        self._table.pause()

    def action_times(self, by: int) -> None:
        """Let times count from something else, as far as there is a mark or another zone."""
        if self._watched.start_ns is None and len(self._watched.store):
            self._tell(_("no row here has a time to go by"))
            return
        look, styles = self._table.look, list(TimeStyle)
        if self._table.marks.latest is None:
            styles.remove(TimeStyle.MARK)
        if look.zone == UTC:
            styles.remove(TimeStyle.LOCAL)
        now = look.times
        at = styles.index(now) if now in styles else 0
        style = styles[(at + by) % len(styles)]
        self._table.set_look(times=style)
        self._panes.look()
        self._tell(_(style.meaning))

    def action_columns(self) -> None:
        """Choose columns, their order and widths."""
        look = self._table.look
        shown = self._table.columns
        chooser = ColumnChooser(shown, lambda name: column_of(name, look).width)
        self.push_screen(chooser, self._choose_columns)

    def _choose_columns(self, chosen: Chosen | None) -> None:
        if chosen is not None:
            self._table.set_look(choice=chosen.choice)

    @on(TableHeader.Clicked)
    def _choose_by_mouse(self) -> None:
        self.action_columns()

    def action_theme(self) -> None:
        """Switch to the next theme."""
        self.theme = theme_after(self.theme)
        self._table.sync()
        self._tell(_("theme {name}").format(name=self.theme))

    def action_pane(self, name: str) -> None:
        """Show the pane of that name, or close it; to explain one row is to stay on it."""
        self._panes.toggle(name)
        if self._panes.holds_row:
            self._table.stay()
        self._show_state()

    def action_zoom(self, by: int) -> None:
        """Look at more time, or less."""
        self._panes.zoom(by)

    def action_scroll_pane(self, by: int) -> None:
        """Move the page of the pane."""
        self._panes.scroll(by)

    @on(RowTable.Opened)
    def _open_by_mouse(self) -> None:
        if not self._panes.holds_row:
            self.action_pane("detail")

    def action_help(self) -> None:
        """Show the page of help."""
        self.push_screen(HelpPage())

    def action_palette(self) -> None:
        """Pick what to do from a list of all that can be done."""
        entries = [Entry(_(key.tooltip), key.action, key_names(key)) for key in COMMANDS]
        self.push_screen(Picker(_("do"), entries), self._do)

    async def _do(self, action: str | None) -> None:
        if action is not None and not await self.run_action(action, self):
            await self.run_action(action, self._table)
