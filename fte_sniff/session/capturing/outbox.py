"""Owns the way from the capture process to the view: a thread that sends, and a bounded backlog.

It must not know what the rows are for. Putting never blocks. When the view does not keep up, the
oldest rows of the backlog are dropped and counted; they are in the recording all the same.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection

from fte_sniff.protocol import PortEvent, Row
from fte_sniff.recording.recorder import Change
from fte_sniff.session.capturing.messages import Batch, Ended, Message

MOST_WAITING = 65_536
"""Rows that wait for the view at most."""

MOST_EVENTS = 1024
"""Port events that wait for the view at most."""

BATCH_EVERY_S = 0.05
"""Seconds between two batches: far less than a person sees, far more than a row takes."""


class Outbox:
    """Sends what is put into it, from a thread of its own, to the other end of a connection."""

    def __init__(self, connection: Connection, when_gone: Callable[[], None]) -> None:
        """Start sending.

        Args:
            connection: where to.
            when_gone: called once, from the sending thread, when nobody listens any more.
        """
        self._connection = connection
        self._when_gone = when_gone
        self._changed = threading.Condition()
        self._rows: deque[Row] = deque(maxlen=MOST_WAITING)
        self._events: deque[PortEvent] = deque(maxlen=MOST_EVENTS)
        self._recording: list[Change] = []
        self._total = self._dropped = self._leftover = 0
        self._end: Ended | None = None
        self._hurry = threading.Event()
        self._thread = threading.Thread(target=self._run, name="outbox", daemon=True)
        self._thread.start()

    def put_rows(self, rows: Sequence[Row]) -> None:
        """Hand on rows; the oldest that wait make room where there is none."""
        with self._changed:
            self._total += len(rows)
            self._dropped += max(0, len(self._rows) + len(rows) - MOST_WAITING)
            self._rows.extend(rows)
            self._changed.notify()

    def put_event(self, event: PortEvent) -> None:
        """Hand on a port event."""
        with self._changed:
            self._events.append(event)
            self._changed.notify()

    def put_recording(self, changes: Sequence[Change]) -> None:
        """Tell what became of the recording."""
        with self._changed:
            self._recording += changes
            self._changed.notify()

    def put_leftover(self, count: int) -> None:
        """Tell with the rows that come how many bytes waited when nothing more was read."""
        with self._changed:
            self._leftover = count

    def close(self, end: Ended) -> None:
        """Send what waits and then `end`; returns when the view has taken it, or is gone."""
        with self._changed:
            self._end = end
            self._changed.notify()
        self._hurry.set()
        self._thread.join()

    def _run(self) -> None:
        try:
            while True:
                for message in self._next_messages():
                    self._connection.send(message)
                    if isinstance(message, Ended):
                        return
                self._hurry.wait(BATCH_EVERY_S)
        except OSError:
            self._when_gone()

    def _next_messages(self) -> list[Message]:
        with self._changed:
            while not (self._rows or self._events or self._end or self._recording):
                self._changed.wait()
            found: list[Message] = []
            if self._rows or self._events or self._recording:
                rows, events = list(self._rows), list(self._events)
                changes = tuple(self._recording)
                found.append(
                    Batch(rows, events, self._total, self._dropped, changes, self._leftover)
                )
                self._rows.clear()
                self._events.clear()
                self._recording.clear()
            if self._end:
                found.append(self._end)
            return found
