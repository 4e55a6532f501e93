"""Owns the keys that take rows out of the screen.

It must not know what their bytes mean.
"""

from __future__ import annotations

from textual.widgets import Input

from fte_sniff.protocol import spaced_hex
from fte_sniff.tui.actions.parts import Parts


class Taking(Parts):
    """Rows, and typed text, to the clipboard."""

    def action_copy(self) -> None:
        """Hand the row's bytes to the terminal as hex."""
        row = self._table.cursor_row
        if row is not None:
            self.copy_to_clipboard(spaced_hex(row.raw))
            self._tell(f"copied {spaced_hex(row.raw)}")

    def action_interrupt(self) -> None:
        """Copy the selection of a field; where nothing is selected, end."""
        field = self.focused
        if isinstance(field, Input) and field.selected_text:
            self.copy_to_clipboard(field.selected_text)
        else:
            self.exit()
