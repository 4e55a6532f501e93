"""LiveSession: start, poll, stop."""

from __future__ import annotations

import multiprocessing
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from fte_sniff.analysis.feed import FeedUpdate, GapDetector, MissingRows, StreamChange, shifted
from fte_sniff.errors import FileError, PortError, TranslatableText
from fte_sniff.protocol import PortEvent, Row
from fte_sniff.session.capture_process import capture
from fte_sniff.session.capture_state import (
    DROP,
    STOP,
    CapturePlan,
    CaptureState,
    Ended,
    Message,
    RowsMessage,
    Started,
)


class BatchGaps:
    """Finds the seams in each batch of a capture, batch by batch."""

    def __init__(self, ports: Sequence[str], baud: int) -> None:
        """No batch came yet; each port began with so many bits per second."""
        self._finder = GapDetector()
        self._finder.begin(dict.fromkeys(ports, baud))
        self._not_shown = 0

    def of(self, batch: RowsMessage) -> list[StreamChange]:
        """Those of the next batch, by place among its rows."""
        found = self._finder.seams(batch.rows, batch.events)
        if batch.not_shown > self._not_shown:
            self._not_shown = batch.not_shown
            found.insert(0, MissingRows(0))
        return found


MOST_ROWS_A_POLL = 16_384
"""Rows that one poll hands over at most, so that a view that was stopped can still breathe."""

END_WITHIN_S = 5.0
"""How long a capture that was asked to end may say nothing before it is killed, seconds."""

LOOK_EVERY_S = 0.1
"""How long one wait for the capture process lasts before the end is thought of again, seconds."""

_KILLED = TranslatableText(
    "the capture did not end within {seconds:g} s of being asked, and was killed; "
    "what it had flushed to its recording until then is kept",
    seconds=END_WITHIN_S,
)
_UNEXPECTED = TranslatableText(
    "the capture process ended unexpectedly; what it had recorded is kept"
)


