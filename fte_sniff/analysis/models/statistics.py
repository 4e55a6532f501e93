"""Owns the numbers over all rows: rates, periods, silence, use of the line, faults over time.

It must not know a clock, a screen or where rows are kept: decoded rows and port events come in,
batch by batch, and it makes no difference where batches are cut. What it keeps is bounded by the
number of ports, not by that of rows. Times of one port are taken not to fall.

    stream   the frames of one kind, to or from one motor, on one port (`streams`)
    port     one wire: how full it is, and how long it is silent
    fault    how often each occurs, and when
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fte_sniff.analysis.accumulators.counts import CountsOverTime, OverTime
from fte_sniff.analysis.columns.fields import Decoded
from fte_sniff.analysis.columns.packing import FRAMED, Codebook
from fte_sniff.analysis.models.bench import Bench
from fte_sniff.analysis.models.fault_counts import FaultCounts
from fte_sniff.analysis.models.port_run import PortNumbers, PortRun
from fte_sniff.analysis.models.streams import StreamNumbers, Streams
from fte_sniff.analysis.store.seams import Pace, Seam
from fte_sniff.protocol import Fault, PortEvent

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

    def __init__(self, bench: Bench) -> None:
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

    def meet(self, seam: Seam) -> None:
        """The next rows stand behind this: no silence, period or rate goes over missing ones."""
        if isinstance(seam, Pace):
            self._port(seam.port).baud = seam.baud
        elif seam.port is None:
            self._streams.interrupt(None)
            for port in self._ports.values():
                port.interrupt()
        elif seam.port in self._ports:
            if seam.port in self._names:
                self._streams.interrupt(self._names.index(seam.port))
            self._ports[seam.port].interrupt()

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
