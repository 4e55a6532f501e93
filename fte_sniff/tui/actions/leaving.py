"""Owns the keys that end things: what runs, what is open, and at last the screen itself.

It must not end the screen by the key that closes what is open.
"""

from __future__ import annotations

from fte_sniff.tui.actions.marking import Marking
from fte_sniff.tui.actions.searching import Searching
from fte_sniff.tui.actions.taking import Taking


class Leaving(Searching, Marking, Taking):
    """Ways back and out."""

    def action_dismiss(self) -> None:
        """End one thing that was begun: a save, a selection, a notice, a search, a pane."""
        if self._end_saving() or self._unselect():
            return
        if self._notice.display and not self._searching:
            self._notice.put_away()
        elif not self._end_search():
            self._panes.close()

    def action_leave(self) -> None:
        """End."""
        self.exit()
