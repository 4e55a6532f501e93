"""Models that follow a growing store, with checkpoints of the motors' state.

rows         |-----------|-----------|-----------|------>
checkpoints  c0          c1          c2    ^ the state here: a copy of c2, and the rows since
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from operator import attrgetter
from typing import Final

import numpy as np

from fte_sniff.analysis.facts import motor_rows
from fte_sniff.analysis.findings import Finding, Findings
from fte_sniff.analysis.model import StreamChange
from fte_sniff.analysis.motors import FlagCounts, MotorEvents, Motors
from fte_sniff.analysis.plots import Traces
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.statistics import LineSetup, Statistics, Streams, StreamStats
from fte_sniff.errors import TranslatableText
from fte_sniff.protocol import Gap, GapKind, PortEvent
from fte_sniff.protocol.rows import Rows

CHECKPOINT_ROWS: Final = 32_768

MOST_TRACED_ROWS: Final = 300_000
"""Most rows that are traced again for a row of the past."""


class LiveModels:
    """Motors, their traces and events, flags and statistics of all rows of a store."""

    def __init__(
        self, store: RowStore, setup: LineSetup, checkpoint_rows: int = CHECKPOINT_ROWS
    ) -> None:
        self._store = store
        self._checkpoint_rows = checkpoint_rows
        self.observed = 0
        """Index after the last observed row."""
        self._checkpoints: deque[tuple[int, Motors]] = deque([(0, Motors())])
        self._changes: list[StreamChange] = []
        """By index in the store; those before rows that a model has yet to observe, and those that
        are needed from the first checkpoint on."""
        self.known = 0
        """Index after the last row whose facts were observed."""
        self._findings = Findings.of_facts()
        self.found: tuple[Finding, ...] = ()
        """The findings of the last search."""
        self.coverage: tuple[TranslatableText, ...] | None = None
        """What that search could not examine, or if it found nothing, what it examined; None
        before the first one."""
        self._events: list[PortEvent] = []
        """Port events that were not observed yet."""
        self.motors = Motors()
        self.traces = Traces()
        self.events = MotorEvents()
        self.statistics = Statistics(setup)
        self.flags = FlagCounts()
        self.missed = 0
        """Rows that left the store before they were observed."""

    @property
    def pending(self) -> int:
        """Rows in the store that were not observed yet."""
        return self._store.next - max(self.observed, self._store.first)

    def step(self, budget_rows: int) -> bool:
        """Observe the next rows, at most `budget_rows`; True if none is left."""
        self._skip_missed()
        self._observe_events()
        end = min(self.observed + budget_rows, self._store.next)
        while self.observed < end:
            self._apply(self._changes_in(self.observed, self.observed + 1))
            stop = min(end, (self.observed // self._checkpoint_rows + 1) * self._checkpoint_rows)
            if following := self._changes_in(self.observed + 1, stop):
                stop = following[0].index
            for rows in self._store.batches(self.observed, stop):
                found = motor_rows(rows)
                self.motors.observe(rows, found)
                self.events.observe(rows, self.motors)
                self.flags.observe(rows, found)
                self.traces.observe(rows)
                self.statistics.observe(rows)
            self.observed = stop
            if stop % self._checkpoint_rows == 0:
                self._checkpoints.append((stop, self.motors.copy()))
        self._observe_facts(budget_rows)
        self._drop_old()
        return not self.pending

    def _observe_facts(self, budget_rows: int) -> None:
        """Observe the next rows whose facts are known."""
        start = max(self.known, self._store.first)
        end = min(self._store.known, self.observed, start + budget_rows)
        for rows in self._store.batches(start, end):
            self.events.observe_facts(rows)
            changes = self._changes_in(self.known, start + len(rows))
            places = [StreamChange(max(0, one.index - start), one.what) for one in changes]
            self._findings.observe(rows, places)
            start = self.known = start + len(rows)

    def add(self, events: Sequence[PortEvent] = (), changes: Sequence[StreamChange] = ()) -> None:
        """Add port events, and changes by rising index in the store, for the next step.

        The rows at the indices were not observed yet.
        """
        self._events += events
        self._changes += changes

    def _observe_events(self) -> None:
        events, self._events = self._events, []
        self.statistics.observe_events(events)
        self._findings.observe_events(events)

    def copy_findings(self) -> Findings:
        """The findings as of now, to be searched while more rows are observed."""
        self._observe_events()
        return self._findings.copy()

    def _changes_in(self, start: int, end: int) -> list[StreamChange]:
        """The changes before the rows from `start` up to `end`."""
        first, last = (bisect_left(self._changes, at, key=_index) for at in (start, end))
        return self._changes[first:last]

    def _apply(self, changes: Iterable[StreamChange]) -> None:
        for change in changes:
            self.statistics.observe_change(change.what)
            if isinstance(change.what, Gap):
                self.motors.interrupt(change.what)

    def _skip_missed(self) -> None:
        start, missed = self.observed, self._store.first - self.observed
        if missed > 0:
            self.missed += missed
            self.observed += missed
            self._apply(self._changes_in(start, self.observed))
            gap = StreamChange(self.observed, Gap(GapKind.NOT_SHOWN, missed))
            insort(self._changes, gap, key=_index)

    def _drop_old(self) -> None:
        """Drop checkpoints before the last one that the store's rows need, and old changes."""
        while len(self._checkpoints) > 1 and self._checkpoints[1][0] <= self._store.first:
            self._checkpoints.popleft()
        needed = min(self._checkpoints[0][0], self.known)
        del self._changes[: bisect_left(self._changes, needed, key=_index)]

    def motors_at(self, index: int) -> Motors | None:
        """The motors right after the row with that index; None if it was not observed yet."""
        end = index + 1
        if end > self.observed:
            return None
        if end == self.observed:
            return self.motors
        start, state = next(one for one in reversed(self._checkpoints) if one[0] <= end)
        motors = state.copy()
        for _rows in self._replay(motors, start, end):
            pass
        return motors

    def _replay(self, motors: Motors, start: int, end: int) -> Iterator[Rows]:
        """The rows from `start` up to `end`, each batch after the motors have observed it."""
        gaps = [one for one in self._changes_in(start, end) if isinstance(one.what, Gap)]
        for stop in (*(gap.index for gap in gaps), end):
            for rows in self._store.batches(start, stop):
                motors.observe(rows)
                yield rows
            if gaps and stop == gaps[0].index:
                gap = gaps.pop(0).what
                motors.interrupt(gap if isinstance(gap, Gap) else None)
            start = stop

    def past(self, index: int, from_ns: int) -> tuple[Traces, MotorEvents]:
        """The traces and the events from a time up to a row.

        They have full detail, unless that is more than `MOST_TRACED_ROWS`: then they are those of
        all rows, which are coarser for times long ago.
        """
        start = self._first_since(index, from_ns)
        if start is None:
            return self.traces, self.events
        traces, events, motors = Traces(), MotorEvents(), Motors()
        for rows in self._replay(motors, start, index + 1):
            traces.observe(rows)
            events.observe(rows, motors)
            events.observe_facts(rows)
        return traces, events

    def _first_since(self, index: int, from_ns: int) -> int | None:
        """Index of a row at or before that time; None if it is too far before `index`."""
        start = index + 1
        first = max(self._store.first, index + 1 - MOST_TRACED_ROWS)
        while start > first:
            at = max(first, start - self._checkpoint_rows)
            begin, found = at, None
            for batch in self._store.batches(at, start):
                early = np.flatnonzero(batch.timed & (batch.t_ns < from_ns))
                if len(early):
                    found = begin + int(early[-1])
                begin += len(batch)
            if found is not None:
                return found
            start = at
        return start if start == self._store.first else None


