"""Owns one field at the bottom: a label, the line being typed, and the verdict on it.

It must not know what the line means; who makes one brings the check.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from rich.text import Text
from textual import events
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.suggester import Suggester
from textual.widget import Widget
from textual.widgets import Input, Static

from fte_sniff.errors import FteSniffError
from fte_sniff.tui.keys import say_keys
from fte_sniff.tui.language import _, later, worded
from fte_sniff.tui.prompt.history import History
from fte_sniff.tui.sentence import Sentence

Check = Callable[[str], object]
"""Reads a line; raises an FteSniffError, with the reason in one line, where it means nothing."""

Take = Callable[[str], None]
"""Does what a line says that passed the check; called before the next key is looked at."""

LOW = 16
"""Lines of the terminal below which the verdict has one line only."""


class Line(Input):
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


class Field(Vertical):
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
        self._line = Line(hint, suggester, self._give, self.fall_back)
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
