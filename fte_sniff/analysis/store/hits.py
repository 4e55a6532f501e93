"""Owns counting the shown rows of a store that pass a test, a few at a time, as far as in memory.

It must not know what is looked for, nor who waits for it. What was counted stays counted while rows
come and leave, and when their block is dropped; a block that was dropped before is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from fte_sniff.analysis.store.block import Block, Places
from fte_sniff.analysis.store.finding import RowTest
from fte_sniff.analysis.store.row_store import RowStore

STEP_ROWS: Final = 4096
"""Rows that one step looks at, at most: a text is looked for in them in about a hundredth of a
second."""


@dataclass(slots=True)
class _Counted:
    """What is known of a block."""

    seen: int = 0
    """Rows that were looked at, from the start."""
    places: Places = field(default_factory=lambda: np.empty(0, np.int64))
    """Of those that pass, rising."""


@dataclass(frozen=True, slots=True)
class Standing:
    """Where a row stands among those that pass."""

    number: int | None
    """From 1; None where the row does not pass, or is not counted yet."""
    all: int
    """How many pass of those that were counted and are kept."""
    left_out: bool
    """Whether there are rows that are not in memory and were not counted."""
    behind: bool
    """Whether there are others that are not counted yet."""


class Hits:
    """The rows that pass, counted under the filter that is in force when it is made."""

    def __init__(self, store: RowStore, test: RowTest) -> None:
        """Nothing is counted.

        Args:
            store: the rows.
            test: says of packed rows which of them pass.
        """
        self._store, self._test = store, test
        self._counted: dict[int, _Counted] = {}

    def step(self) -> bool:
        """Count some rows more, the oldest first; whether there were any."""
        for block in self._store.blocks:
            counted = self._counted.setdefault(block.start, _Counted())
            if counted.seen < self._judged(block) and not block.dropped:
                self._look(block, counted)
                return True
        return False

    def _look(self, block: Block, counted: _Counted) -> None:
        stop = min(self._judged(block), counted.seen + STEP_ROWS)
        places = self._store.shown.places(block)
        places = places[(places >= counted.seen) & (places < stop)]
        if len(places):
            passing = places[self._test(*block.part(places), self._store.codebook)]
            counted.places = np.concatenate((counted.places, passing))
        counted.seen = stop

    def _judged(self, block: Block) -> int:
        """Rows of the block of which it is known whether they are shown."""
        return block.count if self._store.shown.filter is None else block.judged

    def standing(self, index: int) -> Standing:
        """Where the row of an index stands."""
        store, number, count = self._store, None, 0
        left_out = behind = False
        kept = {block.start: self._counted.get(block.start, _Counted()) for block in store.blocks}
        self._counted = kept
        for block in store.blocks:
            counted = kept[block.start]
            missing = counted.seen < self._judged(block)
            left_out = left_out or (missing and block.dropped)
            behind = behind or (missing and not block.dropped)
            places = counted.places[np.searchsorted(counted.places, store.first - block.start) :]
            at = int(np.searchsorted(places, index - block.start))
            if at < len(places) and places[at] == index - block.start:
                number = count + at + 1
            count += len(places)
        return Standing(number, count, left_out, behind)
