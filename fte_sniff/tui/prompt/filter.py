"""Owns the field for a filter: what it suggests, checks and tells.

It must not know the filter's language; `analysis` does.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from rich.cells import cell_len
from rich.text import Text
from textual.app import ComposeResult
from textual.widgets import Static

from fte_sniff.tui.language import _, later
from fte_sniff.tui.prompt.complete import WordSuggester
from fte_sniff.tui.prompt.field import Field, Take
from fte_sniff.tui.prompt.preparing import prepare

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter


def parsed(line: str) -> RowFilter:
    """The filter that a line says.

    Raises:
        FilterError: it says none.
    """
    # polars, which it needs, takes longer to load than a file's first rows take to be shown.
    from fte_sniff.analysis.filter.row_filter import RowFilter

    return RowFilter.parse(line)


class FilterField(Field):
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
