"""Filter the rows: by a line that is typed, by a cell, by a line of the top view."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from fte_sniff.analysis.filter.terms import CellFilter, both, cell_filters
from fte_sniff.errors import printable
from fte_sniff.tui.controllers.controller import Parts, ScreenController
from fte_sniff.tui.i18n import _
from fte_sniff.tui.modals import Entry, Picker
from fte_sniff.tui.panes.pane import Pane
from fte_sniff.tui.prompt import (
    FILTER_NAME,
    FilterField,
    PromptField,
    parse_filter,
    preload_filter,
)


@dataclass(frozen=True, slots=True)
class _Earlier:
    """What was shown before a filter."""

    filter: str
    own: str
    index: int | None = None
    """Index of the cursor's row, if the filter moved the cursor."""
    pane: Pane | None = None
    """The open pane, if the filter closed it."""


class FilterController(ScreenController):
    """Applies filters, and keeps the earlier ones and those that are saved by name."""

    def __init__(self, parts: Parts) -> None:
        """Begin with the filter and the saved filters of the options."""
        super().__init__(parts)
        options = self._options
        self.saved = dict(options.choices.filters)
        """Filters by their names."""
        self.field = FilterField(
            self._focus,
            self._store,
            options.row_filter.text if options.row_filter else "",
            self.saved,
            self._cursor_ns,
            self.set_filter,
            self._ask_name,
        )
        self.name_field = PromptField(self._focus, FILTER_NAME, str, self._name_filter)
        self.own = self.field.current
        """The filter that the user has set last, and not a finding: the one to be remembered."""
        self._earlier: list[_Earlier] = []
        """What was shown before the current filter, the latest last."""

    def _cursor_ns(self) -> int | None:
        row = self._table.cursor_row
        return None if row is None else row.t_ns

    def action_filter(self) -> None:
        """Ask for a filter."""
        self.field.open()

    def action_unfilter(self) -> None:
        """Show all rows."""
        self.set_filter("")

    def action_filter_before(self) -> None:
        """Go back to the previous filter, and to the list whose finding set the current one."""
        if not self._earlier:
            self._notice.inform(_("there was no other filter before"))
            return
        before = self._earlier.pop()
        self.own = before.own
        self._apply_filter(before.filter)
        if before.index is not None:
            self._table.stay_at(before.index)
        if before.pane is not None and before.pane is not self._panes.open:
            self._panes.action_toggle(before.pane.NAME)

    def set_filter(self, line: str) -> None:
        """Apply a valid filter, and remember the current one; an empty one shows all rows."""
        current = self.field.current
        if line != current:
            self._earlier.append(_Earlier(current, self.own))
        self.own = line
        self._apply_filter(line)
        row_filter = self._model.store.view.filter
        if row_filter is not None and row_filter.advice:
            self._notice.inform(_(row_filter.advice))

    def go(self, line: str, index: int) -> None:
        """Apply the filter of a finding, with the cursor at a row or the next one that it shows.

        It closes the open pane. The filter is not remembered with the file.
        """
        index_before = self._table.last_index
        earlier = _Earlier(self.field.current, self.own, index_before, self._panes.open)
        self._earlier.append(earlier)
        self._panes.close()
        self._focus.show_top(False)
        self._table.stay_at(index)
        self._apply_filter(line)

    def _apply_filter(self, line: str) -> None:
        self.field.set_current(line)
        self._model.set_filter(parse_filter(line) if line else None, self._table.near)
        self._table.sync()

    def choose(self) -> None:
        """Show the rows of the line under the cursor of the top view, by a filter."""
        condition = self._panes.top_condition()
        if condition is not None:
            self._add_condition(condition)
            self._focus.show_top(False)

    def _ask_name(self, _line: str) -> None:
        self.name_field.open()

    def _name_filter(self, name: str) -> None:
        """Save the filter in effect by name."""
        if name:
            self.saved[name] = self.field.current
            self._notice.inform(_("saved; f lists the filter as {name}", name=name))

    def action_only(self) -> None:
        """Show only rows with the same value in a cell."""
        self._pick_cell(_("only rows with"), lambda cell: cell.only)

    def action_without(self) -> None:
        """Hide rows with the same value in a cell."""
        self._pick_cell(_("hide rows with"), lambda cell: cell.without)

    def _pick_cell(self, title: str, condition: Callable[[CellFilter], str]) -> None:
        row = self._table.cursor_row
        if row is None:
            return
        preload_filter()
        cells = cell_filters(row)
        names = [cell.column for cell in cells]
        cursor = names.index(self._table.column) if self._table.column in names else 0
        entries = [Entry(printable(cell.only), condition(cell)) for cell in cells]
        self._table.app.push_screen(Picker(title, entries, cursor), self._add_condition)

    def _add_condition(self, condition: str | None) -> None:
        if condition is not None:
            self.set_filter(both(self.field.current, condition))
