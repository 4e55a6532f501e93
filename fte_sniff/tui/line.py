"""The line at the bottom on which the user answers what a key asks, such as the filter."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from rich.text import Text
from textual import on
from textual.app import ComposeResult
from textual.containers import Horizontal
from textual.message import Message
from textual.widgets import Input, Static

from fte_sniff.errors import FteSniffError
from fte_sniff.i18n import _, error_text


@dataclass(frozen=True, slots=True)
class Question:
    """What a key asks for."""

    label: str
    """In English, since errors begin with it."""
    example: str
    """A line that is shown while there is none."""
    parse: Callable[[str], Any]
    """Parses a line that is not empty; raises FteSniffError with the reason where it is invalid."""
    accept: Callable[[str], None]
    """Acts on a valid line, which may be empty."""
    suggest: Callable[[str], Sequence[str]] = lambda _line: ()
    """Whole lines that continue a line, or that it is the name of, the best first."""
    choices: Sequence[str] = ()
    """Lines from which one is chosen by `up` and `down`; the first is there from the start."""
    saves: Callable[[str], None] | None = None
    """Gives a valid line a name, by `^s`."""


MOST_EARLIER: Final = 100
"""Lines of a question that can be had again."""

MOST_SUGGESTED: Final = 12


class CommandLine(Horizontal):
    """A label, an input and what is wrong with it; the input has the focus while it is open."""

    class Typed(Message):
        """The line changed, or is closed: what the status line suggests."""

        def __init__(self, suggestions: Sequence[str]) -> None:
            super().__init__()
            self.suggestions = suggestions

    def __init__(self) -> None:
        """A closed line."""
        super().__init__()
        self.input = Input(compact=True, select_on_focus=False)
        self.input.can_focus = False
        self._label, self._verdict = Static(classes="label"), Static(classes="verdict")
        self.question: Question | None = None
        """What is asked; None while the line is closed."""
        self._earlier: dict[str, list[str]] = {}
        """By label, the lines that were accepted, the newest last."""
        self._step = 0
        self.display = False

    def compose(self) -> ComposeResult:
        """The parts from left to right."""
        yield self._label
        yield self.input
        yield self._verdict

    def ask(self, question: Question, line: str = "") -> None:
        """Let the user type, beginning with a line, or with the first choice."""
        self.question, self._step = question, 0
        self._label.update(Text(f" {_(question.label)} "))
        self.input.placeholder = _(question.example)
        self.display = self.input.can_focus = True
        self._fill(line or next(iter(question.choices), ""))
        self.input.focus()

    def close(self) -> None:
        """Ask nothing."""
        self.question = None
        self.input.can_focus = self.display = False
        self.post_message(self.Typed(()))

    def submit(self) -> None:
        """Act on a valid line and close; an invalid one can be corrected."""
        question, line = self.question, self.input.value.strip()
        if question is not None and self._is_valid(question, line):
            earlier = self._earlier.setdefault(question.label, [])
            if line:
                earlier[:] = [*(one for one in earlier if one != line), line][-MOST_EARLIER:]
            self.close()
            question.accept(line)

    def save(self) -> None:
        """Let the question name a valid line."""
        question, line = self.question, self.input.value.strip()
        if question and question.saves and line and self._is_valid(question, line):
            self.close()
            question.accept(line)
            question.saves(line)

    def step(self, by: int) -> None:
        """Show an earlier line (`by` 1) or a later one (-1), or another choice."""
        if self.question is None:
            return
        lines = [*self.question.choices] or ["", *self._earlier.get(self.question.label, [])[::-1]]
        self._step = (self._step + by) % len(lines)
        self._fill(lines[self._step])

    def complete(self) -> None:
        """Accept the first suggestion."""
        self._fill(next(iter(self._suggestions), self.input.value))

    def _fill(self, line: str) -> None:
        self.input.value, self.input.cursor_position = line, len(line)
        self._judge("")

    @property
    def _suggestions(self) -> list[str]:
        """Earlier lines and what the question suggests, as far as they continue the line."""
        question, line = self.question, self.input.value
        if question is None or not line or question.choices:
            return []
        earlier = self._earlier.get(question.label, [])[::-1]
        found = [*question.suggest(line), *(one for one in earlier if one.startswith(line))]
        return [one for one in dict.fromkeys(found) if one != line]

    @on(Input.Changed)
    def _on_changed(self, event: Input.Changed) -> None:
        event.stop()
        self._judge("")
        self.post_message(self.Typed(self._suggestions[:MOST_SUGGESTED]))

    @on(Input.Submitted)
    def _on_submitted(self, event: Input.Submitted) -> None:
        event.stop()
        self.submit()

    def _is_valid(self, question: Question, line: str) -> bool:
        try:
            if line:
                question.parse(line)
        except FteSniffError as error:
            self._judge(error_text(error).removeprefix(f"{question.label}: "))
            return False
        return True

    def _judge(self, mistake: str) -> None:
        self._verdict.update(Text(mistake))
        self._verdict.display = bool(mistake)
