"""Owns the keys that set rows apart: marks, and a selection from one row to another.

It must not know what is done with them.
"""

from __future__ import annotations

from fte_sniff.tui.actions.parts import Parts
from fte_sniff.tui.language import _


class Marking(Parts):
    """Marks and the selection."""

    def action_mark(self) -> None:
        """Mark the row under the cursor, or take its mark away."""
        if self._table.viewport.count:
            self._table.stay()
            self._table.marks.toggle(self._table.index_here)
            self._table.sync()

    def action_to_mark(self, by: int) -> None:
        """Go to the next marked row, or to the one before."""
        if self._table.jump_to_mark(by):
            return
        if not self._table.marks:
            self._tell(_("no row is marked; m marks one"))
        elif by > 0:
            self._tell(_("no marked row is shown below this one"))
        else:
            self._tell(_("no marked row is shown above this one"))

    def action_select(self) -> None:
        """Begin a selection at the cursor's row, or end it."""
        if self._table.selecting_from is not None:
            self._unselect()
        elif self._table.viewport.count:
            self._table.stay()
            self._table.selecting_from = self._table.index_here
            self._table.sync()
            self._tell(_("selecting: move, then y or Y copies, w saves, esc ends it"))

    def _unselect(self) -> bool:
        """End the selection; whether there was one."""
        if self._table.selecting_from is None:
            return False
        self._table.selecting_from = None
        self._table.sync()
        return True
