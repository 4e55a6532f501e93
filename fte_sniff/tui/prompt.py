"""Input line: filter, search, save, history, completion."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from threading import Thread
from typing import TYPE_CHECKING, ClassVar, Final

from rich.cells import cell_len
from rich.text import Text
from textual import events
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.suggester import Suggester
from textual.widget import Widget
from textual.widgets import Input, Static

from fte_sniff.analysis.search import Search
from fte_sniff.errors import FteSniffError
from fte_sniff.session.save import EXAMPLE, FORMS
from fte_sniff.tui.i18n import _, later, worded
from fte_sniff.tui.keys import say_keys
from fte_sniff.tui.notices import Sentence

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter


class History:
    """Lines, the newest last; going up starts from the line that is being typed."""

    def __init__(self) -> None:
        self._lines: list[str] = []
        self._at = 0
        self._typed = ""

    def add(self, line: str) -> None:
        """Keep a line that was given; the same line again moves to the end."""
        if line in self._lines:
            self._lines.remove(line)
        if line:
            self._lines.append(line)
        self._at = len(self._lines)

    def go(self, by: int, typed: str) -> str:
        """The line `by` steps newer (or older, below 0) than the one that stands there now."""
        if self._at == len(self._lines):
            self._typed = typed
        self._at = min(max(0, self._at + by), len(self._lines))
        return self._typed if self._at == len(self._lines) else self._lines[self._at]


Check = Callable[[str], object]
"""Reads a line; raises an FteSniffError, with the reason in one line, where it means nothing."""

Take = Callable[[str], None]
"""Does what a line says that passed the check; called before the next key is looked at."""

LOW = 16
"""Lines of the terminal below which the verdict has one line only."""


class PromptLine(Input):
    """The line being typed, with the lines before it on the arrow keys."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "older(-1)", later("Older"), show=False),
        Binding("down", "older(1)", later("Newer"), show=False),
        Binding("tab,shift+tab", "complete", later("Complete"), show=False),
        Binding("enter", "submit", later("Apply"), key_display="enter"),
        Binding("escape", "leave", later("Back"), key_display="esc"),
    ]

    def __init__(
        self,
        hint: str,
        suggester: Suggester | None,
        give: Take,
        leave: Callable[[], None],
    ) -> None:
        super().__init__(placeholder=hint, compact=True, suggester=suggester)
        say_keys(self)
        self.history = History()
        self.can_focus = False
        self.asking = False
        """Whether a line is wanted; only then can it have the keys."""
        self._give, self._leave = give, leave

    async def on_key(self, event: events.Key) -> None:
        """Let each key act before the next: what is typed ahead comes in one rush.

        Left to itself, a key that is no text acts only after it has gone up to the app, and the
        text behind it overtakes it. What comes after the line was given goes back to the app.
        """
        if not self.asking:
            event.prevent_default().stop()
            self.app.post_message(events.Key(event.key, event.character))
        elif not event.is_printable:
            for binding in self._bindings.key_to_bindings.get(event.key, ()):
                if await self.app.run_action(binding.action, self):
                    event.prevent_default().stop()
                    break

    def action_older(self, by: int) -> None:
        """Put a line from before into the field."""
        self.value = self.history.go(by, self.value)
        self.cursor_position = len(self.value)

    def action_complete(self) -> None:
        """Take the suggestion over; the keys stay here in any case."""
        self.cursor_position = len(self.value)
        if self._suggestion:
            self.action_cursor_right()

    def on_blur(self) -> None:
        """Leave where something else on the screen was clicked; not with the terminal's window."""
        if self.asking and self.app.app_focus:
            self._leave()

    async def action_submit(self) -> None:
        """Give the line; where it does not pass, it can be mended."""
        self._give(self.value.strip())

    def action_leave(self) -> None:
        """Leave without giving a line."""
        self._leave()


class PromptField(Vertical):
    """A field that checks while one types: green or red, and the reason in words."""

    def __init__(
        self,
        label: str,
        check: Check,
        take: Take,
        hint: str,
        good: str,
        suggester: Suggester | None = None,
    ) -> None:
        """The field.

        Args:
            label: what is asked for, in English, as errors begin with it.
            check: reads a line while one types.
            take: is given the line.
            hint: an example; stands in the empty field.
            good: what the keys do, while nothing is wrong.
            suggester: completes the line.
        """
        super().__init__()
        self._label, self._check, self._take, self._good = label, check, take, good
        self._line = PromptLine(hint, suggester, self._give, self.fall_back)
        self._focused_before: Widget | None = None
        self._verdict = Sentence(classes="verdict")
        self.standing = ""
        """The line that holds; it stands in the field again when the field is left."""
        self.display = False

    def compose(self) -> ComposeResult:
        """The label, the line and, below, the verdict."""
        with Horizontal(classes="asked"):
            yield Static(Text(f" {_(self._label)} "), classes="label")
            yield self._line
        yield self._verdict

    @property
    def asking(self) -> bool:
        """Whether a line is being typed."""
        return self._line.asking

    def ask(self) -> None:
        """Show the field and let the user type."""
        self.display = True
        self.set_class(self.app.size.height < LOW, "-low")
        self.set_class(True, "-asking")
        self._line.value = self.standing
        self._judge(self.standing)
        self._focused_before = self.screen.focused
        self._line.asking = self._line.can_focus = True
        # At once, not after what waits: the next key may be here already.
        self.screen.set_focus(self._line)

    def rest(self) -> None:
        """Show the line that holds; an idle field is hidden."""
        self.set_class(False, "-asking")
        self._line.value = self.standing
        self.display = bool(self.standing)

    def remember(self, line: str) -> None:
        """Keep the line that holds, and one that was given elsewhere, on the arrow keys."""
        self._line.history.add(self.standing)
        self._line.history.add(line)

    def fall_back(self) -> None:
        """Stop asking; the keys go where they went before."""
        if self.asking:
            self._line.asking = self._line.can_focus = False
            self.screen.set_focus(self._focused_before)
        self.rest()

    def on_click(self) -> None:
        """Ask."""
        if not self.asking:
            self.ask()

    def on_input_changed(self, event: Input.Changed) -> None:
        """Check while one types."""
        event.stop()
        self._judge(event.value)

    def _give(self, line: str) -> None:
        """Take the line, if it passes."""
        if self._judge(line):
            self._line.history.add(line)
            self._take(line)
            self.fall_back()

    def _judge(self, line: str) -> bool:
        try:
            if line.strip():
                self._check(line)
        except FteSniffError as reason:
            words = worded(reason).removeprefix(f"{self._label}: ")
            self._tell("✗", words, bad=True)
            return False
        self._tell("✓" if line.strip() else " ", self._good, bad=False)
        return True

    def _tell(self, sign: str, words: str, bad: bool) -> None:
        self.set_class(bad, "-bad")
        self._verdict.say(f" {sign}", words)


