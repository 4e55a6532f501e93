"""Statistics of ports, streams, faults and motors, over one or more inputs.

port     one wire: counts, utilization, silences, events
stream   the frames of one kind, to or from one motor, on one port: rate, period, jitter, ranges
fault    count, and count over time
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from fte_sniff.analysis.counters import Counts, Durations, RecentValues, Series
from fte_sniff.analysis.facts import STREAMS, motor_rows, streams_of
from fte_sniff.analysis.findings import Findings
from fte_sniff.analysis.model import Ends, Model, RowCount, RowModel, Tally
from fte_sniff.analysis.motors import Answers, FlagCounts
from fte_sniff.protocol import (
    DEFAULT_BAUD,
    HEADERS,
    KINDS,
    Direction,
    Fault,
    FrameKind,
    Gap,
    PortEvent,
    PortEventKind,
    byte_time_ns,
)
from fte_sniff.protocol.items import BaudChange
from fte_sniff.protocol.rows import NO_TIME, Codes, Ints, Rows


@dataclass(frozen=True, slots=True)
class LineSetup:
    """What the user says about the line and the motors."""

    baud: int = DEFAULT_BAUD
    """Bits per second on every line."""
    resolution: float | None = None
    """Encoder pulses per turn of a motor's shaft, more than 0; None if unknown."""
    gear_ratio: float = 1.0
    """Turns of the motor's shaft per turn of its load, more than 0."""

    def turns(self, pulses: int) -> float | None:
        """A position in turns of the output shaft; None without a resolution.

        See docs/reference/protocol.md, "Pulses and turns".
        """
        if self.resolution is None:
            return None
        return pulses / self.resolution / self.gear_ratio


DEFAULT_SETUP: Final = LineSetup()


@dataclass
class EventStats(Model):
    """The events of one kind on a port, such as line errors."""

    kind: PortEventKind
    first_ns: int
    """Time of the first one, nanoseconds since 1970 UTC."""
    last_ns: int = 0
    count: int = 0
    total: int = 0
    """Sum of what the events count: line errors, bytes of an overrun."""

    def merge(self, later: EventStats) -> None:
        """Add later events of the same kind."""
        self.count += later.count
        self.total += later.total
        self.last_ns = later.last_ns


