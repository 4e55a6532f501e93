"""A running capture as a feed for one view: its state, and how to start, poll and stop it.

    capture process ──writes──► recording ──thread: grown──items──┐
           └────────control: CaptureState─────────────────────────┴──► FeedUpdate

The rows come from the file, as for any other program that follows it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from shutil import rmtree
from subprocess import TimeoutExpired
from threading import Event, Thread

from fte_sniff.analysis.feed import FeedState, FeedUpdate
from fte_sniff.errors import FileError, TranslatableText
from fte_sniff.protocol.items import Gap, GapKind
from fte_sniff.protocol.rows import Item
from fte_sniff.recording.reader import Recording
from fte_sniff.session.control import CapturePlan, CaptureState, send, start
from fte_sniff.session.feeds import ItemFeed
from fte_sniff.session.following import grown
from fte_sniff.session.inputs import with_effects

END_WITHIN_S = 5.0
"""Seconds without a message after which a capture that should end is killed."""

WAIT_S = 0.25
"""Seconds that one wait lasts in which Ctrl-C is noticed."""

POLL_S = {True: 0.02, False: 0.5}
"""Interval at which the file is polled, by whether the view shows its rows."""

_KILLED = TranslatableText(
    "the capture did not end within {seconds:g} s and was killed", seconds=END_WITHIN_S
)
_ENDED_EARLY = TranslatableText("the capture was ended while it was still writing")
_UNEXPECTED = TranslatableText("the capture process ended unexpectedly")


class LiveSession(ItemFeed):
    """A capture in another process, as a feed for one view.

    `begin` waits for the port. `stop` may be called before that, and from signal handlers.
    """

    def __init__(
        self, plan: CapturePlan, observe: Callable[[FeedUpdate], None] | None = None
    ) -> None:
        """Start the capture process; `observe` receives each update too."""
        self._plan, self._observe = plan, observe
        self.capture = CaptureState()
        """The latest state of the capture process."""
        self._lost = set[str]()
        """The ports that are lost."""
        self._stopped_at_s: float | None = None
        self._received_at_s = 0.0
        """Monotonic time of the last state; many come every second while the capture works."""
        self._killed: TranslatableText | None = None
        """Why the capture was killed."""
        self._process = start(plan)
        self._begun = Event()
        """Set with the first state."""
        self._states = Thread(target=self._read_states, name="reads states", daemon=True)
        self._states.start()
        super().__init__(with_effects(self._items(), self._lost))

    def begin(self) -> None:
        """Wait until the port and the recording are open.

        After a `stop` the capture may have ended already; see `capture`. Raises FteSniffError if
        the port cannot be opened, or the recording cannot be made.
        """
        while not self._begun.wait(WAIT_S):
            self._kill_if_overdue()
        if self.capture.is_ended and self.capture.error is not None:
            raise self.capture.error

    @property
    def stopping(self) -> bool:
        """True after `stop`."""
        return self._stopped_at_s is not None

    @property
    def hurried(self) -> bool:
        """Whether the end did not wait for what was still to be written."""
        return self._killed is _ENDED_EARLY

    @property
    def capture_pid(self) -> int:
        """Process id of the capture, to end it without this view."""
        return self._process.pid

    def _update(self, timeout_s: float, most_rows: int) -> FeedUpdate:
        """As that of any feed; the update goes to the observer too."""
        self._kill_if_overdue()
        update = super()._update(timeout_s, most_rows)
        if self._observe is not None:
            self._observe(update)
        return update

    def _items(self) -> Iterator[Item]:
        """The items of the recording's files, in a thread; one that disappears is left."""
        number, known, poll_s = 0, list[Gap](), POLL_S[self._plan.shows_rows]

        def is_over() -> bool:
            return self.capture.is_ended or len(self.capture.recordings) > number

        self._begun.wait()
        while True:
            is_last = self.capture.is_ended
            if number < len(self.capture.recordings):
                path = Path(self.capture.recordings[number])
                number += 1
                try:
                    reader = Recording(path, is_growing=True)
                    yield from grown(reader, is_over, known, poll_s)
                except FileError as error:
                    yield Gap(GapKind.NOT_SHOWN, reason=error.message)
            elif is_last:
                return
            else:
                time.sleep(poll_s)

    def stop(self) -> None:
        """Request the end of the capture; returns at once, may be called again."""
        if self._stopped_at_s is not None:
            return
        self._stopped_at_s = time.monotonic()
        if not self.capture.started:
            # Opening a port may take long, and no message is read meanwhile.
            self._process.terminate()
        send(self._process, b"stop")

    def interrupt(self) -> None:
        """Stop; kill a capture whose end waits for what `CaptureState.backlog` reports.

        Returns at once. The end states what is not in the recording.
        """
        self.stop()
        if self.capture.is_ending and self.capture.backlog is not None:
            self._kill(_ENDED_EARLY)

    def close(self) -> None:
        """End the capture and wait until its file is closed; discard further rows."""
        self.stop()
        while not self.capture.is_ended:
            self._kill_if_overdue()
            self._states.join(WAIT_S)
        super().close()
        try:
            self._process.wait(END_WITHIN_S)
        except TimeoutExpired:
            self._process.kill()
        self._states.join(END_WITHIN_S)
        for stream in filter(None, (self._process.stdin, self._process.stdout)):
            stream.close()
        if self._plan.is_temporary:
            rmtree(self._plan.recording.parent, ignore_errors=True)

    def state(self) -> FeedState:
        """The state of the capture, whose last rows come after its end."""
        state, running, is_temporary = self.capture, self.running, self._plan.is_temporary
        names = self._plan.wiring.names
        # A bridge shows the device that the host program opens.
        others = names[1:] if state.device is None else (state.device,)
        return FeedState(
            title=" + ".join((names[0], *others)),
            recording=None if is_temporary else state.recording,
            running=running,
            waiting=running and bool(self._lost),
            ended=None if running else state.reason or TranslatableText("stopped"),
            trouble=state.error.message if running and state.error else state.backlog,
            files=() if is_temporary else state.recordings,
            recorded_bytes=state.size,
        )

    # States

    def _read_states(self) -> None:
        """Read the states, in a thread."""
        assert self._process.stdout is not None
        for line in open(self._process.stdout.fileno(), "rb", closefd=False):  # noqa: SIM115
            if self._killed is None and line.endswith(b"\n"):  # or it was killed meanwhile
                self.capture, self._received_at_s = CaptureState.parse(line), time.monotonic()
                self._begun.set()
        if not self.capture.is_ended:
            self.capture = self._without_result(self._killed or _UNEXPECTED)
        self._begun.set()

    def _kill_if_overdue(self) -> None:
        """Kill a capture that should end and sends nothing: it is stuck."""
        if self._stopped_at_s is None or self.capture.is_ended:
            return
        # A capture that still has much to record keeps sending states.
        if time.monotonic() > max(self._stopped_at_s, self._received_at_s) + END_WITHIN_S:
            self._kill(_KILLED)

    def _kill(self, reason: TranslatableText) -> None:
        self._killed = reason
        self._process.kill()
        self.capture = self._without_result(reason)
        self._begun.set()

    def _without_result(self, reason: TranslatableText) -> CaptureState:
        """The state of a capture that ended without one."""
        state = replace(self.capture, is_ended=True)
        if self.stopping and not state.started:
            return state
        path = state.recording or self._plan.recording
        text = "{reason}; up to {what} are not in {path}"
        if not self.hurried:  # the state is older than the last rows
            text = "{reason}; the last rows may not be in {path}"
        error = FileError(text, reason=reason, what=state.remaining, path=path)
        return replace(state, reason=reason, error=error)
