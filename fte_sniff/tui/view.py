"""What is viewed: the rows of a feed, those that are shown, and the span that is looked at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
import polars as pl

from fte_sniff.analysis.feed import FeedState, FeedUpdate
from fte_sniff.analysis.motors import MotorState, motors_at
from fte_sniff.analysis.relations import NONE, AnswerState, answers
from fte_sniff.analysis.store import RowStore
from fte_sniff.analysis.tally import Tally
from fte_sniff.protocol.items import BaudChange, GapKind, PortEventKind
from fte_sniff.protocol.rows import Row, Rows
from fte_sniff.protocol.spec import DEFAULT_BAUD, byte_time_ns
from fte_sniff.session.feeds import ItemFeed
from fte_sniff.tui.shown import Shown

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import Alert, RowFilter
    from fte_sniff.analysis.findings import Finding

WINDOW_NS: Final = 10_000_000_000
"""The time before the cursor, or now, of which the motor strip shows the answers."""

AROUND: Final = 2_500
"""Rows before and after a row among which its command, its answer and the frame before it are:
those of a second of two full lines."""

_STEP: Final = 500
"""Rows that share what is around them: the cursor moves by small steps."""

RATE_NS: Final = 2_000_000_000
"""Window of the rate of frames."""
MOST_WINDOW: Final = 60_000
"""Most rows of a window of `WINDOW_NS`: twice those of two full lines."""


@dataclass(frozen=True)
class Around:
    """Some rows with their relations."""

    first: int
    """Index of the first of them."""
    rows: Rows
    pairs: pl.DataFrame
    """Their `answers`; its indices count from `first`."""

    def command_of(self, index: int) -> int | None:
        """The command that a row answers."""
        found = self.pairs.filter(pl.col("answer") == index - self.first)["command"]
        return None if found.is_empty() else int(found[0]) + self.first

    def answers_of(self, index: int) -> list[Answered]:
        """What is known of the answers to a command, by motor."""
        found = self.pairs.filter(pl.col("command") == index - self.first)
        columns = found.select("motor", "answer", "state", "delay_ns")
        return [
            Answered(motor, None if at == NONE else at + self.first, AnswerState(state), delay_ns)
            for motor, at, state, delay_ns in columns.iter_rows()
        ]


@dataclass(frozen=True, slots=True)
class Answered:
    """The answer to a command, of one motor."""

    motor: int
    answer: int | None
    """Its index."""
    state: AnswerState
    delay_ns: int | None


def around(store: RowStore, start: int, end: int) -> Around:
    """The rows from one index up to another, with those `AROUND` them."""
    first, last = max(0, start - AROUND), min(store.next, end + AROUND)
    rows, runs = store.batch(first, last), store.runs(first, last)
    return Around(first, rows, answers(rows, runs))


@dataclass(frozen=True, slots=True)
class Span:
    """The rows that strip and pane are about, by index, half open."""

    start: int
    end: int
    start_ns: int | None
    now_ns: int | None
    """Its first and its last moment; None without times."""


_PLACED: Final = frozenset(PortEventKind) - {PortEventKind.LINE_ERROR}
"""Events that have a line between the rows; line errors are faults of rows."""


class View:
    """A feed, the store of its rows, those that are shown, and counts over all."""

    def __init__(self, feed: ItemFeed, pulses_per_turn: float | None, alert: Alert | None) -> None:
        self.store = RowStore()
        self.shown = Shown(self.store)
        self.pulses_per_turn, self.alert = pulses_per_turn, alert
        self.filter: RowFilter | None = None
        self.state, self.tally = FeedState("", live=False), Tally()
        self.finding: Finding | None = None
        """The finding whose span is looked at; None for the time before the cursor, or now."""
        self.first_ns: int | None = None
        self.last_ns: int | None = None
        """The earliest and the latest time of a row."""
        self._bauds: dict[str, int] = {}
        self._feed = feed
        self._newest_at_ns = 0
        self._around: tuple[tuple[int, int], Around] | None = None

    # Rows

    def poll(self, now_ns: int) -> FeedUpdate:
        """Take what came since the last poll; raises FteSniffError if the feed failed.

        `now_ns` is of a monotonic clock.
        """
        update = self._feed.poll()
        ended = self.state.running and not update.state.running
        self.state = update.state
        self._store(update)
        if len(update.rows):
            self.tally.observe(update.rows)
            self._newest_at_ns = now_ns
            self.first_ns, self.last_ns = self.tally.times or (None, None)
        if ended:
            self.store.end()
        self.shown.follow()
        return update

    def _store(self, update: FeedUpdate) -> None:
        """Store rows, and what happened between them."""
        done = 0
        for change in update.changes:
            if change.index > done:
                self.store.append(update.rows.select(slice(done, change.index)))
                done = change.index
            self.store.append(change.what)
            if isinstance(change.what, BaudChange):
                self._bauds[change.what.port] = change.what.baud
            elif self.store.next and change.what.kind is not GapKind.PORT:
                # Before the first row nothing is missing; events of ports have their own lines.
                self.shown.place(change.what, self.store.next)
        if len(update.rows) > done:
            self.store.append(update.rows.select(slice(done, None)))
        for event in update.events:
            self.store.append(event)
            if event.kind in _PLACED:
                self.shown.place(event, self.store.index_at(event.t_ns))

    @property
    def lives(self) -> bool:
        """Whether rows come as they happen."""
        return self.state.live and self.state.running

    @property
    def at_rest(self) -> bool:
        """Whether nothing changes without the user."""
        return not self.state.running and not self.shown.pending

    def frames_per_s(self, clock_ns: int) -> float | None:
        """In the last two seconds of a capture, or in its last `MOST_WINDOW` rows where these are
        fewer seconds; on average over a file; None without times."""
        now_ns, frames, duration_ns = self.now_ns(clock_ns), self.tally.frames, 0
        if now_ns is not None and self.first_ns is not None:
            duration_ns = now_ns - self.first_ns
        if self.lives and now_ns is not None and duration_ns > RATE_NS:
            rows = self.store.batch(self.store.next - MOST_WINDOW, self.store.next)
            start_ns = max(now_ns - RATE_NS, int(rows.t_ns[0]))
            frames = int(np.count_nonzero(rows.framed & (rows.t_ns > start_ns)))
            duration_ns = now_ns - start_ns
        return frames * 1e9 / duration_ns if duration_ns > 0 else None

    def set_filter(self, row_filter: RowFilter | None) -> None:
        """Show only rows that pass the filter, or all."""
        self.filter = row_filter
        self.shown.set_filter(row_filter)
        self.shown.follow()

    def row(self, index: int) -> Row:
        """The row with an index."""
        return self.store.batch(index, index + 1)[0]

    def now_ns(self, clock_ns: int) -> int | None:
        """The time of the newest row; in a capture that runs, time passes also without rows."""
        if self.last_ns is None or not self.lives:
            return self.last_ns
        return self.last_ns + clock_ns - self._newest_at_ns

    def byte_ns(self, port: str) -> float:
        """The time of a byte on a port, nanoseconds."""
        return byte_time_ns(self._bauds.get(port, DEFAULT_BAUD))

    # Relations of a row

    def around(self, index: int) -> Around:
        """The rows around a row, with their relations."""
        first = index // _STEP * _STEP
        key = first, min(self.store.next, first + _STEP + AROUND)
        if self._around is None or self._around[0] != key:
            self._around = key, around(self.store, first, first + _STEP)
        return self._around[1]

    def related(self, index: int) -> list[int]:
        """The answers to a command, or the command that a row answers."""
        near = self.around(index)
        found = [one.answer for one in near.answers_of(index)]
        return [one for one in (*found, near.command_of(index)) if one is not None]

    # The span that is looked at

    def span(self, cursor: int | None, clock_ns: int) -> Span:
        """The span of the finding, else the time before the cursor's row; None: before now."""
        if self.finding is not None:
            first_ns, last_ns = self.finding.first_ns, self.finding.last_ns
            start, end = self.store.index_at(first_ns), self.store.index_at(last_ns + 1)
            return Span(start, end, first_ns, last_ns)
        end, now_ns = self.store.next, self.now_ns(clock_ns)
        if cursor is not None:
            end, now_ns = cursor + 1, self.row(cursor).t_ns
            if now_ns is not None and self.first_ns is not None:
                now_ns = max(now_ns, self.first_ns + WINDOW_NS)  # at the start, the first window
                end = max(end, self.store.index_at(now_ns))
        low = max(0, end - MOST_WINDOW)
        if now_ns is None:
            return Span(max(0, end - AROUND), end, None, None)
        t_ns = np.maximum.accumulate(self.store.batch(low, end).t_ns)
        start = low + int(np.searchsorted(t_ns, now_ns - WINDOW_NS))
        return Span(start, end, now_ns - WINDOW_NS, now_ns)

    def motors(self, span: Span) -> list[MotorState]:
        """The motors at the end of a span."""
        start = max(0, span.start - AROUND)
        rows = self.store.batch(start, span.end)
        return motors_at(rows, self.store.runs(start, span.end), span.now_ns)
