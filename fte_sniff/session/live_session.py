"""A running capture as a feed for one view: its state, and how to start, poll and stop it."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import reduce
from pathlib import Path
from subprocess import TimeoutExpired

from fte_sniff.analysis.feed import FeedState, FeedUpdate
from fte_sniff.analysis.model import GapDetector, StreamChange, shifted
from fte_sniff.errors import TOO_MANY_FILES, FileError, FteSniffError, PortError, TranslatableText
from fte_sniff.protocol import PortEvent, PortEventKind
from fte_sniff.protocol.rows import Rows
from fte_sniff.recording.recorder import Change, Outcome
from fte_sniff.session.capture_process import (
    STOP,
    CapturePlan,
    Ended,
    Message,
    RowsMessage,
    Started,
    WriteProgress,
    capture,
)
from fte_sniff.session.worker_process import start_worker


@dataclass(frozen=True, slots=True)
class CaptureState:
    """State of a capture, folded from its messages."""

    names: tuple[str, ...]
    started: bool = False
    """True once the port and the recording, if any, are open."""
    ended: Ended | None = None
    error: FteSniffError | None = None
    """The latest error of the port, the recording or the capture process."""
    recording: Path | None = None
    """Path of the current file; None without a recording or after it stopped."""
    recordings: tuple[Path, ...] = ()
    """All files of the recording, in order; several after rotation or a failed write."""
    stopped_recording: FteSniffError | None = None
    """Why the recording last stopped; at the end `error` says what was lost."""
    device: str | None = None
    total_rows: int = 0
    not_shown: int = 0
    """Rows recorded but not sent, because the view was too slow."""
    leftover: int = 0
    progress: WriteProgress = field(default_factory=WriteProgress)
    lost: frozenset[str] = frozenset()
    """Ports that are currently lost and waited for."""

    @property
    def outcome(self) -> Outcome | None:
        """What was recorded, once the capture process has ended by itself."""
        return self.ended.outcome if self.ended is not None else None

    def after(self, message: Message) -> CaptureState:
        """The state after one more message."""
        if isinstance(message, Ended):
            return replace(self, ended=message, error=message.error, progress=message.progress)
        if isinstance(message, Started):
            return replace(
                self,
                started=True,
                recording=message.recording,
                recordings=() if message.recording is None else (message.recording,),
                device=message.device,
            )
        return reduce(CaptureState._after_change, message.recording, self._after_batch(message))

    def _after_batch(self, batch: RowsMessage) -> CaptureState:
        return replace(
            self,
            total_rows=batch.total_rows,
            not_shown=batch.not_shown,
            leftover=batch.leftover,
            progress=batch.progress,
            lost=reduce(_lost_ports, batch.rows.events, self.lost),
        )

    def _after_change(self, change: Change) -> CaptureState:
        return replace(
            self,
            recording=change.path,
            recordings=self.recordings + (() if change.path is None else (change.path,)),
            stopped_recording=change.failure or self.stopped_recording,
            error=change.failure or self.error,
        )

    @property
    def feed_state(self) -> FeedState:
        """The state as a feed shows it."""
        ended = self.ended
        return FeedState(
            title=self._title(),
            recording=str(self.recording) if self.recording else None,
            running=ended is None,
            waiting=ended is None and bool(self.lost),
            ended=(ended.reason or TranslatableText("stopped")) if ended else None,
            trouble=self._trouble() if ended is None else None,
            rows=self.total_rows,
            not_shown=self.not_shown,
            files=tuple(map(str, self.recordings)),
            recorded_bytes=self.progress.bytes,
        )

    def _title(self) -> str:
        if self.device is not None:
            # A bridge shows the device that the host program opens.
            return f"{self.names[0]} + {self.device}"
        return " + ".join(self.names)

    @property
    def is_write_slow(self) -> bool:
        """Whether the end waits for a write."""
        return self.progress.is_slow and self.progress.is_end

    @property
    def backlog(self) -> str | None:
        """What the end waits for; None if nothing."""
        if self.is_write_slow:
            return TranslatableText(
                "writing is slow, as the disk or the processor is busy: {what} are not written yet",
                what=self.progress.remaining,
            )
        if self.leftover and self.progress.waiting:
            return TranslatableText(
                "writing received data: {bytes:,} bytes left", bytes=self.leftover
            )
        return None

    def _trouble(self) -> str | None:
        if self.error is None:
            return self.backlog
        trouble = self.error.message
        if not self.recording:
            return trouble
        return TranslatableText(
            "{trouble}; recording goes on in {path}", trouble=trouble, path=self.recording
        )


def _lost_ports(lost: frozenset[str], event: PortEvent) -> frozenset[str]:
    if event.kind is PortEventKind.LOST:
        return lost | {event.port}
    if event.kind is PortEventKind.FOUND_AGAIN:
        return lost - {event.port}
    return lost


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
                found = self._gaps.changes(message.rows, message.not_shown)
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

    def hurry(self) -> None:
        """Kill a capture whose end waits for what `CaptureState.backlog` reports; returns at once.

        The end states what is not in the recording.
        """
        if self.state.backlog is not None:
            self._killed = _ENDED_EARLY
            self._process.kill()

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
            was_asked = reason is _ENDED_EARLY
            return Ended(reason, None if was_asked else error(reason), progress=progress)
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
