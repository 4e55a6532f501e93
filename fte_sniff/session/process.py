"""Owns the capture process: port -> framer -> recording, and rows handed to the view.

It must not know what shows the rows. It ends when it is told to, when its port is lost, when its
plan is fulfilled, or when nobody listens any more; in each case the file is closed.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection

from fte_sniff.capture.clock import Clock
from fte_sniff.capture.source import PortSource, SourceEnd, open_source
from fte_sniff.errors import FteSniffError, PortError
from fte_sniff.protocol import Chunk, Framer, PortEvent, PortEventKind, Row
from fte_sniff.recording.facts import PortFacts, host_facts
from fte_sniff.recording.writer import RecordingWriter
from fte_sniff.session.messages import STOP, Ended, Message, Started
from fte_sniff.session.outbox import Outbox
from fte_sniff.session.plan import CapturePlan

FLUSH_EVERY_NS = 500_000_000
"""How long rows wait for the disk at most, so that a second is kept with some room."""

_ENDING_SIGNALS = (signal.SIGTERM, signal.SIGHUP)


def capture(plan: CapturePlan, view: Connection) -> None:
    """Run a capture in this process until it ends, telling the view.

    Args:
        plan: what to do.
        view: where `Message`s go, and where STOP comes from; its end means STOP too.
    """
    # Ctrl-C reaches every process of the terminal; here only the view decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    clock = Clock.tied()
    try:
        with open_source(plan.port, plan.settings, clock) as source:
            _capture_from(source, plan, clock, view)
    except FteSniffError as error:
        _tell(view, Ended(error=error))


def _capture_from(source: PortSource, plan: CapturePlan, clock: Clock, view: Connection) -> None:
    for number in _ENDING_SIGNALS:
        signal.signal(number, lambda *_: source.stop())
    if view.poll():
        # Whatever comes means the end. Nothing was captured yet: no file is made, none replaced.
        _tell(view, Ended())
        return
    # From here on an end leaves an empty recording, which is a true one: the port was open, and
    # nothing came.
    recorder = _recorder(plan, clock)
    _tell(view, Started(recorder.path if recorder else None))
    threading.Thread(target=_obey, args=(view, source), name="obeys", daemon=True).start()
    outbox = Outbox(view, source.stop)
    ended = _Run(plan, source, recorder, outbox).to_the_end()
    # The file is closed: what is left to be told is nothing to hold up a signal for.
    for number in _ENDING_SIGNALS:
        signal.signal(number, signal.SIG_DFL)
    outbox.close(ended)


def _tell(view: Connection, message: Message) -> None:
    with suppress(OSError):  # the view is gone; whoever obeys it learns that too
        view.send(message)


def _recorder(plan: CapturePlan, clock: Clock) -> RecordingWriter | None:
    if plan.recording is None:
        return None
    facts = host_facts(clock.utc_at_tie_ns) | clock.facts() | {"settings": str(plan.settings)}
    ports = (PortFacts(plan.port, plan.settings.baud),)
    return RecordingWriter(plan.recording, ports, facts, existing=plan.existing)


def _obey(view: Connection, source: PortSource) -> None:
    try:
        while view.recv() != STOP:
            pass
    except (EOFError, OSError):
        pass  # nobody is there to tell us any more
    source.stop()


class _Run:
    """One run of a plan, from the first chunk to the closed file."""

    def __init__(
        self,
        plan: CapturePlan,
        source: PortSource,
        recorder: RecordingWriter | None,
        outbox: Outbox,
    ) -> None:
        self._plan = plan
        self._source = source
        self._recorder = recorder
        self._outbox = outbox
        self._framer = Framer(plan.port, plan.settings.baud)
        self._left = plan.count
        self._end_ns: float | None = None
        self._flush_ns = 0
        self._failure: FteSniffError | None = None
        self._last_event = ""

    def to_the_end(self) -> Ended:
        """Take all that the source has, close the recording, and say how it ended."""
        for item in self._source:
            if isinstance(item, PortEvent):
                self._take_event(item)
            else:
                self._take_chunk(item)
            if self._left == 0:
                break
        self._take_rows(self._framer.flush())
        self._record(RecordingWriter.close)
        return self._ended()

    def _ended(self) -> Ended:
        if self._source.end is SourceEnd.LOST and self._left != 0:
            reason = f"{self._plan.port} was lost: {self._last_event}"
            return Ended(reason, self._failure or PortError(f"{reason}; check cable and power"))
        return Ended(None, self._failure)

    def _take_chunk(self, chunk: Chunk) -> None:
        self._take_rows(self._framer.feed(chunk))
        now_ns = chunk.t_ns or 0
        if self._plan.duration_s is not None:
            if self._end_ns is None:
                self._end_ns = now_ns + self._plan.duration_s * 1e9
            if now_ns >= self._end_ns:
                self._source.stop()
        if now_ns >= self._flush_ns:
            self._record(RecordingWriter.flush)
            self._flush_ns = now_ns + FLUSH_EVERY_NS

    def _take_rows(self, rows: list[Row]) -> None:
        if self._left is not None:
            rows = rows[: self._left]
            self._left -= len(rows)
        if rows:
            self._record(lambda recorder: recorder.write(rows))
            self._outbox.put_rows(rows)

    def _take_event(self, event: PortEvent) -> None:
        if event.kind is PortEventKind.LOST:
            self._last_event = event.detail
        self._record(lambda recorder: recorder.write_event(event))
        self._outbox.put_event(event)

    def _record(self, do: Callable[[RecordingWriter], None]) -> None:
        """Do something to the recording; when it fails it stops, and the capture goes on."""
        if self._recorder is None:
            return
        try:
            do(self._recorder)
        except FteSniffError as failure:
            self._failure = failure
            self._outbox.put_failure(failure)
            self._recorder.close()
            self._recorder = None
