"""Prompt fields at the bottom: a line that is checked while the user types, and the focus."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from threading import Thread
from typing import Any, ClassVar, Final

from rich.text import Text
from textual import events
from textual.app import App
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.widget import Widget
from textual.widgets import Input, Static

from fte_sniff.errors import FteSniffError
from fte_sniff.tui.commands import Where
from fte_sniff.tui.i18n import _, error_text, later
from fte_sniff.tui.options import StartOptions
from fte_sniff.tui.panes.switcher import PaneSwitcher
from fte_sniff.tui.panes.top import TopView
from fte_sniff.tui.status_bar import NoticeLine, WrappedText
from fte_sniff.tui.table import RowTable, TableHeader
from fte_sniff.tui.view_model import ViewModel


class Focus:
    """The focus of the screen: the table, the top view, or the line of the open field.

    Exactly one of them can have the focus. So no click, no Tab, and no request that Textual handles
    later can move it, and a key that is typed ahead goes where the key before it led.
    """

    def __init__(self, app: App[None], table: RowTable, header: TableHeader, top: TopView) -> None:
        """The table has the focus once `start` is called."""
        self._app, self._table, self._header, self._top = app, table, header, top
        self._field: PromptField | None = None
        self._holder: Widget = table
        table.can_focus, top.can_focus = True, False

    def start(self) -> None:
        """Give the focus to its owner, once that is on the screen."""
        self._give()

    @property
    def owner(self) -> Widget:
        """The widget that receives the keys, when no page is open."""
        if self._field is not None:
            return self._field.line
        return self._top if self._top.display else self._table

    def show_top(self, shown: bool) -> None:
        """Show the top view in place of the table, or the table again."""
        self._top.display = shown
        self._header.display = self._table.display = not shown
        self._give()

    def open(self, field: PromptField) -> None:
        """Let the user type in a field; any other one is left."""
        if self._field is not None and self._field is not field:
            self._field.close()
        self._field = field
        self._give()

    def close(self, field: PromptField) -> None:
        """Return the focus from a field, if it is the open one."""
        if field is self._field:
            self._field = None
            self._give()

    def has_open(self, field: PromptField) -> bool:
        """Whether the user is typing in this field."""
        return field is self._field

    def clicked(self, widget: Widget | None) -> None:
        """Leave the open field where the table, its header or the top view was clicked."""
        views = (self._table, self._header, self._top)
        clicked = [] if widget is None else widget.ancestors_with_self
        if any(view in clicked for view in views):
            self.leave()

    def leave(self) -> None:
        """Leave the open field, if there is one."""
        if self._field is not None:
            self._field.close()

    def allows(self, where: Where) -> bool:
        """Whether such an action may act now: an open field and a page have their own keys."""
        is_page_open = len(self._app.screen_stack) > 1
        return where is Where.ANYWHERE or not (is_page_open or self._field)

    def prepare(self, where: Where) -> None:
        """Bring the table back for an action on rows that is allowed."""
        if where is Where.ROWS and self._top.display:
            self.show_top(False)

    def _give(self) -> None:
        """Move the focus at once and not by a message: the next key may be typed already."""
        self._holder.can_focus = False
        self._holder = self.owner
        self._holder.can_focus = True
        self._holder.screen.set_focus(self._holder)


class History:
    """Earlier lines, the newest last, and the line that is being typed."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._current = 0
        self._typed = ""

    def append(self, line: str) -> None:
        """Keep a line; a known one moves to the end."""
        if line in self.lines:
            self.lines.remove(line)
        if line:
            self.lines.append(line)
        self._current = len(self.lines)

    @property
    def is_older(self) -> bool:
        """Whether an earlier line is shown."""
        return self._current < len(self.lines)

    def newest_first(self) -> Iterator[str]:
        """All lines, the newest first."""
        return reversed(self.lines)

    def go(self, by: int, typed: str) -> str:
        """The line `by` steps newer (or older, negative) than the current one."""
        if self._current == len(self.lines):
            self._typed = typed
        self._current = min(max(0, self._current + by), len(self.lines))
        return self._typed if self._current == len(self.lines) else self.lines[self._current]


