"""The capture process: reads ports, frames their bytes, and records the rows.

    Source ──chunks──► Wire: framer ──rows──► Merge ──► Recorder ──► file ◄── views follow it
                                                │
                             control: its state ──► the view that started it

It shares nothing else with a view, so one that is slow, hangs or is killed costs no row.
"""

from __future__ import annotations

import io
import os
import signal
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from shutil import rmtree

from fte_sniff.capture.clock import Clock, ClockWatch
from fte_sniff.capture.silence import SilenceWatch
from fte_sniff.capture.source import Source
from fte_sniff.errors import FteSniffError, PortError, TranslatableText
from fte_sniff.platform import HANG_UP
from fte_sniff.protocol.framer import Framer
from fte_sniff.protocol.items import Chunk, PortEvent, PortEventKind
from fte_sniff.protocol.rows import Rows
from fte_sniff.protocol.spec import HEADERS, Direction
from fte_sniff.recording.metadata import PROGRAM, PortFacts, host_facts
from fte_sniff.recording.recorder import Recorder
from fte_sniff.session.control import CapturePlan, CaptureState
from fte_sniff.session.merge import Lane, Merge, uncertain

SLOW_S = 1.0
"""Seconds after which a write of the recording is reported as slow."""

_REPORT_EVERY_S = 0.25

SETTLED = 10
"""Valid frames of one direction after which a wire is known to carry it; one can be chance."""


# The loop

_BREAKS = frozenset({PortEventKind.LOST, PortEventKind.OVERRUN})
"""Events that break the byte stream."""

EMIT_EVERY_NS = 250_000_000
"""Time of the line between two batches of recorded rows, where no view shows them."""

MOST_WAITING = 2**15
"""Rows after which a batch is recorded in any case."""

REACH_NS = 20_000_000
"""How long before a read its bytes may have begun, if earlier reads were empty: an adapter delivers
bytes late."""

MOST_HELD_NS = 1_000_000_000
"""Longest time that a row waits for another port, in nanoseconds of the ports' times."""


class Wire:
    """One port, from its chunks to the lane of its rows."""

    def __init__(self, name: str, baud: int, silence_s: float, uncertainty_ns: int) -> None:
        self.framer, self.lane = Framer(name, baud), Lane()
        self.silence = SilenceWatch(name, silence_s)
        self.frames = Counter[Direction]()
        """Valid ones so far, by direction."""
        self._uncertainty_ns = uncertainty_ns
        self._read_ns = self._now_ns = 0

    def push(self, chunk: Chunk) -> None:
        """Frame a chunk."""
        if (event := self.silence.observe(chunk)) is not None:
            self.lane.put(event)
        self.framer.push(chunk)
        self._now_ns = chunk.t_ns or 0
        if chunk.data:
            self._read_ns = max(self._read_ns, self._now_ns)

    def drain(self) -> None:
        """Put what was decided into the lane, and move its watermark.

        The next row begins at the first undecided byte. Without one, it does not begin before the
        last read with bytes, nor longer than `REACH_NS` before the last read.
        """
        rows = self.framer.drain()
        if len(rows):
            self.lane.put(rows)
            if rows.framed.any():
                self.silence.frame_came()
            headers = rows.raw[rows.faults == 0, 0].tobytes()
            for direction, header in HEADERS.items():
                self.frames[direction] += headers.count(header)
        next_ns = self.framer.pending_since_ns
        if next_ns is None:
            next_ns = max(self._read_ns, self._now_ns - REACH_NS)
        self.lane.reached = next_ns - self._uncertainty_ns


