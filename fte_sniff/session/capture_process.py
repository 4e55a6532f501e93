"""The capture process: reads ports, frames their bytes, and records the rows.

    Source ──chunks──► Wire: framer ──rows──► Merge ──► Recorder ──► file ◄── views follow it
                                                │
                             control: its state ──► the view that started it

It shares nothing else with a view, so one that is slow, hangs or is killed costs no row.
"""

from __future__ import annotations

import io
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from shutil import rmtree

import numpy as np

from fte_sniff.capture.clock import Clock, ClockWatch
from fte_sniff.capture.silence import DEFAULT_SILENCE_S, SilenceWatch
from fte_sniff.capture.source import Source, SourceEnd, Wiring
from fte_sniff.errors import FteSniffError, PortError, TranslatableText
from fte_sniff.platform import ENDING_SIGNALS, HANG_UP
from fte_sniff.protocol import Chunk, Direction, Framer, PortEvent, PortEventKind
from fte_sniff.protocol.rows import Rows
from fte_sniff.recording.metadata import PROGRAM, PortFacts, host_facts
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.recorder import Recorder, RecordingOptions
from fte_sniff.session.control import CaptureState
from fte_sniff.session.merge import Lane, Merge, uncertain
from fte_sniff.session.worker_process import line_of


@dataclass(frozen=True, slots=True)
class CapturePlan:
    """What to capture and how to record it."""

    wiring: Wiring
    recording: Path
    """Path of the recording."""
    existing: Existing = Existing.REFUSE
    recording_options: RecordingOptions = field(default_factory=RecordingOptions)
    is_temporary: bool = False
    """Whether the recording, and its folder, go with the program."""
    outlives_view: bool = False
    """Continue if the view is killed or its terminal is closed; a stop still ends it."""
    shows_rows: bool = True
    """Whether a view shows the rows as they come, so that they are written at once."""
    duration_s: float | None = None
    """End after this many seconds; None or infinity for no limit."""
    count: int | None = None
    """End after this many rows; None for no limit."""
    silence_s: float = DEFAULT_SILENCE_S
    """Report a wire that was alive and is silent for this time, seconds."""


# The state, for the view

SLOW_S = 1.0
"""Seconds after which a write of the recording is reported as slow."""

_REPORT_EVERY_S = 0.25


class Reporter:
    """Sends the state to the view from a thread; a view that does not read delays nothing else.

    The view kills a capture that sends nothing: one that waits for the disk still reports that.
    """

    def __init__(
        self, sent: io.FileIO, state: Callable[[], CaptureState], when_gone: Callable[[], None]
    ) -> None:
        """Start sending what `state` returns; `when_gone` is called if the view is gone."""
        self._sent, self._state, self._when_gone = sent, state, when_gone
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run, name="reports", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Return when the state that has ended is sent, or the view is gone."""
        self._ends.set()
        self._thread.join()

    def _run(self) -> None:
        last: CaptureState | None = None
        try:
            while last is None or not last.is_ended:
                state = self._state()
                if state != last or state.is_slow:
                    self._sent.write(line_of(state))
                last = state
                self._ends.wait(_REPORT_EVERY_S)
        except OSError:
            self._when_gone()


# Swapped or mixed wiring: which direction each port carries

SETTLED = 10
"""Valid frames of one direction after which a wire is known to carry it."""

UNEXPECTED = 3
"""Valid frames of a direction that another wire carries, after which it is reported; one can be
chance."""


_DIRECTIONS = tuple(Direction)


class WiringWatch:
    """Reports once per wire that it carries the direction of another one."""

    def __init__(self, ports: Sequence[str]) -> None:
        self._counts = {port: np.zeros(len(_DIRECTIONS), np.int64) for port in ports}
        self._watched = set(ports) if len(ports) > 1 else set[str]()

    def observe(self, port: str, rows: Rows) -> list[PortEvent]:
        """Events that these rows of one port give rise to."""
        if port not in self._watched:
            return []
        codes = rows.directions[rows.framed & (rows.faults == 0)]
        self._counts[port] += np.bincount(codes, minlength=len(_DIRECTIONS))
        for other, counts in self._counts.items():
            both = (counts >= SETTLED) & (self._counts[port] >= UNEXPECTED)
            if other != port and both.any():
                self._watched -= {port, other}
                detail = TranslatableText(
                    "{direction} frames here and on {other} too: swapped or mixed wiring, or both "
                    "adapters on one wire; connect each adapter's RX to its own wire",
                    direction=_DIRECTIONS[int(both.argmax())],
                    other=other,
                )
                return [PortEvent(int(rows.t_ns[-1]), port, PortEventKind.WIRING, detail)]
        return []


# The loop

_BREAKS = frozenset({PortEventKind.LOST, PortEventKind.OVERRUN})
"""Events that break the byte stream."""

DRAIN_EVERY_NS = 40_000_000
"""Time of the line between two batches of rows: a batch takes as long as many rows. A recording is
flushed only after a batch."""

MOST_UNDRAINED = 2**18
"""Bytes after which a batch ends early, so that a capture with a backlog keeps reporting."""

REACH_NS = 20_000_000
"""How long before a read its bytes may have begun, if earlier reads were empty: an adapter delivers
bytes late."""

MOST_HELD_NS = 1_000_000_000
"""Longest time that a row waits for another port, in nanoseconds of the ports' times."""


