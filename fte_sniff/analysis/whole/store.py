"""The rows of the screen: all in memory, with the indices of those that a filter shows.

index     of a row since the store began; it never changes, also when older rows are dropped
position  of a row among those that are shown
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from fte_sniff.analysis.row_store import RowNote, row_notes
from fte_sniff.analysis.whole.relations import Runs, runs_of, with_facts
from fte_sniff.analysis.model import StreamChange
from fte_sniff.protocol.rows import FACTS, NO_TIME, Bools, Codebook, Codes, Ints, Rows, no_facts

RowTest = Callable[[Rows], Bools]
"""Whether each row passes, such as `RowFilter.matches`."""

DEFAULT_BOUND: Final = 1_000_000
_LOOK_BACK: Final = 4096
"""Rows before new ones that are completed again: those of three seconds of a full line."""


class RowStore:
    """The latest rows, at least `bound`, and those that a filter shows."""

    def __init__(self, bound: int = DEFAULT_BOUND) -> None:
        self.bound = bound
        self.codebook = Codebook()
        self.changes: list[StreamChange] = []
        """Gaps and baud changes, by index."""
        self.first = 0
        """Index of the oldest row."""
        self.known = 0
        """Index after the last row whose facts are known."""
        self._count = 0
        self._space = self._allocated(2 * min(bound, 1 << 16))
        self._filter: RowTest | None = None
        self._filtered = 0
        self.shown: Ints = np.zeros(0, np.int64)
        """Indices of the rows that are shown, rising."""

    def _allocated(self, rows: int) -> Rows:
        facts = {name: np.array(own) for name, own in no_facts(rows).items()}
        return Rows.allocate(self.codebook, rows).with_facts(facts)

    @property
    def rows(self) -> Rows:
        """The rows in the store; a view, to be read at once."""
        return self._space[: self._count]

    @property
    def next(self) -> int:
        """Index of the next row: the number of all rows so far."""
        return self.first + self._count

    def batch(self, start: int, end: int) -> Rows:
        """The rows with indices from `start` up to `end` that are in the store; a view."""
        low, high = max(0, start - self.first), max(0, end - self.first)
        return self._space[low : min(high, self._count)]

    def append(self, rows: Rows, changes: list[StreamChange], *, ended: bool = False) -> None:
        """Append rows with the changes among them; complete and show them."""
        self.changes += [StreamChange(self.next + one.index, one.what) for one in changes]
        if self._count + len(rows) > len(self._space):
            self._make_room(len(rows))
        self._space.assign(self._count, rows.recoded(self.codebook))
        self._count += len(rows)
        self._complete(ended)
        self._show()

    def _make_room(self, more: int) -> None:
        """Drop the oldest rows beyond the bound, or take twice the memory."""
        kept = self.rows[max(0, self._count - self.bound) :]
        self.first += self._count - len(kept)
        space = self._allocated(2 * (len(kept) + more))
        space.assign(0, kept)
        for name in FACTS:
            space.buffers[name][: len(kept)] = kept.buffers[name]
        self._space, self._count = space, len(kept)
        self.shown = self.shown[np.searchsorted(self.shown, self.first) :]

    def _complete(self, ended: bool) -> None:
        """Compute the facts of the rows that are more than a second old."""
        start = max(self.first, self.known - _LOOK_BACK)
        rows = self.batch(start, self.next)
        t_ns = rows.t_ns
        is_recent = t_ns >= t_ns.max(initial=NO_TIME) - 10**9 if len(rows) else np.zeros(0, bool)
        end = self.next if ended or not is_recent.any() else start + int(is_recent.argmax())
        if end > self.known:
            whole = with_facts(rows, self.runs(start, self.next))
            for name in FACTS:
                own = getattr(whole, name)[self.known - start : end - start]
                self._space.buffers[name][self.known - self.first : end - self.first] = own
            self.known = end

    def runs(self, start: int, end: int) -> Runs:
        """The runs of some of the rows."""
        changes = [
            StreamChange(max(0, one.index - start), one.what)
            for one in self.changes
            if one.index < end
        ]
        return runs_of(self.batch(start, end), changes)

    # The rows that are shown

    def set_filter(self, test: RowTest | None) -> None:
        """Show only rows that pass, or all."""
        self._filter, self._filtered, self.shown = test, self.first, np.zeros(0, np.int64)
        self._show()

    def _show(self) -> None:
        start = max(self._filtered, self.first)
        rows = self.batch(start, self.next)
        new = np.arange(len(rows)) if self._filter is None else np.flatnonzero(self._filter(rows))
        self.shown = np.concatenate((self.shown, new + start))
        self._filtered = self.next

    def position_of(self, index: int) -> int:
        """Number of shown rows before an index: the position of a shown row."""
        return int(np.searchsorted(self.shown, index))

    def find(self, test: RowTest, index: int, by: int) -> int | None:
        """Index of the next shown row after an index that passes, or before it (`by` -1)."""
        own = self.shown[self.shown > index] if by > 0 else self.shown[self.shown < index][::-1]
        for start in range(0, len(own), 1 << 16):
            some = own[start : start + (1 << 16)]
            found = np.flatnonzero(test(self._space.select(some - self.first)))
            if len(found):
                return int(some[found[0]])
        return None

    def notes(self) -> Codes:
        """The `RowNote` of each shown row."""
        at = self.shown - self.first
        notes: Codes = row_notes(self.rows)[at]
        missed = self.rows.unanswered[at] > 0
        notes[missed & (notes < RowNote.UNANSWERED)] = RowNote.UNANSWERED
        return notes

    def overview(self, cells: int) -> list[tuple[RowNote, float]]:
        """The worst note in equal shares of the shown rows, and the share of rows that have it."""
        notes = self.notes()
        if not len(notes):
            return []
        starts = np.unique(np.linspace(0, len(notes), cells, endpoint=False).astype(np.int64))
        worst = np.maximum.reduceat(notes, starts)
        sizes = np.diff(starts, append=len(notes))
        same = np.add.reduceat(notes == np.repeat(worst, sizes), starts) / sizes
        return [(RowNote(one), float(share)) for one, share in zip(worst, same, strict=True)]