class CaptureLoop:
    """The capture loop, from the first chunk to the closed file."""

    def __init__(self, plan: CapturePlan, clock: Clock, source: Source, recorder: Recorder) -> None:
        self._plan, self._clock, self._source, self._recorder = plan, clock, source, recorder
        self._clock_watch = ClockWatch(clock.system_ahead_ns())
        baud, uncertainty_ns = plan.wiring.settings.baud, source.uncertainty_ns
        self._wires = {
            name: Wire(name, baud, plan.silence_s, uncertainty_ns[name])
            for name in plan.wiring.names
        }
        self._merge = Merge()
        self._merge.lanes += [wire.lane for wire in self._wires.values()]
        self._remaining = plan.count
        self._turns = 0
        self._is_mixed = False
        self._now_ns = self._emit_ns = 0
        self._recorded_bytes = 0
        """Bytes of the rows that the recorder has."""
        self._writing_since_s: float | None = None
        """When the write under way began."""
        self.shows_rows = plan.shows_rows
        """Whether a view shows the rows as they come."""
        self._reason: str | None = None
        self._error: FteSniffError | None = None
        self.ended = threading.Event()
        """Set when the recording is closed."""

    def run(self) -> None:
        """Process the source to its end, and close the recording."""
        for batch in self._source:
            self._turns += 1
            for item in batch:
                if isinstance(item, PortEvent):
                    self._process_event(item)
                elif self._remaining != 0:
                    self._process_chunk(item)
            self._drain()
            is_due = self.shows_rows or self._now_ns >= self._emit_ns
            if is_due or self._merge.waiting >= MOST_WAITING:
                self._emit()
                self._watch_clock()
                with self._writing():
                    self._recorder.flush_if_due(self._now_ns, at_once=self.shows_rows)
        for wire in self._wires.values():
            wire.framer.end()
        self._drain()
        self._emit(final=True)
        with self._writing():
            self._recorder.close()
        self._error, lost = self._recorder.failure, self._source.lost
        if lost is not None and self._remaining != 0:
            reason = TranslatableText("{port} was lost: {why}", port=lost.port, why=lost.detail)
            self._reason = reason
            self._error = self._error or PortError("{reason}; check cable and power", reason=reason)
        self.ended.set()

    @property
    def state(self) -> CaptureState:
        """How far it is; any thread may read it."""
        since_s, recorder, is_ended = self._writing_since_s, self._recorder, self.ended.is_set()
        # In this order, what moves on meanwhile counts twice rather than not at all.
        is_ending = self._source.is_over
        waiting = self._source.received_bytes - self._recorded_bytes
        return CaptureState(
            [*map(str, recorder.files)],
            None if recorder.is_stopped else str(recorder.path),
            self._source.device,
            self._error if is_ended else recorder.trouble,
            is_ended,
            self._reason,
            recorder.unflushed_rows,
            waiting,
            since_s is not None and time.monotonic() - since_s >= SLOW_S,
            is_ending,
            recorder.size,
            self._turns,
        )

    def _process_chunk(self, chunk: Chunk) -> None:
        now_ns = chunk.t_ns or 0
        self._wires[chunk.port].push(chunk)
        if self._plan.duration_s is not None and not self._now_ns:
            self._source.stop_at(now_ns + self._plan.duration_s * 1e9)
        self._now_ns = max(self._now_ns, now_ns)

    def _drain(self) -> None:
        """Drain all wires, and report once that two of them carry the same direction."""
        for wire in self._wires.values():
            wire.drain()
        for direction in Direction:
            settled = [
                own for own, wire in self._wires.items() if wire.frames[direction] >= SETTLED
            ]
            if self._is_mixed or len(settled) < 2:
                continue
            self._is_mixed = True
            detail = TranslatableText(
                "{direction} frames here and on {other} too: swapped or mixed wiring, or both "
                "adapters on one wire; connect each adapter's RX to its own wire",
                direction=direction,
                other=settled[1],
            )
            event = PortEvent(self._now_ns, settled[0], PortEventKind.WIRING, detail)
            self._wires[settled[0]].lane.put(event)

    def _watch_clock(self) -> None:
        """Report a step of this machine's clock with the first port."""
        if step_ns := self._clock_watch.step(self._clock.system_ahead_ns()):
            detail = TranslatableText(
                "this machine's clock was set by {seconds:+.3f} s; "
                "times in this capture continue evenly from its start",
                seconds=step_ns / 1e9,
            )
            port, wire = next(iter(self._wires.items()))
            wire.lane.put(PortEvent(self._now_ns, port, PortEventKind.CLOCK_SET, detail))

    def _process_event(self, event: PortEvent) -> None:
        wire = self._wires[event.port]
        is_break = event.kind in _BREAKS
        if is_break:
            wire.framer.end()
        wire.drain()  # rows before the event keep their places and times
        if is_break:
            wire.framer.finish()
        if event.kind in (PortEventKind.LOST, PortEventKind.CLOSED):
            wire.silence.lost()
        if event.kind is PortEventKind.BAUD_CHANGED and event.count:
            wire.framer.set_baud(event.count)
        wire.lane.put(event)
        self._emit()

    def _emit(self, *, final: bool = False) -> None:
        """Record what is settled."""
        self._emit_ns = self._now_ns + EMIT_EVERY_NS
        for item in self._merge.take(least=self._now_ns - MOST_HELD_NS, final=final):
            entry = self._limited(item) if isinstance(item, Rows) else item
            assert isinstance(entry, Rows | PortEvent)
            with self._writing():
                self._recorder.write(entry)
            self._recorded_bytes += int(item.length.sum()) if isinstance(item, Rows) else 0

    def _limited(self, rows: Rows) -> Rows:
        if self._remaining is not None:
            rows = rows[: self._remaining]
            self._remaining -= len(rows)
            if not self._remaining:
                self._source.stop()
        unordered = uncertain(rows, self._source.uncertainty_ns)
        return rows.replace(unordered=unordered) if unordered.any() else rows

    @contextmanager
    def _writing(self) -> Iterator[None]:
        self._writing_since_s = time.monotonic()
        yield
        self._writing_since_s = None


