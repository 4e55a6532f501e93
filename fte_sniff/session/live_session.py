"""A running capture as a feed for one view: start, poll, stop."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from subprocess import TimeoutExpired

from fte_sniff.analysis.feed import FeedUpdate, GapDetector, StreamChange, shifted
from fte_sniff.errors import TOO_MANY_FILES, FileError, PortError, TranslatableText
from fte_sniff.protocol.rows import Rows
from fte_sniff.session.capture_process import capture
from fte_sniff.session.capture_state import (
    DROP,
    ROTATE,
    STOP,
    CapturePlan,
    CaptureState,
    Ended,
    Message,
    RowsMessage,
    Started,
)
from fte_sniff.session.worker_process import start_worker

MOST_ROWS_A_POLL = 16_384
"""Most rows of one poll, so that a view that was suspended stays responsive."""

END_WITHIN_S = 5.0
"""Seconds without a message after which a capture that should end is killed."""

WAIT_S = 0.1
"""Seconds that one wait for the capture process lasts."""

_KILLED = TranslatableText(
    "the capture did not end within {seconds:g} s and was killed; the rows written to the "
    "recording so far are kept",
    seconds=END_WITHIN_S,
)
_ENDED_EARLY = TranslatableText("the capture was ended while it was still writing")
_UNEXPECTED = TranslatableText(
    "the capture process ended unexpectedly; what it had recorded is kept"
)


class LiveSession:
    """A capture in another process, as a feed for one view.

    `begin` waits for the port. `stop` may be called before that, and from
    signal handlers. A capture process that does not end when requested is killed.
    """

    def __init__(
        self, plan: CapturePlan, observe: Callable[[FeedUpdate], None] | None = None
    ) -> None:
        """Start the capture process; `observe` receives each update too.

        Raises FileError if the working folder is gone.
        """
        self._observe = observe
        _check_folder()
        self.state = CaptureState(plan.wiring.names)
        self._gaps = GapDetector()
        self._gaps.begin(dict.fromkeys(plan.wiring.names, plan.wiring.settings.baud))
        self._stopped_at_s: float | None = None
        self.received_at_s = 0.0
        """Monotonic time of the last message; one comes every second while the capture works."""
        self._receiving_since_s: float | None = None
        """When receiving of the current, possibly incomplete, message started."""
        self._killed: str | None = None
        """Why the capture process was killed; None if it was not."""
        self._process, self._capture = start_worker(capture, plan)

    def begin(self) -> None:
        """Wait until the port and the recording, if any, are open.

        After a `stop` the capture may have ended already; see `poll`. Raises FteSniffError if
        the port cannot be opened, or the recording cannot be made.
        """
        while not self.state.started and self.state.ended is None:
            if self._capture.poll(WAIT_S):
                self.state = self.state.after(self._receive())
            else:
                self._give_up_when_overdue()
        if self.state.ended is not None and self.state.error is not None:
            self.close()
            raise self.state.error

    @property
    def stopping(self) -> bool:
        """True after `stop`."""
        return self._stopped_at_s is not None

    @property
    def capture_pid(self) -> int:
        """Process id of the capture, to end it without this view."""
        return self._process.pid

    def poll(self) -> FeedUpdate:
        """Rows and events since the previous poll; returns at once."""
        return self.wait(0)

    def wait(self, timeout_s: float) -> FeedUpdate:
        """The next rows and events; empty after `timeout_s` seconds without any."""
        parts: list[Rows] = []
        count = 0
        changes: list[StreamChange] = []
        while self.state.ended is None and count < MOST_ROWS_A_POLL:
            if not self._capture.poll(timeout_s):
                self._give_up_when_overdue()
                break
            timeout_s = 0
            message = self._receive()
            self.state = self.state.after(message)
            if isinstance(message, RowsMessage):
                found = self._gaps.changes(message.rows, message.rows.events, message.not_shown)
                changes += shifted(found, count)
                parts.append(message.rows)
                count += len(message.rows)
        rows = Rows.concat(parts)
        update = FeedUpdate(self.state.feed_state, rows, rows.events, changes)
        if self._observe is not None:
            self._observe(update)
        return update

    def stop(self) -> None:
        """Request the end of the capture; returns at once, may be called again."""
        if self._stopped_at_s is not None:
            since = self._receiving_since_s
            if since is not None and time.monotonic() > since + END_WITHIN_S:
                # The capture hangs within a message, and so does the reader of the rest.
                self._killed = _KILLED
                self._process.kill()
            return
        self._stopped_at_s = time.monotonic()
        if not self.state.started:
            # Opening a port may take long, and no message is read meanwhile.
            self._process.terminate()
        # If it has ended already, `wait` returns how.
        with suppress(OSError):
            self._capture.send(STOP)

    def rotate(self) -> None:
        """Request the next file of the recording; returns at once."""
        if self.state.started:
            with suppress(OSError):
                self._capture.send(ROTATE)

    def hurry(self) -> None:
        """Do not wait for what `CaptureState.backlog` reports; returns at once.

        Waiting bytes are counted as an overrun; a capture whose write takes long is killed.
        """
        if self.state.is_write_slow:
            self._killed = _ENDED_EARLY
            self._process.kill()
        elif self.state.leftover:
            with suppress(OSError):
                self._capture.send(DROP)

    def close(self) -> None:
        """End the capture and wait until its file is closed; discard further rows."""
        self.stop()
        while self.state.ended is None:
            self.wait(WAIT_S)
        try:
            self._process.wait(END_WITHIN_S)
        except TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._capture.close()

    def _give_up_when_overdue(self) -> None:
        if self._stopped_at_s is None:
            return
        # A capture that still has much to record keeps sending messages.
        last_s = max(self._stopped_at_s, self.received_at_s)
        if time.monotonic() > last_s + END_WITHIN_S:
            self._process.kill()
            self.state = self.state.after(self._exit_without_result(_KILLED))

    def _exit_without_result(self, reason: str) -> Ended:
        if self.stopping and not self.state.started:
            return Ended()
        progress = self.state.progress
        error = FileError if reason in (TOO_MANY_FILES, _ENDED_EARLY) else PortError
        if self.state.recording is None:
            return Ended(reason, error(reason), progress=progress)
        whole = TranslatableText(
            "{reason}; up to {what} are not in {path}",
            reason=reason,
            what=progress.remaining,
            path=self.state.recording,
        )
        return Ended(reason, error(whole), progress=progress)

    def _exit_reason(self) -> TranslatableText:
        with suppress(TimeoutExpired):
            if self._process.wait(END_WITHIN_S) == FileError.exit_code:
                return TOO_MANY_FILES
        return _UNEXPECTED

    def _receive(self) -> Message:
        self._receiving_since_s = time.monotonic()
        try:
            message = self._capture.recv()
        except (EOFError, OSError):
            return self._exit_without_result(self._killed or self._exit_reason())
        finally:
            self._receiving_since_s = None
        self.received_at_s = time.monotonic()
        assert isinstance(message, Started | RowsMessage | Ended)
        return message


def _check_folder() -> None:
    try:
        Path.cwd()
    except OSError as error:
        raise FileError(
            TranslatableText("the working folder is gone; go to another one with `cd`")
        ) from error
