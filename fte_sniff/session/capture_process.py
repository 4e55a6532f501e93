"""Child process: capture, record, send batches."""

from __future__ import annotations

import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import groupby
from multiprocessing.connection import Connection
from pathlib import Path

from fte_sniff.capture.bridge import BridgeSource
from fte_sniff.capture.clock import Clock, ClockWatch
from fte_sniff.capture.source import Source, SourceEnd
from fte_sniff.errors import FteSniffError, PortError, TranslatableText
from fte_sniff.protocol import Chunk, Framer, LineErrorMarker, PortEvent, PortEventKind, Row
from fte_sniff.recording.metadata import PROGRAM, PortFacts, host_facts
from fte_sniff.recording.recorder import Change, Recorder
from fte_sniff.session.capture_state import (
    DROP,
    STOP,
    CapturePlan,
    Ended,
    Message,
    RowsMessage,
    Started,
)
from fte_sniff.session.port_merge import Entry, Ordering, WiringWatch

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
                    RowsMessage(rows, events, self._total, self._dropped, changes, self._leftover)
                )
                self._rows.clear()
                self._events.clear()
                self._recording.clear()
            if self._end:
                found.append(self._end)
            return found


_BREAKS = frozenset({PortEventKind.LOST, PortEventKind.OVERRUN})
"""Events across which bytes do not join."""

MUCH = 2**20
"""Bytes that take so long to be written that people want to know: more than a second."""


class Run:
    """One run of a plan, from the first chunk to the closed file."""

    def __init__(
        self,
        plan: CapturePlan,
        clock: Clock,
        source: Source,
        recorder: Recorder | None,
        outbox: Outbox,
    ) -> None:
        """Make ready; nothing is taken from the source yet."""
        self._plan = plan
        self._clock = clock
        self._clock_watch = ClockWatch(clock.system_ahead_ns())
        self._source = source
        self._recorder = recorder
        self._outbox = outbox
        names, baud = plan.wiring.names, plan.wiring.settings.baud
        self._framers = {name: Framer(name, baud) for name in names}
        self._markers = {name: LineErrorMarker() for name in names}
        self._order = Ordering({name: source.uncertainty_ns[name] for name in names})
        self._wiring = WiringWatch(names)
        self._left = plan.count
        self._begun = self._leftover_told = False
        self._flush_every_ns = round(plan.keeping.flush_every_s * 1e9)
        self._flush_ns = 0
        self._lost: PortEvent | None = None

    def to_the_end(self) -> Ended:
        """Take all that the source has, close the recording, and say how it ended."""
        for item in self._source:
            if isinstance(item, PortEvent):
                self._take_event(item)
            else:
                self._take_chunk(item)
            self._hand_on(self._order.take())
            if self._left == 0:
                break
        for port, framer in self._framers.items():
            self._put_rows(port, framer.flush())
        self._hand_on(self._order.drain())
        self._record(Recorder.close)
        return self._ended()

    def _ended(self) -> Ended:
        failure: FteSniffError | None = self._recorder.failure if self._recorder else None
        outcome = self._recorder.outcome if self._recorder else None
        lost = self._lost
        if lost is not None and self._source.end is SourceEnd.LOST and self._left != 0:
            reason = TranslatableText("{port} was lost: {why}", port=lost.port, why=lost.detail)
            return Ended(
                reason,
                failure or PortError("{reason}; check cable and power", reason=reason),
                outcome,
            )
        return Ended(None, failure, outcome)

    def _take_chunk(self, chunk: Chunk) -> None:
        framer = self._framers[chunk.port]
        self._markers[chunk.port].observe(chunk)
        self._put_rows(chunk.port, framer.feed(chunk))
        now_ns = chunk.t_ns or 0
        waits_since_ns = framer.waits_since_ns
        self._order.heard(chunk.port, now_ns, waits_since_ns, data=bool(chunk.data))
        self._begin_at(now_ns)
        self._tell_what_waits()
        if now_ns >= self._flush_ns:
            self._watch_clock(chunk.port, now_ns)
            self._record(Recorder.flush)
            self._flush_ns = now_ns + self._flush_every_ns

    def _watch_clock(self, port: str, now_ns: int) -> None:
        step_ns = self._clock_watch.step(self._clock.system_ahead_ns())
        if step_ns:
            detail = _step_words(step_ns)
            self._order.put(port, [PortEvent(now_ns, port, PortEventKind.CLOCK_SET, detail)])

    def _begin_at(self, now_ns: int) -> None:
        """The first chunk has come: the source itself knows from now on when the end is due."""
        if self._plan.duration_s is not None and not self._begun:
            self._source.stop_at(now_ns + self._plan.duration_s * 1e9)
        self._begun = True

    def _tell_what_waits(self) -> None:
        """Where the reading is over and much is yet to be written, say how much, once."""
        if not self._leftover_told and self._source.end is not None:
            self._leftover_told = True
            if (waiting := self._source.waiting) >= MUCH:
                self._outbox.put_leftover(waiting)

    def _take_event(self, event: PortEvent) -> None:
        if event.kind in _BREAKS:
            self._put_rows(event.port, self._framers[event.port].cut())
        if event.kind is PortEventKind.LOST:
            self._lost = event
        if event.kind is PortEventKind.BAUD_CHANGED and event.count:
            self._framers[event.port].pace(event.count)
        self._order.put(event.port, [event])

    def _put_rows(self, port: str, rows: Sequence[Row]) -> None:
        if rows:
            rows = self._markers[port].mark(rows)
            self._order.put(port, rows)
            self._order.put(port, self._wiring.look(port, rows))

    def _hand_on(self, entries: Sequence[Entry]) -> None:
        for is_event, group in groupby(entries, lambda entry: isinstance(entry, PortEvent)):
            if is_event:
                for event in group:
                    assert isinstance(event, PortEvent)
                    self._hand_on_event(event)
            else:
                self._hand_on_rows([row for row in group if not isinstance(row, PortEvent)])

    def _hand_on_rows(self, rows: list[Row]) -> None:
        if self._left is not None:
            rows = rows[: self._left]
            self._left -= len(rows)
        if rows:
            self._record(lambda recorder: recorder.write(rows))
            self._outbox.put_rows(rows)

    def _hand_on_event(self, event: PortEvent) -> None:
        self._record(lambda recorder: recorder.write_event(event))
        self._outbox.put_event(event)

    def _record(self, do: Callable[[Recorder], None]) -> None:
        """Do something to the recording, and hand on what became of it."""
        if self._recorder is None:
            return
        do(self._recorder)
        if changes := self._recorder.changes():
            self._outbox.put_recording(changes)


