"""Search the rows for a text or bytes."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from functools import partial
from time import monotonic

from textual.worker import WorkType

from fte_sniff.analysis.search import Search, find_step
from fte_sniff.errors import FteSniffError
from fte_sniff.tui.controllers.controller import Parts, ScreenController
from fte_sniff.tui.i18n import _, error_text
from fte_sniff.tui.prompt import SEARCH, PromptField, preload_filter

GROUP = "search"
"""The worker that searches, and its notice."""

SEARCH_BLOCK_S = 0.05
"""How long a search may block the screen before it continues in a worker."""


class SearchController(ScreenController):
    """Finds the rows with a text or bytes, one hit after the other, in a worker if it takes long.

    The search in effect is an attribute of the table, which marks its hits.
    """

    def __init__(self, parts: Parts) -> None:
        super().__init__(parts)
        self.field = PromptField(self._focus, SEARCH, Search.parse, self._search)

    def action_search(self) -> None:
        """Ask for a text or bytes."""
        preload_filter()
        self.field.open()

    def action_again(self, by: int) -> None:
        """Go to the next hit, or to the previous one."""
        search = self._table.search
        if search is None:
            self._notice.inform(_("no search yet; / starts one"))
        else:
            self._find(search, self._table.last_index + by, by)

    def _search(self, line: str) -> None:
        self._cancel()
        self._table.set_search(Search.parse(line) if line else None)
        if self._table.search is not None:
            # While the end is followed, all rows are above.
            by = -1 if self._table.viewport.following else 1
            self._find(self._table.search, self._table.last_index, by)

    def _find(self, search: Search, start: int, by: int) -> None:
        self._cancel()
        steps = self._search_steps(search, start, by)
        until = monotonic() + SEARCH_BLOCK_S
        while monotonic() < until:
            if next(steps, None) is None:
                return
        work: WorkType[None] = partial(self._continue_search, search, steps)
        self._table.run_worker(work, group=GROUP, exclusive=True)

    async def _continue_search(self, search: Search, steps: Iterator[int]) -> None:
        form = _("looking for {text}: {share:.0%} seen, esc ends it")
        for seen in steps:
            share = min(seen / max(1, len(self._store)), 1.0)
            text = form.format(text=search.typed, share=share)
            self._notice.pin(GROUP, text, warning=False)
            await asyncio.sleep(0)

    def _search_steps(self, search: Search, start: int, by: int) -> Iterator[int]:
        """Search to the end of the rows, then from the other end to the start.

        Yields the number of rows that were seen; shows the result at the end.
        """
        store = self._store
        rows_at_start = len(store)
        mask = partial(search.matches, columns={column.name for column in self._table.columns})
        index: int | None = start
        for wrapped in (False, True):
            if wrapped:
                index = store.first if by > 0 else store.next - 1
            while index is not None:
                try:
                    step = find_step(store, mask, index, by)
                except FteSniffError as error:
                    self._notice.unpin(GROUP)
                    self._notice.warn(error_text(error))
                    return
                reached = index if step.found is None else step.found
                if wrapped and (reached - start) * by >= 0:
                    break
                if step.found is not None:
                    self._show_hit(step.found, wrapped)
                    return
                distance = abs(index - start)
                yield rows_at_start - distance if wrapped else distance
                index = step.next_index
        self._report_no_hit(search)

    def _show_hit(self, found: int, wrapped: bool) -> None:
        self._notice.unpin(GROUP)
        if not self._table.jump_to_index(found):
            self._notice.inform(_("the next match arrived after the pause; space continues"))
        elif wrapped:
            self._notice.inform(_("the search continued from the other end"))

    def _report_no_hit(self, search: Search) -> None:
        self._notice.unpin(GROUP)
        text = _("no row that the filter shows has {text}")
        if self._store.view.pending:
            text = _("no row has {text} so far; the filter is still running")
        elif self._store.view.filter is None:
            text = _("no row has {text}")
        self._notice.inform(text.format(text=search.typed))

    @property
    def running(self) -> bool:
        """Whether a search continues in its worker."""
        return any(worker.group == GROUP and worker.is_running for worker in self._table.workers)

    def end(self) -> bool:
        """Cancel a running search, or clear the last one; returns whether there was one."""
        if self.running:
            self._cancel()
            self._notice.unpin(GROUP)
            return True
        if self._table.search is not None:
            self._table.set_search(None)
            return True
        return False

    def _cancel(self) -> None:
        self._table.workers.cancel_group(self._table, GROUP)