def run() -> None:
    """Run the capture whose plan comes through standard input, see `session.control`."""
    # Unbuffered: a thread that waits for a line holds no lock at the end.
    received, sent = io.FileIO(0, closefd=False), io.FileIO(os.dup(1), "w")
    os.dup2(2, 1)
    if line := received.readline():
        _capture(CapturePlan.parse(line), received, sent)


def _capture(plan: CapturePlan, received: io.FileIO, sent: io.FileIO) -> None:
    for number in (signal.SIGINT, *HANG_UP):  # the view handles them
        signal.signal(number, signal.SIG_IGN)
    # The name that `lsof` and `fuser` show for the open port.
    with suppress(OSError):
        Path("/proc/self/comm").write_text(PROGRAM)
    clock = Clock.tied()
    try:
        source = plan.wiring.open(clock)
        # Before a bridge forwards anything: forwarded bytes are recorded in any case.
        signal.signal(signal.SIGTERM, lambda *_: source.stop())
        with source:
            _capture_from(source, plan, clock, received, sent)
    except FteSniffError as error:
        with suppress(OSError):  # the view is gone
            sent.write(CaptureState(error=error, is_ended=True).line())


def _capture_from(
    source: Source, plan: CapturePlan, clock: Clock, received: io.FileIO, sent: io.FileIO
) -> None:
    # From here on the result is a recording, possibly empty: the port was open, no byte arrived.
    loop = CaptureLoop(plan, clock, source, _recorder(plan, clock, source))
    is_gone = threading.Event()

    def obey() -> None:
        """Stop at each line of the view; the end of its pipe means that it is gone."""
        while received.readline():
            source.stop()
        is_gone.set()
        loop.shows_rows = False
        if not plan.outlives_view:
            source.stop()

    threading.Thread(target=obey, daemon=True).start()
    reports = threading.Thread(target=_report, args=(loop, sent), daemon=True)
    reports.start()
    loop.run()
    # The file is closed; a signal may end the process while the last state is sent.
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    reports.join()
    if plan.is_temporary and is_gone.is_set():
        rmtree(plan.recording.parent, ignore_errors=True)


def _report(loop: CaptureLoop, sent: io.FileIO) -> None:
    """Send the state until it has ended; a view that does not read delays nothing else.

    The view kills a capture that sends nothing: one that waits for the disk still reports that.
    """
    last: CaptureState | None = None
    with suppress(OSError):  # the view is gone
        while last is None or not last.is_ended:
            state = loop.state
            if state != last or state.is_slow:
                sent.write(state.line())
            last = state
            loop.ended.wait(_REPORT_EVERY_S)


def _recorder(plan: CapturePlan, clock: Clock, source: Source) -> Recorder:
    baud = plan.wiring.settings.baud
    ports = tuple(PortFacts(name, baud) for name in plan.wiring.names)
    facts = host_facts(clock.utc_at_tie_ns) | clock.facts()
    facts["settings"] = str(plan.wiring.settings)
    for number, name in enumerate(plan.wiring.names, 1):
        facts[f"port.{number}.time_uncertainty_ns"] = str(source.uncertainty_ns[name])
    return Recorder(plan.recording, ports, facts, existing=plan.existing, options=plan.options)
