"""Owns the view's end of a capture process: starting it, hearing from it, ending it.

It must not know what shows the rows, nor what the capture process does inside.
"""

from __future__ import annotations

import multiprocessing
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import TracebackType
from typing import Self

from fte_sniff.analysis.feed import FeedState, FeedUpdate
from fte_sniff.errors import FteSniffError, PortError
from fte_sniff.protocol import PortEvent, Row
from fte_sniff.session.messages import STOP, Batch, Ended, Message, Started
from fte_sniff.session.plan import CapturePlan
from fte_sniff.session.process import LAST_WORDS_S, capture

MOST_ROWS_A_POLL = 16_384
"""Rows that one poll hands over at most, so that a view that was stopped can still breathe."""


class LiveSession:
    """A capture that runs in a process of its own, as a feed for one view."""

    error: FteSniffError | None = None
    """What went wrong, once it has: with the port, the recording, or the capture process."""

    def __init__(self, plan: CapturePlan) -> None:
        """Start the capture and wait until the port is open.

        Raises:
            FteSniffError: the port cannot be opened, or the recording cannot be made.
        """
        self._plan = plan
        self._recording = str(plan.recording) if plan.recording else None
        self._ended: Ended | None = None
        self._total = self._not_shown = 0
        self._stopped = False
        context = multiprocessing.get_context("spawn")
        self._capture, theirs = context.Pipe()
        # A daemon gets SIGTERM when this process ends in a way that skips `close`.
        self._process = context.Process(
            target=capture, args=(plan, theirs), name="fte-sniff capture", daemon=True
        )
        with _interrupts_ignored():
            self._process.start()
        theirs.close()
        first = self._receive()
        self._take(first)
        if isinstance(first, Ended):
            self._process.join()
            raise first.error or PortError(first.reason or "the capture did not start")

    @property
    def total_rows(self) -> int:
        """All rows captured so far."""
        return self._total

    def poll(self) -> FeedUpdate:
        """What came since the poll before; returns at once."""
        return self.wait(0)

    def wait(self, timeout_s: float) -> FeedUpdate:
        """What comes next, or nothing if nothing comes within `timeout_s` seconds."""
        rows: list[Row] = []
        events: list[PortEvent] = []
        while self._ended is None and len(rows) < MOST_ROWS_A_POLL:
            if not self._capture.poll(timeout_s):
                break
            timeout_s = 0
            batch = self._take(self._receive())
            if batch is not None:
                rows += batch.rows
                events += batch.events
        return FeedUpdate(self._state(), rows, events)

    def stop(self) -> None:
        """Ask the capture to end; returns at once, and may be called again."""
        if not self._stopped:
            self._stopped = True
            # Where it has ended already, `wait` tells how.
            with suppress(OSError):
                self._capture.send(STOP)

    def close(self) -> None:
        """End the capture, wait until its file is closed, and forget the rows that still come."""
        self.stop()
        deadline = time.monotonic() + 2 * LAST_WORDS_S
        while self._ended is None and time.monotonic() < deadline:
            self.wait(0.1)
        self._process.join(LAST_WORDS_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._capture.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.close()

    def _receive(self) -> Message:
        try:
            message = self._capture.recv()
        except (EOFError, OSError):
            reason = "the capture process ended unexpectedly; what it had recorded is kept"
            return Ended(reason, PortError(reason))
        assert isinstance(message, Started | Batch | Ended)
        return message

    def _take(self, message: Message) -> Batch | None:
        if isinstance(message, Ended):
            self._ended = message
            self.error = self.error or message.error
            return None
        if isinstance(message, Started):
            return None
        self._total, self._not_shown = message.total_rows, message.not_shown
        if message.recording_failure is not None:
            self._recording = None
            self.error = message.recording_failure
        return message

    def _state(self) -> FeedState:
        ended = self._ended
        reason = (ended.reason or "stopped") if ended else None
        if self.error is not None and ended is None:
            reason = str(self.error)
        return FeedState(
            title=self._plan.port,
            recording=self._recording,
            running=ended is None,
            ended=reason,
            rows=self._total,
            not_shown=self._not_shown,
        )


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """While a process is started in this context, it is born deaf to Ctrl-C."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
