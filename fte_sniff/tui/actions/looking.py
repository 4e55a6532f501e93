"""Owns the keys that say how rows are looked at: pause, the pane, the help.

It must not know what a row is.
"""

from __future__ import annotations

from fte_sniff.tui.actions.parts import Parts
from fte_sniff.tui.help import HelpPage


class Looking(Parts):
    """Ways to look."""

    def action_pause(self) -> None:
        """Freeze the view, or let it go on."""
        self._table.pause()

    def action_detail(self) -> None:
        """Show or hide the explanation of the row under the cursor."""
        self._detail.display = not self._detail.display
        if self._detail.display:
            self._table.stay()
        self._show_state()

    def action_help(self) -> None:
        """Show the page of help."""
        self.push_screen(HelpPage())

    def action_dismiss(self) -> None:
        """Close the pane, or put the notice away."""
        if self._notice.display:
            self._notice.put_away()
        else:
            self._detail.display = False
