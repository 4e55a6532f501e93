"""Session that reads files for a view, playback of their rows, and pages that are read again."""

from __future__ import annotations

import queue
import threading
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from typing import Final

from fte_sniff.analysis.feed import SPEEDS, FeedState, FeedUpdate
from fte_sniff.analysis.model import Rate, StreamChange, Tally, shifted
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.errors import FteSniffError, TranslatableText
from fte_sniff.protocol.rows import NO_ROWS, Rows
from fte_sniff.session.following import Following
from fte_sniff.session.inputs import InputBatch

MAX_READ_AHEAD = 6
"""Largest number of batches that are read ahead of the view."""

MAX_ROWS_PER_POLL = 200_000
"""A poll returns at most about this many rows, so that a screen can draw in between."""


class ReplaySession:
    """Feeds the rows of files to one view."""

    error: FteSniffError | None = None
    """Why reading stopped before the end; None if it did not."""

    def __init__(
        self,
        batches: Iterable[InputBatch],
        title: str,
        total: int | None = None,
        files: Sequence[str] = (),
        pages: RecordingPages | None = None,
        following: Following | None = None,
    ) -> None:
        """Start reading: one batch first, and the others after the view has polled it.

        So an opening screen draws its first rows without delay.

        Args:
            batches: rows and events; iterated in a thread.
            title: the name to show.
            total: approximate number of rows; None if unknown.
            files: paths of the files.
            pages: receives the batches, which all can be read again.
            following: None for a file that does not grow.
        """
        self._following = following
        self._is_live = False
        self._expected_rows, self._files, self._pages = total, files, pages
        self._source = batches
        self._title = title
        self._rows = 0
        self._stop = threading.Event()
        self._resumed = threading.Event()
        self._polled_rows = False
        self._losses: list[str] = []
        self._queue: queue.Queue[InputBatch | None] = queue.Queue(MAX_READ_AHEAD)
        self._running = True
        self._thread = threading.Thread(target=self._run, name="reads the file", daemon=True)
        self._thread.start()

    def poll(self) -> FeedUpdate:
        """Return what was read since the previous poll, without blocking."""
        if self._polled_rows:
            self._resumed.set()
        reads: list[InputBatch] = []
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
        changes: list[StreamChange] = []
        count = 0
        for read in reads:
            self._losses += read.losses
            changes += shifted(read.changes, count)
            count += len(read.rows)
            if self._pages is not None and read.reload is not None:
                self._pages.append(read.reload, len(read.rows))
        self._polled_rows |= bool(reads)
        rows = Rows.concat([read.rows for read in reads if len(read.rows)])
        self._rows += len(rows)
        events = [event for read in reads for event in read.rows.events]
        return FeedUpdate(self._state(), rows, events, changes)

    def rest(self) -> None:
        """Pause reading until the next poll, after the current batch; does not block."""
        if not self._stop.is_set():
            self._resumed.clear()

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

    def _put(self, batch: InputBatch | None) -> bool:
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


def _has_room(reads: list[InputBatch]) -> bool:
    return sum(len(read.rows) for read in reads) < MAX_ROWS_PER_POLL


MAX_PLAYED_PER_STEP: Final = 100_000
"""Rows that one step of playback shows at most."""


class Playback:
    """Shows the rows of a store at the pace at which they came, from one row on."""

    def __init__(self, store: RowStore, index: int, speed: float, now_ns: int) -> None:
        """Hide the rows from an index on; their times give the pace.

        It sets the store's limit. The row at the index or a later one must have a time; `now_ns` is
        the present time of a monotonic clock.
        """
        self._store, self._now_ns = store, now_ns
        self.speed = speed
        self.paused = False
        self.tally = Tally()
        self._rate = Rate()
        for rows in store.batches(store.first, index):
            self.tally.observe(rows)
        self.t_ns = self._time_from(index)
        """The time that is played, nanoseconds since 1970 UTC."""
        store.limit = index

    def _time_from(self, index: int) -> int:
        """Time of the first row with one, from an index on."""
        for rows in self._store.batches(index, self._store.loaded):
            if rows.timed.any():
                return int(rows.t_ns[rows.timed][0])
        return self.tally.last_ns or 0

    @property
    def is_over(self) -> bool:
        """Whether all rows are shown."""
        return self._store.next >= self._store.loaded

    def advance(self, now_ns: int) -> Rows:
        """Show the rows that are due, and return them."""
        elapsed_ns, self._now_ns = now_ns - self._now_ns, now_ns
        if self.paused:
            return NO_ROWS
        self.t_ns += round(elapsed_ns * self.speed)
        start = self._store.next
        self._store.limit = None
        end = min(start + MAX_PLAYED_PER_STEP, self._store.loaded)
        shown = []
        for rows in self._store.batches(start, end):
            later = rows.timed & (rows.t_ns > self.t_ns)
            due = int(later.argmax()) if later.any() else len(rows)
            shown.append(rows[:due])
            if due < len(rows):
                break
        count = sum(map(len, shown))
        self._store.limit = start + count
        for rows in shown:
            self.tally.observe(rows)
        self._rate.observe(sum(int(rows.framed.sum()) for rows in shown), self.t_ns)
        return Rows.concat(shown)

    @property
    def frames_per_s(self) -> float | None:
        """Frames per second of the recorded time, lately."""
        return self._rate.per_second(self.t_ns)

    def change_speed(self, by: int) -> None:
        """Switch to the next speed (`by` 1) or the previous one (-1)."""
        number = bisect_right(SPEEDS, self.speed) if by > 0 else bisect_left(SPEEDS, self.speed) - 1
        self.speed = SPEEDS[min(max(number, 0), len(SPEEDS) - 1)]

    def stop(self) -> None:
        """Show all rows."""
        self._store.limit = None


MAX_CACHED: Final = 4
"""Batches in the cache: a filter works from the cursor in both directions, and the rows of one
block may be in two batches."""


class RecordingPages:
    """Reads rows of recordings again, with an LRU cache of batches; a `BlockSource`."""

    def __init__(self) -> None:
        """Create it without rows."""
        self._reloads: list[Callable[[], Rows]] = []
        self._starts: list[int] = []
        self._rows = 0
        self._batch = lru_cache(MAX_CACHED)(lambda number: self._reloads[number]())

    def append(self, reload: Callable[[], Rows], rows: int) -> None:
        """Append the next batch of `rows` rows, which `reload` reads again."""
        if rows:
            self._reloads.append(reload)
            # Last, because `load` searches this list in another thread.
            self._starts.append(self._rows)
            self._rows += rows

    def load(self, start: int, count: int) -> Rows:
        """The rows from index `start` on; see `BlockSource`.

        Raises FileError if the file changed, or cannot be read any more.
        """
        parts, done = list[Rows](), 0
        while done < count:
            number = bisect_right(self._starts, start + done) - 1
            first = start + done - self._starts[number]
            part = self._batch(number)[first : first + count - done]
            parts.append(part)
            done += len(part)
        # A copy, so that a block does not keep whole batches in memory.
        return Rows.concat([*parts, NO_ROWS])