class PortStats(Model):
    """Statistics of one port so far."""

    def __init__(self, port: str, baud: int, *, interrupted: bool = False) -> None:
        """`interrupted` is whether rows are missing before its first row."""
        self.port = port
        self.baud = baud
        self._opens = not interrupted
        """Whether its first row with a time would follow an earlier row without a gap."""
        self.rows = self.bytes = 0
        self.frames = dict.fromkeys(Direction, 0)
        """Rows whose framing holds, by direction."""
        self.first_ns: int | None = None
        """Time of its first row, nanoseconds since 1970 UTC; None if no row has one."""
        self.last_ns: int | None = None
        self.silences = Durations()
        self.share_over_time = Counts(0, 1, ())
        """`share` in windows of time; set by `Statistics.ports`."""
        self._events: dict[PortEventKind, EventStats] = {}
        self._timed = self._busy_ns = self._end_ns = 0
        self._runs = 0
        """Runs of rows without a gap between them."""
        self._gap_starts_ns = self._gap_idle_ns = 0
        """Sums over gaps: between the starts of the rows around them, and between those rows."""
        self._continues = False
        """Whether the next row follows the last one without a gap."""

    @property
    def per_s(self) -> float | None:
        """Mean rate of rows; None if it is unknown."""
        if self.first_ns is None or self.last_ns is None:
            return None
        span_ns = self.last_ns - self.first_ns - self._gap_starts_ns
        return (self._timed - self._runs) * 1e9 / span_ns if span_ns > 0 else None

    @property
    def share(self) -> float | None:
        """Utilization: share of the time that bytes took, from the first row to the last.

        None where `per_s` is: a single row takes all of its own time.
        """
        if self.first_ns is None or self.per_s is None:
            return None
        span_ns = self._end_ns - self.first_ns - self._gap_idle_ns
        return self._busy_ns / span_ns if span_ns > 0 else None

    @property
    def events(self) -> tuple[EventStats, ...]:
        """By kind, in order of first occurrence."""
        return tuple(self._events.values())

    def observe(self, lengths: Ints, t_ns: Ints, headers: npt.NDArray[np.uint8]) -> None:
        """Count rows: lengths, times or `NO_TIME`, and the first bytes of frames."""
        self.rows += len(lengths)
        self.bytes += int(lengths.sum())
        for direction, header in HEADERS.items():
            self.frames[direction] += int(np.count_nonzero(headers == header))
        known = t_ns != NO_TIME
        if known.any():
            busy_ns = lengths[known] * byte_time_ns(self.baud)
            self._update_times(t_ns[known], t_ns[known] + busy_ns)

    def _update_times(self, t_ns: Ints, ends_ns: Ints) -> None:
        self._timed += len(t_ns)
        self._busy_ns += int((ends_ns - t_ns).sum())
        if not self._continues:
            self._start_run(int(t_ns[0]))
        idle = t_ns - np.concatenate(([self._end_ns], ends_ns[:-1]))
        self.silences.observe(idle[idle > 0], t_ns[idle > 0])
        self.last_ns, self._end_ns = int(t_ns[-1]), int(ends_ns[-1])

    def _start_run(self, t_ns: int) -> None:
        """Start after a gap: the time before is not silence, but missing rows."""
        if self.first_ns is None or self.last_ns is None:
            self.first_ns = t_ns
        else:
            self._gap_starts_ns += t_ns - self.last_ns
            self._gap_idle_ns += t_ns - self._end_ns
        self._end_ns, self._runs, self._continues = t_ns, self._runs + 1, True

    def interrupt(self) -> None:
        """Rows are missing here."""
        self._continues = False
        self._opens = self._opens and self.first_ns is not None

    def merge(self, later: PortStats) -> None:
        """Add the rows that follow; both ended and began with the same baud."""
        self.baud = later.baud
        self.rows += later.rows
        self.bytes += later.bytes
        for direction, count in later.frames.items():
            self.frames[direction] += count
        for kind, events in later._events.items():
            self._events.setdefault(kind, EventStats(kind, events.first_ns)).merge(events)
        if not later._opens:
            self.interrupt()
        if later.first_ns is not None:
            self._merge_times(later, later.first_ns)

    def _merge_times(self, later: PortStats, first_ns: int) -> None:
        if not self._continues:
            self._start_run(first_ns)
        idle = np.array([first_ns - self._end_ns])
        self.silences.observe(idle[idle > 0], np.array([first_ns])[idle > 0])
        self.silences.merge(later.silences)
        self._timed += later._timed
        self._busy_ns += later._busy_ns
        self._runs += later._runs - 1  # one is common
        self._gap_starts_ns += later._gap_starts_ns
        self._gap_idle_ns += later._gap_idle_ns
        self.last_ns, self._end_ns = later.last_ns, later._end_ns
        self._continues = later._continues

    def on_event(self, event: PortEvent) -> None:
        """Count an event."""
        one = EventStats(event.kind, event.t_ns, event.t_ns, 1, event.count)
        self._events.setdefault(event.kind, EventStats(event.kind, event.t_ns)).merge(one)


_QUANTITIES: Final = [[field.name for field in kind.fields if field.unit] for kind in KINDS]
"""By kind code, the fields that have a unit."""


@dataclass(frozen=True, slots=True)
class StreamStats:
    """Statistics of the frames of one kind, to or from one motor, on one port."""

    port: str
    kind: FrameKind
    motor: int | None
    """None for kinds without a motor."""
    count: int
    per_s: float | None
    """Mean rate from the first frame to the last; None if it is unknown."""
    lately_per_s: float | None
    periods: Durations
    """From the start of each frame to that of the next."""
    ranges: Mapping[str, tuple[int, int]]
    """Minimum and maximum of each quantity, by column name."""
    recent_ns: Ints = field(compare=False)
    """Times of the latest frames without a gap between them."""
    latest: tuple[bytes, ...]
    """The last frame, and the frame before it."""
    last_ns: int | None
    """Time of the last frame; None if it has none."""

    @property
    def jitter_ns(self) -> float | None:
        """Range of the period between its 5th and 95th percentile; None without two periods."""
        if self.periods.count < 2:
            return None
        low, high = self.periods.percentile_ns(5), self.periods.percentile_ns(95)
        return None if low is None or high is None else high - low