def watermark_ns(read_ns: int, now_ns: int, pending_ns: int | None) -> int:
    """The earliest time at which the next row of a port can begin.

    That of a port with undecided bytes begins at the first of them, at `pending_ns`. That of
    another does not begin before the last read with bytes, nor longer than `REACH_NS` before the
    last read.
    """
    return max(read_ns, now_ns - REACH_NS) if pending_ns is None else pending_ns


class Wire:
    """One port, from its chunks to the lane of its rows."""

    def __init__(self, framer: Framer, silence: SilenceWatch, uncertainty_ns: int) -> None:
        self.framer, self.lane, self.silence = framer, Lane(), silence
        self._uncertainty_ns = uncertainty_ns
        self._read_ns = self._now_ns = 0

    def push(self, chunk: Chunk) -> None:
        """Frame a chunk."""
        self.framer.push(chunk)
        self._now_ns = chunk.t_ns or 0
        if chunk.data:
            self._read_ns = max(self._read_ns, self._now_ns)

    def drain(self) -> Rows:
        """Put what was decided into the lane, and return it; move the lane's watermark."""
        rows = self.framer.drain()
        if len(rows):
            self.lane.put(rows)
            if rows.framed.any():
                self.silence.frame_came()
        next_ns = watermark_ns(self._read_ns, self._now_ns, self.framer.pending_since_ns)
        self.lane.reached = next_ns - self._uncertainty_ns
        return rows

    def put(self, *events: PortEvent) -> None:
        """Put events that come after what was drained."""
        for event in events:
            self.lane.put(event)


