"""Which rows and columns are shown: the filter in effect and those before, and the columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.filter.terms import both, cell_filters, completions
from fte_sniff.errors import InputTextError, listed
from fte_sniff.i18n import _, later
from fte_sniff.tui.cells import ORDER
from fte_sniff.tui.line import Question
from fte_sniff.tui.parts import Parts

if TYPE_CHECKING:
    from fte_sniff.analysis.findings import Finding
    from fte_sniff.tui.pages import Page


class Filters:
    """The filter in effect, and what was shown before."""

    def __init__(self, parts: Parts) -> None:
        """Begin with the filter of the options."""
        self._parts, self._view, self._table = parts, parts.view, parts.table
        wanted = parts.options.row_filter
        self.current = wanted.text if wanted else ""
        self.saved = dict(parts.options.choices.filters)
        """Filters by their names."""
        self.finding: Finding | None = None
        """That whose span is looked at: it is chosen, or its rows are shown."""
        self.earlier: list[tuple[str, int, Finding | None, Page | None]] = []
        """What was shown before, the latest last: filter, cursor's row, finding, and the list that
        led from there."""

    @property
    def text(self) -> str:
        """The filter, and how many rows pass; empty without one."""
        shown = self._view.shown
        if shown.matches is None:
            return ""
        count = _("{shown:,} of {all:,} rows", shown=shown.count, all=self._view.store.next)
        return f"{self.current}  {count}{' …' if shown.pending else ''}"

    def ask(self) -> None:
        """Let the user change the filter."""
        question = Question(
            later("filter"),
            "motor = 1 AND rpm > 500",
            RowFilter.parse,
            self.accept,
            self._suggest,
            saves=self._ask_name,
        )
        self._parts.line.ask(question, self.current)

    def _ask_name(self, line: str) -> None:
        def save(name: str) -> None:
            if name:
                self.saved[name] = line
                self._parts.status.inform(_("saved; f suggests the filter for {name}", name=name))

        self._parts.line.ask(Question(later("save the filter as"), "stalled", str, save))

    def accept(self, line: str, left: Page | None = None) -> None:
        """Apply a valid filter, and remember the current one; an empty one shows all rows.

        `left` is the list that led to the filter.
        """
        if line != self.current:
            self._remember(left)
        self._apply(line)

    def show(self, finding: Finding, left: Page) -> None:
        """Show the rows of a finding, the first under the cursor; its span is looked at."""
        self._remember(left)
        self._apply(finding.filter, finding)
        self._table.stay_at(self._view.store.index_at(finding.first_ns))
        self._parts.status.inform(_("{text}; backspace returns", text=finding.text))

    def before(self) -> Page | None:
        """Return to what was shown before; returns the list that led from there, if one did."""
        line, index, finding, left = self.earlier.pop()
        self._apply(line, finding)
        self._table.stay_at(index)
        return left

    def look_away(self) -> None:
        """Look no longer at a finding, unless its rows are shown."""
        if self.finding is not None and self.finding.filter != self.current:
            self.finding = None

    def _remember(self, left: Page | None) -> None:
        self.earlier.append((self.current, self._table.last_index, self.finding, left))

    def _apply(self, line: str, finding: Finding | None = None) -> None:
        self.current, self.finding = line, finding
        self._view.set_filter(RowFilter.parse(line) if line else None)
        self._table.sync()

    def add(self, condition: str, left: Page | None = None) -> None:
        """Show only rows that pass the filter in effect and another one."""
        self.accept(both(self.current, condition), left)

    def only(self) -> None:
        """Ask for the column in which rows are like this one."""
        self._ask_cell(later("only rows with"), hides=False)

    def without(self) -> None:
        """Ask for the column in which rows are not like this one."""
        self._ask_cell(later("hide rows with"), hides=True)

    def _ask_cell(self, label: str, *, hides: bool) -> None:
        row = self._table.cursor_row
        if row is None:
            return
        others = cell_filters(row)
        # Rows have the kind and the motor of many others, but hardly ever the time of one.
        choices = sorted(others, key=lambda one: not one.startswith(("kind ", "motor ")))

        def accept(line: str) -> None:
            self.add(others.get(line, line) if hides else line)

        question = Question(label, "motor = 1", RowFilter.parse, accept, choices=choices)
        self._parts.line.ask(question)

    def _suggest(self, line: str) -> list[str]:
        saved = [text for name, text in self.saved.items() if name.startswith(line)]
        return [*saved, *completions(line)]


class Columns:
    """Asks for the columns, from left to right."""

    def __init__(self, parts: Parts) -> None:
        self._parts, self._table = parts, parts.table

    def ask(self) -> None:
        """Let the user change the columns; an empty line lets the width decide."""
        question = Question(
            later("columns"), "time kind motor rpm raw", self.parse, self.accept, self._suggest
        )
        self._parts.line.ask(question, " ".join(one.name for one in self._table.columns))

    def parse(self, line: str) -> Sequence[str]:
        """The names; raises InputTextError for an unknown one, and for one that is there twice."""
        names = line.replace(",", " ").split()
        unknown = [name for name in names if name not in ORDER]
        if unknown:
            text = later("no column {name}; there are {names}")
            raise InputTextError(text, name=unknown[0], names=listed(ORDER))
        if len(set(names)) < len(names):
            raise InputTextError(later("each column once"))
        return names

    def accept(self, line: str) -> None:
        """Show these columns."""
        self._table.set_look(choice=tuple(self.parse(line)) or None)

    def _suggest(self, line: str) -> list[str]:
        before, _space, word = line.rpartition(" ")
        used = before.split()
        return [
            f"{before} {name}".strip()
            for name in ORDER
            if name.startswith(word) and name not in used
        ]
