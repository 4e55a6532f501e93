"""Counts, rates, faults per port and direction.

stream   the frames of one kind, to or from one motor, on one port (`streams`)
port     one wire: how full it is, and how long it is silent
fault    how often each occurs, and when
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from fte_sniff.analysis.counters import CountsOverTime, Durations, OverTime, Recent
from fte_sniff.analysis.feed import BaudChange
from fte_sniff.analysis.fields import NO_KIND, NO_TIME, Decoded, Ints, read_place
from fte_sniff.protocol import (
    DEFAULT_BAUD,
    HEADERS,
    KINDS,
    MOTORS,
    Direction,
    Fault,
    FrameKind,
    Gap,
    PortEvent,
    PortEventKind,
    Status,
    byte_time_ns,
    status_of,
)
from fte_sniff.row_batch import FRAMED, Codebook


@dataclass(frozen=True, slots=True)
class LineSetup:
    """One set-up of line, controller and motors."""

    baud: int = DEFAULT_BAUD
    """Bits per second on every line."""
    resolution: float | None = None
    """Encoder pulses in one turn of a motor's shaft, more than 0; None where nobody said."""
    gear_ratio: float = 1.0
    """Turns of the motor's shaft in one turn of what it drives, more than 0."""

    def turns(self, pulses: int) -> float | None:
        """A position in turns (PROTOCOL.md, "Pulses and turns"); None without a resolution."""
        if self.resolution is None:
            return None
        return pulses / self.resolution / self.gear_ratio


NO_BENCH = LineSetup()
"""Nobody said anything about the set-up."""


@dataclass(slots=True)
class Count:
    """Some rows."""

    rows: int = 0
    bytes: int = 0
    first_ns: int | None = None
    """Of those that have a time, nanoseconds since 1970 UTC; None where none has."""
    last_ns: int | None = None

    def add(self, rows: int, bytes_: int, t_ns: Ints) -> None:
        """So many rows and bytes, and the times of rows that have one."""
        self.rows += rows
        self.bytes += bytes_
        if len(t_ns):
            self._stretch(int(t_ns.min()), int(t_ns.max()))

    def include(self, other: Count) -> None:
        """The rows of another count too."""
        self.rows += other.rows
        self.bytes += other.bytes
        if other.first_ns is not None and other.last_ns is not None:
            self._stretch(other.first_ns, other.last_ns)

    def _stretch(self, first_ns: int, last_ns: int) -> None:
        self.first_ns = first_ns if self.first_ns is None else min(self.first_ns, first_ns)
        self.last_ns = last_ns if self.last_ns is None else max(self.last_ns, last_ns)

    @property
    def span_ns(self) -> int | None:
        """From the first time to the last."""
        if self.first_ns is None or self.last_ns is None:
            return None
        return self.last_ns - self.first_ns


class FaultCounts:
    """The rows so far, by port and combination of faults."""

    def __init__(self) -> None:
        self._counts: dict[tuple[str, tuple[Fault, ...]], Count] = {}

    def add(self, rows: Decoded, codebook: Codebook) -> None:
        """The next rows, with what the numbers of their ports and faults stand for."""
        sets = len(codebook.faults)
        keys = rows.packed["port"].astype(np.int64) * sets + rows.packed["faults"]
        lengths = rows.packed["length"].astype(np.int64)
        for key in np.flatnonzero(np.bincount(keys)).tolist():
            own = keys == key
            port, faults = divmod(key, sets)
            name = codebook.ports[port], codebook.faults[faults]
            count = self._counts.setdefault(name, Count())
            t_ns = rows.t_ns[own & rows.has_time]
            count.add(int(own.sum()), int(lengths[own].sum()), t_ns)

    def by_fault(self, port: str | None = None) -> dict[Fault, Count]:
        """By fault, in the order of the vocabulary; a row counts once for each that it has."""
        found = {fault: Count() for fault in Fault}
        for faults, count in self._of(port):
            for fault in set(faults):
                found[fault].include(count)
        return {fault: count for fault, count in found.items() if count.rows}

    def by_status(self, port: str | None = None) -> dict[Status, Count]:
        """By status; all are in it."""
        found = {status: Count() for status in Status}
        for faults, count in self._of(port):
            found[status_of(faults)].include(count)
        return found

    def _of(self, port: str | None) -> Iterable[tuple[tuple[Fault, ...], Count]]:
        """All combinations on one port, or on all of them."""
        return [
            (faults, count)
            for (name, faults), count in self._counts.items()
            if port is None or name == port
        ]


@dataclass(frozen=True, slots=True)
class EventNumbers:
    """One sort of thing that happened to a port: line errors, for one."""

    kind: PortEventKind
    count: int
    """How often."""
    total: int
    """Of what there was to count each time: errors on the line, bytes of an overrun."""
    first_ns: int
    """When it first did, nanoseconds since 1970 UTC."""
    last_ns: int
    """When it last did, nanoseconds since 1970 UTC."""


