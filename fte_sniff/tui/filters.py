"""Filters: the field that asks for one, with candidates, and what is shown before and after."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from time import monotonic
from typing import TYPE_CHECKING, ClassVar, Final

from rich.cells import cell_len
from rich.text import Text
from textual import on
from textual.binding import Binding, BindingType
from textual.timer import Timer
from textual.widgets import Input, OptionList, Static

from fte_sniff.analysis.filter.terms import CellFilter, both, cell_filters
from fte_sniff.analysis.row_store import BLOCK_ROWS
from fte_sniff.analysis.search import MatchCounter, ValueCounter
from fte_sniff.errors import FilterError, printable
from fte_sniff.protocol import COLUMN_BY_NAME
from fte_sniff.tui.cells import first_fitting
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.modals import Entry, LineList, Picker, list_line
from fte_sniff.tui.panes.findings import FindingsPane
from fte_sniff.tui.panes.pane import Pane
from fte_sniff.tui.prompt import Parts, Prompt, PromptField, preload_filter
from fte_sniff.tui.view_model import STEP_PAUSE_S

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter


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
        # Without colours, no background separates it from the rows.
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


@dataclass(frozen=True, slots=True)
class _Earlier:
    """What was shown before a filter."""

    filter: str
    own: str
    index: int | None = None
    """Index of the cursor's row, if the filter moved the cursor."""
    pane: Pane | None = None
    """The open pane, if the filter closed it."""


