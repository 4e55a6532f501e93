"""What the table shows, and which pane is open."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC

from fte_sniff.protocol.dissect import dissect
from fte_sniff.tui.cells import TimeStyle
from fte_sniff.tui.controllers.controller import ScreenController
from fte_sniff.tui.i18n import _, choice_after
from fte_sniff.tui.modals import ChosenColumns, ColumnChooser, HelpPage
from fte_sniff.tui.panes.pane import BESIDE_CELLS


class ViewController(ScreenController):
    """Times, columns, changed bytes, event lines, panes, the top view and the help."""

    def action_times(self) -> None:
        """Switch to the next time style; without a mark or another zone, two are skipped."""
        if self._model.start_ns is None and len(self._store):
            self._notice.inform(_("no row here has a time"))
            return
        view, styles = self._table.view, list(TimeStyle)
        if self._table.marks.latest is None:
            styles.remove(TimeStyle.MARK)
        if view.zone == UTC:
            styles.remove(TimeStyle.LOCAL)
        style = choice_after(view.times, styles)
        self._table.set_view(times=style)
        self._panes.redraw()
        self._notice.inform(_(style.meaning))

    def action_changes(self) -> None:
        """Highlight the bytes that changed, or no longer."""
        changes = not self._table.view.changes
        self._table.set_view(changes=changes)
        on = _("bytes that differ from the frame before of the same kind and motor are highlighted")
        self._notice.inform(on if changes else _("changed bytes are not highlighted"))

    def action_events(self) -> None:
        """Show the lines of port events and gaps, or hide them."""
        events = not self._table.view.events
        self._table.set_view(events=events)
        self._notice.inform(_("port events are shown") if events else _("port events are hidden"))

    def action_columns(self) -> None:
        """Choose columns and their order."""

        def choose(chosen: ChosenColumns | None) -> None:
            if chosen is not None:
                self._table.set_view(choice=chosen.names, delta=chosen.delta)

        chooser = ColumnChooser(self._table.view, self._table.scrollable_size.width)
        self._table.app.push_screen(chooser, choose)

    def action_aside(self, by: int) -> None:
        """Choose a time in the statistics where they are open, else scroll sideways."""
        pane = self._panes.open
        if pane is not None and pane.aside(by):
            self._panes.redraw_open()
        else:
            self._table.action_aside(by)

    def action_top(self) -> None:
        """Show one line for each kind and motor in place of the table, or the table again."""
        self._focus.show_top(not self._panes.top.display)
        if self._panes.top.display and self._panes.explains_row:
            self._panes.close()
        self._body.call_after_refresh(self._panes.redraw)

    def action_pane_side(self) -> None:
        """Move the panes beside the table, or below it."""
        if not self._body.can_be_beside:
            text = _("a pane is beside the table from {cells} columns on")
            self._notice.inform(text.format(cells=BESIDE_CELLS))
            return
        layout = self._body.pane_layout
        self._body.set_pane_layout(replace(layout, beside=not layout.beside))

    def action_field(self, by: int) -> None:
        """Look at the next field of the cursor's row, or at the previous one."""
        row = self._table.cursor_row
        if row is None:
            return
        self.explain_row()
        current, count = self._table.field, len(dissect(row))
        start = (-1 if by > 0 else count) if current is None else current
        self._table.look_at((start + by) % count)

    def explain_row(self) -> None:
        """Open the detail pane, unless a pane about the row is open."""
        if not self._panes.explains_row:
            self._panes.action_toggle("detail")

    def action_help(self) -> None:
        """Show the help page."""
        self._table.app.push_screen(HelpPage(self._table.palette))
