"""Lists over the screen: pick an entry, or choose columns."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Generic, TypeVar

from rich.cells import cell_len
from rich.style import Style
from rich.text import Text
from textual import events
from textual.app import ComposeResult
from textual.binding import BindingType
from textual.containers import Vertical
from textual.screen import ModalScreen, ScreenResultType
from textual.widget import Widget

from fte_sniff.formats.cell_text import fit
from fte_sniff.protocol import COLUMN_BY_NAME
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.keys import CHOOSING, PICKING, bindings, translate_keys
from fte_sniff.tui.status_bar import KeyLine
from fte_sniff.tui.table.columns import (
    MAX_WIDTH,
    MIN_WIDTH,
    ORDER,
    VALUES,
    ColumnChoice,
    TableColumn,
)

Picked = TypeVar("Picked")

MAX_SHARE = 0.9
"""Share of the screen's height that a list may have."""

BORDER_LINES = 2

CURSOR = Style(reverse=True, bold=True)


class PickerLines(Widget):
    """The lines of a list that fit; a sign marks the one under the cursor."""

    def __init__(self) -> None:
        super().__init__()
        self._lines: Sequence[tuple[str, str]] = ()
        self.cursor = 0

    def show(self, lines: Sequence[tuple[str, str]], cursor: int) -> None:
        """Draw lines, each with a text at its right end."""
        self._lines, self.cursor = lines, cursor
        most = int(self.app.size.height * MAX_SHARE) - BORDER_LINES
        self.styles.height = max(1, min(len(lines), most))
        self.refresh()

    @property
    def top(self) -> int:
        """The first line in view, so that the cursor is in view."""
        height = max(1, self.size.height)
        least = max(0, self.cursor - height + 1)
        return min(max(least, self.cursor - height // 2), max(0, len(self._lines) - height))

    def line_at(self, event: events.Click) -> int | None:
        """Number of the clicked line; None outside of the list."""
        if not self.region.contains(event.screen_x, event.screen_y):
            return None
        number = event.screen_y - self.region.y + self.top
        return number if number < len(self._lines) else None

    def render(self) -> Text:
        """The lines in view."""
        width, top = self.size.width, self.top
        lines = []
        for number, (text, right) in enumerate(self._lines[top : top + self.size.height], top):
            left = max(0, width - 2 - (cell_len(right) + 1 if right else 0))
            line = f"{'>' if number == self.cursor else ' '} {fit(text, left)}"
            line = fit(f"{line} {right}" if right else line, width)
            lines.append(Text(line, CURSOR if number == self.cursor else "", end=""))
        return Text("\n", no_wrap=True, overflow="crop").join(lines)


class ListScreen(ModalScreen[ScreenResultType]):
    """A list in a box, as tall as its lines where they fit.

    Keys that are typed ahead of its end go back to the app.
    """

    def __init__(self) -> None:
        super().__init__()
        self._cursor = 0
        self._done = False
        self._lines = PickerLines()
        translate_keys(self)

    def compose(self) -> ComposeResult:
        """The box and the line of keys."""
        with Vertical(id="picker"):
            yield self._lines
        yield KeyLine()

    @abstractmethod
    def _show(self) -> None:
        """Draw the list with `_show_lines`."""

    @abstractmethod
    def _press(self, event: events.Key) -> None:
        """Handle a key."""

    def _show_lines(self, title: str, subtitle: str, lines: Sequence[tuple[str, str]]) -> None:
        box = self.query_one("#picker")
        box.border_title, box.border_subtitle = Text(title), Text(subtitle)
        self._lines.show(lines, self._cursor)

    def on_mount(self) -> None:
        """Draw the list."""
        self._show()

    def on_resize(self) -> None:
        """Draw the lines that fit."""
        self._show()

    def on_key(self, event: events.Key) -> None:
        """Handle a key before the next one acts."""
        event.prevent_default().stop()
        if self._done:
            self.app.post_message(events.Key(event.key, event.character))
            return
        self._press(event)
        if not self._done:
            self._show()

    def _finish(self, result: ScreenResultType | None) -> None:
        self._done = True
        self.dismiss(result)


@dataclass(frozen=True, slots=True)
class Entry(Generic[Picked]):
    """One line of a picker."""

    text: str
    """Printable."""
    value: Picked
    right: str = ""
    """Text at the right end, such as a key."""


class Picker(ListScreen[Picked | None], Generic[Picked]):
    """A list from which one entry is picked; the result is its value, or None."""

    BINDINGS: ClassVar[list[BindingType]] = bindings(PICKING)

    def __init__(self, title: str, entries: Sequence[Entry[Picked]], cursor: int = 0) -> None:
        """A list.

        Args:
            title: what is picked.
            entries: from top to bottom.
            cursor: number of the entry under the cursor at first.
        """
        super().__init__()
        self._heading, self._entries, self._cursor = title, entries, cursor
        self._typed = ""

    @property
    def shown(self) -> list[Entry[Picked]]:
        """The entries that contain every typed word; the sooner the first one, the higher."""
        words = self._typed.lower().split()
        found = []
        for entry in self._entries:
            text = f"{entry.text} {entry.right}".lower()
            if all(word in text for word in words):
                found.append((text.find(words[0]) if words else 0, entry))
        return [entry for _, entry in sorted(found, key=lambda pair: pair[0])]

    def _show(self) -> None:
        lines = [(entry.text, entry.right) for entry in self.shown]
        self._cursor = min(max(0, self._cursor), max(0, len(lines) - 1))
        hint = _("type to find, enter picks, esc goes back")
        typed = f"{self._typed}_" if self._typed else hint
        self._show_lines(self._heading, typed, lines or [(_("nothing is called that"), "")])

    def _press(self, event: events.Key) -> None:
        page = max(1, self._lines.size.height - 1)
        steps = {"up": -1, "down": 1, "pageup": -page, "pagedown": page}
        steps |= {"ctrl+p": -1, "ctrl+n": 1, "home": -len(self._entries), "end": len(self._entries)}
        if event.key == "escape":
            self._finish(None)
        elif event.key == "enter":
            self._pick(self._cursor)
        elif event.key in steps:
            self._cursor += steps[event.key]
        elif event.key == "backspace":
            self._typed = self._typed[:-1]
        elif event.key == "ctrl+u":
            self._typed = ""
        elif event.is_printable and event.character:
            self._typed, self._cursor = self._typed + event.character, 0

    def _pick(self, number: int) -> None:
        shown = self.shown
        self._finish(shown[number].value if shown else None)

    def on_click(self, event: events.Click) -> None:
        """Pick the clicked entry; a click outside of the box goes back."""
        event.stop()
        number = self._lines.line_at(event)
        box = self.query_one("#picker").region
        if self._done:
            return
        if number is not None and self.shown:
            self._pick(number)
        elif not box.contains(event.screen_x, event.screen_y):
            self._finish(None)

    def on_mouse_scroll_up(self) -> None:
        """Move up."""
        self._cursor -= 1
        self._show()

    def on_mouse_scroll_down(self) -> None:
        """Move down."""
        self._cursor += 1
        self._show()


VALUES_MEANING = later("all values of a row by their short names, as far as there is room")

KEYS = later("space: show, K J: move, < >: width, r: as it was, enter, esc")


@dataclass(frozen=True, slots=True)
class ChosenColumns:
    """Result of the column chooser."""

    choice: ColumnChoice | None
    """None where the width of the window decides."""


@dataclass(slots=True)
class _ColumnLine:
    name: str
    is_shown: bool
    width: int

    @property
    def text(self) -> str:
        meaning = VALUES_MEANING if self.name == VALUES else COLUMN_BY_NAME[self.name].meaning
        return f"[{'x' if self.is_shown else ' '}] {self.name:<10} {_(meaning)}"


class ColumnChooser(ListScreen[ChosenColumns | None]):
    """The columns in order; the result is None where it was cancelled."""

    BINDINGS: ClassVar[list[BindingType]] = bindings(CHOOSING)

    def __init__(self, shown: Sequence[TableColumn], width_of: Callable[[str], int]) -> None:
        """A list of all columns.

        Args:
            shown: the columns of the table.
            width_of: returns the default width of a column.
        """
        super().__init__()
        names = {column.name for column in shown}
        self._columns = [_ColumnLine(column.name, True, column.width) for column in shown]
        self._columns += [
            _ColumnLine(name, False, width_of(name))
            for name in (*ORDER, VALUES)
            if name not in names
        ]

    def _show(self) -> None:
        lines = [(column.text, f"{column.width:>3}") for column in self._columns]
        self._show_lines(_("columns"), _(KEYS), lines)

    def _press(self, event: events.Key) -> None:
        column = self._columns[self._cursor]
        match event.key:
            case "up" | "k":
                self._cursor = max(0, self._cursor - 1)
            case "down" | "j":
                self._cursor = min(len(self._columns) - 1, self._cursor + 1)
            case "K" | "shift+up":
                self._move(-1)
            case "J" | "shift+down":
                self._move(1)
            case "space" | "x":
                column.is_shown = not column.is_shown
            case "less_than_sign" | "left" | "h":
                column.width = max(MIN_WIDTH, column.width - 1)
            case "greater_than_sign" | "right" | "l":
                column.width = min(MAX_WIDTH, column.width + 1)
            case "r":
                self._finish(ChosenColumns(None))
            case "enter":
                self._finish(self._chosen())
            case "escape" | "q" | "C":
                self._finish(None)

    def _move(self, by: int) -> None:
        to = min(max(0, self._cursor + by), len(self._columns) - 1)
        self._columns.insert(to, self._columns.pop(self._cursor))
        self._cursor = to

    def _chosen(self) -> ChosenColumns | None:
        shown = [column for column in self._columns if column.is_shown]
        if not shown:
            return None
        widths = tuple((column.name, column.width) for column in shown)
        return ChosenColumns(ColumnChoice(tuple(column.name for column in shown), widths))

    def on_click(self, event: events.Click) -> None:
        """Show or hide the clicked column."""
        event.stop()
        number = self._lines.line_at(event)
        if number is not None and not self._done:
            self._cursor = number
            self._columns[number].is_shown = not self._columns[number].is_shown
            self._show()
