"""Which panes are visible."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from time import perf_counter
from typing import Final

from fte_sniff.analysis.feed import StreamChange
from fte_sniff.analysis.live_models import LiveModels
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.statistics import LineSetup
from fte_sniff.protocol import PortEvent
from fte_sniff.tui.panes.bytes import BytesPane
from fte_sniff.tui.panes.detail import DetailPane
from fte_sniff.tui.panes.motors import MotorsPane
from fte_sniff.tui.panes.pane import Pane, PaneContext
from fte_sniff.tui.panes.statistics import StatisticsPane
from fte_sniff.tui.table.theme import palette_of
from fte_sniff.tui.table.widget import RowTable

STEP_ROWS: Final = 32_768
"""Rows that the models look at in one go; each row costs a quarter more in half as many."""

SEEN_S: Final = 0.03
"""How long the models may take at one tick while somebody looks, seconds; the screen waits."""

UNSEEN_S: Final = 0.015
"""The same while nobody does: a file then loads the faster."""

BREATH_S: Final = 0.005
"""Between two times that the models take while they are behind: keys and drawing come first."""

UNSEEN_ROWS: Final = 4_096
"""Rows that the models let come together while nobody looks at them: fewer goes cost less."""


class Panes:
    """The panes, at most one of them shown."""

    def __init__(self, store: RowStore, table: RowTable, bench: LineSetup) -> None:
        """No pane is shown."""
        self._store, self._table, self._bench = store, table, bench
        self._models = LiveModels(store, bench)
        self._motors = MotorsPane()
        self._panes: dict[str, Pane] = {
            "detail": DetailPane(),
            "bytes": BytesPane(),
            "motors": self._motors,
            "statistics": StatisticsPane(),
        }
        self._shown: Pane | None = None
        self._goes_on = self._rests = False
        self._seen_at_s = 0.0
        self._newest = 0
        self._newest_at_ns = self._clock_ns = 0

    def __iter__(self) -> Iterator[Pane]:
        return iter(self._panes.values())

    @property
    def open(self) -> bool:
        """Whether a pane is shown."""
        return self._shown is not None

    def toggle(self, name: str) -> None:
        """Show the pane of that name in place of any other, or close it where it is shown."""
        wanted = self._panes[name]
        shown = self._shown
        self.close()
        if shown is not wanted:
            self._shown = wanted
            wanted.display = True
            wanted.scroll_home(animate=False)
        # It has no size yet.
        self._table.call_after_refresh(self.look)

    @property
    def holds_row(self) -> bool:
        """Whether the pane shown is about one row, which then should not run away."""
        return isinstance(self._shown, DetailPane | BytesPane)

    def follow_cursor(self) -> None:
        """The cursor is on another row."""
        if self.holds_row:
            self.look()

    def close(self) -> None:
        """Show none."""
        if self._shown is not None:
            self._shown.display = False
            self._shown = None

    def zoom(self, by: int) -> None:
        """Look at more time (by 1) or less (-1), where the pane shown is about time."""
        if self._shown is self._motors:
            self._motors.zoom(by)
            self.look()

    def scroll(self, by: int) -> None:
        """Move the page of the pane by lines."""
        if self._shown is not None:
            self._shown.scroll_relative(y=by, animate=False)

    def tell_events(self, events: Sequence[PortEvent]) -> None:
        """Something happened to ports."""
        self._models.statistics.observe_events(events)

    def add_changes(self, changes: Sequence[StreamChange]) -> None:
        """Pass on gaps and baud changes between rows of the store."""
        self._models.add_changes(changes)

    def tick(self, now_ns: int, running: bool) -> None:
        """Let the models look at what came, and draw the pane where it is time.

        Args:
            now_ns: any rising clock's nanoseconds.
            running: whether time goes on where the rows come from, also without rows.
        """
        self._clock_ns = now_ns
        self._rests = False
        if self._store.next != self._newest or not running:
            self._newest, self._newest_at_ns = self._store.next, now_ns
        if self.open or self._models.pending >= UNSEEN_ROWS or self.overtaken:
            self._catch_up()
        if self._shown is not None and now_ns / 1e9 - self._seen_at_s >= self._shown.EVERY_S:
            self.look()

    def rest(self) -> None:
        """Let the models wait for the next tick: other things come first."""
        self._rests = True

    def _catch_up(self) -> None:
        """Let the models look; what is too much for one time goes on behind what else there is."""
        until = perf_counter() + (SEEN_S if self.open else UNSEEN_S)
        while not (done := self._models.step(STEP_ROWS)) and perf_counter() < until:
            pass
        if not (done or self._goes_on):
            self._goes_on = True
            self._table.set_timer(BREATH_S, self._go_on)

    def _go_on(self) -> None:
        self._goes_on = False
        if not self._rests:
            self._catch_up()

    @property
    def overtaken(self) -> bool:
        """Whether rows would soon leave memory before the models saw them, to be read again then.

        Half of what is in memory is what they saw last, and half of the rest is for one more look.
        """
        return 4 * self._models.pending > self._store.most_in_memory

    def look(self) -> None:
        """Draw the pane that is shown, once there is a place for it."""
        if self._shown is not None and self._shown.laid_out:
            self._seen_at_s = self._clock_ns / 1e9
            self._shown.see(self._sight())

    def _sight(self) -> PaneContext:
        table = self._table
        following = table.viewport.following and not table.viewport.paused
        row, newest_ns = table.cursor_row, self._newest_ns
        return PaneContext(
            row=row,
            index=table.cursor_index,
            place=table.viewport.cursor + 1 if row is not None else 0,
            following=following,
            now_ns=newest_ns if following or row is None else row.t_ns,
            newest_ns=newest_ns,
            store=self._store,
            models=self._models,
            bench=self._bench,
            palette=palette_of(table.app.current_theme),
            zone=table.look.shown_zone,
        )

    @property
    def _newest_ns(self) -> int | None:
        """At the end of a capture that runs, time goes on without rows."""
        newest = self._models.traces.last_ns
        return None if newest is None else newest + self._clock_ns - self._newest_at_ns
