"""Findings: search for them while rows come, list them, and go to their rows."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from textual.worker import WorkType

from fte_sniff.analysis.findings import Cause, Finding
from fte_sniff.tui.controllers.controller import Parts, ScreenController
from fte_sniff.tui.controllers.filters import FilterController
from fte_sniff.tui.i18n import _
from fte_sniff.tui.panes.findings import FindingsPane, span_of

EVERY_NS = 5_000_000_000
"""Shortest time between two searches; each takes some tenths of a second in a thread."""

RECENT_NS = 600_000_000_000
"""How far back a finding of a capture that runs may be to be shown in a line."""

SEARCH = "findings"
"""Group of the worker that searches."""


class FindingsController(ScreenController):
    """Keeps the findings current; shows those of a file once, and new ones of a capture."""

    def __init__(self, parts: Parts, filters: FilterController) -> None:
        super().__init__(parts)
        self._filters = filters
        self._searched = 0
        """Rows that the last search has seen."""
        self._next_ns = 0
        self._running = self._offered = False
        self._reported: set[tuple[str, str, int | None]] = set()
        """Cause, port and motor of the findings that were shown in a line."""

    def tick(self, now_ns: int) -> None:
        """Search in a thread, if rows came since and the last search was a while ago."""
        models = self._panes.models
        complete = not self._model.state.running and models.known == self._store.next
        is_due = now_ns >= self._next_ns or (complete and not self._running)
        if self._running or models.known == self._searched or not is_due:
            return
        self._running, self._searched = True, models.known
        self._next_ns = now_ns + EVERY_NS
        work: WorkType[None] = self._search
        self._table.run_worker(work, group=SEARCH)

    async def _search(self) -> None:
        models, live = self._panes.models, self._model.state.live
        try:
            # Of a copy: more rows are observed meanwhile.
            findings = models.findings.copy()
            findings.grows = self._model.state.running
            search = findings.found_and_recent
            found, recent = await asyncio.to_thread(search, RECENT_NS if live else 0)
        finally:
            self._running = False
        models.found, models.coverage = tuple(found), tuple(findings.coverage(found))
        self._panes.redraw_open()
        if live:
            self._report(recent)
        else:
            self._offer()

    def _offer(self) -> None:
        """Open the list of a file's findings, once, where no pane is open."""
        if self._panes.models.found and not self._offered:
            self._offered = True
            if self._panes.open is None:
                self._panes.action_toggle(FindingsPane.NAME)

    def _report(self, found: Sequence[Finding]) -> None:
        """Show a new finding of a capture in one line, once; events of ports were shown before."""
        for one in found:
            if one.cause is Cause.PORT:
                continue
            topic = (one.cause, one.port, one.motor)
            if topic not in self._reported:
                self._reported.add(topic)
                when = span_of(one, self._table.view.shown_zone)
                text = _("{when}: {text}; ! lists the findings", when=when, text=one.text)
                self._notice.warn(text, topic)

    def go(self) -> bool:
        """Show the rows of the finding that is chosen in the open list, the first under the cursor.

        Returns False where the list is not open, or has no findings.
        """
        pane = self._panes.open
        finding = pane.chosen if isinstance(pane, FindingsPane) else None
        if finding is not None:
            self._filters.go(finding.filter, self._store.index_from(finding.first_ns))
            self._notice.inform(_("{text}; backspace returns", text=finding.text))
        return finding is not None
