"""The capture process: its plan, its messages, and what it does.

It reads ports, frames their bytes, records the rows, and sends them to the view. Only requests such
as STOP come back from the view.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final, TypeAlias

from fte_sniff.capture.clock import Clock, ClockWatch
from fte_sniff.capture.silence import DEFAULT_SILENCE_S, SilenceWatch
from fte_sniff.capture.source import Source, SourceEnd, Wiring
from fte_sniff.errors import FteSniffError, PortError, TranslatableText
from fte_sniff.platform import ENDING_SIGNALS, HANG_UP
from fte_sniff.protocol import Chunk, Direction, Framer, PortEvent, PortEventKind
from fte_sniff.protocol.rows import NO_ROWS, Rows
from fte_sniff.recording.metadata import PROGRAM, PortFacts, host_facts
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.recorder import Change, Outcome, Recorder, RecordingOptions
from fte_sniff.session.merge import Merge, MergeLane


@dataclass(frozen=True, slots=True)
class CapturePlan:
    """What to capture and how to record it."""

    wiring: Wiring
    recording: Path | None
    """Path of the recording; None to record nothing."""
    existing: Existing = Existing.REFUSE
    recording_options: RecordingOptions = field(default_factory=RecordingOptions)
    outlives_view: bool = False
    """Continue if the view is killed or its terminal is closed; a STOP still ends it."""
    duration_s: float | None = None
    """End after this many seconds; None or infinity for no limit."""
    count: int | None = None
    """End after this many rows; None for no limit."""
    silence_s: float = DEFAULT_SILENCE_S
    """Report a wire that was alive when it was silent for this long, seconds."""


# Messages from and to the view

STOP: Final = "stop"
"""Request: end the capture and close its file."""


@dataclass(frozen=True, slots=True)
class Started:
    """The port and the recording, if any, are open."""

    recording: Path | None
    """Path of the recording; may differ from the plan's if that name was taken."""
    device: str | None = None
    """The device that host programs open, for a bridge."""


@dataclass(frozen=True, slots=True)
class WriteProgress:
    """How far the recording is on the disk."""

    unrecorded: int = 0
    """Rows that are not in the file yet."""
    waiting: int = 0
    """Bytes that were read and are in no row yet."""
    is_slow: bool = False
    """Whether a write takes long."""
    is_end: bool = False
    bytes: int = 0
    """Size of all files."""
    turns: int = 0
    """How often the capture has looked for bytes; it grows on a silent line too."""

    @property
    def remaining(self) -> TranslatableText:
        """What is not in the file yet: `512 rows and 1,024 bytes not yet in rows`."""
        rows = TranslatableText("{rows:,} rows", rows=self.unrecorded)
        if not self.waiting:
            return rows
        return TranslatableText(
            "{rows} and {bytes:,} bytes not yet in rows", rows=rows, bytes=self.waiting
        )


@dataclass(frozen=True, slots=True)
class RowsMessage:
    """Rows and events since the previous batch."""

    rows: Rows
    total_rows: int
    """All rows captured so far."""
    not_shown: int
    """Rows captured and recorded, but dropped because the view was too slow."""
    recording: tuple[Change, ...] = ()
    """Changes of the recording since the previous batch."""
    leftover: int = 0
    """Bytes still to be written when reading ended, if many; else 0."""
    progress: WriteProgress = WriteProgress()


@dataclass(frozen=True, slots=True)
class Ended:
    """The last message: the capture is over and its file is closed."""

    reason: str | None = None
    """Why it ended, in one line; None if it was requested."""
    error: FteSniffError | None = None
    outcome: Outcome | None = None
    progress: WriteProgress = WriteProgress()
    """How far the recording is; the last known if the capture was killed."""


Message: TypeAlias = Started | RowsMessage | Ended


MOST_WAITING = 65_536
"""Most rows that wait for the view; older ones are dropped from the view only."""

MOST_EVENTS = 1024
"""Most port events that wait for the view."""

SLOW_S = 1.0
"""Seconds after which a write of the recording is reported as slow."""

BATCH_EVERY_S = 0.05
"""Seconds between two batches: imperceptible, but many rows."""


