"""Owns the keys that lead to a row: by its number, its time, or what is wrong with it.

It must not know how rows are found; the watched rows and the store do.
"""

from __future__ import annotations

from fte_sniff.analysis.search import find_raised
from fte_sniff.errors import shown
from fte_sniff.tui.actions.parts import Parts
from fte_sniff.tui.language import _
from fte_sniff.tui.prompt.goto import ToOffset, parse_goal
from fte_sniff.tui.table.cells import clock_text


class Seeking(Parts):
    """Ways to a row."""

    def _go(self, line: str) -> None:
        if not line:
            return
        zone, cursor = self._table.look.shown_zone, self._table.viewport.cursor
        goal = parse_goal(line, zone)
        row = self._watched.row_of(goal, cursor, zone)
        if row is None and isinstance(goal, ToOffset):
            words = _("no row that is shown has byte {offset:,} of its stream")
            self._tell(words.format(offset=goal.offset))
        elif row is None:
            self._tell(_("no row here has a time to go by"))
        if row is None:
            return
        last = self._table.viewport.count - 1
        moment = self._watched.moment_of(goal, cursor, zone)
        self._table.jump(row)
        if row > last >= 0:
            words = _("there is no row {number:,}; this is the last")
            self._tell(words.format(number=row + 1))
        elif moment is not None:
            self._tell_outside(line, moment)

    def _tell_outside(self, line: str, moment: int) -> None:
        """Say that no row is of that time, where it lies before or after all that are shown."""
        first, last = self._watched.shown_ends
        zone = self._table.look.shown_zone
        if last is not None and moment > last:
            words, end = _("{time} lies after the last row ({end})"), last
        elif first is not None and moment < first:
            words, end = _("{time} lies before the first row ({end})"), first
        else:
            return
        self._tell(words.format(time=shown(line.strip()), end=clock_text(end, 3, zone)))

    def action_goto(self) -> None:
        """Ask where to go."""
        self._goto_field.ask()

    def action_fault(self, by: int) -> None:
        """Go to the next row with a fault, or to the one before."""
        if self._table.jump_to_fault(by):
            return
        words = _("no row with a fault below this one")
        if by < 0:
            words = _("no row with a fault above this one")
        if find_raised(self._watched.store, self._table.index_here, by) is not None:
            hint = _("{key} goes to one whose ERROR or ONLINE is not in order")
            words += "; " + hint.format(key="a" if by > 0 else "A")
        self._tell(words)

    def action_raised(self, by: int) -> None:
        """Go to the next row with a flag byte that is not in order, or to the one before."""
        if self._table.jump_to_raised(by):
            return
        if by > 0:
            self._tell(_("no row below this one whose ERROR or ONLINE is not in order"))
        else:
            self._tell(_("no row above this one whose ERROR or ONLINE is not in order"))