@dataclass(frozen=True, slots=True)
class PortNumbers:
    """One wire."""

    port: str
    rows: int
    bytes: int
    frames: Mapping[Direction, int]
    """Rows whose framing holds, by direction."""
    baud: int
    """Bits per second, at last."""
    first_ns: int | None
    """Time of its first row, nanoseconds since 1970 UTC; None where no row has one."""
    last_ns: int | None
    per_s: float | None
    """Rows, on the average from the first to the last; None where that cannot be told."""
    share: float | None
    """Of the time from the first row to the end of the last that bytes took; None without times."""
    silences: Durations
    """From the end of each row to the begin of the next, where there was anything between."""
    share_over_time: OverTime
    events: tuple[EventNumbers, ...]
    """What happened to the port, in the order in which it first did."""


class PortRun:
    """One wire as it runs."""

    def __init__(self, baud: int) -> None:
        """Nothing came yet, at so many bits per second."""
        self.baud = baud
        self.rows = self.bytes = self.timed = self.taken_ns = 0
        self.frames = dict.fromkeys(Direction, 0)
        self.first_ns: int | None = None
        self.last_ns: int | None = None
        self.end_ns = 0
        self._runs = 0
        self._between_rows_ns = self._between_ends_ns = 0
        self._goes_on = False
        self.silences = Durations()
        self.events: dict[PortEventKind, EventNumbers] = {}

    @property
    def byte_ns(self) -> int:
        """Nanoseconds that a byte takes."""
        return byte_time_ns(self.baud)

    def add(self, lengths: Ints, t_ns: Ints) -> None:
        """Rows: lengths, and times or `NO_TIME`."""
        self.rows += len(lengths)
        self.bytes += int(lengths.sum())
        known = t_ns != NO_TIME
        self._add_timed(t_ns[known], t_ns[known] + lengths[known] * self.byte_ns)

    def add_frames(self, headers: npt.NDArray[np.uint8]) -> None:
        """Rows whose framing holds, with their first bytes."""
        for direction, header in HEADERS.items():
            self.frames[direction] += int(np.count_nonzero(headers == header))

    def _add_timed(self, t_ns: Ints, ends_ns: Ints) -> None:
        self.timed += len(t_ns)
        self.taken_ns += int((ends_ns - t_ns).sum())
        if not len(t_ns):
            return
        if not self._goes_on:
            self._begin_run(int(t_ns[0]))
        before = np.concatenate(([self.end_ns], ends_ns[:-1]))
        silent = t_ns - before
        self.silences.add(silent[silent > 0], t_ns[silent > 0])
        self.last_ns, self.end_ns = int(t_ns[-1]), int(ends_ns[-1])

    def _begin_run(self, t_ns: int) -> None:
        """What lies before this time was not silence, but rows that are not here."""
        if self.first_ns is None or self.last_ns is None:
            self.first_ns = t_ns
        else:
            self._between_rows_ns += t_ns - self.last_ns
            self._between_ends_ns += t_ns - self.end_ns
        self.end_ns, self._runs, self._goes_on = t_ns, self._runs + 1, True

    def interrupt(self) -> None:
        """Rows are missing here, so that the next one is measured against none before."""
        self._goes_on = False

    @property
    def per_s(self) -> float | None:
        """Rows, on the average from the first to the last; None where that cannot be told."""
        if self.first_ns is None or self.last_ns is None:
            return None
        span = self.last_ns - self.first_ns - self._between_rows_ns
        return (self.timed - self._runs) * 1e9 / span if span > 0 else None

    @property
    def share(self) -> float | None:
        """Of the time from the first row to the end of the last that bytes took."""
        if self.first_ns is None:
            return None
        span = self.end_ns - self.first_ns - self._between_ends_ns
        return self.taken_ns / span if span > 0 else None

    def happened(self, event: PortEvent) -> None:
        """This happened to it."""
        before = self.events.get(event.kind)
        self.events[event.kind] = EventNumbers(
            event.kind,
            1 if before is None else before.count + 1,
            event.count + (0 if before is None else before.total),
            event.t_ns if before is None else before.first_ns,
            event.t_ns,
        )

    def numbers(self, name: str, share_over_time: OverTime) -> PortNumbers:
        """All of it so far."""
        return PortNumbers(
            name,
            self.rows,
            self.bytes,
            self.frames,
            self.baud,
            self.first_ns,
            self.last_ns,
            self.per_s,
            self.share,
            self.silences,
            share_over_time,
            tuple(self.events.values()),
        )


_NUMS: Final = 256


