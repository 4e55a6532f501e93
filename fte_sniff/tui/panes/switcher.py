"""Pane switcher: the table, one pane below or beside it, and the models that panes draw."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import Final

from textual.app import ComposeResult
from textual.containers import Container, Vertical
from textual.worker import WorkType

from fte_sniff.analysis.feed import FeedState
from fte_sniff.analysis.findings import Cause, Finding
from fte_sniff.analysis.live_models import LiveModels
from fte_sniff.analysis.model import StreamChange
from fte_sniff.analysis.motors import Health
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.errors import FteSniffError
from fte_sniff.protocol import PortEvent
from fte_sniff.protocol.dissect import dissect
from fte_sniff.tui.cells import span_text
from fte_sniff.tui.i18n import _
from fte_sniff.tui.options import SHARES, StartOptions
from fte_sniff.tui.panes.findings import FindingsPane, span_of
from fte_sniff.tui.panes.motors import MotorsPane
from fte_sniff.tui.panes.pane import Pane, PaneContext
from fte_sniff.tui.panes.row import BytesPane, DetailPane
from fte_sniff.tui.panes.statistics import StatisticsPane
from fte_sniff.tui.panes.top import TopView
from fte_sniff.tui.status_bar import NoticeLine
from fte_sniff.tui.table import RowTable, TableHeader
from fte_sniff.tui.view_model import STEP_PAUSE_S

PANES: Final[tuple[type[Pane], ...]] = (
    *(DetailPane, BytesPane, MotorsPane, StatisticsPane, FindingsPane),
)

STEP_ROWS: Final = 32_768
"""Rows in one step of the models; half as many cost a quarter more per row."""

OPEN_BUDGET_S: Final = 0.03
"""How long the models may block the screen at a tick while a pane is open, seconds."""

CLOSED_BUDGET_S: Final = 0.015
"""How long they may block it while no pane is open, seconds: a file then loads faster."""

CLOSED_BATCH_ROWS: Final = 4_096
"""Rows that are collected for a step while no pane is open: fewer steps cost less."""

HEALTH_NS: Final = 10_000_000_000
"""Time before the cursor of which the health of the motors is shown."""

HEALTH_EVERY_NS: Final = 1_000_000_000
"""Shortest time between two updates of it: each costs a step of the models."""

HEALTH: Final = {Health.SOUND: "●", Health.TROUBLED: "◐", Health.SILENT: "○"}

FINDINGS_EVERY_NS: Final = 5_000_000_000
"""Shortest time between two searches for findings; each takes some tenths of a second in a
thread."""

RECENT_NS: Final = 600_000_000_000
"""How far back a finding of a capture that runs may be to be shown in a line."""

SEARCH: Final = "findings"
"""Group of the worker that searches for findings."""

BESIDE_CELLS: Final = 160
"""Cells of the terminal from which on a pane can be beside the table."""

STEP_SHARE: Final = 5
"""By how much a key moves the divider, percent."""


class PaneSwitcher(Container):
    """The table or the top view, and the panes, of which at most one is shown.

    A pane is mounted when it is shown for the first time.
    """

    def __init__(
        self,
        store: RowStore,
        header: TableHeader,
        table: RowTable,
        notice: NoticeLine,
        options: StartOptions,
    ) -> None:
        super().__init__(id="body")
        self._store, self._header, self._table, self._notice = store, header, table, notice
        self._line_setup = options.line_setup
        self.pane_layout = options.choices.panes
        self.models = LiveModels(store, options.line_setup)
        self.top = TopView()
        self._panes: dict[str, Pane] = {}
        """The panes that are mounted, by name."""
        self.open: Pane | None = None
        """The pane that is shown; None while all are closed."""
        self._held: int | None = None
        """Index of the row at which a pane stopped following the end."""
        self._step_pending = self._postponed = self._rows_come = False
        self._drawn_at_ns: dict[Pane | TopView, int] = {}
        self._drawn: dict[Pane | TopView, tuple[object, ...]] = {}
        self._newest = 0
        self._newest_at_ns = self._clock_ns = 0
        self._playhead_ns: int | None = None
        self._zone = table.view.shown_zone
        self.health = ""
        """How the motors answered in `HEALTH_NS` up to the cursor, and their answer time."""
        self._health_at_ns = -HEALTH_EVERY_NS
        self._searched = 0
        """Rows that the last search for findings has seen."""
        self._next_search_ns = 0
        self._searching = self._offered = False
        self._reported: set[tuple[str, str, int | None]] = set()
        """Cause, port and motor of the findings that were shown in a line."""

    def compose(self) -> ComposeResult:
        """The main part; panes are mounted later."""
        yield Vertical(self._header, self._table, self.top, id="main")

    def _pane(self, name: str) -> Pane:
        """The pane of that name."""
        if name not in self._panes:
            pane = self._panes[name] = next(kind for kind in PANES if name == kind.NAME)()
            if self.is_attached:  # not at the end, after a search or by a key typed ahead
                self.mount(pane)
                self._place()
        return self._panes[name]

    def on_resize(self) -> None:
        """Place the panes."""
        self._place()

    def _place(self) -> None:
        layout, beside = self.pane_layout, self._beside
        self.set_class(beside, "-beside")
        share = layout.width if beside else layout.height
        self.set_class(share is not None, "-divided")
        for pane in self._panes.values():
            pane.styles.width = None if share is None or not beside else f"{share}%"
            pane.styles.height = None if share is None or beside else f"{share}%"

    @property
    def _can_be_beside(self) -> bool:
        """Whether the terminal is wide enough for a pane beside the table."""
        return self.app.size.width >= BESIDE_CELLS

    @property
    def _beside(self) -> bool:
        return self.pane_layout.beside and self._can_be_beside

    def action_move(self) -> None:
        """Move the panes beside the table, or below it."""
        if not self._can_be_beside:
            text = _("a pane is beside the table from {cells} columns on", cells=BESIDE_CELLS)
            self._notice.inform(text)
            return
        self.pane_layout = replace(self.pane_layout, beside=not self.pane_layout.beside)
        self._place()

    def action_grow(self, by: int) -> None:
        """Make the open pane larger (`by` 1) or smaller (-1)."""
        if self.open is None or not self.size:
            return
        layout, beside = self.pane_layout, self._beside
        share = layout.width if beside else layout.height
        if share is None:
            size, whole = self.open.outer_size, self.size
            part = size.width / whole.width if beside else size.height / whole.height
            share = round(part * 100)
        share = min(max(share + by * STEP_SHARE, SHARES.start), SHARES.stop - 1)
        wider, taller = replace(layout, width=share), replace(layout, height=share)
        self.pane_layout = wider if beside else taller
        self._place()

    def action_switch(self, name: str) -> None:
        """Show the pane of that name in place of any other, or close it where it is shown.

        A pane that explains a row stops following the end.
        """
        pane, before = self._pane(name), self.open
        self._hide()
        if before is not pane:
            self.open = pane
            pane.display = True
        if self.explains_row:
            pane.scroll_home(animate=False)
            self._hold_row()
        else:
            self._release_row()
        # The pane has no size before the next layout.
        self.call_after_refresh(self.redraw)

    def action_motor(self, motor: int) -> None:
        """Give one motor the whole screen, or show all again."""
        pane = self._pane(MotorsPane.NAME)
        assert isinstance(pane, MotorsPane)
        chosen = motor if self.open is not pane or pane.chosen != motor else None
        if self.open is not pane:
            self.action_switch(MotorsPane.NAME)
        pane.chosen = chosen
        self.set_class(chosen is not None, "-full")
        self.call_after_refresh(self.redraw)

    def close(self) -> bool:
        """Show no pane; returns whether one was open."""
        if self.open is None:
            return False
        self._hide()
        self._release_row()
        return True

    def _hide(self) -> None:
        if self.open is not None:
            self.open.forget_choice()
            self.set_class(False, "-full")
            self.open.display = False
            self.open = None

    def _hold_row(self) -> None:
        viewport = self._table.viewport
        if viewport.following and not viewport.paused:
            self._held = self._table.last_index
        self._table.stop_following()

    def _release_row(self) -> None:
        """Follow the end again, if a pane stopped that and the cursor has not moved since."""
        if self._held == self._table.last_index:
            self._table.action_follow()
        self._held = None

    def forget_texts(self) -> None:
        """Draw all texts again, as the language has changed."""
        for pane in self._panes.values():
            pane.forget_texts()
        self.redraw()

    @property
    def explains_row(self) -> bool:
        """Whether the open pane is about the cursor's row, which then should not move away."""
        return self.open is not None and self.open.EXPLAINS_ROW

    def on_table_moved(self) -> None:
        """Draw a pane about the cursor's row; all, if times have another zone."""
        before, self._zone = self._zone, self._table.view.shown_zone
        if self.explains_row or self._zone != before:
            self.redraw()

    def action_aside(self, by: int) -> None:
        """Choose a time in the statistics where they are open, else scroll sideways."""
        if self.open is not None and self.open.aside(by):
            self.redraw_open()
        else:
            self._table.action_aside(by)

    def action_field(self, by: int) -> None:
        """Look at the next field of the cursor's row, or at the previous one."""
        row = self._table.cursor_row
        if row is None:
            return
        self.explain_row()
        current, count = self._table.field, len(dissect(row))
        start = (-1 if by > 0 else count) if current is None else current
        self._table.look_at((start + by) % count)

    def explain_row(self) -> None:
        """Open the detail pane, unless a pane about the row is open."""
        if not self.explains_row:
            self.action_switch(DetailPane.NAME)

    def action_change(self, method: str, *arguments: int) -> None:
        """Change the open pane by a method that every pane has, and draw it."""
        if self.open is not None:
            getattr(self.open, method)(*arguments)
            self.redraw_open()

    def observe(self, events: Sequence[PortEvent], changes: Sequence[StreamChange] = ()) -> None:
        """Add port events, and gaps and baud changes between rows, to the models."""
        if events:
            self._forget_drawn()
        self.models.add(events, changes)

    def restart(self, events: Sequence[PortEvent], changes: Sequence[StreamChange]) -> None:
        """Begin the models anew, with these events and changes."""
        self.models = LiveModels(self._store, self._line_setup)
        self.observe(events, changes)

    def tick(self, now_ns: int, state: FeedState, playhead_ns: int | None = None) -> None:
        """Update the models with new rows, and draw the open pane where it is due.

        `now_ns` is of any monotonic clock; in a capture that runs, time passes also without rows.
        `playhead_ns` is the time that is played, nanoseconds since 1970 UTC.
        """
        self._search_for_findings(now_ns, state)
        running = state.live and state.running
        self._clock_ns, self._playhead_ns = now_ns, playhead_ns
        self._postponed = False
        self._rows_come = running or playhead_ns is not None
        if self._store.next != self._newest or not running:
            self._newest, self._newest_at_ns = self._store.next, now_ns
        if now_ns - self._health_at_ns >= HEALTH_EVERY_NS:
            self._health_at_ns = now_ns
            try:
                self._update_health()
            except FteSniffError:  # rows cannot be read any more; who asks for them gets the reason
                self.health = ""
        due = [view for view in self._views if self._is_due(view)]
        # Few large steps cost less than many small ones.
        wanted = due and self._models_shown
        if wanted or self.models.pending >= CLOSED_BATCH_ROWS or self.models_late:
            self._update_models()
        for view in due:
            self._redraw_changed(view)

    def _search_for_findings(self, now_ns: int, state: FeedState) -> None:
        """Search in a thread, if rows came since and the last search was a while ago."""
        known = self.models.known
        complete = not state.running and known == self._store.next
        is_due = now_ns >= self._next_search_ns or (complete and not self._searching)
        if self._searching or known == self._searched or not is_due:
            return
        self._searching, self._searched = True, known
        self._next_search_ns = now_ns + FINDINGS_EVERY_NS
        work: WorkType[None] = partial(self._find, state)
        self.run_worker(work, group=SEARCH)

    async def _find(self, state: FeedState) -> None:
        models = self.models  # playback may begin others meanwhile
        try:
            findings = models.copy_findings()
            findings.grows = state.running
            search = findings.found_and_recent
            found, recent = await asyncio.to_thread(search, RECENT_NS if state.live else 0)
        finally:
            self._searching = False
        models.found, models.coverage = tuple(found), tuple(findings.coverage(found))
        self.redraw_open()
        if state.live:
            self._report(recent)
        elif found and not self._offered:
            # The list of a file's findings opens once, where no pane is open.
            self._offered = True
            if self.open is None:
                self.action_switch(FindingsPane.NAME)

    def _report(self, found: Sequence[Finding]) -> None:
        """Show a new finding of a capture in one line, once; events of ports were shown before."""
        for one in found:
            topic = (one.cause, one.port, one.motor)
            if one.cause is not Cause.PORT and topic not in self._reported:
                self._reported.add(topic)
                when = span_of(one, self._table.view.shown_zone)
                text = _("{when}: {text}; ! lists the findings", when=when, text=one.text)
                self._notice.warn(text, topic)

    def _update_health(self) -> None:
        """How the motors answered up to the cursor, or up to the time of the top view."""
        if self.models.known < self._store.known and not self._postponed:
            self._update_models()
        viewport, index, row = self._table.viewport, self._table.cursor_index, None
        end_ns, events = self.models.traces.last_ns, self.models.events
        if self.top.display:
            if self._is_top_frozen:
                return
        elif index is not None and not viewport.following:
            row = self._table.cursor_row
            end_ns = None if row is None else row.t_ns
        if end_ns is None or self.models.pending > STEP_ROWS:
            self.health = ""
            return
        if row is not None and index is not None:
            events = self.models.past(index, end_ns - HEALTH_NS)[1]
        span = end_ns + 1 - HEALTH_NS, end_ns + 1
        marks = " ".join(f"{motor}{HEALTH[one]}" for motor, one in events.health(span).items())
        delay_ns = events.delay_ns(99, span)
        self.health = marks if delay_ns is None else f"{marks}  p99 {span_text(delay_ns)}"

    def _is_due(self, view: Pane | TopView) -> bool:
        return self._clock_ns - self._drawn_at_ns.get(view, 0) >= view.REDRAW_S * 1e9

    @property
    def _is_top_frozen(self) -> bool:
        return self._table.viewport.paused and self.top in self._drawn

    @property
    def _views(self) -> list[Pane | TopView]:
        """What is shown of the panes and the top view, and not frozen by a pause."""
        views: list[Pane | TopView] = []
        if self.top.display and not self._is_top_frozen:
            views.append(self.top)
        return views if self.open is None else [*views, self.open]

    def _forget_drawn(self) -> None:
        """Let everything be drawn again; a top view that a pause has frozen only fits its width."""
        frozen = self._drawn[self.top] if self._is_top_frozen else None
        self._drawn.clear()
        if frozen is not None:
            self._drawn[self.top] = frozen
            self.top.fit_columns()

    @property
    def _models_shown(self) -> bool:
        """Whether anything is shown that draws the models."""
        return bool(self._views) and not self.explains_row

    def postpone_models(self) -> None:
        """Update the models no more before the next tick."""
        self._postponed = True

    def _update_models(self) -> None:
        until = perf_counter() + (OPEN_BUDGET_S if self._models_shown else CLOSED_BUDGET_S)
        while not (done := self.models.step(STEP_ROWS)) and perf_counter() < until:
            pass
        if not (done or self._step_pending):
            self._step_pending = True
            self.set_timer(STEP_PAUSE_S, self._continue_models)

    def _continue_models(self) -> None:
        self._step_pending = False
        if not self._postponed:
            self._update_models()

    @property
    def models_pending(self) -> bool:
        """Whether the models will observe more rows although none comes."""
        return bool(self.models.pending) and (self._models_shown or self.models_late)

    @property
    def models_late(self) -> bool:
        """Whether rows could leave memory before the models have seen them.

        Half of the rows in memory are the last that the models have seen, and half of the rest is
        reserved for one more step.
        """
        return 4 * self.models.pending > self._store.most_in_memory

    def redraw(self) -> None:
        """Draw the open pane and the top view, where they have a size."""
        self._forget_drawn()
        if self._models_shown and not self._postponed:
            self._update_models()
        for view in self._views:
            self._redraw_changed(view)

    def redraw_open(self) -> None:
        """Draw the open pane; a top view that a pause has frozen stays as it is."""
        if self.open is not None:
            self._drawn.pop(self.open, None)
            self._redraw_changed(self.open)

    def top_time(self, *, live: bool) -> str:
        """The time that the top view shows; empty while it is closed."""
        if not self.top.display:
            return ""
        return self.top.time_text(live=live and not self._table.viewport.paused)

    def top_condition(self) -> str | None:
        """Filter for the rows of the line under the cursor of the top view; None without lines."""
        if not self.top.scrollable_content_region:
            # It has just been opened, and has the lines of its last drawing, or none.
            self._update_models()
            self.top.draw(self._pane_context())
        return self.top.condition

    def _redraw_changed(self, view: Pane | TopView) -> None:
        """Draw it, unless it shows the same already."""
        if not view.scrollable_content_region:
            return
        context, shown = self._pane_context(), self._store.view
        sizes = view.scrollable_content_region.size, self.app.size
        rows = self.models.observed, self.models.pending, shown.filter, shown.count
        drawn = (sizes, context, rows, view.is_behind)
        if drawn != self._drawn.get(view) or view.is_behind:
            self._drawn[view], self._drawn_at_ns[view] = drawn, self._clock_ns
            view.draw(context)

    def _pane_context(self) -> PaneContext:
        table, row = self._table, self._table.cursor_row
        index = -1 if table.cursor_index is None else table.cursor_index
        following = table.viewport.following and not table.viewport.paused
        newest_ns = self.models.traces.last_ns
        if self._playhead_ns is not None:
            newest_ns = self._playhead_ns
        elif newest_ns is not None:
            # In a running capture time passes also without rows.
            newest_ns += self._clock_ns - self._newest_at_ns
        return PaneContext(
            row=row,
            index=table.cursor_index,
            row_number=table.viewport.cursor + 1 if row is not None else 0,
            following=following,
            now_ns=newest_ns if following or row is None else row.t_ns,
            newest_ns=newest_ns,
            rates_ns=newest_ns if self._rows_come else None,
            store=self._store,
            models=self.models,
            line_setup=self._line_setup,
            palette=table.palette,
            zone=table.view.shown_zone,
            field=table.field,
            answers=tuple(table.relations.answers(index)),
            command=table.relations.command(index),
        )
