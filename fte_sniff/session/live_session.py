"""A running capture as a feed for one view: its state, and how to start, poll and stop it.

    capture process ──writes──► recording ──► Follower ──items──┐
           └────────control: CaptureState───────────────────────┴──► FeedUpdate

The rows come from the file, as for any other program that follows it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from shutil import rmtree
from subprocess import TimeoutExpired
from threading import Event, Thread

from fte_sniff.analysis.feed import FeedState, FeedUpdate
from fte_sniff.errors import FileError, PortError, TranslatableText
from fte_sniff.protocol.items import Gap, GapKind
from fte_sniff.protocol.rows import Item
from fte_sniff.recording.reader import Recording
from fte_sniff.session.control import CapturePlan, CaptureState, send, start
from fte_sniff.session.following import Follower
from fte_sniff.session.inputs import EventEffects
from fte_sniff.session.replay import update_of

END_WITHIN_S = 5.0
"""Seconds without a message after which a capture that should end is killed."""

WAIT_S = 0.1
"""Seconds that one wait lasts in which Ctrl-C is noticed."""

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
        try:
            Path.cwd()
        except OSError as error:
            raise FileError(
                TranslatableText("the working folder is gone; go to another one with `cd`")
            ) from error
        self.state = CaptureState()
        """The latest of the capture process."""
        self._effects = EventEffects(dict.fromkeys(plan.wiring.names, plan.wiring.settings.baud))
        self._follower: Follower | None = None
        self._next_file = 0
        """Index of the next file to follow, among those of the recording."""
        self._stopped_at_s: float | None = None
        self._received_at_s = 0.0
        """Monotonic time of the last state; many come every second while the capture works."""
        self.hurried = False
        """Whether the end did not wait for what was still to be written."""
        self._process = start(plan)
        self._begun = Event()
        """Set with the first state."""
        self._reader = Thread(target=self._read, name="reads states", daemon=True)
        self._reader.start()

    def begin(self) -> None:
        """Wait until the port and the recording are open.

        After a `stop` the capture may have ended already; see `poll`. Raises FteSniffError if
        the port cannot be opened, or the recording cannot be made.
        """
        while not self._begun.wait(WAIT_S):
            self._kill_if_overdue()
        if self.state.is_ended and self.state.error is not None:
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
            self._kill_if_overdue()
            items = list(self._effects.of(self._follow()))
            left_s = until_s - time.monotonic()
            if items or not self._is_running or left_s <= 0:
                break
            time.sleep(min(POLL_S, left_s))
        update = update_of(self._feed_state(), items)
        if self._observe is not None:
            self._observe(update)
        return update

    @property
    def _is_running(self) -> bool:
        """Whether more rows can come."""
        if not self.state.is_ended:
            return True
        is_read = self._follower is None or self._follower.ended is not None
        return not (is_read and self._next_file >= len(self.state.recordings))

    def _follow(self) -> list[Item]:
        """What is new in the files; one that disappears is left for the next one."""
        try:
            if self._follower is None or self._follower.ended is not None:
                if self._next_file >= len(self.state.recordings):
                    return []
                self._next_file += 1
                reader = Recording(
                    Path(self.state.recordings[self._next_file - 1]), is_growing=True
                )
                self._follower = Follower(reader, goes_on=lambda: not self.state.is_ended)
            found = list[Item](self._follower.poll())
        except FileError as error:
            self._follower = None
            return [Gap(GapKind.NOT_SHOWN, reason=error.message)]
        path = str(self._follower.reader.path)
        if path in self.state.recordings:
            self._next_file = self.state.recordings.index(path) + 1
        return found

    def stop(self) -> None:
        """Request the end of the capture; returns at once, may be called again."""
        if self._stopped_at_s is not None:
            return
        self._stopped_at_s = time.monotonic()
        if not self.state.started:
            # Opening a port may take long, and no message is read meanwhile.
            self._process.terminate()
        send(self._process, b"stop")

    def hurry(self) -> None:
        """Kill a capture whose end waits for what `CaptureState.backlog` reports; returns at once.

        The end states what is not in the recording.
        """
        if self.state.backlog is not None:
            self.hurried = True
            self._process.kill()

    def close(self) -> None:
        """End the capture and wait until its file is closed; discard further rows."""
        self.stop()
        while not self.state.is_ended:
            self._kill_if_overdue()
            self._reader.join(WAIT_S)
        try:
            self._process.wait(END_WITHIN_S)
        except TimeoutExpired:
            self._process.kill()
        self._reader.join(END_WITHIN_S)
        for stream in filter(None, (self._process.stdin, self._process.stdout)):
            stream.close()
        if self._plan.is_temporary:
            rmtree(self._plan.recording.parent, ignore_errors=True)

    def _feed_state(self) -> FeedState:
        state, running = self.state, self._is_running
        names, is_temporary = self._plan.wiring.names, self._plan.is_temporary
        # A bridge shows the device that the host program opens.
        others = names[1:] if state.device is None else (state.device,)
        return FeedState(
            title=" + ".join((names[0], *others)),
            recording=None if is_temporary else state.recording,
            running=running,
            waiting=running and bool(self._effects.lost),
            ended=None if running else state.reason or TranslatableText("stopped"),
            trouble=self._trouble() if running else None,
            rows=state.rows,
            files=() if is_temporary else state.recordings,
            recorded_bytes=state.size,
        )

    def _trouble(self) -> str | None:
        state = self.state
        if state.error is None:
            return state.backlog
        trouble = state.error.message
        if not state.recording or state.is_ended:
            return trouble
        return TranslatableText(
            "{trouble}; recording goes on in {path}", trouble=trouble, path=state.recording
        )

    # States

    def _read(self) -> None:
        """Read the states, in a thread."""
        assert self._process.stdout is not None
        for line in open(self._process.stdout.fileno(), "rb", closefd=False):  # noqa: SIM115
            if line.endswith(b"\n"):  # or it was killed meanwhile
                self.state, self._received_at_s = CaptureState.parse(line), time.monotonic()
                self._begun.set()
        if not self.state.is_ended:
            self.state = self._without_result(_UNEXPECTED)
        self._begun.set()

    def _kill_if_overdue(self) -> None:
        """Kill a capture that should end and sends nothing: it is stuck."""
        if self._stopped_at_s is None or self.state.is_ended:
            return
        # A capture that still has much to record keeps sending states.
        if time.monotonic() > max(self._stopped_at_s, self._received_at_s) + END_WITHIN_S:
            self._process.kill()
            self.state = self._without_result(_KILLED)
            self._begun.set()

    def _without_result(self, reason: str) -> CaptureState:
        """The state of a capture that ended without one."""
        state, reason = replace(self.state, is_ended=True), _ENDED_EARLY if self.hurried else reason
        if self.stopping and not state.started:
            return state
        error = FileError if self.hurried else PortError
        if state.recording is None or self._plan.is_temporary:
            return replace(state, reason=reason, error=None if self.hurried else error(reason))
        whole = TranslatableText(
            "{reason}; up to {what} are not in {path}",
            reason=reason,
            what=state.remaining,
            path=state.recording,
        )
        return replace(state, reason=reason, error=error(whole))
