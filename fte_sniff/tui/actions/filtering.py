"""Owns the keys that say which rows are shown.

It must not know the filter's language; `analysis` does.
"""

from __future__ import annotations

from fte_sniff.analysis.filter import RowFilter
from fte_sniff.tui.actions.parts import Parts


class Filtering(Parts):
    """Filters, by the field at the bottom."""

    def _set_filter(self, line: str) -> None:
        self._filter_field.standing = line
        self._watched.set_filter(RowFilter.parse(line) if line else None, self._table.near)
        self._table.sync()

    def action_filter(self) -> None:
        """Ask for a filter."""
        self._filter_field.ask()

    def action_unfilter(self) -> None:
        """Show all rows again."""
        self._set_filter("")
        self._filter_field.fall_back()