def _numbered() -> tuple[list[tuple[int, int | None]], Ints]:
    """Every kind and motor that there can be, and by kind and NUM the place among them."""
    places = np.full((NO_KIND + 1, _NUMS), -1, np.int64)
    found: list[tuple[int, int | None]] = []
    for code, kind in enumerate(KINDS):
        if kind.names_motor:
            for motor in MOTORS:
                places[code, motor] = len(found)
                found.append((code, motor))
        else:
            places[code, :] = len(found)
            found.append((code, None))
    places[places < 0] = len(found)
    return found, places


_STREAMS, _PLACES = _numbered()
_NO_STREAM: Final = len(_STREAMS)

_Place: TypeAlias = tuple[int, int, bool]
"""Where a field stands: start, size, and whether it is signed."""

_QUANTITIES: Final[list[dict[str, _Place]]] = [
    {field.name: (field.start, field.size, field.signed) for field in kind.fields if field.unit}
    for kind in KINDS
]
"""By kind code, the fields that have a unit, by row name."""

_QUANTITY_PLACES: Final = sorted({place for fields in _QUANTITIES for place in fields.values()})


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
    ranges: Mapping[str, tuple[int, int]]
    """The least and the greatest of each quantity in it, by row name."""

    @property
    def jitter_ns(self) -> float | None:
        """How much the period varies: between the 5 percent shortest and the 5 percent longest.

        None where there are no two periods.
        """
        if self.periods.count < 2:
            return None
        low, high = self.periods.percentile_ns(5), self.periods.percentile_ns(95)
        return None if low is None or high is None else high - low


class _Stream:
    """One stream as it runs."""

    def __init__(self) -> None:
        self.count = 0
        self.last_ns = 0
        self.goes_on = False
        """Whether the next frame is measured against the one before."""
        self._measured = self._measured_ns = 0
        self.periods = Durations()
        self.times = Recent()
        self.ranges: dict[str, tuple[int, int]] = {}

    def add(self, count: int, t_ns: Ints) -> None:
        """So many frames, and the times of those that have one."""
        self.count += count
        if not len(t_ns):
            return
        before = [self.last_ns] if self.goes_on else t_ns[:1]
        periods = np.diff(t_ns, prepend=before)[0 if self.goes_on else 1 :]
        ends = t_ns[len(t_ns) - len(periods) :]
        self.periods.add(periods[periods >= 0], ends[periods >= 0])
        self._measured += len(periods)
        self._measured_ns += int(periods.sum())
        self.last_ns, self.goes_on = int(t_ns[-1]), True
        self.times.add(t_ns)

    def stretch(self, name: str, low: int, high: int) -> None:
        """A quantity had values from `low` to `high`."""
        if name in self.ranges:
            low, high = min(low, self.ranges[name][0]), max(high, self.ranges[name][1])
        self.ranges[name] = low, high

    @property
    def per_s(self) -> float | None:
        return self._measured * 1e9 / self._measured_ns if self._measured_ns > 0 else None


def _ends(rows: Decoded, order: Ints, starts: Ints) -> dict[_Place, tuple[list[int], list[int]]]:
    """By place of a field, the least and the greatest in each stretch of the rows so ordered."""
    found = {}
    for place in _QUANTITY_PLACES:
        column = read_place(rows.raw, *place).astype(np.int64)[order]
        lows, highs = np.minimum.reduceat(column, starts), np.maximum.reduceat(column, starts)
        found[place] = lows.tolist(), highs.tolist()
    return found


class Streams:
    """Every stream so far."""

    def __init__(self) -> None:
        self._streams: dict[tuple[int, int], _Stream] = {}

    def add(self, rows: Decoded) -> None:
        """The next rows; their ports' numbers mean the same each time."""
        of_port = rows.packed["port"].astype(np.int64) * (_NO_STREAM + 1)
        keys = of_port + _PLACES[rows.kinds, rows.nums]
        # Small numbers are sorted by counting them.
        order = np.argsort(keys.astype(np.min_scalar_type(int(keys.max()))), kind="stable")
        ordered, t_ns = keys[order], rows.t_ns[order]
        starts = np.flatnonzero(np.diff(ordered, prepend=-1))
        ends = _ends(rows, order, starts)
        stops = [*starts[1:].tolist(), len(order)]
        for number, (start, stop) in enumerate(zip(starts.tolist(), stops, strict=True)):
            port, place = divmod(int(ordered[start]), _NO_STREAM + 1)
            if place == _NO_STREAM:
                continue
            stream = self._streams.setdefault((port, place), _Stream())
            times = t_ns[start:stop]
            stream.add(stop - start, times[times != NO_TIME])
            for name, where in _QUANTITIES[_STREAMS[place][0]].items():
                lows, highs = ends[where]
                stream.stretch(name, lows[number], highs[number])

    def interrupt(self, wire: int | None) -> None:
        """Rows of a port, by its number, or of all are missing here: no period goes over this."""
        for (port, _), stream in self._streams.items():
            if wire in (None, port):
                stream.goes_on = False
                stream.times = Recent()

    def numbers(self, ports: Sequence[str], now_ns: int | None) -> list[StreamNumbers]:
        """Each, by port, kind and motor.

        Args:
            ports: what the numbers of ports stand for.
            now_ns: not before the last row; None where no time is present.
        """
        return [
            StreamNumbers(
                ports[port],
                KINDS[_STREAMS[place][0]],
                _STREAMS[place][1],
                stream.count,
                stream.per_s,
                None if now_ns is None else stream.times.per_second(now_ns),
                stream.periods,
                stream.ranges,
            )
            for (port, place), stream in sorted(self._streams.items(), key=lambda one: one[0])
        ]


