"""The search for findings in the rows of a view."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

from fte_sniff.analysis.events import counted, since
from fte_sniff.analysis.findings import Finding, find, ranked
from fte_sniff.analysis.segments import Segments, summed
from fte_sniff.analysis.store import STEP_ROWS, RowStore
from fte_sniff.analysis.table import EMPTY
from fte_sniff.errors import TranslatableText
from fte_sniff.protocol.rows import Item

RECENT_NS: Final = 300_000_000_000
"""The last time of a capture, in which findings are looked for alone: what is rare in hours may
stand out there."""


class Examined(NamedTuple):
    """The findings, best first, and what could not be examined."""

    findings: Sequence[Finding]
    coverage: Sequence[TranslatableText]


class Examiner:
    """Counts the rows of a store as they come, and looks for findings; used by one thread."""

    def __init__(self, store: RowStore) -> None:
        self._store, self._cutter, self._counts = store, Segments(most=1), counted(EMPTY)
        self._done = self._marks = 0
        """Rows and marks of the store that are counted."""

    def search(self, *, lives: bool) -> Examined:
        """Count what is new, and look for findings; `lives` is whether rows may follow."""
        for item in self._new():
            for table in self._cutter.push(item):
                self._counts = summed([self._counts, counted(table)])
        counts = summed([self._counts, counted(self._cutter.rest())])
        report = find(counts)
        last_ns = report.extent["greatest t"]
        if not lives or last_ns is None:
            return Examined(report.found, report.coverage())
        recent = find(since(counts, last_ns - RECENT_NS))
        found = ranked([*report.found, *recent.found])
        return Examined(found, replace(report, found=found).coverage())

    def _new(self) -> Iterator[Item]:
        """The rows and marks since the last search, in order."""
        store, end = self._store, self._store.next
        marks, self._marks = store.marks[self._marks :], len(store.marks)
        for mark in marks:
            yield from self._rows(min(mark.index, end))
            yield mark.what
        yield from self._rows(end)

    def _rows(self, end: int) -> Iterator[Item]:
        while self._done < end:
            stop = min(end, self._done + STEP_ROWS)
            rows, self._done = self._store.batch(self._done, stop), stop
            yield rows
