"""Modal screens: pick an entry from a list, choose columns, and the help page."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, combinations, pairwise, zip_longest
from pathlib import Path
from typing import ClassVar, Final, TypeAlias

from rich.cells import cell_len
from rich.table import Column, Table
from rich.text import Text
from textual import events, on
from textual.app import App, ComposeResult
from textual.binding import BindingType
from textual.containers import Vertical, VerticalScroll
from textual.screen import ModalScreen, ScreenResultType
from textual.strip import Strip
from textual.widgets import OptionList, Static

from fte_sniff.analysis.filter.terms import EXAMPLES
from fte_sniff.analysis.motors import Health
from fte_sniff.analysis.relations import UNCHANGED
from fte_sniff.errors import listed
from fte_sniff.formats.cell_text import wrap
from fte_sniff.protocol import (
    COLUMN_BY_NAME,
    COLUMNS,
    FAULT_MEANINGS,
    MOTORS,
    VALUE_FIELDS,
    status_of,
)
from fte_sniff.protocol.columns import LOOKS, ORDER_MARK, short_names_of
from fte_sniff.protocol.spec import online_bit_text
from fte_sniff.tui.cells import (
    DELTA,
    ORDER,
    RAISED_MARK,
    VALUES,
    Delta,
    TableView,
    TimeStyle,
    layout_for,
)
from fte_sniff.tui.commands import CHOOSING, PICKING, READING, SECTIONS, bindings, key_names
from fte_sniff.tui.i18n import ExplainedWord, _, choice_after, later, set_language
from fte_sniff.tui.painter import (
    BAR_EVENT,
    BAR_MARKED,
    BAR_RAISED,
    EVENT_SIGN,
    REVERSED,
    SHADES,
    Palette,
    Sign,
)
from fte_sniff.tui.panes.motors import OFFLINE
from fte_sniff.tui.panes.row import UNCERTAIN_ORDER
from fte_sniff.tui.panes.switcher import HEALTH
from fte_sniff.tui.status_bar import KeyLine


def list_line(text: str, right: str) -> Table:
    """A line of a list, with a text at its right end."""
    line = Table.grid(Column(ratio=1, no_wrap=True), Column(no_wrap=True), expand=True)
    line.add_row(Text(text), Text(f" {right}" if right else ""))
    return line


class LineList(OptionList, can_focus=False):
    """Lines of which one is under the cursor; a screen handles their keys.

    Textual's OptionList (8.2) marks it by colours, which are not seen where there are none.
    """

    def render_line(self, y: int) -> Strip:
        """A line; reversed under the cursor, as there may be no colours."""
        strip = super().render_line(y)
        under_cursor = self.scroll_offset.y + y == self.highlighted
        return strip.apply_style(REVERSED) if under_cursor else strip


class KeyScreen(ModalScreen[ScreenResultType]):
    """A page over the screen that handles each key before the next one acts.

    Keys that are typed ahead of its end go back to the app.
    """

    def __init__(self) -> None:
        super().__init__()
        self._done = False

    def on_key(self, event: events.Key) -> None:
        """Handle a key, or send it back."""
        event.prevent_default().stop()
        if self._done:
            self.app.post_message(events.Key(event.key, event.character))
        else:
            self._press(event)

    @abstractmethod
    def _press(self, event: events.Key) -> None:
        """Handle a key."""

    def _finish(self, result: ScreenResultType | None) -> None:
        self._done = True
        self.dismiss(result)


class ListScreen(KeyScreen[ScreenResultType]):
    """A list in a box, as tall as its lines where they fit."""

    def __init__(self) -> None:
        super().__init__()
        self._list = LineList(compact=True)

    def compose(self) -> ComposeResult:
        """The box and the line of keys."""
        with Vertical(id="picker"):
            yield self._list
        yield KeyLine()

    @abstractmethod
    def _choose(self, event: events.Key) -> None:
        """Handle a key that does not move the cursor."""

    @abstractmethod
    def _click(self, number: int) -> None:
        """Handle a click on a line."""

    @property
    def _cursor(self) -> int:
        return self._list.highlighted or 0

    def _show(
        self, title: str, subtitle: str, lines: Sequence[tuple[str, str]], cursor: int
    ) -> None:
        for box in self.query("#picker"):  # none where ctrl+c, typed ahead, has closed the page
            box.border_title, box.border_subtitle = Text(title), Text(subtitle)
        self._list.set_options(list_line(text, right) for text, right in lines)
        self._list.highlighted = cursor

    def _press(self, event: events.Key) -> None:
        page, all_lines = max(1, self._list.size.height - 1), self._list.option_count
        steps = {"up": -1, "down": 1, "pageup": -page, "pagedown": page}
        steps |= {"ctrl+p": -1, "ctrl+n": 1, "home": -all_lines, "end": all_lines}
        if event.key in steps:
            self._list.highlighted = self._cursor + steps[event.key]
        else:
            self._choose(event)

    @on(OptionList.OptionSelected)
    def _on_clicked(self, event: OptionList.OptionSelected) -> None:
        if not self._done:
            self._click(event.option_index)


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of a picker."""

    text: str
    """Printable."""
    value: str
    right: str = ""
    """Text at the right end, such as a key."""
    words: str = ""
    """Further words by which it is found."""