class FilterField(PromptField):
    """Asks for a filter, and shows the current one with the number of rows that pass.

    It keeps the earlier filters, and those that are saved by name.
    """

    PROMPT = Prompt(
        later("filter"),
        "motor = 1 AND rpm > 500",
        later("enter applies, empty shows all; down: list, up: earlier, ^s: save by name"),
    )
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("ctrl+s", "save", later("Save"), key_display="^s"),
    ]

    def __init__(self, parts: Parts) -> None:
        """Begin with the filter and the saved filters of the options."""
        super().__init__(parts)
        options = self._options
        self.saved = dict(options.choices.filters)
        """Filters by their names."""
        self.name_field = FilterNameField(parts, self)
        self.current = options.row_filter.text if options.row_filter else ""
        self.own = self.current
        """The filter that the user has set last, and not a finding: the one to be remembered."""
        self._earlier: list[_Earlier] = []
        """What was shown before the current filter, the latest last."""
        self._count = Static(classes="shown")
        self._count_text = ""
        self._dropdown = Dropdown()
        self._matching: MatchCounter | None = None
        self._values: dict[str, ValueCounter] = {}
        self._column: str | None = None
        self._timer: Timer | None = None

    def fill(self) -> None:
        """Add the dropdown over the line, and the count behind it."""
        if self.line.parent is None and self.is_attached:
            super().fill()
            self.mount(self._dropdown, before=0)
            self._asked.mount(self._count)

    def on_mount(self) -> None:
        """Show the filter with which the screen opens."""
        self.close()

    def parse(self, line: str) -> RowFilter:
        """Parse a filter; raises FilterError if the line is not a filter."""
        return parse_filter(line)

    def open(self, line: str | None = None) -> None:
        """Let the user type."""
        super().open(line)
        # The line is drawn first: the import takes long, and the list is placed at the line.
        self.call_after_refresh(self._prepare)

    def _prepare(self) -> None:
        preload_filter()
        self.call_after_refresh(self._suggest)

    def close(self) -> None:
        """Return the focus and stop counting."""
        super().close()
        self._dropdown.display = False
        self._matching, self._values, self._column = None, {}, None

    def set_count(self, shown: int, every: int, pending: int) -> None:
        """Show how many rows pass the filter in effect, of all, and how many are to go.

        Not while one is typed.
        """
        if not self.is_open:
            self._show_count(_count_forms(shown, every, pending))

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
            self.name_field.open()

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
            for name, text in self.saved.items()
            if name.lower().startswith(typed) and text != line
        ]
        earlier = [
            Candidate(text, _("earlier"))
            for text in self.line.history.newest_first()
            if typed in text.lower() and text not in (line, *self.saved.values())
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

    def _cursor_ns(self) -> int | None:
        row = self._table.cursor_row
        return None if row is None else row.t_ns

    def action_unfilter(self) -> None:
        """Show all rows."""
        self.accept("")

    def action_filter_before(self) -> None:
        """Go back to the previous filter, and to the list whose finding set the current one."""
        if not self._earlier:
            self._notice.inform(_("there was no other filter before"))
            return
        before = self._earlier.pop()
        self.own = before.own
        self._apply_filter(before.filter)
        if before.index is not None:
            self._table.stay_at(before.index)
        if before.pane is not None and before.pane is not self._panes.open:
            self._panes.action_switch(before.pane.NAME)

    def accept(self, line: str) -> None:
        """Apply a valid filter, and remember the current one; an empty one shows all rows."""
        current = self.current
        if line != current:
            self._earlier.append(_Earlier(current, self.own))
        self.own = line
        self._apply_filter(line)
        row_filter = self._model.store.view.filter
        if row_filter is not None and row_filter.advice:
            self._notice.inform(_(row_filter.advice))

    def show_finding(self) -> bool:
        """Show the rows of the finding that is chosen in the open list, the first under the cursor.

        The list is closed, and the filter is not remembered with the file. Returns False where the
        list is not open, or has no findings.
        """
        pane = self._panes.open
        finding = pane.chosen if isinstance(pane, FindingsPane) else None
        if finding is None:
            return False
        index_before = self._table.last_index
        earlier = _Earlier(self.current, self.own, index_before, self._panes.open)
        self._earlier.append(earlier)
        self._panes.close()
        self._focus.show_top(False)
        self._table.stay_at(self._store.index_from(finding.first_ns))
        self._apply_filter(finding.filter)
        self._notice.inform(_("{text}; backspace returns", text=finding.text))
        return True

    def _apply_filter(self, line: str) -> None:
        self.set_current(line)
        self._model.set_filter(parse_filter(line) if line else None, self._table.near)
        self._table.sync()

    def choose(self) -> None:
        """Show the rows of the line under the cursor of the top view, by a filter."""
        condition = self._panes.top_condition()
        if condition is not None:
            self._add_condition(condition)
            self._focus.show_top(False)

    def action_only(self) -> None:
        """Show only rows with the same value in a cell."""
        self._pick_cell(_("only rows with"), lambda cell: cell.only)

    def action_without(self) -> None:
        """Hide rows with the same value in a cell."""
        self._pick_cell(_("hide rows with"), lambda cell: cell.without)

    def _pick_cell(self, title: str, condition: Callable[[CellFilter], str]) -> None:
        row = self._table.cursor_row
        if row is None:
            return
        preload_filter()
        cells = cell_filters(row)
        names = [cell.column for cell in cells]
        cursor = names.index(self._table.column) if self._table.column in names else 0
        entries = [Entry(printable(cell.only), condition(cell)) for cell in cells]
        self.app.push_screen(Picker(title, entries, cursor), self._add_condition)

    def _add_condition(self, condition: str | None) -> None:
        if condition is not None:
            self.accept(both(self.current, condition))


class FilterNameField(PromptField):
    """Asks for the name by which the filter in effect is saved."""

    PROMPT = Prompt(
        later("save the filter as"),
        "stalled",
        later("enter saves it for the list of f, esc goes back"),
    )

    def __init__(self, parts: Parts, filters: FilterField) -> None:
        super().__init__(parts)
        self._filters = filters

    def accept(self, line: str) -> None:
        """Save the filter by a name."""
        if line:
            self._filters.saved[line] = self._filters.current
            self._notice.inform(_("saved; f lists the filter as {name}", name=line))