class _KindStream(Model):
    def __init__(self, *, interrupted: bool) -> None:
        """`interrupted` is whether frames are missing before the first one."""
        self.count = 0
        self.periods = Durations()
        self.recent = RecentValues()
        self.ranges: dict[str, tuple[int, int]] = {}
        self._ends = Ends[int](interrupted=interrupted)
        """Times of the first and the last frame."""
        self._measured = self._measured_ns = 0
        self.latest: tuple[bytes, ...] = ()
        self.last_ns: int | None = None

    def observe(self, latest: Codes, t_ns: Ints) -> None:
        """Count frames: the bytes of the last two, and the times of all, or `NO_TIME`."""
        self.count += len(t_ns)
        self.latest = (*(raw.tobytes() for raw in latest[::-1]), *self.latest)[:2]
        self.last_ns = None if t_ns[-1] == NO_TIME else int(t_ns[-1])
        t_ns = t_ns[t_ns != NO_TIME]
        if not len(t_ns):
            return
        before = self._ends.append(int(t_ns[0]), int(t_ns[-1]))
        self._measure(t_ns if before is None else np.concatenate(([before], t_ns)))
        self.recent.observe(t_ns)

    def _measure(self, times: Ints) -> None:
        periods, ends = np.diff(times), times[1:]
        self.periods.observe(periods[periods >= 0], ends[periods >= 0])
        self._measured += len(periods)
        self._measured_ns += int(periods.sum())

    def update_range(self, name: str, low: int, high: int) -> None:
        if name in self.ranges:
            low, high = min(low, self.ranges[name][0]), max(high, self.ranges[name][1])
        self.ranges[name] = low, high

    def interrupt(self) -> None:
        """Frames are missing here: no period and no rate spans the gap."""
        self._ends.interrupt()
        self.recent = RecentValues()

    def merge(self, later: _KindStream) -> None:
        """Add the frames that follow."""
        if later._ends.interrupted:
            self.recent = RecentValues()
        if (adjacent := self._ends.merge(later._ends)) is not None:
            self._measure(np.array(adjacent))
        self.recent.merge(later.recent)
        self.latest, self.last_ns = (*later.latest, *self.latest)[:2], later.last_ns
        self.count += later.count
        self.periods.merge(later.periods)
        self._measured += later._measured
        self._measured_ns += later._measured_ns
        for name, (low, high) in later.ranges.items():
            self.update_range(name, low, high)

    @property
    def per_s(self) -> float | None:
        return self._measured * 1e9 / self._measured_ns if self._measured_ns > 0 else None