class Picker(ListScreen[str | None]):
    """A list from which one entry is picked; the result is its value, or None."""

    BINDINGS: ClassVar[list[BindingType]] = bindings(PICKING)

    def __init__(self, title: str, entries: Sequence[Entry], cursor: int = 0) -> None:
        super().__init__()
        self._heading, self._entries, self._first = title, entries, cursor
        self._typed = ""

    @property
    def shown(self) -> list[Entry]:
        """The entries that contain every typed word; the sooner the first one, the higher.

        A key that was typed comes first, and hits at the start of a word before others.
        """
        words = self._typed.lower().split()
        found = []
        for entry in self._entries:
            parts = [f" {part}".lower() for part in (entry.text, entry.right, entry.words)]
            if all(any(word in part for part in parts) for word in words):
                starts = [part.find(f" {words[0]}") for part in parts] if words else [0]
                at = min((start for start in starts if start >= 0), default=-1)
                is_key = self._typed in entry.right.split()
                found.append(((not is_key, at < 0, at), entry))
        return [entry for _, entry in sorted(found, key=lambda pair: pair[0])]

    def on_mount(self) -> None:
        """Draw the list."""
        self._type("", self._first)

    def _type(self, typed: str, cursor: int = 0) -> None:
        self._typed = typed
        lines = [(entry.text, entry.right) for entry in self.shown]
        hint = f"{typed}_" if typed else _("type to find, enter picks, esc goes back")
        self._show(self._heading, hint, lines or [(_("no match"), "")], cursor)

    def _choose(self, event: events.Key) -> None:
        match event.key:
            case "escape":
                self._finish(None)
            case "enter":
                self._click(self._cursor)
            case "backspace":
                self._type(self._typed[:-1], self._cursor)
            case "ctrl+u":
                self._type("", self._cursor)
            case _ if event.is_printable and event.character:
                self._type(self._typed + event.character)

    def _click(self, number: int) -> None:
        shown = self.shown
        self._finish(shown[number].value if shown else None)

    def on_click(self, event: events.Click) -> None:
        """Go back where the click was outside of the box."""
        box = self.query_one("#picker").region
        if not (self._done or box.contains(event.screen_x, event.screen_y)):
            self._finish(None)


KEYS = later("space: show, K J: move, r: as it was, enter, esc")


@dataclass(frozen=True, slots=True)
class ChosenColumns:
    """Result of the column chooser."""

    names: tuple[str, ...] | None
    """From left to right; None where the width of the window decides."""
    delta: Delta


