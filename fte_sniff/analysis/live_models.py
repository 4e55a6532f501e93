"""Models that follow a growing store, with checkpoints of motor state for any row.

rows    |-----------|-----------|-----------|------>
states  s0          s1          s2    ^ wanted: s2, and the rows since
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import deque
from collections.abc import Sequence
from operator import attrgetter
from typing import Final

from fte_sniff.analysis.feed import StreamChange
from fte_sniff.analysis.fields import Decoded, timed
from fte_sniff.analysis.motor_stats import FlagsSeen
from fte_sniff.analysis.motors import Motors, addressed
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.statistics import LineSetup, Statistics
from fte_sniff.analysis.traces import Traces
from fte_sniff.protocol import Gap, GapKind

STATE_EVERY: Final = 32_768
"""Rows between two states that are kept."""

MOST_ROWS_TRACED: Final = 300_000
"""Rows at most that are traced anew for a look at the past; more would be felt."""


class LiveModels:
    """Motors, their traces, flags and the statistics of all rows that went through a store."""

    def __init__(self, store: RowStore, bench: LineSetup, state_every: int = STATE_EVERY) -> None:
        """Nothing was looked at yet.

        Args:
            store: where the rows are; it may go on to grow.
            bench: what the user said about the set-up.
            state_every: rows between two states that are kept, at least 1.
        """
        self._store = store
        self._every = state_every
        self._next = 0
        self._states: deque[tuple[int, Motors]] = deque([(0, Motors())])
        self._changes: list[StreamChange] = []
        self._observed = 0
        self.motors = Motors()
        self.traces = Traces()
        self.statistics = Statistics(bench)
        self.flags = FlagsSeen()
        self.missed = 0
        """Rows that had left the store before they were looked at."""

    @property
    def behind(self) -> int:
        """Rows in the store that were not looked at yet."""
        return self._store.next - max(self._next, self._store.first)

    def step(self, budget_rows: int) -> bool:
        """Look at the next rows, at most so many; True when none is left."""
        self._skip_what_left()
        end = min(self._next + budget_rows, self._store.next)
        while self._next < end:
            stop = min(end, (self._next // self._every + 1) * self._every)
            self._observe_up_to(self._next)
            if self._observed < len(self._changes):
                stop = min(stop, self._changes[self._observed].index)
            for packed in self._store.packed(self._next, stop):
                rows = Decoded(packed)
                found = addressed(rows)
                self.motors.add(rows, found)
                self.flags.add(rows, found)
                self.traces.add(rows)
                self.statistics.add(rows, self._store.codebook)
            self._next = stop
            if stop % self._every == 0:
                self._states.append((stop, self.motors.copied()))
        self._forget_what_left()
        return not self.behind

    def add_changes(self, changes: Sequence[StreamChange]) -> None:
        """Note the changes between rows that the next steps process.

        Args:
            changes: by rising index, which is the row's in the store.
        """
        self._changes += changes

    def _observe_up_to(self, index: int) -> None:
        """What is looked at next is the row of that index."""
        while self._observed < len(self._changes) and self._changes[self._observed].index <= index:
            change = self._changes[self._observed].what
            self.statistics.observe_change(change)
            if isinstance(change, Gap):
                self.motors.interrupt()
            self._observed += 1

    def _skip_what_left(self) -> None:
        gone = self._store.first - self._next
        if gone > 0:
            self.missed += gone
            self._next += gone
            left = StreamChange(self._next, Gap(GapKind.NOT_SHOWN, gone))
            insort(self._changes, left, key=_index)

    def _forget_what_left(self) -> None:
        """Keep one state from before the oldest row, to start from."""
        while len(self._states) > 1 and self._states[1][0] <= self._store.first:
            self._states.popleft()
        gone = min(self._observed, bisect_left(self._changes, self._states[0][0], key=_index))
        del self._changes[:gone]
        self._observed -= gone

    def motors_at(self, index: int) -> Motors | None:
        """The motors right after the row of that index; None where it was not looked at yet."""
        end = index + 1
        if end > self._next:
            return None
        if end == self._next:
            return self.motors
        start, state = next(kept for kept in reversed(self._states) if kept[0] <= end)
        motors = state.copied()
        first, last = (bisect_left(self._changes, at, key=_index) for at in (start, end))
        for change in self._changes[first:last]:
            if isinstance(change.what, Gap):
                self._add(motors, start, change.index)
                motors.interrupt()
                start = change.index
        self._add(motors, start, end)
        return motors

    def _add(self, motors: Motors, start: int, end: int) -> None:
        for packed in self._store.packed(start, end):
            motors.add(Decoded(packed))

    def traces_at(self, index: int, from_ns: int) -> Traces:
        """The traces around a row, back to a time: in full detail where that is not too much.

        Otherwise they are those over all rows, which know less of what is long past.
        """
        start = self._first_from(index, from_ns)
        if start is None:
            return self.traces
        traces = Traces()
        for packed in self._store.packed(start, index + 1):
            traces.add(Decoded(packed))
        return traces

    def _first_from(self, index: int, from_ns: int) -> int | None:
        """Where the rows since that time begin; None where that is too far before `index`."""
        start = index + 1
        first = max(self._store.first, index + 1 - MOST_ROWS_TRACED)
        while start > first:
            at = max(first, start - self._every)
            times = [p["t_ns"][timed(p)] for p in self._store.packed(at, start)]
            if any(len(t_ns) and t_ns[0] < from_ns for t_ns in times):
                return at
            start = at
        return start if start == self._store.first else None


_index = attrgetter("index")