_index: Final = attrgetter("index")


class ShownStreams:
    """The streams of the rows that the store's filter shows; gaps are not considered."""

    def __init__(self, store: RowStore) -> None:
        self._store = store
        self._begin()

    def _begin(self) -> None:
        self._filter = self._store.view.filter
        self._streams = Streams()
        self._ports: list[str] = []
        self._observed = self._store.first
        """Index after the last observed row."""

    @property
    def pending(self) -> int:
        """Rows that were not observed yet."""
        return self._store.next - max(self._observed, self._store.first)

    def step(self, budget_rows: int) -> bool:
        """Observe the next rows, once the filter was applied to all; True if none is left."""
        view = self._store.view
        if view.filter is not self._filter or self._observed > self._store.next:
            self._begin()
        if view.pending:
            return False
        self._observed = max(self._observed, self._store.first)
        end = min(self._observed + budget_rows, self._store.next)
        while self._observed < end:
            block = self._store.block_at(self._observed)
            offsets, stop = view.offsets(block), min(end, block.end) - block.start
            first, last = offsets.searchsorted((self._observed - block.start, stop))
            if last > first:
                rows = self._store.in_memory(block).rows.select(offsets[first:last])
                self._ports = list(rows.ports)
                self._streams.observe(rows)
            self._observed = block.start + stop
        return not self.pending

    def stats(self, now_ns: int | None) -> list[StreamStats]:
        """By port, kind and motor; `now_ns` is not before the last row."""
        return self._streams.stats(self._ports, now_ns)
