"""Owns the field that asks what is to be found in the rows.

It must not know how a search is meant; `analysis` does.
"""

from __future__ import annotations

from fte_sniff.analysis.search import Search
from fte_sniff.tui.language import _, later
from fte_sniff.tui.prompt.field import Field, Take
from fte_sniff.tui.prompt.preparing import prepare


class SearchField(Field):
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
