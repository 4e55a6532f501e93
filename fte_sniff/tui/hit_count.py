"""Owns the count of rows that have what is looked for, and what is told of it.

It must not know what a search means, nor hold up the screen: it counts a little at a time, in what
lies in memory, and looks at rows that came since no more often than somebody can read numbers.
"""

from __future__ import annotations

from functools import partial
from time import monotonic
from typing import Final

from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.search import Hits, Standing
from fte_sniff.tui.language import _, later
from fte_sniff.tui.table.widget import RowTable

BREATH_S: Final = 0.005
"""Between two steps: keys and drawing come first."""

EVERY_S: Final = 0.5
"""Between two looks at what came."""

HIT: Final = later("hit {number:,} of {all:,}")
HITS: Final = later("{all:,} hits")
HIT_IN_MEMORY: Final = later("hit {number:,} of {all:,} in memory")
HITS_IN_MEMORY: Final = later("{all:,} hits in memory")
HITS_SO_FAR: Final = later("{all:,} hits so far")


class HitCount:
    """Counts for the search that the table has now."""

    def __init__(self, store: RowStore, table: RowTable) -> None:
        """Nothing is looked for yet."""
        self._store, self._table = store, table
        self._hits: Hits | None = None
        self._about: tuple[object, ...] = ()
        self._goes_on = self._caught_up = False
        self._due_s = 0.0

    def tick(self) -> None:
        """Begin anew where something else is looked for; else count what came."""
        search = self._table.search
        columns = frozenset(column.name for column in self._table.columns)
        about = (search, columns, self._store.shown.filter)
        if about != self._about:
            self._about, self._due_s, self._caught_up = about, 0.0, False
            test = search and partial(search.mask, columns=columns)
            self._hits = Hits(self._store, test) if test else None
        if self._hits is not None and not self._goes_on and monotonic() >= self._due_s:
            self._go_on()

    def _go_on(self) -> None:
        self._goes_on = self._hits is not None and self._hits.step()
        if self._goes_on:
            self._table.set_timer(BREATH_S, self._go_on)
        else:
            # What comes from now on is counted soon enough for nobody to be told that it is not.
            self._caught_up, self._due_s = True, monotonic() + EVERY_S

    @property
    def words(self) -> str:
        """How many hits there are, and which of them the cursor is on; empty without a search."""
        if self._hits is None or self._table.search is None:
            return ""
        index = self._table.cursor_index
        standing = self._hits.standing(-1 if index is None else index)
        return _(_form(standing, self._caught_up)).format(number=standing.number, all=standing.all)


def _form(standing: Standing, caught_up: bool) -> str:
    if not caught_up:
        return HITS_SO_FAR
    if standing.left_out:
        return HITS_IN_MEMORY if standing.number is None else HIT_IN_MEMORY
    return HITS if standing.number is None else HIT
