"""Prompt fields at the bottom: filter, search and save, with history and completion."""

from __future__ import annotations

from collections.abc import Callable, Collection
from importlib import import_module
from threading import Thread
from typing import TYPE_CHECKING, ClassVar, Final, TypeAlias

from rich.cells import cell_len
from rich.text import Text
from textual import events
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.suggester import Suggester
from textual.widget import Widget
from textual.widgets import Input, Static

from fte_sniff.errors import FteSniffError
from fte_sniff.formats.writers import FORMAT_BY_SUFFIX
from fte_sniff.session.save import DEFAULT_NAME, PICTURE_SUFFIXES, free_path
from fte_sniff.tui.i18n import _, error_text, later
from fte_sniff.tui.keys import translate_keys
from fte_sniff.tui.notices import WrappedText

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter


class History:
    """Earlier lines, the newest last, and the line that is being typed."""

    def __init__(self) -> None:
        self._lines: list[str] = []
        self._current = 0
        self._typed = ""

    def append(self, line: str) -> None:
        """Keep a line; a known one moves to the end."""
        if line in self._lines:
            self._lines.remove(line)
        if line:
            self._lines.append(line)
        self._current = len(self._lines)

    def go(self, by: int, typed: str) -> str:
        """The line `by` steps newer (or older, negative) than the current one."""
        if self._current == len(self._lines):
            self._typed = typed
        self._current = min(max(0, self._current + by), len(self._lines))
        return self._typed if self._current == len(self._lines) else self._lines[self._current]


Check: TypeAlias = Callable[[str], object]
"""Parses a line; raises an FteSniffError with the reason where it is invalid."""

OnSubmit: TypeAlias = Callable[[str], None]
"""Receives a valid line, before the next key acts."""

LOW = 16
"""Lines of the terminal below which the verdict has only one line."""


