"""Keep rows only around rows that match."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import TypeAlias

from fte_sniff.protocol import Gap, GapKind, PortEvent, Row
from fte_sniff.recording.retention import TriggerWindow

MOST_WAITING = 500_000
"""Rows that wait at most, some 100 MB; the oldest are left out where there are more."""

Entry: TypeAlias = Row | PortEvent
_NO_ROWS = Gap(GapKind.LEFT_OUT, 0, reason="the trigger did not ask for them")

Select: TypeAlias = Callable[[Sequence[Row]], list[Row]]
"""Picks rows: those of the given ones, themselves and in their order."""


class Trigger:
    """Decides of each row whether it is kept; `gaps` reports the others."""

    def __init__(self, select: Select, around: TriggerWindow) -> None:
        """Take what picks the rows, and how much is kept around each."""
        self._select = select
        self._before_ns = round(around.before_s * 1e9)
        self._after_ns = round(around.after_s * 1e9)
        self._until_ns = -1
        self._waiting: deque[Entry] = deque()
        self._rows_waiting = 0
        self._gap = _NO_ROWS
        self._gaps: list[Gap] = []
        self.taken = self.dropped = 0
        """Rows that came, and those of them that were left out."""
        self.events = 0
        """How often it fired after it had kept nothing."""

    def rows(self, rows: Sequence[Row]) -> list[Entry]:
        """What is kept, now that these rows have come; older ones may be among it."""
        kept: list[Entry] = []
        self.taken += len(rows)
        picked = iter(self._select(rows))
        wanted = next(picked, None)
        for row in rows:
            t_ns = row.t_ns or 0
            if row is wanted:
                wanted = next(picked, None)
                self._release(t_ns, kept)
                self.events += t_ns > self._until_ns
                self._until_ns = max(self._until_ns, t_ns + self._after_ns)
                kept.append(row)
            elif t_ns <= self._until_ns:
                kept.append(row)
            else:
                self._waiting.append(row)
                self._rows_waiting += 1
                self._expire(t_ns - self._before_ns, kept)
        return kept

    def event(self, event: PortEvent) -> list[Entry]:
        """What is kept, now that this event has come."""
        if event.t_ns <= self._until_ns:
            return [event]
        self._waiting.append(event)
        kept: list[Entry] = []
        self._expire(event.t_ns - self._before_ns, kept)
        return kept

    def end(self) -> list[Entry]:
        """The events that waited; the rows that did are left out."""
        kept: list[Entry] = []
        while self._waiting:
            self._drop(kept)
        self._close()
        return kept

    def gaps(self) -> list[Gap]:
        """The gaps that ended since the previous call."""
        gaps, self._gaps = self._gaps, []
        return gaps

    def _release(self, t_ns: int, kept: list[Entry]) -> None:
        """Give out what waited and is not too old for a row at `t_ns`."""
        self._expire(t_ns - self._before_ns, kept)
        kept += self._waiting
        self._waiting.clear()
        self._rows_waiting = 0
        self._close()

    def _expire(self, oldest_ns: int, kept: list[Entry]) -> None:
        while self._waiting and (
            self._rows_waiting > MOST_WAITING or (self._waiting[0].t_ns or 0) < oldest_ns
        ):
            self._drop(kept)

    def _drop(self, kept: list[Entry]) -> None:
        entry = self._waiting.popleft()
        if isinstance(entry, PortEvent):
            kept.append(entry)
            return
        self._rows_waiting -= 1
        self.dropped += 1
        self._gap = self._gap.including(entry.t_ns or 0)

    def _close(self) -> None:
        if self._gap.rows:
            self._gaps.append(self._gap)
            self._gap = _NO_ROWS