class ColumnChooser(ListScreen[ChosenColumns | None]):
    """The columns in order; the result is None where it was cancelled."""

    BINDINGS: ClassVar[list[BindingType]] = bindings(CHOOSING)

    def __init__(self, view: TableView, cells: int) -> None:
        """A list of all columns, for a table of that many cells."""
        super().__init__()
        self._delta = view.delta
        shown = [column.name for column in layout_for(cells, view).columns]
        self._names = list(dict.fromkeys((*shown, *ORDER, VALUES)))
        self._shown = set(shown)

    def on_mount(self) -> None:
        """Draw the list."""
        self._draw(0)

    def _draw(self, cursor: int) -> None:
        self._show(_("columns"), _(KEYS), [(self._line(name), "") for name in self._names], cursor)

    def _line(self, name: str) -> str:
        if name == VALUES:
            meaning = _("all values of a row by their short names, as far as there is room")
        elif name == DELTA:
            meaning = _("{meaning} (d: another)", meaning=_(self._delta.meaning))
        else:
            meaning = _(COLUMN_BY_NAME[name].meaning)
        return f"[{'x' if name in self._shown else ' '}] {name:<10} {meaning}"

    def _choose(self, event: events.Key) -> None:
        cursor = self._cursor
        name, last = self._names[cursor], len(self._names) - 1
        match event.key:
            case "k":
                cursor -= 1
            case "j":
                cursor += 1
            case "K" | "shift+up" | "J" | "shift+down":
                by = -1 if event.key in ("K", "shift+up") else 1
                cursor = min(max(0, cursor + by), last)
                self._names.remove(name)
                self._names.insert(cursor, name)
            case "space" | "x":
                self._shown ^= {name}
            case "d":
                self._delta = choice_after(self._delta, list(Delta))
            case "r":
                self._finish(ChosenColumns(None, Delta.ROW))
            case "enter":
                self._finish(self._chosen())
            case "escape" | "q" | "C":
                self._finish(None)
        if not self._done:
            self._draw(cursor)

    def _click(self, number: int) -> None:
        self._shown ^= {self._names[number]}
        self._draw(number)

    def _chosen(self) -> ChosenColumns | None:
        names = tuple(name for name in self._names if name in self._shown)
        return ChosenColumns(names, self._delta) if names else None


EVENT_MEANING = later("a port event, or rows that are missing: not a row")
FAULTY_CELL = later("rows with a fault, few to many; the colour is that of the worst")
P99_MEANING = later("in the status line: 99 % of the answers of all motors came within this time")
OFFLINE_MEANING = later(
    "its bit is 0; the protocol does not say which bit is which motor, this is an assumption:"
    " {bits}"
)
RAISED = later("ERROR is not 00, or ONLINE is not 0F")

Pair: TypeAlias = tuple[str | Text, str]
"""A key or a name, with a style if it has one, and its meaning."""


FRAMING = (
    ("header", later("first byte: AA to the controller, 55 from it")),
    ("cmd", later("the kind of the frame")),
    ("reserve", later("bytes without a meaning")),
    ("tail", later("last byte: EE")),
)


def field_pairs(palette: Palette) -> Iterator[Pair]:
    """Each field in the style of its bytes, with its short names and its meaning."""
    for name, meaning in FRAMING:
        yield Text(name, palette.fields[name]), _(meaning)
    for field in VALUE_FIELDS:
        short = " ".join(short_names_of(field.name))
        meaning = _(COLUMN_BY_NAME[field.name].meaning)
        yield Text(f"{field.name} {short}", palette.fields[field.name]), meaning
    for age, look in enumerate((*palette.changed, palette.faint)):
        text = _("with d: differs from the frame before of the same kind and motor")
        if age:
            text = _("with d: frames since the change: {count}", count=age)
        if age == UNCHANGED:
            text = _("with d: did not change")
        yield Text("E8", look), text


