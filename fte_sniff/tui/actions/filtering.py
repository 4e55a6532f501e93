"""Owns the keys that say which rows are shown.

It must not know the filter's language; `analysis` does.
"""

from __future__ import annotations

from collections.abc import Callable

from fte_sniff.analysis.filter.cell_filter import CellFilter, both, cell_filters
from fte_sniff.errors import shown
from fte_sniff.tui.actions.parts import Parts
from fte_sniff.tui.language import _
from fte_sniff.tui.picking import Entry, Picker
from fte_sniff.tui.prompt.filter import parsed
from fte_sniff.tui.prompt.preparing import prepare


class Filtering(Parts):
    """Filters: typed into the field at the bottom, or picked from the cells of a row."""

    def _set_filter(self, line: str) -> None:
        """Put a filter in force that passed the check; an empty one shows all."""
        before = self._filter_field.standing
        if line != before:
            self._filters_before.append(before)
        self._hold_filter(line)

    def _hold_filter(self, line: str) -> None:
        self._filter_field.hold(line)
        self._watched.set_filter(parsed(line) if line else None, self._table.near)
        self._table.sync()

    def action_filter(self) -> None:
        """Ask for a filter."""
        self._filter_field.ask()

    def action_unfilter(self) -> None:
        """Show all rows again."""
        self._set_filter("")

    def action_filter_before(self) -> None:
        """Go back to the filter that stood before this one."""
        if self._filters_before:
            self._hold_filter(self._filters_before.pop())
        else:
            self._tell(_("no other filter stood before"))

    def action_only(self) -> None:
        """Show only rows that are like the cursor's in one cell."""
        self._pick_cell(_("only rows with"), lambda cell: cell.only)

    def action_without(self) -> None:
        """Hide rows that are like the cursor's in one cell."""
        self._pick_cell(_("hide rows with"), lambda cell: cell.without)

    def _pick_cell(self, title: str, said: Callable[[CellFilter], str]) -> None:
        row = self._table.cursor_row
        if row is None:
            return
        prepare()
        cells = cell_filters(row)
        names = [cell.column for cell in cells]
        at = names.index(self._table.column) if self._table.column in names else 0
        entries = [Entry(shown(cell.only), said(cell)) for cell in cells]
        self.push_screen(Picker(title, entries, at), self._add_filter)

    def _add_filter(self, condition: str | None) -> None:
        if condition is not None:
            self._set_filter(both(self._filter_field.standing, condition))