def _step_words(step_ns: int) -> TranslatableText:
    seconds = abs(step_ns) / 1e9
    if step_ns < 0:
        return TranslatableText(
            "this machine's clock was set back by {seconds:.3f} s; "
            "the times here go on evenly from the start of the capture",
            seconds=seconds,
        )
    return TranslatableText(
        "this machine's clock was set forth by {seconds:.3f} s; "
        "the times here go on evenly from the start of the capture",
        seconds=seconds,
    )


_SWITCH_EVERY_S = 0.0005
"""How long the thread that frames and records may keep the one that reads from its bytes."""

_DEAF_TO = (signal.SIGINT, signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU)
"""What a terminal tells all that runs on it."""

_ENDING_SIGNALS = (signal.SIGTERM, signal.SIGHUP)


def capture(plan: CapturePlan, view: Connection) -> None:
    """Run a capture in this process until it ends, telling the view.

    Args:
        plan: what to do.
        view: where `Message`s go, and where STOP comes from; its end means STOP too.
    """
    # Whoever asks who has the port open shall read a name that says something.
    with suppress(OSError):
        Path("/proc/self/comm").write_text(PROGRAM)
    # Ctrl-C and Ctrl-Z reach every process of the terminal; here only the view decides what they
    # mean. A capture that stood still would lose what comes meanwhile.
    for number in _DEAF_TO:
        signal.signal(number, signal.SIG_IGN)
    sys.setswitchinterval(_SWITCH_EVERY_S)
    clock = Clock.tied()
    try:
        source = plan.wiring.open(clock)
        # Before it passes anything on: what is passed on is recorded, however soon the end comes.
        for number in _ENDING_SIGNALS:
            signal.signal(number, lambda *_: source.stop())
        with source:
            _capture_from(source, plan, clock, view)
    except FteSniffError as error:
        _tell(view, Ended(error=error))


def _capture_from(source: Source, plan: CapturePlan, clock: Clock, view: Connection) -> None:
    if plan.outlives_view:
        # The terminal is gone, and with it the view; that is no reason to end.
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    if view.poll() and not isinstance(source, BridgeSource):
        # Whatever comes means the end. Nothing was captured yet: no file is made, none replaced.
        # (A bridge may have passed bytes on by now, and all of these are recorded.)
        _tell(view, Ended())
        return
    # From here on an end leaves an empty recording, which is a true one: the port was open, and
    # nothing came.
    recorder = _recorder(plan, _facts(plan, clock, source))
    device = source.device if isinstance(source, BridgeSource) else None
    _tell(view, Started(recorder.path if recorder else None, device))
    when_gone = _go_on if plan.outlives_view else source.stop
    threading.Thread(target=_obey, args=(view, source, when_gone), daemon=True).start()
    outbox = Outbox(view, when_gone)
    ended = Run(plan, clock, source, recorder, outbox).to_the_end()
    # The file is closed: what is left to be told is nothing to hold up a signal for.
    for number in _ENDING_SIGNALS:
        signal.signal(number, signal.SIG_DFL)
    outbox.close(ended)


def _tell(view: Connection, message: Message) -> None:
    with suppress(OSError):  # the view is gone; whoever obeys it learns that too
        view.send(message)


def _facts(plan: CapturePlan, clock: Clock, source: Source) -> dict[str, str]:
    """What the recording says of its capture."""
    facts = host_facts(clock.utc_at_tie_ns) | clock.facts()
    facts["settings"] = str(plan.wiring.settings)
    for number, name in enumerate(plan.wiring.names, 1):
        facts[f"port.{number}.time_uncertainty_ns"] = str(source.uncertainty_ns[name])
        facts[f"port.{number}.granted"] = source.granted[name]
    return facts


def _recorder(plan: CapturePlan, facts: dict[str, str]) -> Recorder | None:
    if plan.recording is None:
        return None
    baud = plan.wiring.settings.baud
    ports = tuple(PortFacts(name, baud) for name in plan.wiring.names)
    select = None
    if plan.trigger is not None:
        from fte_sniff.analysis.filter.row_filter import RowFilter

        select = RowFilter.parse(plan.trigger).select
        facts = facts | {"trigger": plan.trigger}
    return Recorder(
        plan.recording,
        ports,
        facts,
        existing=plan.existing,
        keeping=plan.keeping,
        select=select,
    )


def _obey(view: Connection, source: Source, when_gone: Callable[[], None]) -> None:
    obeyed = {STOP: source.stop, DROP: source.drop}
    try:
        while True:
            obeyed[view.recv()]()
    except (EOFError, OSError):
        when_gone()


def _go_on() -> None:
    """What a capture does about a view that is gone, where it was asked to outlive it."""
