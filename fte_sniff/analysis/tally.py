"""Counts of rows by port and fault.

Not part of `counters`, so that commands count the rows of a short log without loading numpy.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from fte_sniff.analysis.model import Model
from fte_sniff.protocol import Fault, Rows, Status, status_of
from fte_sniff.protocol.rows import NO_TIME


@dataclass
class RowCount(Model):
    """Number of rows and bytes, and the range of their times."""

    rows: int = 0
    bytes: int = 0
    """Bytes on the wire."""
    first_ns: int | None = None
    """Earliest time of a row, nanoseconds since 1970 UTC; None if no row has one."""
    last_ns: int | None = None

    def count(self, rows: int, bytes_: int, times: tuple[int, int] | None) -> None:
        """Add rows; `times` are the earliest and the latest time of those that have one."""
        self.rows += rows
        self.bytes += bytes_
        if times is not None:
            first, last = times
            self.first_ns = first if self.first_ns is None else min(self.first_ns, first)
            self.last_ns = last if self.last_ns is None else max(self.last_ns, last)

    def observe(self, rows: Rows) -> None:
        """Add rows."""
        extent = rows.extent
        self.count(len(rows), rows.size, None if extent is None else extent[:2])

    def merge(self, other: RowCount) -> None:
        """Add the rows of another count."""
        self.count(other.rows, other.bytes, other.times)

    @property
    def times(self) -> tuple[int, int] | None:
        """Earliest and latest time; None if no row has one."""
        if self.first_ns is None or self.last_ns is None:
            return None
        return self.first_ns, self.last_ns

    @property
    def duration_ns(self) -> int | None:
        """Nanoseconds from the earliest time to the latest."""
        return None if self.times is None else self.times[1] - self.times[0]


@dataclass
class Tally(RowCount):
    """Counts of rows by port and faults; its own count is that of all rows."""

    frames: int = 0
    """Rows whose framing holds, malformed or not."""
    _counts: dict[tuple[str, tuple[Fault, ...]], RowCount] = field(default_factory=dict)
    """By port, in order of first occurrence, and combination of faults."""

    def observe(self, rows: Rows) -> None:
        """Add rows."""
        ports, faults = rows.counts("port"), rows.counts("faults")
        self.frames += rows.counts("framed").get(True, 0)
        RowCount.observe(self, rows)
        if len(ports) == len(faults) == 1:
            self._count_of(rows, *ports, *faults).observe(rows)
        elif rows.prefers_numpy():
            self._observe_columns(rows)
        else:
            names = ("port", "faults", "length", "t_ns")
            columns = (rows.buffers[name].tolist() for name in names)
            for port, fault, length, t_ns in zip(*columns, strict=True):
                times = None if t_ns == NO_TIME else (t_ns, t_ns)
                self._count_of(rows, port, fault).count(1, length, times)

    def _observe_columns(self, rows: Rows) -> None:
        import numpy as np

        sets = len(rows.codebook.faults)
        keys = rows.port.astype(np.int64) * sets + rows.faults
        counts = np.bincount(keys)
        most = int(counts.argmax())
        others = np.flatnonzero(keys != most)
        for key in np.flatnonzero(counts).tolist():
            own = keys == most if key == most else others[keys[others] == key]
            t_ns = rows.t_ns[own]
            t_ns = t_ns[t_ns != NO_TIME]
            times = (int(t_ns.min()), int(t_ns.max())) if len(t_ns) else None
            size = int(rows.length[own].sum())
            self._count_of(rows, *divmod(key, sets)).count(int(counts[key]), size, times)

    def _count_of(self, rows: Rows, port: int, faults: int) -> RowCount:
        name = rows.codebook.ports[port], rows.codebook.faults[faults]
        return self._counts.setdefault(name, RowCount())

    def merge(self, other: RowCount) -> None:
        """Add the rows of another tally."""
        RowCount.merge(self, other)
        if isinstance(other, Tally):
            self.frames += other.frames
            for name, count in other._counts.items():
                self._counts.setdefault(name, RowCount()).merge(count)

    @property
    def ports(self) -> tuple[str, ...]:
        """The ports of the rows."""
        return tuple(dict.fromkeys(port for port, _ in self._counts))

    @property
    def faults(self) -> tuple[Fault, ...]:
        """The faults of the rows, in order of first occurrence."""
        return tuple(dict.fromkeys(fault for _, faults in self._counts for fault in faults))

    def by_fault(self, port: str | None = None) -> dict[Fault, RowCount]:
        """By fault that occurred; a row counts once for each of its faults."""
        found = {fault: RowCount() for fault in Fault}
        for faults, count in self._on(port):
            for fault in set(faults):
                found[fault].merge(count)
        return {fault: count for fault, count in found.items() if count.rows}

    def by_status(self, port: str | None = None) -> dict[Status, RowCount]:
        """By status, all of them."""
        found = {status: RowCount() for status in Status}
        for faults, count in self._on(port):
            found[status_of(faults)].merge(count)
        return found

    def _on(self, port: str | None) -> Iterator[tuple[tuple[Fault, ...], RowCount]]:
        for (name, faults), count in self._counts.items():
            if port is None or name == port:
                yield faults, count

    @property
    def malformed(self) -> int:
        """Malformed rows."""
        return self.by_status()[Status.MALFORMED].rows

    @property
    def malformed_share(self) -> float:
        """Share of malformed rows, 0 to 1."""
        return self.malformed / self.rows if self.rows else 0.0
