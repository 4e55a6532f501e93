"""Keep rows only around rows that match."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import TypeAlias

from fte_sniff.errors import TranslatableText
from fte_sniff.protocol import Gap, GapKind, PortEvent, Row
from fte_sniff.recording.retention import TriggerWindow

MAX_WAITING_ROWS = 500_000
"""Rows that may wait for a trigger, about 100 MB; of more, the oldest are dropped."""

Entry: TypeAlias = Row | PortEvent
Select: TypeAlias = Callable[[Sequence[Row]], list[Row]]
"""Selects rows: returns some of the given objects, in their order."""

_EMPTY = Gap(GapKind.LEFT_OUT, 0, reason=TranslatableText("they are outside the trigger window"))


class Trigger:
    """Selects the rows around those that match; `gaps` reports the others."""

    def __init__(self, matches: Select, window: TriggerWindow) -> None:
        self._matches = matches
        self._before_ns = round(window.before_s * 1e9)
        self._after_ns = round(window.after_s * 1e9)
        self._until_ns = -1
        self._waiting: deque[Entry] = deque()
        self._waiting_rows = 0
        self._gap = _EMPTY
        self._gaps: list[Gap] = []
        self.seen = self.dropped = 0
        """All rows, and those of them that were not kept."""
        self.events = 0
        """How often it fired while it kept nothing."""

    def select(self, rows: Sequence[Row]) -> list[Entry]:
        """The entries to keep after these rows; they may include earlier ones."""
        kept: list[Entry] = []
        self.seen += len(rows)
        matching = iter(self._matches(rows))
        match = next(matching, None)
        for row in rows:
            t_ns = row.t_ns or 0
            if row is match:
                match = next(matching, None)
                self._release(t_ns, kept)
                self.events += t_ns > self._until_ns
                self._until_ns = max(self._until_ns, t_ns + self._after_ns)
                kept.append(row)
            elif t_ns <= self._until_ns:
                kept.append(row)
            else:
                self._waiting.append(row)
                self._waiting_rows += 1
                self._expire(t_ns - self._before_ns, kept)
        return kept

    def select_event(self, event: PortEvent) -> list[Entry]:
        """The entries to keep after this event."""
        if event.t_ns <= self._until_ns:
            return [event]
        self._waiting.append(event)
        kept: list[Entry] = []
        self._expire(event.t_ns - self._before_ns, kept)
        return kept

    def flush(self) -> list[Entry]:
        """The events that still wait; the rows that wait are dropped."""
        kept: list[Entry] = []
        while self._waiting:
            self._drop(kept)
        self._close_gap()
        return kept

    def gaps(self) -> list[Gap]:
        """The gaps that ended since the previous call."""
        gaps, self._gaps = self._gaps, []
        return gaps

    def _release(self, t_ns: int, kept: list[Entry]) -> None:
        """Keep the waiting entries in the window before a match at `t_ns`."""
        self._expire(t_ns - self._before_ns, kept)
        kept += self._waiting
        self._waiting.clear()
        self._waiting_rows = 0
        self._close_gap()

    def _expire(self, oldest_ns: int, kept: list[Entry]) -> None:
        while self._waiting and (
            self._waiting_rows > MAX_WAITING_ROWS or (self._waiting[0].t_ns or 0) < oldest_ns
        ):
            self._drop(kept)

    def _drop(self, kept: list[Entry]) -> None:
        """Drop the oldest entry that waits; events are kept all the same."""
        entry = self._waiting.popleft()
        if isinstance(entry, PortEvent):
            kept.append(entry)
            return
        self._waiting_rows -= 1
        self.dropped += 1
        self._gap = self._gap.including(entry.t_ns or 0)

    def _close_gap(self) -> None:
        if self._gap.rows:
            self._gaps.append(self._gap)
            self._gap = _EMPTY
