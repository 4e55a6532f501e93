"""Options with which the screen is opened."""

from __future__ import annotations

import signal
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import tzinfo
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from fte_sniff.analysis.row_store import BLOCK_ROWS, DEFAULT_BOUND, UNBOUNDED, BlockSource, RowStore
from fte_sniff.analysis.statistics import DEFAULT_SETUP, LineSetup
from fte_sniff.platform import ENDING_SIGNALS
from fte_sniff.session.notes import Notes
from fte_sniff.session.save import UNKNOWN, ExportSource
from fte_sniff.session.user_state import START, Place
from fte_sniff.tui.cells import Delta, TableView

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import Alert, RowFilter, SilenceAlert


SHARES: Final = range(10, 86)
"""Possible shares of a pane, percent of the table and the pane."""


@dataclass(frozen=True, slots=True)
class PaneLayout:
    """Where the open pane is, and its share of the screen."""

    beside: bool = True
    """Whether it is beside the table, on a wide terminal, and not below it."""
    height: int | None = None
    """A number of `SHARES` where it is below; None where the pane decides."""
    width: int | None = None
    """A number of `SHARES` where it is beside; None for the default."""


@dataclass(frozen=True, slots=True)
class Choices:
    """What the user chooses on the screen, and has again the next time.

    The fields, but for `filters`, are the settings of the screen in the settings file.
    """

    theme: str | None = None
    """One of `i18n.THEMES`; None for the default."""
    columns: tuple[str, ...] | None = None
    """From left to right, at least one; None where the width of the window decides."""
    language: str | None = None
    """A key of `i18n.LANGUAGES`, or its `AUTO`; None where it was never chosen."""
    filters: tuple[tuple[str, str], ...] = ()
    """Names of saved filters, each with its filter."""
    pane_beside: bool = True
    pane_height: int | None = None
    pane_width: int | None = None
    delta: Delta = Delta.ROW
    changes: bool = False
    events: bool = True

    @property
    def view(self) -> TableView:
        """The table's view at the start."""
        return TableView(
            choice=self.columns, delta=self.delta, changes=self.changes, events=self.events
        )

    @property
    def panes(self) -> PaneLayout:
        """The place of the panes at the start."""
        return PaneLayout(self.pane_beside, self.pane_height, self.pane_width)


@dataclass(frozen=True, slots=True)
class StartOptions:
    """How the screen begins, and what holds while it is open."""

    leave_at_end: bool = False
    row_filter: RowFilter | None = None
    alert: Alert | SilenceAlert | None = None
    colors: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    """Styles of rows by the filter that they match; the first that matches wins."""
    notes: Notes | None = None
    """Notes on the rows; None to keep none."""
    place: Place = START
    play_speed: float | None = None
    """Speed at which a file is played from the start; None to show all of it."""
    save_place: Callable[[Place], None] | None = None
    keep_rows: int = DEFAULT_BOUND
    """Rows that are kept, or kept in memory, at least 1; the oldest are dropped first."""
    signals: tuple[signal.Signals, ...] = ENDING_SIGNALS
    """Signals that close the screen and restore the terminal; others are left alone."""
    line_setup: LineSetup = DEFAULT_SETUP
    language: str = "en"
    """A key of `i18n.LANGUAGES`."""
    choices: Choices = Choices()
    save_choices: Callable[[Choices], None] | None = None
    warnings: tuple[str, ...] = ()
    """Problems from before the screen opened, a sentence each."""
    export_source: ExportSource = UNKNOWN
    """Facts about the rows that are saved with them."""
    zone: tzinfo | None = None
    """Zone of local times, in which the times are shown first; None for that of the machine, and
    UTC first."""

    def store(self, source: BlockSource | None = None) -> RowStore:
        """A store bounded by `keep_rows`; one for all rows where a source can read them again."""
        if source is None:
            return RowStore(self.keep_rows)
        return RowStore(UNBOUNDED, source=source, most_blocks=max(2, self.keep_rows // BLOCK_ROWS))


DEFAULTS: Final = StartOptions()
