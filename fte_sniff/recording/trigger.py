"""Keep rows only around rows that match."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from itertools import pairwise, takewhile
from typing import TypeAlias

import numpy as np

from fte_sniff.errors import TranslatableText
from fte_sniff.protocol import Gap, GapKind, PortEvent
from fte_sniff.protocol.rows import NO_ROWS, Bools, Ints, Rows
from fte_sniff.recording.retention import TriggerWindow

MAX_WAITING_ROWS = 500_000
"""Rows that may wait for a trigger, about 25 MB; of more, the oldest are dropped."""

Select: TypeAlias = Callable[[Rows], Bools]
"""Selects rows: whether each of them matches."""

_EMPTY = Gap(GapKind.LEFT_OUT, 0, reason=TranslatableText("they are outside the trigger window"))
_NEVER, _EVER = -1, 2**63 - 1


class Trigger:
    """Selects the rows around those that match; `gaps` reports the others."""

    def __init__(self, matches: Select, window: TriggerWindow) -> None:
        self._matches = matches
        self._before_ns = round(window.before_s * 1e9)
        self._after_ns = round(window.after_s * 1e9)
        self._until_ns = _NEVER
        self._waiting: deque[Rows] = deque()
        self._waiting_rows = 0
        self._events: deque[PortEvent] = deque()
        self._gap = _EMPTY
        self._gaps: list[Gap] = []
        self.seen = self.dropped = 0
        """All rows, and those of them that were not kept."""
        self.events = 0
        """How often it fired while it kept nothing."""

    def select(self, rows: Rows) -> Rows:
        """The rows to keep after these; they may include earlier ones. Port events are all kept."""
        kept: list[Rows] = []
        self._events.extend(rows.events)
        if len(rows):
            self.seen += len(rows)
            t_ns = np.maximum.accumulate(rows.t_ns)
            matches = self._matches(rows)
            nexts = np.minimum.accumulate(np.where(matches, t_ns, _EVER)[::-1])[::-1]
            if matches.any():
                self._expire(int(nexts[0]) - self._before_ns)
                kept += self._waiting
                self._waiting.clear()
                self._waiting_rows = 0
            kept += self._kept(rows, self._until(matches, t_ns) | (t_ns >= nexts - self._before_ns))
            self._expire(int(t_ns[-1]) - self._before_ns)
        next_ns = int(self._waiting[0].t_ns[0]) if self._waiting else _EVER
        events = list(takewhile(lambda event: event.t_ns < next_ns, self._events))
        for _ in events:
            self._events.popleft()
        return Rows.concat(kept).with_columns(events=events)

    def _until(self, matches: Bools, t_ns: Ints) -> Bools:
        """Which rows match, or are in the window after one that does."""
        ends = np.maximum.accumulate(np.where(matches, t_ns + self._after_ns, self._until_ns))
        self.events += int((matches & (t_ns > np.append(self._until_ns, ends[:-1]))).sum())
        self._until_ns = int(ends[-1])
        found: Bools = t_ns <= ends
        return found

    def _kept(self, rows: Rows, keeps: Bools) -> Iterator[Rows]:
        """The rows to keep; those after the last of them wait."""
        edges = [0, *(np.flatnonzero(np.diff(keeps)) + 1).tolist(), len(rows)]
        for start, stop in pairwise(edges):
            run = rows[start:stop]
            if keeps[start]:
                self._close_gap()
                yield run
            elif stop < len(rows):
                self._drop(run)
            else:
                self._waiting.append(run)
                self._waiting_rows += len(run)

    def flush(self) -> Rows:
        """The events that still wait; the rows that wait are dropped."""
        self._expire(_EVER)
        self._close_gap()
        events = list(self._events)
        self._events.clear()
        return NO_ROWS.with_columns(events=events)

    def gaps(self) -> list[Gap]:
        """The gaps that ended since the previous call."""
        gaps, self._gaps = self._gaps, []
        return gaps

    def _expire(self, oldest_ns: int) -> None:
        """Drop the rows that wait and are earlier, or too many."""
        while self._waiting:
            run = self._waiting.popleft()
            old = int(np.maximum.accumulate(run.t_ns).searchsorted(oldest_ns))
            count = min(len(run), max(old, self._waiting_rows - MAX_WAITING_ROWS))
            self._waiting_rows -= count
            self._drop(run[:count])
            if count < len(run):
                self._waiting.appendleft(run[count:])
                return

    def _drop(self, rows: Rows) -> None:
        if (extent := rows.extent) is not None:
            first_ns, last_ns, count = extent
            self.dropped += count
            self._gap = self._gap.including(first_ns, count).including(last_ns, 0)

    def _close_gap(self) -> None:
        if self._gap.rows:
            self._gaps.append(self._gap)
            self._gap = _EMPTY
