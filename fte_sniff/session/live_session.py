"""A running capture as a feed for one view: its state, and how to start, poll and stop it.

    capture process ──writes──► recording ──► Follower ──items──┐
           └──────────control──────────────► CaptureState ──────┴──► FeedUpdate

The rows come from the file, as for any other program that follows it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from queue import Empty, Queue
from shutil import rmtree
from subprocess import TimeoutExpired
from threading import Thread
from typing import Final

from fte_sniff.analysis.feed import FeedState, FeedUpdate
from fte_sniff.errors import TOO_MANY_FILES, FileError, FteSniffError, PortError, TranslatableText
from fte_sniff.protocol import Gap, GapKind, PortEvent, PortEventKind
from fte_sniff.protocol.rows import Item
from fte_sniff.recording.reader import Recording
from fte_sniff.recording.recorder import FileChange, Outcome
from fte_sniff.session.capture_process import CapturePlan, capture
from fte_sniff.session.control import (
    CaptureStatus,
    Ended,
    Message,
    Started,
    Stop,
    line_of,
    message_in,
)
from fte_sniff.session.following import Follower
from fte_sniff.session.inputs import EventEffects
from fte_sniff.session.replay import update_of
from fte_sniff.session.worker_process import start_worker, tell

REPORTED_LEFTOVER: Final = 2**20
"""This many waiting bytes take over a second to write, and are reported."""


@dataclass(frozen=True, slots=True)
class CaptureState:
    """State of a capture, folded from its messages."""

    names: tuple[str, ...]
    is_temporary: bool = False
    """Whether the recording goes with the program."""
    started: bool = False
    """True once the port and the recording are open."""
    ended: Ended | None = None
    error: FteSniffError | None = None
    """The latest error of the port, the recording or the capture process."""
    recording: Path | None = None
    """Path of the current file; None after recording stopped."""
    recordings: tuple[Path, ...] = ()
    """All files of the recording, in order; several after rotation or a failed write."""
    device: str | None = None
    progress: CaptureStatus = field(default_factory=CaptureStatus)
    lost: frozenset[str] = frozenset()
    """Ports that are currently lost and waited for."""

    @property
    def outcome(self) -> Outcome | None:
        """What was recorded, once the capture process has ended by itself."""
        return self.ended.outcome if self.ended is not None else None

    def after(self, message: Message) -> CaptureState:
        """The state after one more message."""
        match message:
            case Started():
                files = (message.recording,)
                return replace(
                    self,
                    started=True,
                    recording=message.recording,
                    recordings=files,
                    device=message.device,
                )
            case CaptureStatus():
                return replace(self, progress=message)
            case Ended():
                return replace(self, ended=message, error=message.error, progress=message.progress)
            case FileChange(path, failure):
                return replace(
                    self,
                    recording=path,
                    recordings=self.recordings + (() if path is None else (path,)),
                    error=failure or self.error,
                )
        return self

    def feed_state(self, *, is_read: bool) -> FeedState:
        """The state as a feed shows it; `is_read` is whether all rows were polled."""
        ended = self.ended if is_read else None
        is_shown = self.recording is not None and not self.is_temporary
        return FeedState(
            title=self._title(),
            recording=str(self.recording) if is_shown else None,
            running=ended is None,
            waiting=ended is None and bool(self.lost),
            ended=(ended.reason or TranslatableText("stopped")) if ended else None,
            trouble=self._trouble() if ended is None else None,
            rows=self.progress.rows,
            files=() if self.is_temporary else tuple(map(str, self.recordings)),
            recorded_bytes=self.progress.bytes,
        )

    def _title(self) -> str:
        if self.device is not None:
            # A bridge shows the device that the host program opens.
            return f"{self.names[0]} + {self.device}"
        return " + ".join(self.names)

    @property
    def backlog(self) -> str | None:
        """What the end waits for; None if nothing."""
        progress = self.progress
        if progress.is_slow and progress.is_end:
            return TranslatableText(
                "writing is slow, as the disk or the processor is busy: {what} are not written yet",
                what=progress.remaining,
            )
        if progress.is_end and progress.waiting >= REPORTED_LEFTOVER:
            return TranslatableText(
                "writing received data: {bytes:,} bytes left", bytes=progress.waiting
            )
        return None

    def _trouble(self) -> str | None:
        if self.error is None:
            return self.backlog
        trouble = self.error.message
        if not self.recording or self.ended is not None:
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


END_WITHIN_S = 5.0
"""Seconds without a message after which a capture that should end is killed."""

WAIT_S = 0.1
"""Seconds that one wait for the capture process lasts."""

POLL_S = 0.02
"""Interval at which the file is polled."""

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
        self._plan, self._observe = plan, observe
        _check_folder()
        self.state = CaptureState(plan.wiring.names, plan.is_temporary)
        self._effects = EventEffects(dict.fromkeys(plan.wiring.names, plan.wiring.settings.baud))
        self._follower: Follower | None = None
        self._next_file = 0
        """Index of the next file to follow, among those of the recording."""
        self._stopped_at_s: float | None = None
        self._received_at_s = 0.0
        """Monotonic time of the last message; one comes every second while the capture works."""
        self._killed: str | None = None
        """Why the capture process was killed; None if it was not."""
        self._process = start_worker(capture, plan)
        self._messages = Queue[Message | None]()
        """What the capture sent; None after the last."""
        self._reader = Thread(target=self._read, name="reads messages", daemon=True)
        self._reader.start()

    def begin(self) -> None:
        """Wait until the port and the recording are open.

        After a `stop` the capture may have ended already; see `poll`. Raises FteSniffError if
        the port cannot be opened, or the recording cannot be made.
        """
        while not self.state.started and self.state.ended is None:
            self._receive(WAIT_S)
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
        until_s = time.monotonic() + timeout_s
        while True:
            self._receive_all(min(POLL_S, max(0.0, until_s - time.monotonic())))
            items = list(self._effects.of(self._follow()))
            if items or not self._is_running or time.monotonic() >= until_s:
                break
        for item in items:
            if isinstance(item, PortEvent):
                self.state = replace(self.state, lost=_lost_ports(self.state.lost, item))
        update = update_of(self.state.feed_state(is_read=not self._is_running), items)
        if self._observe is not None:
            self._observe(update)
        return update

    @property
    def _is_running(self) -> bool:
        """Whether more rows can come."""
        if self.state.ended is None:
            return True
        is_read = self._follower is None or self._follower.ended is not None
        return not (is_read and self._next_file >= len(self.state.recordings))

    def _follow(self) -> list[Item]:
        """What is new in the files; one that disappears is left for the next one."""
        try:
            if self._follower is None or self._follower.ended is not None:
                if self._next_file >= len(self.state.recordings):
                    return []
                path = self.state.recordings[self._next_file]
                self._next_file += 1
                reader = Recording(path, is_growing=True)
                self._follower = Follower(reader, goes_on=lambda: self.state.ended is None)
            found = list[Item](self._follower.poll())
        except FileError as error:
            self._follower = None
            return [Gap(GapKind.NOT_SHOWN, reason=error.message)]
        if self._follower.reader.path in self.state.recordings:
            self._next_file = self.state.recordings.index(self._follower.reader.path) + 1
        return found

    def stop(self) -> None:
        """Request the end of the capture; returns at once, may be called again."""
        if self._stopped_at_s is not None:
            return
        self._stopped_at_s = time.monotonic()
        if not self.state.started:
            # Opening a port may take long, and no message is read meanwhile.
            self._process.terminate()
        # If it has ended already, `wait` returns how.
        with suppress(OSError):
            tell(self._process, line_of(Stop()))

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
            self._receive_all(WAIT_S)
        try:
            self._process.wait(END_WITHIN_S)
        except TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join(END_WITHIN_S)
        if self._plan.is_temporary:
            rmtree(self._plan.recording.parent, ignore_errors=True)

    # Messages

    def _read(self) -> None:
        """Read the messages, in a thread."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._messages.put(message_in(line))
        self._messages.put(None)

    def _receive_all(self, timeout_s: float) -> None:
        """Apply the messages that came, or the first within a time."""
        while self.state.ended is None and self._receive(timeout_s):
            timeout_s = 0

    def _receive(self, timeout_s: float) -> bool:
        """Apply the next message within a time; False if none came."""
        try:
            message = self._messages.get(timeout=timeout_s)
        except Empty:
            self._give_up_when_overdue()
            return False
        self._received_at_s = time.monotonic()
        if message is None:
            message = self._exit_without_result(self._killed or self._exit_reason())
        self.state = self.state.after(message)
        return True

    def _give_up_when_overdue(self) -> None:
        if self._stopped_at_s is None:
            return
        # A capture that still has much to record keeps sending messages.
        last_s = max(self._stopped_at_s, self._received_at_s)
        if time.monotonic() > last_s + END_WITHIN_S:
            self._process.kill()
            self.state = self.state.after(self._exit_without_result(_KILLED))

    def _exit_without_result(self, reason: str) -> Ended:
        if self.stopping and not self.state.started:
            return Ended()
        progress = self.state.progress
        error = FileError if reason in (TOO_MANY_FILES, _ENDED_EARLY) else PortError
        if self.state.recording is None or self.state.is_temporary:
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


def _check_folder() -> None:
    try:
        Path.cwd()
    except OSError as error:
        raise FileError(
            TranslatableText("the working folder is gone; go to another one with `cd`")
        ) from error
