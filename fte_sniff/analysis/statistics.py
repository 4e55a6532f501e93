"""Owns the numbers over all rows: rates, periods, silence, use of the line, faults over time.

It must not know a clock, a screen or where rows are kept: decoded rows and port events come in,
batch by batch, and it makes no difference where batches are cut. What it keeps is bounded by the
number of ports, not by that of rows. Times of one port are taken not to fall.

    stream   the frames of one kind, to or from one motor, on one port: what has a period
    port     one wire: how full it is, and how long it is silent
    fault    how often each occurs, and when
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fte_sniff.analysis.bench import Bench
from fte_sniff.analysis.counts import CountsOverTime
from fte_sniff.analysis.durations import Durations
from fte_sniff.analysis.fields import NO_KIND, Bools, Decoded, Ints
from fte_sniff.analysis.packing import Codebook
from fte_sniff.analysis.recent import Recent
from fte_sniff.protocol import KINDS, MOTORS, Fault, FrameKind, PortEvent, PortEventKind

FAULTS: Final = tuple(Fault)

_NAMES_MOTOR: Final = np.array([*(kind.names_motor for kind in KINDS), False])
_NUMS: Final = 256
_NO_STREAM: Final = -1


def _sound() -> Bools:
    """By kind and NUM: whether there can be such a stream."""
    sound = np.zeros((NO_KIND + 1, _NUMS), np.bool_)
    for code, kind in enumerate(KINDS):
        sound[code, list(MOTORS) if kind.names_motor else [0]] = True
    return sound


_SOUND: Final = _sound()


@dataclass(frozen=True, slots=True)
class OverTime:
    """A number in each of equally long slots of time."""

    start_ns: int
    """When the first slot begins, nanoseconds since 1970 UTC."""
    slot_ns: int
    values: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class StreamNumbers:
    """The frames of one kind, to or from one motor that there can be, on one port."""

    port: str
    kind: FrameKind
    motor: int | None
    """None where frames of this kind name none."""
    count: int
    per_s: float | None
    """On the average from its first frame to its last; None where that cannot be told."""
    lately_per_s: float | None
    periods: Durations
    """From the begin of each frame to that of the next; its ends are those of silence too."""

    @property
    def jitter_ns(self) -> float | None:
        """How much the period varies: between the 5 percent shortest and the 5 percent longest."""
        low, high = self.periods.percentile_ns(5), self.periods.percentile_ns(95)
        return None if low is None or high is None else high - low


@dataclass(frozen=True, slots=True)
class EventNumbers:
    """One sort of thing that happened to a port: line errors, for one."""

    kind: PortEventKind
    count: int
    last_ns: int
    """When it last did, nanoseconds since 1970 UTC."""


@dataclass(frozen=True, slots=True)
class PortNumbers:
    """One wire."""

    port: str
    rows: int
    bytes: int
    share: float | None
    """Of the time from the first row to the end of the last that bytes took; None without times."""
    silences: Durations
    """From the end of each row to the begin of the next, where there was anything between."""
    share_over_time: OverTime
    events: tuple[EventNumbers, ...]
    """What happened to the port, in the order in which it first did."""


@dataclass(frozen=True, slots=True)
class FaultNumbers:
    """One sort of fault, on all ports."""

    fault: Fault
    count: int
    over_time: OverTime
    """Rows with it that have a time."""


class _Stream:
    """One stream as it runs."""

    def __init__(self) -> None:
        self.count = 0
        self.timed = 0
        self.first_ns = self.last_ns = 0
        self.periods = Durations()
        self.times = Recent()

    def add(self, count: int, t_ns: Ints) -> None:
        """So many frames, and the times of those that have one."""
        self.count += count
        if not len(t_ns):
            return
        before = t_ns[:1] if not self.timed else [self.last_ns]
        periods = np.diff(t_ns, prepend=before)[0 if self.timed else 1 :]
        ends = t_ns[len(t_ns) - len(periods) :]
        self.periods.add(periods[periods >= 0], ends[periods >= 0])
        if not self.timed:
            self.first_ns = int(t_ns[0])
        self.last_ns = int(t_ns[-1])
        self.timed += len(t_ns)
        self.times.add(t_ns)

    @property
    def per_s(self) -> float | None:
        span = self.last_ns - self.first_ns
        return (self.timed - 1) * 1e9 / span if span > 0 else None


class _Port:
    """One wire as it runs."""

    def __init__(self) -> None:
        self.rows = self.bytes = self.timed_bytes = 0
        self.first_ns: int | None = None
        self.end_ns = 0
        self.silences = Durations()
        self.events: dict[PortEventKind, EventNumbers] = {}

    def add(self, lengths: Ints, t_ns: Ints, ends_ns: Ints, timed_bytes: int) -> None:
        """Rows: all lengths, and begins and ends of those that have a time."""
        self.rows += len(lengths)
        self.bytes += int(lengths.sum())
        self.timed_bytes += timed_bytes
        if not len(t_ns):
            return
        if self.first_ns is None:
            self.first_ns = self.end_ns = int(t_ns[0])
        before = np.concatenate(([self.end_ns], ends_ns[:-1]))
        silent = t_ns - before
        self.silences.add(silent[silent > 0], t_ns[silent > 0])
        self.end_ns = int(ends_ns[-1])


class Statistics:
    """The numbers over all rows added so far."""

    def __init__(self, bench: Bench) -> None:
        """No rows; `bench` tells how long a byte takes."""
        self._byte_ns = bench.byte_ns
        self._names: list[str] = []
        self._streams: dict[tuple[int, int, int], _Stream] = {}
        self._ports: dict[str, _Port] = {}
        self._faults = np.zeros(len(FAULTS), np.int64)
        self._faults_over_time = CountsOverTime()
        self._bytes_over_time = CountsOverTime()

    def add(self, rows: Decoded, codebook: Codebook) -> None:
        """The next rows, with what the numbers of their ports and faults stand for."""
        if not len(rows):
            return
        self._names = codebook.ports
        self._add_ports(rows)
        self._add_streams(rows)
        self._add_faults(rows, codebook)

    def add_events(self, events: Sequence[PortEvent]) -> None:
        """What happened to ports."""
        for event in events:
            told = self._ports.setdefault(event.port, _Port()).events
            before = told[event.kind].count if event.kind in told else 0
            told[event.kind] = EventNumbers(event.kind, before + 1, event.t_ns)

    def _add_ports(self, rows: Decoded) -> None:
        codes, lengths = rows.packed["port"], rows.packed["length"].astype(np.int64)
        for code in np.unique(codes):
            own = codes == code
            t_ns, taken = rows.t_ns[own & rows.has_time], lengths[own & rows.has_time]
            port = self._ports.setdefault(self._names[code], _Port())
            port.add(lengths[own], t_ns, t_ns + taken * self._byte_ns, int(taken.sum()))
        known = rows.has_time
        self._bytes_over_time.add(codes[known].astype(np.int64), rows.t_ns[known], lengths[known])

    def _add_streams(self, rows: Decoded) -> None:
        kinds = rows.kinds.astype(np.int64)
        nums = np.where(_NAMES_MOTOR[kinds], rows.nums, 0)
        keys = (rows.packed["port"].astype(np.int64) * (NO_KIND + 1) + kinds) * _NUMS + nums
        keys[~_SOUND[kinds, nums]] = _NO_STREAM
        for key in np.unique(keys):
            if key == _NO_STREAM:
                continue
            own = keys == key
            rest, num = divmod(int(key), _NUMS)
            stream = self._streams.setdefault((*divmod(rest, NO_KIND + 1), num), _Stream())
            stream.add(int(own.sum()), rows.t_ns[own & rows.has_time])

    def _add_faults(self, rows: Decoded, codebook: Codebook) -> None:
        codes = rows.packed["faults"]
        for place, fault in enumerate(FAULTS):
            having = np.array([fault in faults for faults in codebook.faults])
            if not having.any():
                continue
            own = having[codes]
            self._faults[place] += own.sum()
            t_ns = rows.t_ns[own & rows.has_time]
            self._faults_over_time.add(np.full(len(t_ns), place), t_ns)

    def streams(self, now_ns: int | None) -> list[StreamNumbers]:
        """Every stream, by port, kind and motor; `now_ns` is not before the last row."""
        return [
            StreamNumbers(
                self._names[port],
                KINDS[kind],
                num if KINDS[kind].names_motor else None,
                stream.count,
                stream.per_s,
                None if now_ns is None else stream.times.per_second(now_ns),
                stream.periods,
            )
            for (port, kind, num), stream in sorted(self._streams.items())
        ]

    def ports(self) -> list[PortNumbers]:
        """Every port that rows or events came from, in the order in which they first did."""
        return [
            PortNumbers(
                name,
                port.rows,
                port.bytes,
                self._share(port),
                port.silences,
                self._share_over_time(name),
                tuple(port.events.values()),
            )
            for name, port in self._ports.items()
        ]

    def _share(self, port: _Port) -> float | None:
        if port.first_ns is None or port.end_ns <= port.first_ns:
            return None
        return port.timed_bytes * self._byte_ns / (port.end_ns - port.first_ns)

    def _share_over_time(self, name: str) -> OverTime:
        counts = self._bytes_over_time
        code = self._names.index(name) if name in self._names else len(self._names)
        shares = counts.of(code) * self._byte_ns / counts.slot_ns
        return OverTime(counts.start_ns, counts.slot_ns, tuple(shares.tolist()))

    def faults(self) -> list[FaultNumbers]:
        """Every fault that occurred, in the order of the vocabulary."""
        counts = self._faults_over_time
        over_time = (counts.start_ns, counts.slot_ns)
        return [
            FaultNumbers(fault, int(self._faults[place]),
                         OverTime(*over_time, tuple(counts.of(place).tolist())))
            for place, fault in enumerate(FAULTS)
            if self._faults[place]
        ]  # fmt: skip