class Outbox:
    """Queue of rows and events that a thread sends to the view in batches."""

    def __init__(self, connection: Connection, when_gone: Callable[[], None]) -> None:
        """Start sending; `when_gone` is called once, from that thread, if the view is gone."""
        self._connection = connection
        self._when_gone = when_gone
        self._changed = threading.Condition()
        self._rows: deque[Rows] = deque()
        self._waiting = 0
        """Rows that wait."""
        self._events: deque[PortEvent] = deque(maxlen=MOST_EVENTS)
        self._recording: list[Change] = []
        self._total = self._dropped = 0
        self.leftover = 0
        """Bytes that still waited when reading ended; sent with the next batch."""
        self._end: Ended | None = None
        self._turns = 0
        self.progress: Callable[[], WriteProgress] = WriteProgress
        """How far the recording is on the disk; called from the sending thread."""
        self._hurry = threading.Event()
        self._thread = threading.Thread(target=self._run, name="outbox", daemon=True)
        self._thread.start()

    def put(self, rows: Rows = NO_ROWS, changes: Sequence[Change] = ()) -> None:
        """Queue rows and events, and changes of the recording; a full queue drops old rows."""
        with self._changed:
            self._total += len(rows)
            if len(rows):
                self._rows.append(rows.replace(()))
                self._waiting += len(rows)
            while (excess := self._waiting - MOST_WAITING) > 0:
                oldest = self._rows.popleft()
                if excess < len(oldest):
                    self._rows.appendleft(oldest[excess:])
                dropped = min(excess, len(oldest))
                self._waiting -= dropped
                self._dropped += dropped
            self._events.extend(rows.events)
            self._recording += changes
            self._changed.notify()

    def close(self, end: Ended) -> None:
        """Send everything queued, then `end`; return when it is sent or the view is gone."""
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
            found: list[Message] = []
            while not (self._rows or self._events or self._end or self._recording):
                if not self._changed.wait(SLOW_S) and self._made_progress():
                    # The view gives up a capture that sends nothing.
                    found.append(self._batch())
                    return found
            if self._rows or self._events or self._recording:
                found.append(self._batch())
                self._rows.clear()
                self._waiting = 0
                self._events.clear()
                self._recording.clear()
            if self._end:
                found.append(self._end)
            return found

    def _made_progress(self) -> bool:
        """Whether the capture still reads, or writes slowly."""
        progress, turns = self.progress(), self._turns
        self._turns = progress.turns
        return progress.is_slow or progress.turns != turns

    def _batch(self) -> RowsMessage:
        return RowsMessage(
            Rows.concat(list(self._rows)).replace(self._events),
            self._total,
            self._dropped,
            tuple(self._recording),
            self.leftover,
            self.progress(),
        )


# Swapped or mixed wiring: which direction each port carries

SETTLED = 10
"""Valid frames of one direction after which a wire is known to carry it."""

UNEXPECTED = 3
"""Valid frames of the other direction after which it is reported; one can be chance."""


_DIRECTIONS = tuple(Direction)


class WiringWatch:
    """Reports once per wire that it carries the other wire's direction, or the same as another."""

    def __init__(self, ports: Sequence[str]) -> None:
        self._counts: dict[str, Counter[Direction]] = {port: Counter() for port in ports}
        self._own: dict[str, Direction] = {}
        self._quiet = set(ports) if len(ports) < 2 else set[str]()

    def observe(self, port: str, rows: Rows) -> list[PortEvent]:
        """Events that these rows of one port give rise to."""
        if port in self._quiet:
            return []
        counts = self._counts[port]
        wanted = rows.framed & (rows.faults == 0)
        if port in self._own:
            wanted &= rows.directions != _DIRECTIONS.index(self._own[port])
        for code, t_ns in zip(
            rows.directions[wanted].tolist(), rows.t_ns[wanted].tolist(), strict=True
        ):
            direction = _DIRECTIONS[code]
            counts[direction] += 1
            if detail := self._problem(port, direction):
                if direction is not self._own[port]:
                    self._quiet.add(port)
                return [PortEvent(t_ns, port, PortEventKind.WIRING, detail)]
        return []

    def _problem(self, port: str, direction: Direction) -> str | None:
        counts, own = self._counts[port], self._own.get(port)
        if own is None:
            if counts[direction] < SETTLED:
                return None
            self._own[port] = direction
            return self._same_as_another(port, direction)
        if direction is own or counts[direction] < UNEXPECTED:
            return None
        return TranslatableText(
            "{direction} frames on the wire that carries {own} frames: swapped "
            "or mixed wiring; connect each adapter's RX to its own wire",
            direction=direction,
            own=own,
        )

    def _same_as_another(self, port: str, direction: Direction) -> str | None:
        for other, own in self._own.items():
            if other != port and own is direction:
                return TranslatableText(
                    "{direction} frames here and on {other} too: are both adapters on "
                    "the same wire? Connect one RX to each",
                    direction=direction,
                    other=other,
                )
        return None


