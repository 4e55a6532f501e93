"""Owns the keys of the search: what is looked for, and the way from one such row to the next.

It must not know how a search is meant. Millions of rows are looked at block by block, so that the
screen goes on meanwhile; what is near is there at once.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from time import monotonic

from fte_sniff.analysis.search import Search, find_step
from fte_sniff.errors import FteSniffError, shown
from fte_sniff.tui.actions.parts import Parts
from fte_sniff.tui.language import _, worded

AT_ONCE_S = 0.05
"""How long the search may hold up the screen before it goes on beside it."""

GROUP = "search"
"""What the work beside the screen is called."""


@dataclass(frozen=True, slots=True)
class Look:
    """How far a search is."""

    found: int | None
    """Index of the row that has it."""
    seen: int
    """Rows that it has passed."""
    around: bool
    """Whether it began anew from the other end."""


class Searching(Parts):
    """Looking for a text or bytes."""

    def action_search(self) -> None:
        """Ask what to look for."""
        self._search_field.ask()

    def action_again(self, by: int) -> None:
        """Go to the next row that has it, or to the one before."""
        search = self._table.search
        if search is None:
            self._tell(_("nothing was looked for yet; / begins"))
        else:
            self._seek(search, self._table.index_here + by, by)

    def _search(self, line: str) -> None:
        """Look for a line that passed the check; an empty one ends the search."""
        self.workers.cancel_group(self, GROUP)
        self._table.set_search(Search.parse(line) if line else None)
        if self._table.search is not None:
            # Whoever follows the end looks back from there.
            by = -1 if self._table.viewport.following else 1
            self._table.stay()
            self._seek(self._table.search, self._table.index_here, by)

    def _seek(self, search: Search, start: int, by: int) -> None:
        self.workers.cancel_group(self, GROUP)
        steps = self._steps(search, start, by)
        until = monotonic() + AT_ONCE_S
        while monotonic() < until:
            if self._step(search, steps) is None:
                return
        self._work(GROUP, partial(self._go_on, search, steps))

    async def _go_on(self, search: Search, steps: Iterator[Look]) -> None:
        while (look := self._step(search, steps)) is not None:
            share = look.seen / max(1, len(self._watched.store))
            words = _("looking for {text}: {share:.0%} seen, esc ends it")
            words = words.format(text=shown(search.typed), share=min(share, 1.0))
            self._notice.hold(GROUP, words, worry=False)
            await asyncio.sleep(0)

    def _step(self, search: Search, steps: Iterator[Look]) -> Look | None:
        """How far the search is now; None where it has come to its end, and has said so."""
        try:
            look = next(steps, None)
        except FteSniffError as error:
            self._notice.release(GROUP)
            self._notice.warn(worded(error))
            return None
        if look is None:
            self._notice.release(GROUP)
            self._tell_none(search)
        elif look.found is not None:
            self._notice.release(GROUP)
            self._show_found(look)
        else:
            return look
        return None

    def _steps(self, search: Search, start: int, by: int) -> Iterator[Look]:
        """To the end of the rows, and then from the other end to where it began."""
        store = self._watched.store
        begun = len(store)
        mask = partial(search.mask, columns={column.name for column in self._table.columns})
        index: int | None = start
        for around in (False, True):
            if around:
                index = store.first if by > 0 else store.next - 1
            while index is not None:
                step = find_step(store, mask, index, by)
                here = step.found if step.found is not None else index
                if around and (here - start) * by >= 0:
                    return
                seen = abs(index - start) if not around else begun - abs(start - index)
                yield Look(step.found, seen, around)
                index = step.onward

    def _show_found(self, look: Look) -> None:
        if look.found is None or not self._table.jump_to_index(look.found):
            self._tell(_("the next row that has it came after the pause; space goes on"))
        elif look.around:
            self._tell(_("there was no further one: it went on from the other end"))

    def _tell_none(self, search: Search) -> None:
        if self._watched.store.shown.pending:
            words = _("no row so far has {text}; the filter is still at work")
        elif self._watched.store.shown.filter is None:
            words = _("no row has {text}")
        else:
            words = _("no row that the filter shows has {text}")
        self._tell(words.format(text=shown(search.typed)))

    @property
    def _searching(self) -> bool:
        return any(worker.group == GROUP and worker.is_running for worker in self.workers)

    def _end_search(self) -> bool:
        """End a search that runs, or forget what was looked for; whether there was one."""
        if self._searching:
            self.workers.cancel_group(self, GROUP)
            self._notice.release(GROUP)
            return True
        if self._table.search is not None:
            self._table.set_search(None)
            return True
        return False
