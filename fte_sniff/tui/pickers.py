"""File, port and column pickers."""

from __future__ import annotations

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
from textual.screen import ModalScreen
from textual.widget import Widget

from fte_sniff.protocol import COLUMN_BY_NAME
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.keys import CHOOSING, PICKING, bindings, say_keys
from fte_sniff.tui.status_bar import KeyLine
from fte_sniff.tui.table.columns import LEAST, MOST, ORDER, VALUES, ColumnChoice, TableColumn
from fte_sniff.tui.text import fit

Picked = TypeVar("Picked")

SHARE = 0.9
"""How much of the screen's height a list takes at most."""

BORDERS = 2
"""Lines that the box around a list takes."""

CURSOR = Style(reverse=True, bold=True)


@dataclass(frozen=True, slots=True)
class Entry(Generic[Picked]):
    """One line of the list."""

    words: str
    """What stands there; text from outside must have gone through `errors.printable`."""
    value: Picked
    aside: str = ""
    """What stands at its end, such as a key."""


class PickerLines(Widget):
    """The entries that there is room for, the one under the cursor set off by a sign too."""

    def __init__(self) -> None:
        super().__init__()
        self._lines: Sequence[tuple[str, str]] = ()
        self.cursor = 0

    def show(self, lines: Sequence[tuple[str, str]], cursor: int) -> None:
        """Draw these, each with what stands at its end."""
        self._lines, self.cursor = lines, cursor
        room = int(self.app.size.height * SHARE) - BORDERS
        self.styles.height = max(1, min(len(lines), room))
        self.refresh()

    @property
    def top(self) -> int:
        """The first line in view; the cursor is always in view."""
        height = max(1, self.size.height)
        least = max(0, self.cursor - height + 1)
        return min(max(least, self.cursor - height // 2), max(0, len(self._lines) - height))

    def render(self) -> Text:
        """The lines in view."""
        width, top = self.size.width, self.top
        made = []
        for at, (words, aside) in enumerate(self._lines[top : top + self.size.height], top):
            room = max(0, width - 2 - (cell_len(aside) + 1 if aside else 0))
            line = f"{'>' if at == self.cursor else ' '} {fit(words, room)}"
            line = fit(f"{line} {aside}" if aside else line, width)
            made.append(Text(line, CURSOR if at == self.cursor else "", end=""))
        return Text("\n", no_wrap=True, overflow="crop").join(made)


class Picker(ModalScreen[Picked | None], Generic[Picked]):
    """A list over the screen; gives the value of the picked entry, or None."""

    BINDINGS: ClassVar[list[BindingType]] = bindings(PICKING)

    def __init__(self, title: str, entries: Sequence[Entry[Picked]], at: int = 0) -> None:
        """The list.

        Args:
            title: what is picked.
            entries: from top to bottom.
            at: where the cursor stands at first.
        """
        super().__init__()
        self._heading, self._entries, self._at = title, entries, at
        self._typed = ""
        self._done = False
        self._lines = PickerLines()
        say_keys(self)

    def compose(self) -> ComposeResult:
        """A box as tall as its entries, as far as there is room."""
        with Vertical(id="picker"):
            yield self._lines
        yield KeyLine()

    def on_mount(self) -> None:
        """Show the entries."""
        self._show()

    def on_resize(self) -> None:
        """Show as many as there is room for."""
        self._show()

    @property
    def shown(self) -> list[Entry[Picked]]:
        """The entries that have every word that was typed, the sooner the higher."""
        words = self._typed.lower().split()
        found = []
        for entry in self._entries:
            text = f"{entry.words} {entry.aside}".lower()
            if all(word in text for word in words):
                found.append((text.find(words[0]) if words else 0, entry))
        return [entry for _, entry in sorted(found, key=lambda pair: pair[0])]

    def _show(self) -> None:
        shown = self.shown
        self._at = min(max(0, self._at), max(0, len(shown) - 1))
        box = self.query_one("#picker")
        box.border_title = Text(self._heading)
        hint = _("type to find, enter picks, esc goes back")
        box.border_subtitle = Text(f"{self._typed}_" if self._typed else hint)
        lines = [(entry.words, entry.aside) for entry in shown] or [
            (_("nothing is called that"), "")
        ]
        self._lines.show(lines, self._at)

    def on_key(self, event: events.Key) -> None:
        """Do what the key says, or hand it on where the pick was made before it."""
        event.prevent_default().stop()
        if self._done:
            self.app.post_message(events.Key(event.key, event.character))
        else:
            self._press(event)

    def _press(self, event: events.Key) -> None:
        page = max(1, self._lines.size.height - 1)
        steps = {"up": -1, "down": 1, "pageup": -page, "pagedown": page}
        steps |= {"ctrl+p": -1, "ctrl+n": 1, "home": -len(self._entries), "end": len(self._entries)}
        if event.key == "escape":
            self._give(None)
        elif event.key == "enter":
            shown = self.shown
            self._give(shown[self._at].value if shown else None)
        elif event.key in steps:
            self._at += steps[event.key]
        elif event.key == "backspace":
            self._typed = self._typed[:-1]
        elif event.key == "ctrl+u":
            self._typed = ""
        elif event.is_printable and event.character:
            self._typed, self._at = self._typed + event.character, 0
        if not self._done:
            self._show()

    def _give(self, value: Picked | None) -> None:
        self._done = True
        self.dismiss(value)

    def on_click(self, event: events.Click) -> None:
        """Pick the entry under the mouse; a click beside the list goes back."""
        event.stop()
        if self._done:
            return
        at = event.screen_y - self._lines.region.y + self._lines.top
        shown = self.shown
        if not self._lines.region.contains(event.screen_x, event.screen_y):
            if not self.query_one("#picker").region.contains(event.screen_x, event.screen_y):
                self._give(None)
        elif at < len(shown):
            self._give(shown[at].value)

    def on_mouse_scroll_up(self) -> None:
        """Move up."""
        self._at -= 1
        self._show()

    def on_mouse_scroll_down(self) -> None:
        """Move down."""
        self._at += 1
        self._show()


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
        self._list = PickerLines()
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