class LiveSession:
    """A capture that runs in a process of its own, as a feed for one view.

    `begin`, or entering it as a context, waits for the port; `stop` may be called before that, and
    from signal handlers. Once asked to end, it ends: a capture process that is stuck is killed.
    """

    def __init__(self, plan: CapturePlan) -> None:
        """Start the capture process; what it finds is told by `begin`.

        Raises:
            FileError: the working folder is gone, without which no process can be started.
        """
        _check_folder()
        self.told = CaptureState(plan.wiring.names)
        """What the capture has told by now."""
        self._seams = BatchGaps(plan.wiring.names, plan.wiring.settings.baud)
        self._stopped_at_s: float | None = None
        self._heard_at_s = 0.0
        self._receiving_since_s: float | None = None
        """Since when a message has been coming in, which may have begun and not gone on."""
        self._killed = False
        context = multiprocessing.get_context("spawn")
        self._capture, theirs = context.Pipe()
        # A daemon gets SIGTERM when this process ends in a way that skips `close`.
        self._process = context.Process(
            target=capture, args=(plan, theirs), name="fte-sniff capture", daemon=True
        )
        with _undisturbed():
            self._process.start()
        theirs.close()

    def begin(self) -> None:
        """Wait until the port is open, and the recording if there is to be one.

        Where it was asked to stop meanwhile, it may have ended already; `poll` tells.

        Raises:
            FteSniffError: the port cannot be opened, or the recording cannot be made.
        """
        while not self.told.begun and self.told.ended is None:
            if self._capture.poll(LOOK_EVERY_S):
                self.told = self.told.after(self._receive())
            else:
                self._give_up_when_overdue()
        if self.told.ended is not None and self.told.error is not None:
            self.close()
            raise self.told.error

    @property
    def stopping(self) -> bool:
        """Whether the capture was asked to end."""
        return self._stopped_at_s is not None

    @property
    def capture_pid(self) -> int:
        """The capture process, for whoever has to end it without this view."""
        assert self._process.pid is not None
        return self._process.pid

    @property
    def descriptor(self) -> int:
        """Can be read from when there is something to poll; until `close`."""
        return self._capture.fileno()

    def poll(self) -> FeedUpdate:
        """What came since the poll before; returns at once."""
        return self.wait(0)

    def wait(self, timeout_s: float) -> FeedUpdate:
        """What comes next, or nothing if nothing comes within `timeout_s` seconds."""
        rows: list[Row] = []
        events: list[PortEvent] = []
        seams: list[StreamChange] = []
        while self.told.ended is None and len(rows) < MOST_ROWS_A_POLL:
            if not self._capture.poll(timeout_s):
                self._give_up_when_overdue()
                break
            timeout_s = 0
            message = self._receive()
            self.told = self.told.after(message)
            if isinstance(message, RowsMessage):
                seams += shifted(self._seams.of(message), len(rows))
                rows += message.rows
                events += message.events
        return FeedUpdate(self.told.state, rows, events, seams)

    def stop(self) -> None:
        """Ask the capture to end; returns at once, and may be called again."""
        if self._stopped_at_s is not None:
            since = self._receiving_since_s
            if since is not None and time.monotonic() > since + END_WITHIN_S:
                # It stands still within a message, and so does whoever waits for the rest of it.
                self._killed = True
                self._process.kill()
            return
        self._stopped_at_s = time.monotonic()
        if not self.told.begun:
            # It may be waiting for a port that takes long to open, and hear nothing else.
            self._process.terminate()
        # Where it has ended already, `wait` tells how.
        with suppress(OSError):
            self._capture.send(STOP)

    def drop_leftover(self) -> None:
        """Do not wait for what still waits to be written, where that was told to be much.

        It is counted in the recording as an overrun. Returns at once.
        """
        if self.told.leftover:
            with suppress(OSError):
                self._capture.send(DROP)

    def close(self) -> None:
        """End the capture, wait until its file is closed, and forget the rows that still come."""
        self.stop()
        while self.told.ended is None:
            self.wait(LOOK_EVERY_S)
        self._process.join(END_WITHIN_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._capture.close()

    def __enter__(self) -> Self:
        self.begin()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def _overdue(self) -> bool:
        asked = self._stopped_at_s
        if asked is None:
            return False
        # One that is behind has much to record yet, and tells of it all the while.
        return time.monotonic() > max(asked, self._heard_at_s) + END_WITHIN_S

    def _give_up_when_overdue(self) -> None:
        """Kill a capture that was asked to end and has nothing to say to it."""
        if self._overdue:
            self._process.kill()
            self.told = self.told.after(self._gone(_KILLED))

    def _gone(self, reason: str) -> Ended:
        """What the end of a process means that left no word of its own."""
        if self.stopping and not self.told.begun:
            return Ended()
        return Ended(reason, PortError(reason))

    def _receive(self) -> Message:
        self._receiving_since_s = time.monotonic()
        try:
            message = self._capture.recv()
        except (EOFError, OSError):
            return self._gone(_KILLED if self._killed else _UNEXPECTED)
        finally:
            self._receiving_since_s = None
        self._heard_at_s = time.monotonic()
        assert isinstance(message, Started | RowsMessage | Ended)
        return message


def _check_folder() -> None:
    try:
        Path.cwd()
    except OSError as error:
        raise FileError(
            TranslatableText("the working folder is gone; go to another one with `cd`")
        ) from error


@contextmanager
def _undisturbed() -> Iterator[None]:
    """A process that is started in this context gets all it is to be told, and hears no Ctrl-C."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[int] = []
    before = {signal.SIGINT: signal.signal(signal.SIGINT, signal.SIG_IGN)}
    for number in (signal.SIGTERM, signal.SIGHUP):
        before[number] = signal.signal(number, lambda number, _: held.append(number))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    for late in held:
        signal.raise_signal(late)
