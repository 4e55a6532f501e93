"""Prompt fields at the bottom: filter, search and save, with history and completion."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from threading import Thread
from time import monotonic
from typing import TYPE_CHECKING, Any, ClassVar, Final, TypeAlias

from rich.cells import cell_len
from rich.text import Text
from textual import events, on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.timer import Timer
from textual.widget import Widget
from textual.widgets import Input, OptionList, Static

from fte_sniff.analysis.row_store import BLOCK_ROWS, RowStore
from fte_sniff.analysis.search import MatchCounter, ValueCounter
from fte_sniff.errors import FilterError, FteSniffError, TranslatableText
from fte_sniff.formats.writers import FORMAT_BY_SUFFIX
from fte_sniff.protocol import COLUMN_BY_NAME
from fte_sniff.session.save import DEFAULT_NAME
from fte_sniff.tui.cells import first_fitting
from fte_sniff.tui.focus import Focus
from fte_sniff.tui.i18n import _, error_text, later
from fte_sniff.tui.modals import LineList, list_line
from fte_sniff.tui.status_bar import WrappedText
from fte_sniff.tui.view_model import STEP_PAUSE_S

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter


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


Check: TypeAlias = Callable[[str], object]
"""Parses a line; raises an FteSniffError with the reason where it is invalid."""

OnSubmit: TypeAlias = Callable[[str], None]
"""Receives a valid line, before the next key acts."""


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
class Prompt:
    """What a field asks for."""

    label: str
    """In English, since errors begin with it."""
    example: str
    """A line that is shown while there is none."""
    hint: str
    """What the keys do, shown while the line is valid."""


class PromptField(Vertical):
    """A labelled input that is checked while the user types; Enter shows a mistake."""

    def __init__(self, focus: Focus, prompt: Prompt, check: Check, on_submit: OnSubmit) -> None:
        """A closed field: `check` parses a line, `on_submit` receives a valid one."""
        super().__init__()
        self._prompt, self._check, self._on_submit = prompt, check, on_submit
        self._focus = focus
        self.line = PromptLine(self)
        self._verdict = WrappedText(classes="verdict")
        self._label = Static(self._label_text, classes="label")
        self.default = ""
        """The line that an empty one stands for."""
        self.current = ""
        """The line in effect; shown while the field is closed."""
        self._refused: str | None = None
        """The line that was submitted with a mistake."""
        self.display = False

    @property
    def _label_text(self) -> Text:
        return Text(f" {_(self._prompt.label)} ")

    def translate(self) -> None:
        """Show the label in the current language."""
        self._label.update(self._label_text)

    def compose(self) -> ComposeResult:
        """The label, the input and, below, the verdict."""
        with Horizontal(classes="asked"):
            yield self._label
            yield self.line
        yield self._verdict

    @property
    def is_open(self) -> bool:
        """Whether the user is typing a line."""
        return self._focus.has_open(self)

    def open(self, line: str | None = None) -> None:
        """Show the field with a line, or that in effect; its input has the focus."""
        self.line.placeholder = self.default or _(self._prompt.example)
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
            self._on_submit(line)
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
            self._on_valid(self._check(line) if line.strip() else None)
        except FteSniffError as error:
            self._on_valid(None)
            text = error_text(error).removeprefix(f"{self._prompt.label}: ")
            if finished:
                self._show_verdict("✗", text, bad=True)
            else:
                self._show_verdict("…", _(self._prompt.hint), bad=False)
            return False
        self._show_verdict("✓" if line.strip() else " ", _(self._prompt.hint), bad=False)
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


def parse_filter(line: str) -> RowFilter:
    """Parse a filter; raises FilterError if the line is not a filter."""
    from fte_sniff.analysis.filter.row_filter import RowFilter

    return RowFilter.parse(line)


@dataclass(frozen=True, slots=True)
class Candidate:
    """One line of the dropdown."""

    text: str
    """What is inserted, or the whole line that replaces the typed one."""
    right: str = ""
    """What it is: a meaning, or the number of rows."""
    start: int = 0
    """Where the text that it replaces starts; that ends at the cursor."""


class Dropdown(LineList):
    """Candidates above the input.

    `textual-autocomplete` opens below the cursor, so at the bottom of the screen it covers the
    line that is typed, and it takes Up and Enter before the user has entered the list.
    """

    def __init__(self) -> None:
        super().__init__(compact=True)
        self.candidates: Sequence[Candidate] = ()
        self.display = False

    def show(self, candidates: Sequence[Candidate], lines: int, width: int, left: int) -> None:
        """Show candidates in at most `lines` lines and `width` cells, from a column on."""
        self.display = bool(candidates) and lines > 0
        if candidates == self.candidates and self.option_count:
            return
        self.candidates = candidates
        names = max((cell_len(one.text) for one in candidates), default=0)
        rights = max((cell_len(one.right) for one in candidates), default=0)
        cells = min(width, names + rights + 4 + (len(candidates) > lines))
        self.styles.width = cells
        self.styles.height = min(lines, len(candidates))
        self.styles.offset = (max(0, min(left, width - cells)), -min(lines, len(candidates)))
        # Without colours there is no background that separates it from the rows.
        side = "│" if self.app.no_color else " "
        self.set_options(list_line(side + one.text, one.right + side) for one in candidates)
        self.highlighted = None

    @property
    def chosen(self) -> Candidate | None:
        """The candidate that the user has moved to."""
        return None if self.highlighted is None else self.candidates[self.highlighted]

    def move(self, by: int) -> bool:
        """Move by lines; up from the first leaves the list. False if the key is not for it."""
        here = self.highlighted
        if not self.display or (here is None and by < 0):
            return False
        place = 0 if here is None else here + by
        self.highlighted = None if place < 0 else min(place, len(self.candidates) - 1)
        return True


MOST_CANDIDATES: Final = 200
"""Lines of the dropdown; more are found by typing."""

MOST_EARLIER: Final = 5

UNCOUNTED: Final = ("time", "offset", "raw")
"""Columns whose values seldom repeat; they are not suggested."""

STEP_S: Final = 0.01
"""How long counting may block the screen before keys come first."""


FILTER: Final = Prompt(
    later("filter"),
    "motor = 1 AND rpm > 500",
    later("enter applies, empty shows all; down: list, up: earlier, ^s: save by name"),
)


_COUNT_PADDING: Final = 2
"""Cells around the count."""


def _count_forms(shown: int, every: int, pending: int = 0) -> tuple[str, str]:
    """How many of all rows pass a filter, in words and short."""
    numbers = f"{shown:,}/{every:,}"
    if pending:
        rows = _(
            "{shown:,} of {all:,} rows, {pending:,} to go", shown=shown, all=every, pending=pending
        )
        return rows, f"{numbers} …"
    return _("{shown:,} of {all:,} rows", shown=shown, all=every), numbers


class FilterField(PromptField):
    """Asks for a filter; shows the current one with the number of rows that pass."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("ctrl+s", "save", later("Save"), key_display="^s"),
    ]

    def __init__(
        self,
        focus: Focus,
        store: RowStore,
        current: str,
        saved: Mapping[str, str],
        cursor_ns: Callable[[], int | None],
        on_submit: OnSubmit,
        on_save: OnSubmit,
    ) -> None:
        """A field over the rows of a store, with the filter in effect.

        It suggests `saved` filters, by name, and the time that `cursor_ns` returns. `on_save`
        receives a filter to be saved by name.
        """
        super().__init__(focus, FILTER, parse_filter, on_submit)
        self._store, self._saved, self._cursor_ns, self._on_save = store, saved, cursor_ns, on_save
        self._count = Static(classes="shown")
        self._count_text = ""
        self._dropdown = Dropdown()
        self._matching: MatchCounter | None = None
        self._values: dict[str, ValueCounter] = {}
        self._column: str | None = None
        self._timer: Timer | None = None
        self.current = current

    def compose(self) -> ComposeResult:
        """The dropdown over the line."""
        yield self._dropdown
        yield from super().compose()

    def on_mount(self) -> None:
        """Add the count after the line."""
        self.query_one(".asked").mount(self._count)
        self.close()

    def open(self, line: str | None = None) -> None:
        """Let the user type."""
        preload_filter()
        super().open(line)
        # The line has no place on the screen before the next layout.
        self.call_after_refresh(self._suggest)

    def close(self) -> None:
        """Return the focus and stop counting."""
        super().close()
        self._dropdown.display = False
        self._matching, self._values, self._column = None, {}, None

    def set_count(self, count: tuple[int, int, int] | None) -> None:
        """Show how many rows pass the filter in effect, of all, and how many are to go.

        Not while one is typed.
        """
        if not self.is_open:
            self._show_count([""] if count is None else _count_forms(*count))

    def _show_count(self, forms: Sequence[str]) -> None:
        """Show the number of rows in the first of these forms that leaves the line uncut."""
        around = cell_len(f"{self._label_text} {self.line.value} ") + _COUNT_PADDING
        text = first_fitting(forms, self.size.width - around)
        if text != self._count_text:
            # The count changes all the time: a new layout only where its width changes.
            layout = cell_len(text) != cell_len(self._count_text)
            self._count_text = text
            self._count.update(Text(text), layout=layout)

    def action_save(self) -> None:
        """Apply a valid filter, and ask for its name."""
        line = self.line.value.strip()
        if line and self._judge(line):
            self.submit(line)
            self._on_save(line)

    def on_input_changed(self, event: Input.Changed) -> None:
        """Check the line, count its rows, and suggest how it goes on."""
        super().on_input_changed(event)
        self._suggest()

    def _on_valid(self, parsed: RowFilter | None) -> None:
        """Count the rows that pass; the steps give way to keys."""
        self._matching = None
        self._show_count([""])
        if self.is_open and parsed is not None:
            self._matching = MatchCounter(self._store, parsed.matches, BLOCK_ROWS)
            self._continue()

    def _continue(self) -> None:
        if self._timer is None:
            self._timer = self.set_timer(STEP_PAUSE_S, self._step)

    def _step(self) -> None:
        """Count for a moment: first the values that are suggested, then the matching rows."""
        self._timer = None
        until = monotonic() + STEP_S
        values = self._values.get(self._column or "")
        changed = False
        # At least one step each time: the machine may be busy with something else for long.
        while running := values is not None and values.step():
            changed = True
            if monotonic() >= until:
                break
        if changed:
            self._suggest()
        try:
            while self._matching is not None and not running:
                if not self._matching.step():
                    self._show_matching(self._matching)
                    break
                running = monotonic() >= until
        except FilterError:
            self._matching = None
        if running:
            self._continue()

    def _show_matching(self, counter: MatchCounter) -> None:
        total = counter.position(-1).total
        self._show_count(_count_forms(total, len(self._store)))

    def _observed(self, column: str) -> Mapping[str, int]:
        """The values of a column that are counted so far."""
        if column in UNCOUNTED:
            return {}
        self._column = column
        if column not in self._values:
            self._values[column] = ValueCounter(self._store, column)
        self._continue()
        return self._values[column].counts

    def _suggest(self) -> None:
        line = self.line
        if not self.is_open:
            return
        candidates = self._candidates(line.value, line.cursor_position)
        start = candidates[0].start if candidates else 0
        left = line.region.x - self.region.x + cell_len(line.value[:start]) - line.scroll_offset.x
        lines = min(8, self.app.size.height // 3)
        self._dropdown.show(candidates[:MOST_CANDIDATES], lines, self.app.size.width, left - 1)

    def _candidates(self, line: str, cursor: int) -> list[Candidate]:
        from fte_sniff.analysis.filter.completion import completions

        self._column = None
        typed = line.strip().lower()
        saved = [
            Candidate(text, name)
            for name, text in self._saved.items()
            if name.lower().startswith(typed) and text != line
        ]
        earlier = [
            Candidate(text, _("earlier"))
            for text in self.line.history.newest_first()
            if typed in text.lower() and text not in (line, *self._saved.values())
        ][:MOST_EARLIER]
        found = completions(line, cursor, self._cursor_ns(), self._observed)
        here = [
            Candidate(choice, self._meaning(choice, found.counts), found.start)
            for choice in found.choices
        ]
        return [*here, *saved, *earlier] if typed else [*saved, *earlier, *here]

    @staticmethod
    def _meaning(choice: str, counts: Mapping[str, int]) -> str:
        if choice in counts:
            return _("{count:,} rows", count=counts[choice])
        column = COLUMN_BY_NAME.get(choice)
        return "" if column is None else _(column.meaning)

    def move(self, by: int) -> bool:
        """Move in the dropdown."""
        return self._dropdown.move(by)

    def pick(self, *, typed: bool = False) -> bool:
        """Insert the candidate under the cursor, or with `typed`, that of the typed word."""
        chosen = self._dropdown.chosen
        cursor, value = self.line.cursor_position, self.line.value
        if chosen is None and typed and self._dropdown.display:
            first = self._dropdown.candidates[0]
            chosen = first if value[first.start : cursor].strip() else None
        if chosen is None:
            return False
        before = value[: chosen.start] + chosen.text + " "
        self.line.value = before + (value[cursor:].lstrip() if chosen.start else "")
        self.line.cursor_position = len(before)
        # At once: the next key may be typed already, and is for the line.
        self._dropdown.highlighted = None
        return True

    def leave_list(self) -> bool:
        """Leave the dropdown; returns whether the cursor was in it."""
        was_in = self._dropdown.highlighted is not None
        self._dropdown.highlighted = None
        return was_in

    @on(OptionList.OptionSelected)
    def _on_clicked(self, event: OptionList.OptionSelected) -> None:
        event.stop()
        self._dropdown.highlighted = event.option_index
        self.pick()


FILTER_NAME: Final = Prompt(
    later("save the filter as"),
    "stalled",
    later("enter saves it for the list of f, esc goes back"),
)
SEARCH: Final = Prompt(
    later("search"),
    "rpm=1000, AA 01, hex:AA ?? 03",
    later("enter finds the next row from here on, then n and N; up: earlier ones"),
)
GOTO: Final = Prompt(
    later("go to"),
    "1200, 50%, 12:00:03.5, +2s, -50ms, @8190",
    later("enter goes there, esc stays here"),
)
NOTE: Final = Prompt(
    later("note"),
    later("the wheel was blocked by hand"),
    later("enter keeps it beside the recording, an empty one removes it, esc goes back"),
)
ROWS_FILE: Final = Prompt(
    later("save to"),
    DEFAULT_NAME,
    TranslatableText(
        "enter saves, esc goes back; the extension selects the format: {forms}",
        forms=" ".join(FORMAT_BY_SUFFIX),
    ),
)