FAULTS: Final = tuple(Fault)


@dataclass(frozen=True, slots=True)
class FaultNumbers:
    """One sort of fault, on all ports."""

    fault: Fault
    count: int
    over_time: OverTime
    """Rows with it that have a time."""


class Statistics:
    """The numbers over all rows added so far."""

    def __init__(self, bench: LineSetup) -> None:
        """No rows; `bench` tells how long a byte takes."""
        self._baud = bench.baud
        self._names: list[str] = []
        self._streams = Streams()
        self._ports: dict[str, PortRun] = {}
        self.fault_counts = FaultCounts()
        """The same rows by port and faults."""
        self._faults_over_time = CountsOverTime()
        self._taken_over_time = CountsOverTime()

    def add(self, rows: Decoded, codebook: Codebook) -> None:
        """The next rows, with what the numbers of their ports and faults stand for."""
        if not len(rows):
            return
        self._names = codebook.ports
        self._add_ports(rows)
        self._streams.add(rows)
        self._add_faults(rows, codebook)

    def add_events(self, events: Sequence[PortEvent]) -> None:
        """What happened to ports."""
        for event in events:
            self._port(event.port).happened(event)

    def observe_change(self, change: Gap | BaudChange) -> None:
        """Set the baud, or end what is measured: no silence, period or rate spans a gap."""
        if isinstance(change, BaudChange):
            self._port(change.port).baud = change.baud
        elif change.port is None:
            self._streams.interrupt(None)
            for port in self._ports.values():
                port.interrupt()
        elif change.port in self._ports:
            if change.port in self._names:
                self._streams.interrupt(self._names.index(change.port))
            self._ports[change.port].interrupt()

    def _port(self, name: str) -> PortRun:
        if name not in self._ports:
            self._ports[name] = PortRun(self._baud)
        return self._ports[name]

    def _add_ports(self, rows: Decoded) -> None:
        codes, lengths = rows.packed["port"], rows.packed["length"].astype(np.int64)
        framed = (rows.packed["form"] & FRAMED).astype(np.bool_)
        for code in np.flatnonzero(np.bincount(codes)).tolist():
            own, port = codes == code, self._port(self._names[code])
            port.add(lengths[own], rows.t_ns[own])
            port.add_frames(rows.raw[own & framed, 0])
            known = own & rows.has_time
            taken = lengths[known] * port.byte_ns
            self._taken_over_time.add(np.full(len(taken), code, np.int64), rows.t_ns[known], taken)

    def _add_faults(self, rows: Decoded, codebook: Codebook) -> None:
        self.fault_counts.add(rows, codebook)
        codes = rows.packed["faults"]
        for place, fault in enumerate(FAULTS):
            having = np.array([fault in faults for faults in codebook.faults])
            if having.any():
                t_ns = rows.t_ns[having[codes] & rows.has_time]
                self._faults_over_time.add(np.full(len(t_ns), place), t_ns)

    def streams(self, now_ns: int | None) -> list[StreamNumbers]:
        """Every stream, by port, kind and motor; `now_ns` is not before the last row."""
        return self._streams.numbers(self._names, now_ns)

    def ports(self) -> list[PortNumbers]:
        """Every port that rows or events came from, in the order in which they first did."""
        return [
            port.numbers(name, self._share_over_time(name)) for name, port in self._ports.items()
        ]

    def _share_over_time(self, name: str) -> OverTime:
        counts = self._taken_over_time
        code = self._names.index(name) if name in self._names else len(self._names)
        shares = counts.of(code) / counts.slot_ns
        return OverTime(counts.start_ns, counts.slot_ns, tuple(shares.tolist()))

    def faults(self) -> list[FaultNumbers]:
        """Every fault that occurred, in the order of the vocabulary."""
        counts = self._faults_over_time
        return [
            FaultNumbers(
                fault,
                count.rows,
                OverTime(
                    counts.start_ns, counts.slot_ns, tuple(counts.of(FAULTS.index(fault)).tolist())
                ),
            )
            for fault, count in self.fault_counts.by_fault().items()
        ]
