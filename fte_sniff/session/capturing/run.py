"""Owns one run of a plan: items of a source in, rows in order to the recording and to the view.

It must not know processes or signals, nor what shows the rows.

    chunk -> the framer of its port -> one order of all ports -+-> recorder
                                                               +-> outbox
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby

from fte_sniff.capture.clock import Clock, ClockWatch
from fte_sniff.capture.source import Source, SourceEnd
from fte_sniff.errors import FteSniffError, PortError, Said
from fte_sniff.protocol import Chunk, Framer, LineErrorMarker, PortEvent, PortEventKind, Row
from fte_sniff.recording.recorder import Recorder
from fte_sniff.session.capturing.messages import Ended
from fte_sniff.session.capturing.ordering import Entry, Ordering
from fte_sniff.session.capturing.outbox import Outbox
from fte_sniff.session.capturing.plan import CapturePlan
from fte_sniff.session.capturing.wiring import WiringWatch

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
            reason = Said("{port} was lost: {why}", port=lost.port, why=lost.detail)
            return Ended(
                reason,
                failure or PortError(Said("{reason}; check cable and power", reason=reason)),
                outcome,
            )
        return Ended(None, failure, outcome)

    def _take_chunk(self, chunk: Chunk) -> None:
        framer = self._framers[chunk.port]
        self._markers[chunk.port].heed(chunk)
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


def _step_words(step_ns: int) -> Said:
    seconds = abs(step_ns) / 1e9
    if step_ns < 0:
        return Said(
            "this machine's clock was set back by {seconds:.3f} s; "
            "the times here go on evenly from the start of the capture",
            seconds=seconds,
        )
    return Said(
        "this machine's clock was set forth by {seconds:.3f} s; "
        "the times here go on evenly from the start of the capture",
        seconds=seconds,
    )