def completed(line: str, t_ns: int | None = None) -> str | None:
    """The line with the likeliest rest of its last word, or None where nothing fits behind it.

    `t_ns` is a time to go by where one is asked for.
    """
    if not line.strip():
        return None
    # It is loaded with the filter, once one is asked for; a screen begins sooner without.
    from fte_sniff.analysis.filter.completion import completions

    found = completions(line, t_ns=t_ns)
    wholes = (line[: found.start] + choice for choice in found.choices)
    return next((whole for whole in wholes if whole.lower().startswith(line.lower())), None)


class WordSuggester(Suggester):
    """Suggests the rest of a name, a sign or a value."""

    def __init__(self, time_here: Callable[[], int | None]) -> None:
        """`time_here` tells the time to go by, if there is one."""
        super().__init__(use_cache=False, case_sensitive=True)
        self._time_here = time_here

    async def get_suggestion(self, value: str) -> str | None:
        """The whole line as it would be."""
        return completed(value, self._time_here())


_NEEDED: Final = (
    "fte_sniff.analysis.filter.row_filter",
    "fte_sniff.analysis.filter.completion",
    "fte_sniff.analysis.search_frame",
)


def prepare() -> None:
    """Begin to load it; returns at once, and costs nothing where it is there already."""
    Thread(target=_load, name="loads the filter", daemon=True).start()


def _load() -> None:
    for name in _NEEDED:
        import_module(name)


def parsed(line: str) -> RowFilter:
    """The filter that a line says.

    Raises:
        FilterError: it says none.
    """
    # polars, which it needs, takes longer to load than a file's first rows take to be shown.
    from fte_sniff.analysis.filter.row_filter import RowFilter

    return RowFilter.parse(line)


class FilterField(PromptField):
    """Asks for a filter, and shows the one that holds with the number of rows it lets through."""

    def __init__(
        self, row_filter: RowFilter | None, take: Take, time_here: Callable[[], int | None]
    ) -> None:
        """The field.

        Args:
            row_filter: the filter that already holds.
            take: what is done with another.
            time_here: tells the time that is suggested where one is asked for.
        """
        super().__init__(
            later("filter"),
            parsed,
            take,
            "motor = 1 AND rpm > 500",
            _("enter applies, empty shows all; tab completes, up: earlier ones; esc: back"),
            WordSuggester(time_here),
        )
        self._shown = Static(classes="shown")
        self._words = ""
        self.standing = row_filter.text if row_filter else ""

    def compose(self) -> ComposeResult:
        """The field, and behind the line the count."""
        yield from super().compose()

    def on_mount(self) -> None:
        """Put the count behind the line."""
        self.query_one(".asked").mount(self._shown)
        self.rest()

    def ask(self) -> None:
        """Let the user type."""
        prepare()
        super().ask()

    def hold(self, line: str) -> None:
        """Take over a filter that was not typed here; it can be gone back to with the arrows."""
        self.remember(line)
        self.standing = line
        self.fall_back()

    def tell_shown(self, words: str) -> None:
        """Say how many rows the filter that is on lets through; not while another is typed."""
        words = "" if self.asking else words
        if words != self._words:
            # Laid out anew only where it has another width: numbers run all the time.
            moved = cell_len(words) != cell_len(self._words)
            self._words = words
            self._shown.update(Text(words), layout=moved)


class SearchField(PromptField):
    """Asks for a text or bytes."""

    def __init__(self, take: Take) -> None:
        super().__init__(
            later("search"),
            Search.parse,
            take,
            "rpm=1000, AA 01, hex:AA ?? 03",
            _("enter finds the next row from here on, then n and N; up: earlier ones"),
        )

    def ask(self) -> None:
        """Let the user type."""
        prepare()
        super().ask()


class SaveField(PromptField):
    """Asks for a name; says while one types whether a file can be made there."""

    def __init__(self, check: Check, take: Take) -> None:
        super().__init__(
            later("save to"),
            check,
            take,
            EXAMPLE,
            _("enter saves, esc goes back; the name's end is the form: {forms}").format(
                forms=" ".join(FORMS)
            ),
        )