def help_pairs(palette: Palette) -> Iterator[tuple[str, Sequence[Pair]]]:
    """Sections of the page: a heading and its pairs."""
    for heading, keys in SECTIONS:
        yield _(heading), [(key_names(key), _(key.tooltip)) for key in keys]
    signs = [(look.mark, status.value) for status, look in LOOKS.items()]
    signs.append((RAISED_MARK, _(RAISED)))
    signs.append((ORDER_MARK, _(UNCERTAIN_ORDER)))
    signs += [(sign, _(sign.meaning)) for sign in Sign if sign.meaning]
    signs.append((EVENT_SIGN, _(EVENT_MEANING)))
    yield _("Signs of rows"), signs
    in_bar = [
        (SHADES, _(FAULTY_CELL)),
        (BAR_RAISED, _(RAISED)),
        (Sign.UNANSWERED.value, _(Sign.UNANSWERED.meaning)),
        (BAR_MARKED, _(Sign.MARKED.meaning)),
    ]
    in_bar.append((BAR_EVENT, _(EVENT_MEANING)))
    yield _("Signs in the scroll bar"), in_bar
    bits = _(listed(online_bit_text(motor) for motor in MOTORS))
    of_motors = [(HEALTH[one], _(one.value)) for one in Health]
    of_motors += [("p99", _(P99_MEANING)), (_(OFFLINE), _(OFFLINE_MEANING, bits=bits))]
    yield _("Signs of motors"), of_motors
    yield _("Fields and their bytes"), list(field_pairs(palette))
    words: tuple[ExplainedWord, ...] = (*TimeStyle, *Delta)
    yield _("Times"), [(_(style), _(style.meaning)) for style in words]
    yield (
        _("Faults"),
        [
            (f"{LOOKS[status_of((fault,))].mark} {fault}", _(meaning))
            for fault, meaning in FAULT_MEANINGS.items()
        ],
    )
    columns = [(column.name, _(column.meaning)) for column in COLUMNS]
    yield _("Columns, and names in a filter"), columns
    yield _("Filters"), [(example, _(meaning)) for example, meaning in EXAMPLES]


LEAST_COLUMN: Final = 48
"""Cells of a column of the help, where there is more than one."""

COLUMN_GAP: Final = 3


