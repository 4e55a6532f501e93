"""Feeds of files for a view: as fast as they are read, or as fast as the rows came."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from fte_sniff.analysis.feed import Feed, FeedState, FeedUpdate
from fte_sniff.errors import FteSniffError, TranslatableText
from fte_sniff.protocol import Gap, GapKind, PortEvent
from fte_sniff.protocol.items import Change
from fte_sniff.protocol.rows import NO_ROWS, NO_TIME, Item, Rows
from fte_sniff.session.following import Following

MAX_READ_AHEAD = 6
"""Largest number of batches that are read ahead of the view."""

MAX_ROWS_PER_POLL = 200_000
"""A poll returns at most about this many rows, so that a screen can draw in between."""


def update_of(state: FeedState, items: Iterable[Item]) -> FeedUpdate:
    """The update of a feed with these items."""
    parts, events, changes, count = list[Rows](), list[PortEvent](), list[Change](), 0
    for item in items:
        if isinstance(item, Rows):
            parts.append(item)
            count += len(item)
        elif isinstance(item, PortEvent):
            events.append(item)
        else:
            changes.append(Change(count, item))
    return FeedUpdate(state, Rows.concat(parts), events, changes)


class ReplaySession:
    """Feeds the rows of files to one view."""

    error: FteSniffError | None = None
    """Why reading stopped before the end; None if it did not."""

    def __init__(
        self,
        items: Iterable[Item],
        title: str,
        total: int | None = None,
        files: Sequence[str] = (),
        following: Following | None = None,
    ) -> None:
        """Start reading: one batch first, and the others after the view has polled it.

        So an opening screen draws its first rows without delay.

        Args:
            items: iterated in a thread.
            title: the name to show.
            total: approximate number of rows; None if unknown.
            files: paths of the files.
            following: None for a file that does not grow.
        """
        self._following = following
        self._is_live = False
        self._expected_rows, self._files = total, files
        self._source = items
        self._title = title
        self._rows = 0
        self._stop = threading.Event()
        self._resumed = threading.Event()
        self._polled_rows = False
        self._losses: list[str] = []
        self._queue: queue.Queue[Item | None] = queue.Queue(MAX_READ_AHEAD)
        self._running = True
        self._thread = threading.Thread(target=self._run, name="reads the file", daemon=True)
        self._thread.start()

    def poll(self) -> FeedUpdate:
        """Return what was read since the previous poll, without blocking."""
        if self._polled_rows:
            self._resumed.set()
        reads: list[Item] = []
        while self._running and _has_room(reads):
            try:
                batch = self._queue.get_nowait()
            except queue.Empty:
                break
            if batch is None:
                self._running = False
            else:
                reads.append(batch)
        if self._following is not None and self._following.is_up_to_date and self._queue.empty():
            self._is_live = True
        for item in reads:
            if isinstance(item, Gap) and item.kind is GapKind.DAMAGE:
                self._losses.append(item.reason)
            self._rows += len(item) if isinstance(item, Rows) else 0
        self._polled_rows |= bool(reads)
        return update_of(self._state(), reads)

    def stop(self) -> None:
        """Stop reading; does not block."""
        self._stop.set()
        self._resumed.set()
        if self._following is not None:
            self._following.stop()

    def _state(self) -> FeedState:
        progress = None
        if self._running and self._expected_rows:
            progress = min(1.0, self._rows / self._expected_rows)
        return FeedState(
            title=self._title if self._following is None else self._following.name,
            running=self._running,
            ended=None if self._running else self._end(),
            trouble=_damaged(self._losses),
            live=self._is_live,
            follows=self._following is not None,
            rows=self._rows,
            progress=progress,
            files=self._files,
        )

    def _end(self) -> str | None:
        """Why the rows ended; None at the end of a file that does not grow."""
        if self.error is not None:
            return self.error.message
        return None if self._following is None else self._following.ended

    def _run(self) -> None:
        try:
            for batch in self._source:
                if not self._put(batch):
                    return
                self._resumed.wait()
        except FteSniffError as error:
            self.error = error
        self._put(None)

    def _put(self, batch: Item | None) -> bool:
        while not self._stop.is_set():
            try:
                self._queue.put(batch, timeout=0.1)
            except queue.Full:
                continue
            return True
        return False


def _damaged(losses: Sequence[str]) -> str | None:
    """The first loss and the number of further ones; None without any."""
    if not losses:
        return None
    if len(losses) == 1:
        return TranslatableText("the file is damaged: {loss}", loss=losses[0])
    return TranslatableText(
        "the file is damaged: {loss}; {count:,} more are reported at the end",
        loss=losses[0],
        count=len(losses) - 1,
    )


def _has_room(reads: list[Item]) -> bool:
    return sum(len(read) for read in reads if isinstance(read, Rows)) < MAX_ROWS_PER_POLL


class Played:
    """Another feed's rows as fast as they came, or `speed` times as fast."""

    def __init__(
        self, feed: Feed, speed: float, clock: Callable[[], int] = time.monotonic_ns
    ) -> None:
        """Play from now on, by a clock in nanoseconds."""
        self._feed, self._speed, self._clock = feed, speed, clock
        self._rows, self._given = NO_ROWS, 0
        self._changes: list[Change] = []
        self._events: list[PortEvent] = []
        self._began: tuple[int, int] | None = None
        """Time of the clock and of the rows at the start."""

    def poll(self) -> FeedUpdate:
        """The rows whose time has come."""
        update = self._feed.poll()
        self._changes += _shifted(update.changes, len(self._rows))
        self._events += update.events
        self._rows = Rows.concat([one for one in (self._rows, update.rows) if len(one)])
        count = self._due_rows()
        last_ns = int(self._rows.t_ns[:count].max(initial=NO_TIME))
        is_over = count == len(self._rows) and not update.state.running
        rows, self._rows = self._rows[:count], self._rows[count:]
        changes = [one for one in self._changes if one.index < count or is_over]
        self._changes = _shifted(self._changes[len(changes) :], -count)
        events = [one for one in self._events if one.t_ns <= last_ns or is_over]
        self._events = [one for one in self._events if one not in events]
        self._given += count
        state = replace(update.state, running=not is_over, rows=self._given, progress=None)
        return FeedUpdate(state, rows, events, changes)

    def _due_rows(self) -> int:
        """The number of rows whose time has come; rows without a time come with those before."""
        t_ns, now_ns = np.maximum.accumulate(self._rows.t_ns), self._clock()
        timed = t_ns[t_ns != NO_TIME]
        if self._began is None and len(timed):
            self._began = now_ns, int(timed[0])
        if self._began is None:
            return len(t_ns)
        since_ns, first_ns = self._began
        until_ns = first_ns + round((now_ns - since_ns) * self._speed)
        return int(np.searchsorted(t_ns, until_ns, side="right"))

    def stop(self) -> None:
        """Stop the other feed."""
        self._feed.stop()


def _shifted(changes: Iterable[Change], by: int) -> list[Change]:
    return [replace(change, index=change.index + by) for change in changes]
