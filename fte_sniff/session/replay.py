"""Feeds of files for a view: as fast as they are read, or as fast as the rows came."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress

import numpy as np

from fte_sniff.analysis.feed import FeedState, FeedUpdate
from fte_sniff.errors import FteSniffError, TranslatableText
from fte_sniff.protocol.items import Change, Gap, GapKind, PortEvent
from fte_sniff.protocol.rows import Item, Rows
from fte_sniff.session.following import Follower
from fte_sniff.session.merge import EVER

MAX_READ_AHEAD = 6
"""Largest number of batches that are read ahead of the view."""

CLOSE_WITHIN_S = 2.0
"""Longest time that the end waits for a read."""

PLAY_EVERY_S = 0.02
"""Interval at which rows are played."""

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
        follower: Follower | None = None,
        *,
        plays: bool = False,
    ) -> None:
        """Start reading: one batch first, and the others after the view has polled it.

        So an opening screen draws its first rows without delay.

        Args:
            items: iterated in a thread.
            title: the name to show.
            total: approximate number of rows; None if unknown.
            files: paths of the files.
            follower: None for a file that does not grow.
            plays: whether the rows come one after the other, as in a capture.
        """
        self._follower, self._expected_rows, self._files = follower, total, files
        self._source, self._title = items, title
        self._stop, self._resumed = threading.Event(), threading.Event()
        self._damage: str | None = None
        """The first damage; the end reports all."""
        self._rows, self._running, self._is_live = 0, True, plays
        self._follows = plays or follower is not None
        self._queue: queue.Queue[Item | None] = queue.Queue(MAX_READ_AHEAD)
        self._thread = threading.Thread(target=self._run, name="reads the file", daemon=True)
        self._thread.start()

    def poll(self) -> FeedUpdate:
        """Return what was read since the previous poll, without blocking."""
        reads, start = list[Item](), self._rows
        if start:
            self._resumed.set()
        while self._running and self._rows - start < MAX_ROWS_PER_POLL:
            try:
                item = self._queue.get_nowait()
            except queue.Empty:
                break
            if item is None:
                self._running = False
                break
            reads.append(item)
            self._rows += len(item) if isinstance(item, Rows) else 0
            if isinstance(item, Gap) and item.kind is GapKind.DAMAGE:
                own = TranslatableText("the file is damaged: {loss}", loss=item.reason)
                self._damage = self._damage or own
        self._is_live |= (
            self._follower is not None and self._follower.is_up_to_date and self._queue.empty()
        )
        return update_of(self._state(), reads)

    def stop(self) -> None:
        """Stop reading; does not block."""
        self._stop.set()
        self._resumed.set()
        if self._follower is not None:
            self._follower.stop()

    def close(self) -> None:
        """Stop reading, and wait until it has stopped: it needs threads, which the exit ends."""
        self.stop()
        self._thread.join(CLOSE_WITHIN_S)

    def _state(self) -> FeedState:
        follower, ended = self._follower, None
        if not self._running:
            ended = follower.ended if follower is not None else None
            ended = self.error.message if self.error is not None else ended
        total = self._expected_rows if self._running else None
        return FeedState(
            title=self._title if follower is None else str(follower.reader.path),
            running=self._running,
            ended=ended,
            trouble=self._damage,
            live=self._is_live,
            follows=self._follows,
            rows=self._rows,
            progress=min(1.0, self._rows / total) if total else None,
            files=self._files,
        )

    def _run(self) -> None:
        try:
            for item in self._source:
                if not self._put(item):
                    return
                if isinstance(item, Rows) and len(item):
                    self._resumed.wait()
        except FteSniffError as error:
            self.error = error
        self._put(None)

    def _put(self, item: Item | None) -> bool:
        while not self._stop.is_set():
            with suppress(queue.Full):
                self._queue.put(item, timeout=0.1)
                return True
        return False


def played(items: Iterable[Item], speed: float) -> Iterator[Item]:
    """The items as fast as they came, or `speed` times as fast.

    Rows without a time, and what is between rows, come with the row before them.
    """
    began_ns = first_ns = None
    for item in items:
        left = item
        while isinstance(left, Rows) and len(left):
            times = np.maximum.accumulate(left.t_ns)
            if began_ns is None and left.timed.any():
                began_ns, first_ns = time.monotonic_ns(), int(left.t_ns[left.timed][0])
            until_ns = EVER
            if began_ns is not None and first_ns is not None:
                until_ns = first_ns + round((time.monotonic_ns() - began_ns) * speed)
            count = int(np.searchsorted(times, until_ns, side="right"))
            yield left[:count]
            left = left[count:]
            if len(left):
                time.sleep(PLAY_EVERY_S)
        if not isinstance(item, Rows):
            yield item
