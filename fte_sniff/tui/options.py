"""How the screen is opened."""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import dataclass
from datetime import tzinfo
from enum import Enum
from typing import TYPE_CHECKING, Final, TypeAlias

from fte_sniff.analysis.row_store import BLOCK_ROWS, DEFAULT_BOUND, ENDLESS, BlockSource, RowStore
from fte_sniff.analysis.statistics import DEFAULT_SETUP, LineSetup
from fte_sniff.session.save import UNKNOWN, ExportSource
from fte_sniff.tui.table.columns import ColumnChoice

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter


ENDING_SIGNALS: Final = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
"""Signals upon which the screen closes and leaves the terminal as it was."""


class AtEnd(Enum):
    """What the screen does when its feed has ended."""

    STAY = "stay"
    """The rows can still be looked at."""
    LEAVE = "leave"
    """The screen closes by itself."""


@dataclass(frozen=True, slots=True)
class Choices:
    """What the user chooses on the screen, and would choose again the next time."""

    theme: str | None = None
    """A name of `theme_names`; None for the usual one."""
    columns: ColumnChoice | None = None
    """None where the width of the window decides."""


Keep: TypeAlias = Callable[[Choices], None]
"""Keeps what was chosen, for the next time."""


def keep_nothing(_choices: Choices) -> None:
    """The next screen begins as this one did."""


@dataclass(frozen=True, slots=True)
class StartOptions:
    """How the screen begins, and what holds while it is open."""

    at_end: AtEnd = AtEnd.STAY
    row_filter: RowFilter | None = None
    """Only the rows that it wants are shown, until the user says otherwise."""
    keep_rows: int = DEFAULT_BOUND
    """Rows that can be looked at, or lie in memory, at least 1; the oldest leave first."""
    signals: tuple[signal.Signals, ...] = ENDING_SIGNALS
    """Upon which the screen closes; others do what they did before."""
    bench: LineSetup = DEFAULT_SETUP
    """What the user said about the set-up."""
    language: str = "en"
    """A word of `language.LANGUAGES`."""
    choices: Choices = Choices()
    """What was chosen before."""
    keep: Keep = keep_nothing
    """Is told at the end what was chosen, where that differs from `choices`."""
    trouble: tuple[str, ...] = ()
    """What went wrong before the screen was there to tell it, a sentence each."""
    origin: ExportSource = UNKNOWN
    """What is known of the rows beside them, to be saved with them."""
    zone: tzinfo | None = None
    """Of local times; None for this machine's."""

    def store(self, source: BlockSource | None = None) -> RowStore:
        """A store for so many rows; for all there are, where a source gives the others again."""
        if source is None:
            return RowStore(self.keep_rows)
        return RowStore(ENDLESS, source=source, most_blocks=max(2, self.keep_rows // BLOCK_ROWS))


USUAL: Final = StartOptions()
"""Nobody said anything."""
