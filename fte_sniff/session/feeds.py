"""Feeds of a view: a thread reads items, and the view polls them.

    items ──thread──► queue ──poll──► FeedUpdate

A capture, a followed file and a file that is played differ in the iterator of their items.
"""

from __future__ import annotations

import queue
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress

import numpy as np

from fte_sniff.analysis.feed import FeedState, FeedUpdate
from fte_sniff.errors import FteSniffError, TranslatableText
from fte_sniff.protocol.items import Change, Gap, GapKind, PortEvent
from fte_sniff.protocol.rows import Item, Rows
from fte_sniff.session.following import Follower
from fte_sniff.session.merge import EVER

MAX_READ_AHEAD = 16
"""Largest number of items that are read ahead of the view."""

CLOSE_WITHIN_S = 2.0
"""Longest time that the end waits for a read."""

PLAY_EVERY_S = 0.02
"""Interval at which rows are played."""

MAX_ROWS_PER_POLL = 200_000
"""A poll returns at most about this many rows, so that a screen can draw in between."""


class ItemFeed(ABC):
    """Feeds items that a thread reads to one view; subclasses have the state and what stops it."""

    def __init__(self, items: Iterable[Item]) -> None:
        """Start the thread, which iterates the items."""
        self.error: FteSniffError | None = None
        """Why reading stopped before the end; None if it did not."""
        self.running = True
        """Whether the view has not had all items."""
        self.rows = 0
        """Rows that the view has had."""
        self.damage: str | None = None
        """The first damage of a file; the end reports all."""
        self._abandoned = threading.Event()
        self._queue: queue.Queue[Item | None] = queue.Queue(MAX_READ_AHEAD)
        self._thread = threading.Thread(
            target=self._read, args=(items,), name="reads items", daemon=True
        )
        self._thread.start()

    @abstractmethod
    def state(self) -> FeedState:
        """The state of the source."""

    @abstractmethod
    def stop(self) -> None:
        """Request the end, which a later poll reports; returns at once, may be called again."""

    def poll(self) -> FeedUpdate:
        """What was read since the previous call; never blocks; may be called after the end.

        The first rows come alone, so that a screen shows them soon.
        """
        return self._update(0, MAX_ROWS_PER_POLL if self.rows else 1)

    def wait(self, timeout_s: float) -> FeedUpdate:
        """The next rows, with what is before them; waits `timeout_s` seconds for something."""
        return self._update(timeout_s, 1)

    def _update(self, timeout_s: float, most_rows: int) -> FeedUpdate:
        parts, events, changes, count = list[Rows](), list[PortEvent](), list[Change](), 0
        while self.running and count < most_rows:
            try:
                item = self._queue.get(timeout=0 if parts or events or changes else timeout_s)
            except queue.Empty:
                break
            if item is None:
                self.running = False
            elif isinstance(item, Rows):
                parts.append(item)
                count += len(item)
            elif isinstance(item, PortEvent):
                events.append(item)
            else:
                changes.append(Change(count, item))
                if isinstance(item, Gap) and item.kind is GapKind.DAMAGE:
                    own = TranslatableText("the file is damaged: {loss}", loss=item.reason)
                    self.damage = self.damage or own
        self.rows += count
        return FeedUpdate(self.state(), Rows.concat(parts), events, changes)

    def close(self) -> None:
        """Stop reading, and wait until it has stopped: it needs threads, which the exit ends."""
        self._abandoned.set()
        self._thread.join(CLOSE_WITHIN_S)

    def _read(self, items: Iterable[Item]) -> None:
        try:
            for item in items:
                if self._abandoned.is_set():
                    break
                if not isinstance(item, Rows) or len(item):
                    self._put(item)
        except FteSniffError as error:
            self.error = error
        finally:
            self._put(None)

    def _put(self, item: Item | None) -> None:
        while not self._abandoned.is_set():
            with suppress(queue.Full):
                self._queue.put(item, timeout=0.1)
                return


class FileFeed(ItemFeed):
    """Feeds the items of files."""

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
        """Start reading.

        Args:
            items: iterated in a thread.
            title: the name to show.
            total: approximate number of rows; None if unknown.
            files: paths of the files.
            follower: None for a file that does not grow.
            plays: whether the rows come one after the other, as in a capture.
        """
        self._title, self._total, self._files, self._follower = title, total, files, follower
        self._follows, self._is_live = plays or follower is not None, plays
        super().__init__(items)

    def stop(self) -> None:
        """Stop reading; does not block."""
        self._abandoned.set()
        if self._follower is not None:
            self._follower.stop()

    def state(self) -> FeedState:
        """The state of the file."""
        follower, ended = self._follower, None
        self._is_live |= follower is not None and follower.is_up_to_date and self._queue.empty()
        if not self.running:
            ended = follower.ended if follower is not None else None
            ended = self.error.message if self.error is not None else ended
        total = self._total if self.running else None
        return FeedState(
            title=self._title if follower is None else str(follower.reader.path),
            running=self.running,
            ended=ended,
            trouble=self.damage,
            live=self._is_live,
            follows=self._follows,
            progress=min(1.0, self.rows / total) if total else None,
            files=self._files,
        )


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
