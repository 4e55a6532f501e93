"""Modal screens: pick an entry from a list, choose columns, and the help page."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, Generic, TypeAlias, TypeVar

from rich.cells import cell_len
from rich.style import Style
from rich.text import Text
from textual import events
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical, VerticalScroll
from textual.screen import ModalScreen, ScreenResultType
from textual.widget import Widget
from textual.widgets import Static

from fte_sniff.analysis.filter.terms import EXAMPLES
from fte_sniff.formats.cell_text import fit, padded, wrap
from fte_sniff.formats.text_layout import ORDER_MARK
from fte_sniff.protocol import COLUMN_BY_NAME, COLUMNS, FAULT_MEANINGS, Status, status_of
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.keys import CHOOSING, PICKING, SECTIONS, bindings, key_names, translate_keys
from fte_sniff.tui.panes.detail import UNCERTAIN_ORDER
from fte_sniff.tui.status_bar import KeyLine
from fte_sniff.tui.table.columns import (
    MARKS,
    MAX_WIDTH,
    MIN_WIDTH,
    ORDER,
    RAISED_MARK,
    VALUES,
    ColumnChoice,
    TableColumn,
    TimeStyle,
)
from fte_sniff.tui.table.painter import Sign

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
        """A list of all columns; `width_of` returns the default width of one."""
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


RAISED = later("ERROR or ONLINE reports that a motor is not in order")

Pair: TypeAlias = tuple[str, str]
"""A key or a name, and its meaning."""


def help_pairs() -> Iterator[tuple[str, list[Pair]]]:
    """Sections of the page: a heading and its pairs."""
    for heading, keys in SECTIONS:
        yield _(heading), [(key_names(key), _(key.tooltip)) for key in keys]
    signs = [(MARKS[status], status.value) for status in Status]
    signs.append((RAISED_MARK, _(RAISED)))
    signs.append((ORDER_MARK, _(UNCERTAIN_ORDER)))
    signs += [(sign, _(sign.meaning)) for sign in Sign if sign.meaning]
    yield _("Signs before a row"), signs
    yield _("Times"), [(_(style), _(style.meaning)) for style in TimeStyle]
    yield (
        _("Faults"),
        [
            (f"{MARKS[status_of((fault,))]} {fault}", _(meaning))
            for fault, meaning in FAULT_MEANINGS.items()
        ],
    )
    columns = [(column.name, _(column.meaning)) for column in COLUMNS]
    yield _("Columns, and names in a filter"), columns
    yield _("Filters"), [(example, _(meaning)) for example, meaning in EXAMPLES]


def help_text(width: int) -> Text:
    """The page in `width` cells."""
    lines = []
    for heading, pairs in help_pairs():
        lines.append(Text(heading, style="bold"))
        left_width = min(max(cell_len(left) for left, _right in pairs), width // 2)
        for pair in pairs:
            lines += _pair_lines(pair, left_width, width)
        lines.append(Text())
    return Text("\n", no_wrap=True).join(lines)


def _pair_lines(pair: Pair, left_width: int, width: int) -> Iterator[Text]:
    """Side by side where the left side fits, else one below the other."""
    left, right = pair
    indent = " " * (left_width + 4)
    lines = wrap(right, max(8, width - len(indent)))
    if cell_len(left) <= left_width:
        first = lines.pop(0) if lines else ""
        yield Text.assemble("  ", (padded(left, left_width), "bold"), "  ", first)
    else:
        yield from (Text("  " + line, style="bold") for line in wrap(left, max(8, width - 2)))
    yield from (Text(indent + line) for line in lines)


class HelpPage(ModalScreen[None]):
    """The help page over the screen."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding(keys, action, short, priority=True, show=bool(short), key_display=display)
        for keys, action, short, display in (
            ("escape,question_mark,q,enter", "dismiss", later("Back"), "esc"),
            ("down,j", "scroll(1)", later("Down"), "down"),
            ("up,k", "scroll(-1)", later("Up"), "up"),
            ("pagedown,ctrl+d,space", "page(1)", later("Page"), "space"),
            ("pageup,ctrl+u", "page(-1)", "", None),
            ("home,g", "edge(-1)", later("Start"), "g"),
            ("end,G", "edge(1)", later("End"), "G"),
        )
    ]

    def __init__(self) -> None:
        super().__init__()
        translate_keys(self)
        self._text = Static()
        # An attribute, since a query finds nothing once the page is dismissed.
        self._page = VerticalScroll(self._text, id="help", can_focus=False)
        self._page.border_title = _("Keys and signs")

    def compose(self) -> ComposeResult:
        """The page and its keys."""
        yield self._page
        yield KeyLine()

    def on_mount(self) -> None:
        """Update the subtitle when the page is scrolled."""
        self.watch(self._page, "scroll_y", self._show_rest)

    def on_resize(self) -> None:
        """Wrap the page to the new width."""
        width = self._page.scrollable_content_region.width
        self._text.update(help_text(width))
        self.call_after_refresh(self._show_rest)

    def _show_rest(self) -> None:
        page = self._page
        below = round(page.max_scroll_y - page.scroll_y)
        more = _("{count} more lines: down, pgdn, end   esc: back").format(count=below)
        page.border_subtitle = more if below > 0 else _("esc: back")

    def action_scroll(self, by: int) -> None:
        """Scroll by lines, once the page is laid out."""
        self.call_after_refresh(self._page.scroll_relative, y=by, animate=False)

    def action_page(self, by: int) -> None:
        """Scroll by a page."""
        (self._page.scroll_page_down if by > 0 else self._page.scroll_page_up)(animate=False)

    def action_edge(self, by: int) -> None:
        """Go to the end, or to the start (negative)."""
        (self._page.scroll_end if by > 0 else self._page.scroll_home)(animate=False)