@cache
def _actions(kind: type[Widget]) -> Mapping[str, str]:
    """Actions of the keys of a widget; a class overrides those of its parents."""
    tables = (vars(parent).get("BINDINGS", ()) for parent in reversed(kind.__mro__))
    bindings = [one for table in tables for one in table if isinstance(one, Binding)]
    return {key: one.action for one in bindings for key in one.key.split(",")}


class PromptLine(Input):
    """The input of a field, with earlier lines on the arrow keys, which Textual's Input lacks."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "older(-1)", later("Older"), show=False),
        Binding("down", "older(1)", later("Newer"), show=False),
        Binding("tab,shift+tab", "complete", later("Complete"), show=False),
        Binding("enter", "submit", later("Apply"), key_display="enter"),
        Binding("escape", "leave", later("Back"), key_display="esc"),
    ]

    def __init__(self, field: PromptField) -> None:
        super().__init__(compact=True, select_on_focus=False)
        self.can_focus = False
        self.history = History()
        self._field = field

    async def on_key(self, event: events.Key) -> None:
        """Let each key act before the next one, also when several are typed ahead.

        By default, a key without text acts only after it has bubbled up to the app, and later
        text overtakes it. Keys after the line was submitted go back to the app.
        """
        if not self._field.is_open:
            event.prevent_default().stop()
            self.app.post_message(events.Key(event.key, event.character))
        elif not event.is_printable:
            for node in (self, self._field):
                action = _actions(type(node)).get(event.key)
                if action is not None and await self.app.run_action(action, node):
                    event.prevent_default().stop()
                    return

    def action_older(self, by: int) -> None:
        """Move in the list of candidates, or show another line of the history."""
        if self._field.move(by) and not self.history.is_older:
            return
        self.value = self.history.go(by, self.value)
        self.cursor_position = len(self.value)

    def action_complete(self) -> None:
        """Accept the first candidate; the focus stays here in any case."""
        if not self._field.pick(typed=True):
            self.value = self.value or self._field.default
            self.cursor_position = len(self.value)

    async def action_submit(self) -> None:
        """Insert the chosen candidate, or submit the line."""
        if not self._field.pick():
            self._field.submit(self.value.strip())

    def action_leave(self) -> None:
        """Leave the list of candidates, or close the field."""
        if not self._field.leave_list():
            self._field.close()

    def on_paste(self, event: events.Paste) -> None:
        """Insert all lines as one."""
        event.prevent_default().stop()
        self.replace(" ".join(event.text.split()), *self.selection)


@dataclass(frozen=True, slots=True)
class Parts:
    """The parts of the screen that fields and playback change."""

    options: StartOptions
    model: ViewModel
    table: RowTable
    panes: PaneSwitcher
    focus: Focus
    notice: NoticeLine


@dataclass(frozen=True, slots=True)
class Prompt:
    """What a field asks for."""

    label: str
    """In English, since errors begin with it."""
    example: str
    """A line that is shown while there is none."""
    hint: str
    """What the keys do, shown while the line is valid."""


class PromptField(Vertical):
    """A labelled input that is checked while the user types; Enter shows a mistake.

    A subclass defines what it asks for, and what it does with a valid line. The input and what
    is around it are mounted when the field is opened for the first time, since most never are.
    """

    PROMPT: ClassVar[Prompt]

    def __init__(self, parts: Parts) -> None:
        """A closed field."""
        super().__init__()
        self._options, self._model, self._table = parts.options, parts.model, parts.table
        self._panes, self._focus, self._notice = parts.panes, parts.focus, parts.notice
        self._store = parts.model.store
        self.line = PromptLine(self)
        self._asked = Horizontal(classes="asked")
        self._verdict = WrappedText(classes="verdict")
        self._label = Static(self._label_text, classes="label")
        self.default = ""
        """The line that an empty one stands for."""
        self.current = ""
        """The line in effect; shown while the field is closed."""
        self._refused: str | None = None
        """The line that was submitted with a mistake."""
        self.display = False

    def parse(self, line: str) -> object:
        """Parse a line; raises FteSniffError with the reason where it is invalid."""
        return line

    def accept(self, line: str) -> None:
        """Act on a valid line, before the next key acts."""

    @property
    def _label_text(self) -> Text:
        return Text(f" {_(self.PROMPT.label)} ")

    def translate(self) -> None:
        """Show the label in the current language."""
        self._label.update(self._label_text)

    def fill(self) -> None:
        """Mount the label, the input and, below, the verdict, at the first use."""
        if self.line.parent is None and self.is_attached:
            self.mount(self._asked, self._verdict)
            # Not as its children: they would be mounted too late for the focus.
            self._asked.mount(self._label, self.line)

    @property
    def is_open(self) -> bool:
        """Whether the user is typing a line."""
        return self._focus.has_open(self)

    def action_ask(self) -> None:
        """Open the field."""
        self.open()

    def open(self, line: str | None = None) -> None:
        """Show the field with a line, or that in effect; its input has the focus."""
        if not self.is_attached:
            return  # a key that was typed ahead of the end
        self.fill()
        self.line.placeholder = self.default or _(self.PROMPT.example)
        self.display = True
        self.set_class(True, "-asking")
        self.line.value = self.current if line is None else line
        self.line.cursor_position = len(self.line.value)
        self._refused = None
        self._judge(self.line.value)
        self._focus.open(self)

    def close(self) -> None:
        """Return the focus, and show the line in effect; without one, hide the field."""
        self._focus.close(self)
        self.set_class(False, "-asking")
        self.line.value = self.current
        self.display = bool(self.current)
        if self.display:
            self.fill()

    def set_current(self, line: str) -> None:
        """Set the line in effect; the previous one is in the history."""
        self.line.history.append(self.current)
        self.line.history.append(line)
        self.current = line
        self.close()

    def on_click(self) -> None:
        """Open the field."""
        if not self.is_open:
            self.open()

    def on_input_changed(self, event: Input.Changed) -> None:
        """Check the line; it may not be finished, so a mistake is not shown yet.

        Keys that are typed ahead submit the line before its last change is reported.
        """
        event.stop()
        if self.is_open:
            self._judge(event.value, finished=event.value == self._refused)

    def submit(self, line: str) -> None:
        """Forward a valid line and close; an invalid one can be corrected."""
        line = line or self.default
        self._refused = self.line.value
        if self._judge(line):
            self.line.history.append(line)
            self.accept(line)
            self.close()

    def move(self, by: int) -> bool:
        """Move in the candidates; False where there are none."""
        return False

    def pick(self, *, typed: bool = False) -> bool:
        """Insert a candidate; False where none is chosen."""
        return False

    def leave_list(self) -> bool:
        """Leave the candidates; False where the cursor is not in them."""
        return False

    def _judge(self, line: str, *, finished: bool = True) -> bool:
        """Check a line and show the verdict; an empty line is valid."""
        try:
            self._on_valid(self.parse(line) if line.strip() else None)
        except FteSniffError as error:
            self._on_valid(None)
            text = error_text(error).removeprefix(f"{self.PROMPT.label}: ")
            if finished:
                self._show_verdict("✗", text, bad=True)
            else:
                self._show_verdict("…", _(self.PROMPT.hint), bad=False)
            return False
        self._show_verdict("✓" if line.strip() else " ", _(self.PROMPT.hint), bad=False)
        return True

    def _on_valid(self, parsed: Any) -> None:
        """Handle what the check of a valid line returned; None for an invalid or empty one."""

    def _show_verdict(self, sign: str, text: str, bad: bool) -> None:
        self.set_class(bad, "-bad")
        self._verdict.show(f" {sign}", text)


_FILTER_MODULES: Final = (
    "fte_sniff.analysis.filter.row_filter",
    "fte_sniff.analysis.filter.completion",
)
"""Modules that import polars, which takes longer than to show the first rows of a file."""


def preload_filter() -> None:
    """Start to import the modules of filter and search in a thread."""

    def load() -> None:
        for name in _FILTER_MODULES:
            import_module(name)

    Thread(target=load, name="filter import", daemon=True).start()