class CaptureLoop:
    """The capture loop, from the first chunk to the closed file."""

    def __init__(
        self,
        plan: CapturePlan,
        clock: Clock,
        source: Source,
        recorder: Recorder,
    ) -> None:
        self._plan, self._clock, self._source, self._recorder = plan, clock, source, recorder
        self._clock_watch = ClockWatch(clock.system_ahead_ns())
        names, baud = plan.wiring.names, plan.wiring.settings.baud
        self._merge = Merge()
        self._wires: dict[str, Wire] = {}
        for name in names:
            silence = SilenceWatch(name, plan.silence_s)
            wire = Wire(Framer(name, baud), silence, source.uncertainty_ns[name])
            self._wires[name] = wire
            self._merge.lanes.append(wire.lane)
        self._wiring = WiringWatch(names)
        self._remaining = plan.count
        self._rows = self._turns = 0
        self._started = self._is_ending = self._is_ended = False
        self._now_ns = self._drain_ns = self._undrained = 0
        self._lost: PortEvent | None = None
        self._writing_since_s: float | None = None
        """When the write under way began."""
        self.shows_rows = plan.shows_rows
        """Whether a view shows the rows as they come."""
        self._reason: str | None = None
        self._error: FteSniffError | None = None

    def run(self) -> None:
        """Process the source to its end, and close the recording."""
        for item in self._source:
            self._turns += 1
            if isinstance(item, PortEvent):
                self._process_event(item)
            else:
                self._process_chunk(item)
            if self._remaining == 0:
                break
        self._is_ending = True
        for port, wire in self._wires.items():
            wire.framer.end()
            self._drain_wire(port)
            if self._remaining == 0:
                wire.put(self._closed(port))
        self._emit(final=True)
        self._record(Recorder.close)
        self._error, lost = self._recorder.failure, self._lost
        if lost is not None and self._source.end is SourceEnd.LOST and self._remaining != 0:
            reason = TranslatableText("{port} was lost: {why}", port=lost.port, why=lost.detail)
            self._reason = reason
            self._error = self._error or PortError("{reason}; check cable and power", reason=reason)
        self._is_ended = True

    def _closed(self, port: str) -> PortEvent:
        detail = TranslatableText("all requested rows were captured")
        return PortEvent(self._clock.now_ns(), port, PortEventKind.CLOSED, detail)

    @property
    def state(self) -> CaptureState:
        """How far it is; any thread may read it."""
        since_s, recorder, is_ended = self._writing_since_s, self._recorder, self._is_ended
        return CaptureState(
            tuple(recorder.files),
            None if recorder.is_stopped else recorder.path,
            self._source.device,
            self._error if is_ended else recorder.trouble,
            is_ended,
            self._reason,
            recorder.outcome if is_ended else None,
            self._rows,
            recorder.unflushed_rows,
            self._source.waiting,
            since_s is not None and time.monotonic() - since_s >= SLOW_S,
            self._is_ending or self._source.end is not None,
            recorder.size,
            self._turns,
        )

    def _process_chunk(self, chunk: Chunk) -> None:
        wire, now_ns = self._wires[chunk.port], chunk.t_ns or 0
        if (event := wire.silence.observe(chunk)) is not None:
            wire.put(event)
        wire.push(chunk)
        self._now_ns = max(self._now_ns, now_ns)
        self._start_duration(now_ns)
        self._undrained += len(chunk.data)
        if now_ns >= self._drain_ns or self._undrained >= MOST_UNDRAINED:
            self._drain_ns, self._undrained = now_ns + DRAIN_EVERY_NS, 0
            for port in self._wires:
                self._drain_wire(port)
            self._emit()
            if (event := wire.silence.check(now_ns)) is not None:
                wire.put(event)
            self._watch_clock(chunk.port, now_ns)
            at_once = self.shows_rows
            self._record(lambda recorder: recorder.flush_if_due(now_ns, at_once=at_once))

    def _drain_wire(self, port: str) -> None:
        wire = self._wires[port]
        rows = wire.drain()
        if len(rows):
            wire.put(*self._wiring.observe(port, rows))

    def _watch_clock(self, port: str, now_ns: int) -> None:
        step_ns = self._clock_watch.step(self._clock.system_ahead_ns())
        if step_ns:
            detail = TranslatableText(
                "this machine's clock was set by {seconds:+.3f} s; "
                "times in this capture continue evenly from its start",
                seconds=step_ns / 1e9,
            )
            self._wires[port].put(PortEvent(now_ns, port, PortEventKind.CLOCK_SET, detail))

    def _start_duration(self, now_ns: int) -> None:
        if self._plan.duration_s is not None and not self._started:
            self._source.stop_at(now_ns + self._plan.duration_s * 1e9)
        self._started = True

    def _process_event(self, event: PortEvent) -> None:
        wire = self._wires[event.port]
        is_break = event.kind in _BREAKS
        if is_break:
            wire.framer.end()
        self._drain_wire(event.port)  # rows before the event keep their places and times
        if is_break:
            wire.framer.restart()
        if event.kind is PortEventKind.LOST:
            self._lost = event
        if event.kind in (PortEventKind.LOST, PortEventKind.CLOSED):
            wire.silence.lost()
        if event.kind is PortEventKind.BAUD_CHANGED and event.count:
            wire.framer.set_baud(event.count)
        wire.put(event)
        self._emit()

    def _emit(self, *, final: bool = False) -> None:
        """Record what is settled."""
        for item in self._merge.take(least=self._now_ns - MOST_HELD_NS, final=final):
            entry = self._limited(item) if isinstance(item, Rows) else item
            assert isinstance(entry, Rows | PortEvent)
            self._record(lambda recorder, entry=entry: recorder.write(entry))  # type: ignore[misc]

    def _limited(self, rows: Rows) -> Rows:
        if self._remaining is not None:
            rows = rows[: self._remaining]
            self._remaining -= len(rows)
        self._rows += len(rows)
        unordered = uncertain(rows, self._source.uncertainty_ns)
        return rows.replace(unordered=unordered) if unordered.any() else rows

    def _record(self, do: Callable[[Recorder], None]) -> None:
        self._writing_since_s = time.monotonic()
        try:
            do(self._recorder)
        finally:
            self._writing_since_s = None