def help_text(width: int, palette: Palette, find: str = "") -> Text:
    """The page in `width` cells, in as many columns as fit; only what has each word of `find`."""
    columns = max(1, (width + COLUMN_GAP) // (LEAST_COLUMN + COLUMN_GAP))
    each = (width + COLUMN_GAP) // columns - COLUMN_GAP
    words, sections = find.lower().split(), list[list[Text]]()
    for heading, pairs in help_pairs(palette):
        found = [
            pair
            for pair in pairs
            if all(word in f"{heading} {pair[0]} {pair[1]}".lower() for word in words)
        ]
        if found:
            left_width = min(max(cell_len(str(left)) for left, _right in found), each // 2)
            lines = [line for pair in found for line in _pair_lines(pair, left_width, each)]
            sections.append([Text(heading, style="bold"), *lines, Text()])
    if not sections:
        return Text(_("no match"))
    lines = []
    for cells in zip_longest(*_columns(sections, columns), fillvalue=Text()):
        line = Text()
        for number, cell in enumerate(cells):
            line.pad_right(number * (each + COLUMN_GAP) - line.cell_len)
            line.append_text(cell)
        lines.append(line)
    return Text("\n", no_wrap=True).join(lines)


def _columns(sections: Sequence[list[Text]], count: int) -> list[list[Text]]:
    """The sections in at most `count` columns, so that the longest column is short."""
    inner = range(1, len(sections))
    cuts = combinations(inner, min(count - 1, len(inner)))
    divided = (
        [[*chain(*sections[start:end])] for start, end in pairwise((0, *cut, len(sections)))]
        for cut in cuts
    )
    return min(divided, key=lambda columns: max(map(len, columns)))


def _pair_lines(pair: Pair, left_width: int, width: int) -> Iterator[Text]:
    """Side by side where the left side fits, else one below the other."""
    left, right = str(pair[0]), pair[1]
    style = pair[0].style if isinstance(pair[0], Text) else "bold"
    indent = " " * (left_width + 4)
    lines = wrap(right, max(8, width - len(indent)))
    if cell_len(left) <= left_width:
        first = lines.pop(0) if lines else ""
        space = " " * (left_width - cell_len(left))
        yield Text.assemble("  ", (left, style), space, "  ", first)
    else:
        for line in wrap(left, max(8, width - 2)):
            yield Text.assemble("  ", (line, style))
    yield from (Text(indent + line) for line in lines)


_SCROLLS: Final = {
    **dict.fromkeys(("down", "j"), "down"),
    **dict.fromkeys(("up", "k"), "up"),
    **dict.fromkeys(("pagedown", "ctrl+d", "space"), "page_down"),
    **dict.fromkeys(("pageup", "ctrl+u"), "page_up"),
    **dict.fromkeys(("home", "g"), "home"),
    **dict.fromkeys(("end", "G"), "end"),
}
"""By key, how it scrolls the help."""


class HelpPage(KeyScreen[None]):
    """The help page over the screen; `/` finds what has some words.

    Textual's HelpPanel lists the keys of the focused widget; this page explains the signs and the
    colours of bytes too, in the language of the screen.
    """

    BINDINGS: ClassVar[list[BindingType]] = bindings(READING)

    def __init__(self, palette: Palette) -> None:
        super().__init__()
        self._palette = palette
        self._typed, self._typing = "", False
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
        self._draw()

    def _draw(self) -> None:
        width = self._page.scrollable_content_region.width
        self._text.update(help_text(width, self._palette, self._typed))
        self.call_after_refresh(self._show_rest)

    def _show_rest(self) -> None:
        page = self._page
        below = round(page.max_scroll_y - page.scroll_y)
        more = _("{count} more lines: down, pgdn, end   esc: back", count=below)
        rest = more if below > 0 else _("esc: back")
        found = f"/{self._typed}_   " if self._typing else ""
        page.border_subtitle = Text(found + rest)

    def _press(self, event: events.Key) -> None:
        typed = event.character if event.is_printable and event.character else ""
        match event.key:
            case _ if self._typing and typed:
                self._find(self._typed + typed)
            case "backspace" if self._typing:
                self._find(self._typed[:-1])
            case "slash":
                self._typing = True
                self._find("")
            case "escape" | "enter" if self._typing:
                self._typing = False
                self._find(self._typed if event.key == "enter" else "")
            case "escape" if self._typed:
                self._find("")
            case "escape" | "question_mark" | "q" | "enter":
                self._finish(None)
            case key if key in _SCROLLS:
                scroll = getattr(self._page, f"scroll_{_SCROLLS[key]}")
                self.call_after_refresh(scroll, animate=False)

    def _find(self, typed: str) -> None:
        self._typed = typed
        self._page.scroll_home(animate=False)
        self._draw()


class PickerApp(App[str | None]):
    """A screen of its own for one picker, before another screen opens."""

    CSS_PATH = Path(__file__).with_name("screen.tcss")
    ENABLE_COMMAND_PALETTE = False

    def __init__(self, title: str, entries: Sequence[Entry]) -> None:
        super().__init__()
        self._heading, self._entries = title, entries

    def on_mount(self) -> None:
        """Open the picker."""
        self.push_screen(Picker(_(self._heading), self._entries), self.exit)


def pick(entries: Sequence[Entry], language: str) -> str | None:
    """Let the user pick one of recent recordings; None if nothing was picked."""
    set_language(language)
    return PickerApp(later("recordings in this folder, the latest first"), entries).run()