# The loop

_BREAKS = frozenset({PortEventKind.LOST, PortEventKind.OVERRUN})
"""Events that break the byte stream."""

REPORTED_LEFTOVER = 2**20
"""This many waiting bytes take over a second to write, and are reported."""


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

    def __init__(self, framer: Framer, lane: MergeLane, silence: SilenceWatch) -> None:
        self.framer, self._lane, self.silence = framer, lane, silence
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
            self._lane.put(rows)
            if rows.framed.any():
                self.silence.frame_came()
        next_ns = watermark_ns(self._read_ns, self._now_ns, self.framer.pending_since_ns)
        self._lane.reached = (next_ns - self._lane.uncertainty_ns,)
        return rows

    def put(self, *events: PortEvent) -> None:
        """Put events that come after what was drained."""
        if events:
            self._lane.put(NO_ROWS.replace(events))


class CaptureLoop:
    """The capture loop, from the first chunk to the closed file."""

    def __init__(
        self,
        plan: CapturePlan,
        clock: Clock,
        source: Source,
        recorder: Recorder | None,
        outbox: Outbox,
    ) -> None:
        self._plan = plan
        self._clock = clock
        self._clock_watch = ClockWatch(clock.system_ahead_ns())
        self._source = source
        self._recorder = recorder
        self._outbox = outbox
        names, baud = plan.wiring.names, plan.wiring.settings.baud
        self._merge = Merge(marks=True)
        self._wires: dict[str, Wire] = {}
        for name in names:
            lane = MergeLane(source.uncertainty_ns[name])
            self._merge.lanes.append(lane)
            silence = SilenceWatch(name, plan.silence_s)
            self._wires[name] = Wire(Framer(name, baud), lane, silence)
        self._wiring = WiringWatch(names)
        self._remaining = plan.count
        self._started = self._leftover_reported = False
        self._now_ns = self._drain_ns = self._undrained = 0
        self._lost: PortEvent | None = None
        self._writing_since_s: float | None = None
        """When the write under way began."""
        self._is_ending = False
        self._turns = 0
        outbox.progress = self._progress

    def run(self) -> Ended:
        """Process the source to its end, close the recording, and return how it ended."""
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
        return self._result()

    def _closed(self, port: str) -> PortEvent:
        detail = TranslatableText("all requested rows were captured")
        return PortEvent(self._clock.now_ns(), port, PortEventKind.CLOSED, detail)

    def _result(self) -> Ended:
        failure: FteSniffError | None = self._recorder.failure if self._recorder else None
        outcome = self._recorder.outcome if self._recorder else None
        lost = self._lost
        if lost is not None and self._source.end is SourceEnd.LOST and self._remaining != 0:
            reason = TranslatableText("{port} was lost: {why}", port=lost.port, why=lost.detail)
            return Ended(
                reason,
                failure or PortError("{reason}; check cable and power", reason=reason),
                outcome,
                self._progress(),
            )
        return Ended(None, failure, outcome, self._progress())

    def _process_chunk(self, chunk: Chunk) -> None:
        wire, now_ns = self._wires[chunk.port], chunk.t_ns or 0
        if (event := wire.silence.observe(chunk)) is not None:
            wire.put(event)
        wire.push(chunk)
        self._now_ns = max(self._now_ns, now_ns)
        self._start_duration(now_ns)
        self._report_leftover()
        self._undrained += len(chunk.data)
        if now_ns >= self._drain_ns or self._undrained >= MOST_UNDRAINED:
            self._drain_ns, self._undrained = now_ns + DRAIN_EVERY_NS, 0
            self._drain()
            if (event := wire.silence.check(now_ns)) is not None:
                wire.put(event)
            self._watch_clock(chunk.port, now_ns)
            self._record(lambda recorder: recorder.flush_if_due(now_ns))

    def _drain(self) -> None:
        for port in self._wires:
            self._drain_wire(port)
        self._emit()

    def _drain_wire(self, port: str) -> None:
        wire = self._wires[port]
        rows = wire.drain()
        if len(rows):
            wire.put(*self._wiring.observe(port, rows))

    def _watch_clock(self, port: str, now_ns: int) -> None:
        step_ns = self._clock_watch.step(self._clock.system_ahead_ns())
        if step_ns:
            detail = _step_words(step_ns)
            self._wires[port].put(PortEvent(now_ns, port, PortEventKind.CLOCK_SET, detail))

    def _start_duration(self, now_ns: int) -> None:
        if self._plan.duration_s is not None and not self._started:
            self._source.stop_at(now_ns + self._plan.duration_s * 1e9)
        self._started = True

    def _report_leftover(self) -> None:
        if not self._leftover_reported and self._source.end is not None:
            self._leftover_reported = True
            if (waiting := self._source.waiting) >= REPORTED_LEFTOVER:
                self._outbox.leftover = waiting

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
        """Record what is settled, and send it to the view."""
        taken = self._merge.take(least=self._now_ns - MOST_HELD_NS, final=final)
        if taken is None:
            return
        rows = taken.rows
        if self._remaining is not None:
            rows = rows[: self._remaining].replace(rows.events)
            self._remaining -= len(rows)
        self._record(lambda recorder: recorder.write(rows, *rows.events))
        self._outbox.put(rows)

    def _record(self, do: Callable[[Recorder], None]) -> None:
        if self._recorder is None:
            return
        self._writing_since_s = time.monotonic()
        try:
            do(self._recorder)
        finally:
            self._writing_since_s = None
        if changes := self._recorder.changes():
            self._outbox.put(changes=changes)

    def _progress(self) -> WriteProgress:
        since_s, recorder = self._writing_since_s, self._recorder
        return WriteProgress(
            recorder.unflushed_rows if recorder is not None else 0,
            self._source.waiting,
            since_s is not None and time.monotonic() - since_s >= SLOW_S,
            self._is_ending or self._source.end is not None,
            recorder.size if recorder is not None else 0,
            self._turns,
        )


