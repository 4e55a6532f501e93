"""Owns one field at the bottom: a label, the line being typed, and the verdict on it.

It must not know what the line means; who makes one brings the check.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.message import Message
from textual.suggester import Suggester
from textual.widgets import Input, Static

from fte_sniff.errors import FteSniffError, shown
from fte_sniff.tui.prompt.history import History

Check = Callable[[str], object]
"""Reads a line; raises an FteSniffError, with the reason in one line, where it means nothing."""


LOW = 16
"""Lines of the terminal below which the verdict has one line only."""


class Line(Input):
    """The line being typed, with the lines before it on the arrow keys."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "older(-1)", "Older", show=False),
        Binding("down", "older(1)", "Newer", show=False),
        Binding("enter", "submit", "Apply", key_display="enter"),
        Binding("escape", "leave", "Back", key_display="esc"),
    ]

    class Left(Message):
        """The field was left without giving a line."""

    def __init__(self, hint: str, suggester: Suggester | None) -> None:
        super().__init__(placeholder=hint, compact=True, suggester=suggester)
        self.history = History()

    def action_older(self, by: int) -> None:
        """Put a line from before into the field."""
        self.value = self.history.go(by, self.value)
        self.cursor_position = len(self.value)

    def action_leave(self) -> None:
        """Leave without giving a line."""
        self.post_message(self.Left())


class Field(Vertical):
    """A field that checks while one types: green or red, and the reason in words."""

    class Given(Message):
        """A line that passed the check was given."""

        def __init__(self, field: Field, line: str) -> None:
            super().__init__()
            self.field = field
            self.line = line

    class Closed(Message):
        """The field no longer asks."""

        def __init__(self, field: Field) -> None:
            super().__init__()
            self.field = field

    def __init__(
        self, label: str, check: Check, hint: str, good: str, suggester: Suggester | None = None
    ) -> None:
        super().__init__()
        self._label, self._check, self._good = label, check, good
        self._line = Line(hint, suggester)
        self._verdict = Static(classes="verdict")
        self.standing = ""
        """The line that holds; it stands in the field again when the field is left."""
        self.display = False

    def compose(self) -> ComposeResult:
        """The label, the line and, below, the verdict."""
        with Horizontal(classes="asked"):
            yield Static(Text(f" {self._label} "), classes="label")
            yield self._line
        yield self._verdict

    @property
    def asking(self) -> bool:
        """Whether a line is being typed."""
        return self._line.has_focus

    def ask(self) -> None:
        """Show the field and let the user type."""
        self.display = True
        self.set_class(self.app.size.height < LOW, "-low")
        self.set_class(True, "-asking")
        self._line.value = self.standing
        self._judge(self.standing)
        self._line.focus()

    def rest(self) -> None:
        """Show the line that holds; an idle field is hidden."""
        self.set_class(False, "-asking")
        self._line.value = self.standing
        self.display = bool(self.standing)

    def fall_back(self) -> None:
        """Stop asking."""
        self.rest()
        self.post_message(self.Closed(self))

    def on_input_changed(self, event: Input.Changed) -> None:
        """Check while one types."""
        event.stop()
        self._judge(event.value)

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Give the line, if it passes."""
        event.stop()
        line = event.value.strip()
        if self._judge(line):
            self._line.history.add(line)
            self.post_message(self.Given(self, line))

    def on_line_left(self, event: Line.Left) -> None:
        """Leave everything as it was."""
        event.stop()
        self.fall_back()

    def _judge(self, line: str) -> bool:
        try:
            if line.strip():
                self._check(line)
        except FteSniffError as reason:
            words = str(reason).removeprefix(f"{self._label}: ")
            self._tell("✗", shown(words), bad=True)
            return False
        self._tell("✓" if line.strip() else " ", self._good, bad=False)
        return True

    def _tell(self, sign: str, words: str, bad: bool) -> None:
        self.set_class(bad, "-bad")
        self._verdict.update(Text(f" {sign} {words}"))