class PromptLine(Input):
    """The input of a field, with earlier lines on the arrow keys."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "older(-1)", later("Older"), show=False),
        Binding("down", "older(1)", later("Newer"), show=False),
        Binding("tab,shift+tab", "complete", later("Complete"), show=False),
        Binding("enter", "submit", later("Apply"), key_display="enter"),
        Binding("escape", "leave", later("Back"), key_display="esc"),
    ]

    def __init__(self, field: PromptField, placeholder: str, suggester: Suggester | None) -> None:
        super().__init__(placeholder=placeholder, compact=True, suggester=suggester)
        translate_keys(self)
        self.history = History()
        self.can_focus = False
        self.is_open = False
        """Whether keys are typed into it."""
        self._field = field

    async def on_key(self, event: events.Key) -> None:
        """Let each key act before the next one, also when several are typed ahead.

        By default, a key that is no text acts only after it has bubbled up to the app, and later
        text overtakes it. Keys after the line was submitted go back to the app.
        """
        if not self.is_open:
            event.prevent_default().stop()
            self.app.post_message(events.Key(event.key, event.character))
        elif not event.is_printable:
            for binding in self._bindings.key_to_bindings.get(event.key, ()):
                if await self.app.run_action(binding.action, self):
                    event.prevent_default().stop()
                    break

    def action_older(self, by: int) -> None:
        """Show another line of the history."""
        self.value = self.history.go(by, self.value)
        self.cursor_position = len(self.value)

    def action_complete(self) -> None:
        """Accept the suggestion; the focus stays here in any case."""
        self.value = self.value or self._field.default
        self.cursor_position = len(self.value)
        if self._suggestion:
            self.action_cursor_right()

    def on_blur(self) -> None:
        """Leave where another widget was clicked, but not where the terminal lost the focus."""
        if self.is_open and self.app.app_focus:
            self._field.close()

    async def action_submit(self) -> None:
        """Submit the line."""
        self._field.submit(self.value.strip())

    def action_leave(self) -> None:
        """Close the field."""
        self._field.close()


class PromptField(Vertical):
    """A labelled input that is checked while the user types."""

    LABEL: ClassVar[str]
    """What is asked for; in English, since errors begin with it."""
    EXAMPLE: ClassVar[str]
    """A line that is shown while there is none."""
    HINT: ClassVar[str]
    """What the keys do, shown while the line is valid."""

    def __init__(
        self, check: Check, on_submit: OnSubmit, suggester: Suggester | None = None
    ) -> None:
        """A closed field: `check` parses a line, `on_submit` receives a valid one."""
        super().__init__()
        self._check, self._on_submit = check, on_submit
        self._line = PromptLine(self, self.EXAMPLE, suggester)
        self._focused_before: Widget | None = None
        self._verdict = WrappedText(classes="verdict")
        self._label = Static(self._label_text, classes="label")
        self.current = ""
        """The line in effect; shown while the field is closed."""
        self.display = False

    @property
    def _label_text(self) -> Text:
        return Text(f" {_(self.LABEL)} ")

    def translate(self) -> None:
        """Show the label in the current language."""
        self._label.update(self._label_text)

    def compose(self) -> ComposeResult:
        """The label, the input and, below, the verdict."""
        with Horizontal(classes="asked"):
            yield self._label
            yield self._line
        yield self._verdict

    @property
    def is_open(self) -> bool:
        """Whether the user is typing a line."""
        return self._line.is_open

    def open(self) -> None:
        """Show the field and focus its input."""
        self.display = True
        self.set_class(self.app.size.height < LOW, "-low")
        self.set_class(True, "-asking")
        self._line.value = self.current
        self._judge(self.current)
        self._focused_before = self.screen.focused
        self._line.is_open = self._line.can_focus = True
        # At once and not by a message, since the next key may have been typed already.
        self.screen.set_focus(self._line)

    def close(self) -> None:
        """Return the focus, and show the line in effect; without one, hide the field."""
        if self.is_open:
            self._line.is_open = self._line.can_focus = False
            self.screen.set_focus(self._focused_before)
        self.set_class(False, "-asking")
        self._line.value = self.current
        self.display = bool(self.current)

    def set_current(self, line: str) -> None:
        """Set the line in effect; the previous one is in the history."""
        self._line.history.append(self.current)
        self._line.history.append(line)
        self.current = line
        self.close()

    def on_click(self) -> None:
        """Open the field."""
        if not self.is_open:
            self.open()

    def on_input_changed(self, event: Input.Changed) -> None:
        """Check the line."""
        event.stop()
        self._judge(event.value)

    @property
    def hint(self) -> str:
        """The translated hint."""
        return _(self.HINT)

    @property
    def default(self) -> str:
        """The line that an empty one stands for."""
        return ""

    def submit(self, line: str) -> None:
        """Forward a valid line and close; an invalid one can be corrected."""
        line = line or self.default
        if self._judge(line):
            self._line.history.append(line)
            self._on_submit(line)
            self.close()

    def _judge(self, line: str) -> bool:
        """Check a line and show the verdict; an empty line is valid."""
        try:
            if line.strip():
                self._check(line)
        except FteSniffError as error:
            self._show_verdict("✗", error_text(error).removeprefix(f"{self.LABEL}: "), bad=True)
            return False
        self._show_verdict("✓" if line.strip() else " ", self.hint, bad=False)
        return True

    def _show_verdict(self, sign: str, text: str, bad: bool) -> None:
        self.set_class(bad, "-bad")
        self._verdict.show(f" {sign}", text)


_FILTER_MODULES: Final = (
    "fte_sniff.analysis.filter.row_filter",
    "fte_sniff.analysis.filter.completion",
    "fte_sniff.analysis.search_frame",
)
"""Modules that import polars, which takes longer than to show the first rows of a file."""


def preload_filter() -> None:
    """Start to import the modules of filter and search in a thread."""

    def load() -> None:
        for name in _FILTER_MODULES:
            import_module(name)

    Thread(target=load, name="filter import", daemon=True).start()


def parse_filter(line: str) -> RowFilter:
    """Parse a filter; raises FilterError if the line is no filter."""
    from fte_sniff.analysis.filter.row_filter import RowFilter

    return RowFilter.parse(line)


def completed(line: str, t_ns: int | None = None) -> str | None:
    """The line with its last word completed, or None; `t_ns` is suggested for a time."""
    if not line.strip():
        return None
    from fte_sniff.analysis.filter.completion import completions

    found = completions(line, t_ns=t_ns)
    lines = (line[: found.start] + choice for choice in found.choices)
    return next((whole for whole in lines if whole.lower().startswith(line.lower())), None)


class FilterSuggester(Suggester):
    """Completes names, operators and values of a filter."""

    def __init__(self, cursor_ns: Callable[[], int | None]) -> None:
        super().__init__(use_cache=False, case_sensitive=True)
        self._cursor_ns = cursor_ns

    async def get_suggestion(self, value: str) -> str | None:
        """The whole line with the completion."""
        return completed(value, self._cursor_ns())


class FilterField(PromptField):
    """Asks for a filter; shows the current one with the number of rows that pass."""

    LABEL = later("filter")
    EXAMPLE = "motor = 1 AND rpm > 500"
    HINT = later("enter applies, empty shows all; tab completes, up: earlier ones; esc: back")

    def __init__(
        self, current: str, on_submit: OnSubmit, cursor_ns: Callable[[], int | None]
    ) -> None:
        """A field with the filter in effect; `cursor_ns` returns the time that is suggested."""
        super().__init__(parse_filter, on_submit, FilterSuggester(cursor_ns))
        self._count = Static(classes="shown")
        self._count_text = ""
        self.current = current

    def on_mount(self) -> None:
        """Add the count after the line."""
        self.query_one(".asked").mount(self._count)
        self.close()

    def open(self) -> None:
        """Let the user type."""
        preload_filter()
        super().open()

    def set_count(self, text: str) -> None:
        """Show the number of rows that pass the filter in effect; not while one is typed."""
        text = "" if self.is_open else text
        if text != self._count_text:
            # The count changes all the time: a new layout only where its width changes.
            layout = cell_len(text) != cell_len(self._count_text)
            self._count_text = text
            self._count.update(Text(text), layout=layout)


class SearchField(PromptField):
    """Asks for a text or bytes."""

    LABEL = later("search")
    EXAMPLE = "rpm=1000, AA 01, hex:AA ?? 03"
    HINT = later("enter finds the next row from here on, then n and N; up: earlier ones")

    def open(self) -> None:
        """Let the user type."""
        preload_filter()
        super().open()


class SaveField(PromptField):
    """Asks for a file name; checks while the user types whether the file can be written."""

    LABEL = later("save to")
    EXAMPLE = DEFAULT_NAME
    HINT = later("enter saves, esc goes back; the name's end is the form: {forms}")
    SUFFIXES: ClassVar[Collection[str]] = FORMAT_BY_SUFFIX

    def open(self) -> None:
        """Suggest a name that is free, and let the user type another."""
        self._line.placeholder = str(free_path(self.EXAMPLE))
        super().open()

    @property
    def default(self) -> str:
        """The suggested name."""
        return self._line.placeholder

    @property
    def hint(self) -> str:
        """With the names of all forms."""
        return super().hint.format(forms=" ".join(self.SUFFIXES))


class PictureField(SaveField):
    """Asks for the file name of a picture of the screen."""

    LABEL = later("picture to")
    EXAMPLE = "fte-sniff-screen.svg"
    SUFFIXES = PICTURE_SUFFIXES