def _step_words(step_ns: int) -> TranslatableText:
    seconds = abs(step_ns) / 1e9
    if step_ns < 0:
        return TranslatableText(
            "this machine's clock was set back by {seconds:.3f} s; "
            "times in this capture continue evenly from its start",
            seconds=seconds,
        )
    return TranslatableText(
        "this machine's clock was set forward by {seconds:.3f} s; "
        "times in this capture continue evenly from its start",
        seconds=seconds,
    )


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


def capture(plan: CapturePlan, view: Connection) -> None:
    """Run a capture in this process; a STOP from `view`, or its closed connection, ends it."""
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
            _capture_from(source, plan, clock, view)
    except FteSniffError as error:
        _send(view, Ended(error=error))


def _capture_from(source: Source, plan: CapturePlan, clock: Clock, view: Connection) -> None:
    if plan.outlives_view:
        # A closed terminal ends the view only.
        for number in HANG_UP:
            signal.signal(number, signal.SIG_IGN)
    if view.poll() and source.device is None:
        # Any message means STOP. Nothing was captured, so no file is created or replaced.
        # (A bridge may have forwarded bytes by now; they are recorded.)
        _send(view, Ended())
        return
    # From here on the result is a recording, possibly empty: the port was open, no byte arrived.
    recorder = _recorder(plan, _facts(plan, clock, source))
    _send(view, Started(recorder.path if recorder else None, source.device))
    when_gone = (lambda: None) if plan.outlives_view else source.stop
    threading.Thread(target=_obey, args=(view, source.stop, when_gone), daemon=True).start()
    outbox = Outbox(view, when_gone)
    ended = CaptureLoop(plan, clock, source, recorder, outbox).run()
    # The file is closed; signals may end the process while the last messages are sent.
    for number in _ending_signals():
        signal.signal(number, signal.SIG_DFL)
    outbox.close(ended)


def _send(view: Connection, message: Message) -> None:
    with suppress(OSError):  # the view is gone; `_obey` notices it too
        view.send(message)


def _facts(plan: CapturePlan, clock: Clock, source: Source) -> dict[str, str]:
    facts = host_facts(clock.utc_at_tie_ns) | clock.facts()
    facts["settings"] = str(plan.wiring.settings)
    for number, name in enumerate(plan.wiring.names, 1):
        facts[f"port.{number}.time_uncertainty_ns"] = str(source.uncertainty_ns[name])
        facts[f"port.{number}.granted"] = source.capabilities[name]
    return facts


def _recorder(plan: CapturePlan, facts: dict[str, str]) -> Recorder | None:
    if plan.recording is None:
        return None
    baud = plan.wiring.settings.baud
    ports = tuple(PortFacts(name, baud) for name in plan.wiring.names)
    return Recorder(
        plan.recording,
        ports,
        facts,
        existing=plan.existing,
        options=plan.recording_options,
    )


def _obey(view: Connection, stop: Callable[[], None], when_gone: Callable[[], None]) -> None:
    """Stop at the first request of the view; the end of its pipe means that it is gone."""
    try:
        while True:
            view.recv()
            stop()
    except (EOFError, OSError):
        when_gone()