class Streams(Model):
    """The streams so far, by port and number of the stream."""

    def __init__(self) -> None:
        self._streams: dict[tuple[str, int], _KindStream] = {}
        self._interrupted: set[str | None] = set()
        """Ports with a gap so far; None for a gap of all ports."""

    def has_gap(self, port: str) -> bool:
        """Whether rows of a port are missing somewhere so far."""
        return not self._interrupted.isdisjoint((port, None))

    def _stream(self, port: str, code: int) -> _KindStream:
        found = self._streams.get((port, code))
        if found is None:
            found = _KindStream(interrupted=self.has_gap(port))
            self._streams[port, code] = found
        return found

    def observe(self, rows: Rows) -> None:
        """Add the next rows."""
        names = {name for own in _QUANTITIES for name in own}
        columns = {name: rows.field(name)[0] for name in names}
        for port, code, at in streams_of(rows):
            stream = self._stream(port, code)
            stream.observe(rows.raw[at[-2:]], rows.t_ns[at])
            for name in _QUANTITIES[STREAMS[code][0]]:
                own = columns[name][at]
                stream.update_range(name, int(own.min()), int(own.max()))

    def interrupt(self, port: str | None) -> None:
        """Rows of a port, or of all ports, are missing here."""
        self._interrupted.add(port)
        for (name, _), stream in self._streams.items():
            if port in (None, name):
                stream.interrupt()

    def merge(self, later: Streams) -> None:
        """Add the frames that follow."""
        for (port, code), stream in later._streams.items():
            self._stream(port, code).merge(stream)
        for (port, code), stream in self._streams.items():
            if (port, code) not in later._streams and later.has_gap(port):
                stream.interrupt()
        self._interrupted |= later._interrupted

    def stats(self, ports: Sequence[str], now_ns: int | None) -> list[StreamStats]:
        """By port, in the given order, and number of the stream."""
        return [
            StreamStats(
                port=port,
                kind=KINDS[STREAMS[code][0]],
                motor=STREAMS[code][1],
                count=stream.count,
                per_s=stream.per_s,
                lately_per_s=None if now_ns is None else stream.recent.per_second(now_ns),
                periods=stream.periods,
                ranges=stream.ranges,
                recent_ns=stream.recent.values,
                latest=stream.latest,
                last_ns=stream.last_ns,
            )
            for (port, code), stream in sorted(
                self._streams.items(), key=lambda one: (ports.index(one[0][0]), one[0][1])
            )
        ]


SHORTEST_NS: Final = 1 << 24
"""Duration of the shortest windows over time, nanoseconds: about 17 ms."""

WINDOWS: Final = 512
"""Windows over time."""

_FAULTS: Final = tuple(Fault)


@dataclass(frozen=True, slots=True)
class FaultStats:
    """Statistics of one fault on all ports."""

    fault: Fault
    count: int
    over_time: Counts
    """Rows with the fault that have a time."""


class Statistics(RowModel):
    """Statistics of all rows so far."""

    def __init__(self, setup: LineSetup) -> None:
        """`setup` has the baud of ports for which no `BaudChange` comes."""
        self._baud = setup.baud
        self._streams = Streams()
        self._ports: dict[str, PortStats] = {}
        self.tally = Tally()
        self._faults_over_time, self._busy_over_time = (
            Series(shortest_ns=SHORTEST_NS, windows=WINDOWS, levels=1) for _ in range(2)
        )

    def _observe(self, rows: Rows) -> None:
        self._observe_ports(rows)
        self._streams.observe(rows)
        self._observe_faults(rows)

    def observe_events(self, events: Sequence[PortEvent]) -> None:
        """Count port events."""
        for event in events:
            self._port(event.port).on_event(event)

    def observe_change(self, change: Gap | BaudChange) -> None:
        """Apply a change before the next rows: no period, silence or rate spans a gap."""
        if isinstance(change, BaudChange):
            self._port(change.port).baud = change.baud
        else:
            self._streams.interrupt(change.port)
            for name, port in self._ports.items():
                if change.port in (None, name):
                    port.interrupt()

    def merge(self, later: Self) -> None:
        """Add the statistics of the rows that follow, as if they had been observed here.

        Each port must begin there with the baud that it has here.
        """
        for name, port in self._ports.items():
            if name not in later._ports and later._streams.has_gap(name):
                port.interrupt()
        for name, port in later._ports.items():
            self._port(name, port.baud).merge(port)
        self._streams.merge(later._streams)
        self.tally.merge(later.tally)
        self._faults_over_time.merge(later._faults_over_time)
        self._busy_over_time.merge(
            later._busy_over_time, [self._number_of(name) for name in later._ports]
        )

    def _port(self, name: str, baud: int | None = None) -> PortStats:
        if name not in self._ports:
            interrupted = self._streams.has_gap(name)
            self._ports[name] = PortStats(name, baud or self._baud, interrupted=interrupted)
        return self._ports[name]

    def _number_of(self, name: str) -> int:
        return list(self._ports).index(name)

    def _observe_ports(self, rows: Rows) -> None:
        codes, lengths = rows.port, rows.length.astype(np.int64)
        framed = rows.framed
        for code in np.flatnonzero(np.bincount(codes)).tolist():
            own, port = codes == code, self._port(rows.ports[code])
            port.observe(lengths[own], rows.t_ns[own], rows.raw[own & framed, 0])
            known = own & rows.timed
            busy = lengths[known] * byte_time_ns(port.baud)
            self._busy_over_time.observe(rows.t_ns[known], busy, self._number_of(port.port))

    def _observe_faults(self, rows: Rows) -> None:
        self.tally.observe(rows)
        for number, fault in enumerate(_FAULTS):
            if (having := rows.has(fault) & rows.timed).any():
                self._faults_over_time.observe(rows.t_ns[having], group=number)

    def streams(self, now_ns: int | None) -> list[StreamStats]:
        """By port, kind and motor; `now_ns` is not before the last row."""
        return self._streams.stats(list(self._ports), now_ns)

    def ports(self) -> list[PortStats]:
        """By port, in order of first occurrence."""
        for number, port in enumerate(self._ports.values()):
            busy = self._busy_over_time.counts(number)
            shares = [busy_ns / busy.window_ns for busy_ns in busy.values]
            port.share_over_time = busy._replace(values=shares)
        return list(self._ports.values())

    def faults(self) -> list[FaultStats]:
        """By fault that occurred."""
        return [
            FaultStats(fault, count.rows, self._faults_over_time.counts(_FAULTS.index(fault)))
            for fault, count in self.tally.by_fault().items()
        ]