_SWITCH_EVERY_S = 0.0005
"""Longest time that the framing thread may delay the reading thread (interpreter switch)."""


def _ending_signals() -> list[signal.Signals]:
    """The signals that end a capture; a SIGHUP that is ignored, as with nohup, stays ignored."""
    return [
        number
        for number in ENDING_SIGNALS
        if number != signal.SIGINT
        and not (number in HANG_UP and signal.getsignal(number) is signal.SIG_IGN)
    ]


def capture(plan: CapturePlan, received: io.FileIO, sent: io.FileIO) -> None:
    """Run a capture in this process; a line that is received ends it, or the end of all lines."""
    # The name that `lsof` and `fuser` show for the open port.
    with suppress(OSError):
        Path("/proc/self/comm").write_text(PROGRAM)
    sys.setswitchinterval(_SWITCH_EVERY_S)
    clock = Clock.tied()
    try:
        source = plan.wiring.open(clock)
        # Before a bridge forwards anything: forwarded bytes are recorded in any case.
        for number in _ending_signals():
            signal.signal(number, lambda *_: source.stop())
        with source:
            _capture_from(source, plan, clock, received, sent)
    except FteSniffError as error:
        with suppress(OSError):  # the view is gone
            sent.write(line_of(CaptureState(error=error, is_ended=True)))


def _capture_from(
    source: Source, plan: CapturePlan, clock: Clock, received: io.FileIO, sent: io.FileIO
) -> None:
    if plan.outlives_view:
        # A closed terminal ends the view only.
        for number in HANG_UP:
            signal.signal(number, signal.SIG_IGN)
    # From here on the result is a recording, possibly empty: the port was open, no byte arrived.
    recorder = _recorder(plan, _facts(plan, clock, source))
    is_gone = threading.Event()

    def when_gone() -> None:
        is_gone.set()
        loop.shows_rows = False
        if not plan.outlives_view:
            source.stop()

    loop = CaptureLoop(plan, clock, source, recorder)
    reporter = Reporter(sent, lambda: loop.state, when_gone)
    requests = (received, source.stop, when_gone)
    threading.Thread(target=_obey, args=requests, daemon=True).start()
    loop.run()
    # The file is closed; signals may end the process while the last state is sent.
    for number in _ending_signals():
        signal.signal(number, signal.SIG_DFL)
    reporter.close()
    if plan.is_temporary and is_gone.is_set():
        rmtree(plan.recording.parent, ignore_errors=True)


def _facts(plan: CapturePlan, clock: Clock, source: Source) -> dict[str, str]:
    facts = host_facts(clock.utc_at_tie_ns) | clock.facts()
    facts["settings"] = str(plan.wiring.settings)
    for number, name in enumerate(plan.wiring.names, 1):
        facts[f"port.{number}.time_uncertainty_ns"] = str(source.uncertainty_ns[name])
        facts[f"port.{number}.granted"] = source.capabilities[name]
    return facts


def _recorder(plan: CapturePlan, facts: dict[str, str]) -> Recorder:
    baud = plan.wiring.settings.baud
    ports = tuple(PortFacts(name, baud) for name in plan.wiring.names)
    options = plan.recording_options
    return Recorder(plan.recording, ports, facts, existing=plan.existing, options=options)


def _obey(received: io.FileIO, stop: Callable[[], None], when_gone: Callable[[], None]) -> None:
    """Stop at each line of the view; the end of its pipe means that it is gone."""
    while received.readline():
        stop()
    when_gone()
