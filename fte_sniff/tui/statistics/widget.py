"""Owns the pane of statistics.

It must not know what its page says.
"""

from __future__ import annotations

from typing import Final

from fte_sniff.tui.language import _, later
from fte_sniff.tui.pane import Pane, Sight
from fte_sniff.tui.statistics.page import Told, page

TITLE: Final = later("statistics of all rows")
HINT: Final = later("J K: scroll   esc: close")


class StatisticsPane(Pane):
    """The numbers over all rows, whatever the filter shows and wherever the cursor is."""

    EVERY_S = 0.5

    def __init__(self) -> None:
        super().__init__(HINT)

    def see(self, sight: Sight) -> None:
        """Draw the numbers as they are now."""
        self.entitle(_(TITLE))
        models = sight.models
        told = Told(
            models.statistics,
            models.flags.numbers(),
            sight.newest_ns,
            models.behind,
            models.missed,
            sight.zone,
        )
        self.draw(page(told, self.room.width, sight.palette))