@dataclass
class RowSource(Model):
    """One input."""

    name: str
    """May hold text from outside, so escape it when you show it."""
    count: RowCount = field(default_factory=RowCount)


class StatisticsSummary(RowModel):
    """Statistics of all rows so far."""

    def __init__(self, setup: LineSetup, *, with_findings: bool = False) -> None:
        """`setup` has the baud of ports for which no input has one."""
        self.findings = Findings() if with_findings else None
        self.sources: list[RowSource] = []
        self.statistics = Statistics(setup)
        self.answers = Answers()
        """By motor; meaningful only if `in_order`."""
        self.flags = FlagCounts()
        """By motor; `times_lost` is meaningful only if `in_order`."""

    def begin(self, name: str) -> None:
        """Start the next input."""
        self.sources.append(RowSource(name))

    def observe_events(self, events: Sequence[PortEvent]) -> None:
        """Count port events."""
        self.statistics.observe_events(events)
        if self.findings is not None:
            self.findings.observe_events(events)

    def observe_change(self, change: Gap | BaudChange) -> None:
        """Apply a change before the next rows."""
        self.statistics.observe_change(change)
        if isinstance(change, Gap):
            self.answers.interrupt(change)
        if self.findings is not None:
            self.findings.observe_change(change)

    def merge(self, later: Self) -> None:
        """Add the inputs that follow, as if they had been observed here."""
        self.sources += later.sources
        self.statistics.merge(later.statistics)
        self.answers.merge(later.answers)
        self.flags.merge(later.flags)
        if self.findings is not None and later.findings is not None:
            self.findings.merge(later.findings)

    def _observe(self, rows: Rows) -> None:
        self.sources[-1].count.observe(rows)
        self.statistics.observe(rows)
        found = motor_rows(rows)
        self.answers.observe(rows, found)
        self.flags.observe(rows, found)
        if self.findings is not None:
            self.findings.observe(rows)

    @property
    def total(self) -> RowCount:
        """All rows."""
        total = RowCount()
        for source in self.sources:
            total.merge(source.count)
        return total

    @property
    def in_order(self) -> bool:
        """Whether the inputs follow each other in time without overlap."""
        times = [source.count.times for source in self.sources if source.count.rows]
        return all(
            before is not None and after is not None and before[1] <= after[0]
            for before, after in pairwise(times)
        )
