"""Owns the list in which one chooses the table's columns, their order and their widths.

It must not know rows. What it gives is a `ColumnChoice`, or that the window is to decide again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

from textual import events
from textual.app import ComposeResult
from textual.binding import BindingType
from textual.containers import Vertical
from textual.screen import ModalScreen

from fte_sniff.protocol import COLUMN_BY_NAME
from fte_sniff.tui.keyline import KeyLine
from fte_sniff.tui.keys import CHOOSING, bindings, say_keys
from fte_sniff.tui.language import _, later
from fte_sniff.tui.picking import Lines
from fte_sniff.tui.table.columns import LEAST, MOST, ORDER, VALUES, TableColumn
from fte_sniff.tui.table.look import ColumnChoice

VALUES_MEANING = later("all values of a row by their short names, as far as there is room")

KEYS = later("space: show, K J: move, < >: width, r: as it was, enter, esc")


@dataclass(frozen=True, slots=True)
class Chosen:
    """What was chosen."""

    choice: ColumnChoice | None
    """None where the width of the window is to decide."""


@dataclass(slots=True)
class _Line:
    name: str
    wanted: bool
    width: int


class ColumnChooser(ModalScreen[Chosen | None]):
    """The columns in the order in which they stand side by side; gives None where left."""

    BINDINGS: ClassVar[list[BindingType]] = bindings(CHOOSING)

    def __init__(self, shown: Sequence[TableColumn], width_of: Callable[[str], int]) -> None:
        """The list.

        Args:
            shown: the columns that are in the table now.
            width_of: the width that any column has of its own.
        """
        super().__init__()
        self._lines = [_Line(column.name, True, column.width) for column in shown]
        names = {line.name for line in self._lines}
        rest = (name for name in (*ORDER, VALUES) if name not in names)
        self._lines += [_Line(name, False, width_of(name)) for name in rest]
        self._at = 0
        self._done = False
        self._list = Lines()
        say_keys(self)

    def compose(self) -> ComposeResult:
        """A box as tall as there are columns, as far as there is room."""
        with Vertical(id="picker"):
            yield self._list
        yield KeyLine()

    def on_mount(self) -> None:
        """Show the columns."""
        self._show()

    def on_resize(self) -> None:
        """Show as many as there is room for."""
        self._show()

    def _show(self) -> None:
        box = self.query_one("#picker")
        box.border_title = _("columns")
        box.border_subtitle = _(KEYS)
        self._list.show([(_words(line), f"{line.width:>3}") for line in self._lines], self._at)

    def on_key(self, event: events.Key) -> None:
        """Do what the key says, or hand it on where the choice was made before it."""
        event.prevent_default().stop()
        if self._done:
            self.app.post_message(events.Key(event.key, event.character))
            return
        self._press(event.key)
        if not self._done:
            self._show()

    def _press(self, key: str) -> None:
        line = self._lines[self._at]
        match key:
            case "up" | "k":
                self._at = max(0, self._at - 1)
            case "down" | "j":
                self._at = min(len(self._lines) - 1, self._at + 1)
            case "K" | "shift+up":
                self._move(-1)
            case "J" | "shift+down":
                self._move(1)
            case "space" | "x":
                line.wanted = not line.wanted
            case "less_than_sign" | "left" | "h":
                line.width = max(LEAST, line.width - 1)
            case "greater_than_sign" | "right" | "l":
                line.width = min(MOST, line.width + 1)
            case "r":
                self._give(Chosen(None))
            case "enter":
                self._give(self._chosen())
            case "escape" | "q" | "C":
                self._give(None)

    def _move(self, by: int) -> None:
        to = min(max(0, self._at + by), len(self._lines) - 1)
        self._lines.insert(to, self._lines.pop(self._at))
        self._at = to

    def _chosen(self) -> Chosen | None:
        wanted = [line for line in self._lines if line.wanted]
        if not wanted:
            return None
        widths = tuple((line.name, line.width) for line in wanted)
        return Chosen(ColumnChoice(tuple(line.name for line in wanted), widths))

    def _give(self, chosen: Chosen | None) -> None:
        self._done = True
        self.dismiss(chosen)

    def on_click(self, event: events.Click) -> None:
        """Show or hide the column under the mouse."""
        event.stop()
        at = event.screen_y - self._list.region.y + self._list.top
        inside = self._list.region.contains(event.screen_x, event.screen_y)
        if inside and at < len(self._lines) and not self._done:
            self._at = at
            self._press("space")
            self._show()


def _words(line: _Line) -> str:
    meaning = VALUES_MEANING if line.name == VALUES else COLUMN_BY_NAME[line.name].meaning
    return f"[{'x' if line.wanted else ' '}] {line.name:<10} {_(meaning)}"
