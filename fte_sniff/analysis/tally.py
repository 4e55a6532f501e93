"""Counts of rows by status, kind, fault and port; the base of models that can merge.

Not part of `counters`, so that commands count the rows of a short log without loading numpy.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Self

from fte_sniff.protocol import KINDS, Fault, Frame, Gap, PortEvent, Row, Status, status_of

if TYPE_CHECKING:
    from fte_sniff.analysis.feed import BaudChange, StreamChange
    from fte_sniff.row_batch import RowBatch


@dataclass(slots=True)
class RowCount:
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

    def count_batch(self, rows: RowBatch) -> None:
        """Add the rows of a batch."""
        import numpy as np

        t_ns = rows.t_ns if rows.timed.all() else rows.t_ns[rows.timed]
        times = (int(t_ns.min()), int(t_ns.max())) if len(t_ns) else None
        self.count(len(rows), int(rows.length.sum(dtype=np.int64)), times)

    def include(self, other: RowCount) -> None:
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


class RowModel(ABC):
    """What counts consecutive rows, and those of another model that counted the rows after them."""

    def begin(self, name: str) -> None:  # noqa: B027
        """Start the next input."""

    def observe(
        self,
        rows: Sequence[Row],
        events: Sequence[PortEvent] = (),
        changes: Sequence[StreamChange] = (),
    ) -> None:
        """Add the next rows, and the port events and changes among them."""
        from fte_sniff.row_batch import RowBatch

        batch, start = RowBatch.from_rows(rows), 0
        for change in changes:
            if change.index > start:
                self._observe(batch[start : change.index])
            self.observe_change(change.what)
            start = change.index
        if len(batch) > start:
            self._observe(batch[start:])
        self._observe_events(events)

    @abstractmethod
    def _observe(self, rows: RowBatch) -> None:
        """Add rows, at least one."""

    def _observe_events(self, events: Sequence[PortEvent]) -> None:  # noqa: B027
        """Add port events."""

    @abstractmethod
    def observe_change(self, change: Gap | BaudChange) -> None:
        """Apply a change before the next rows."""

    @abstractmethod
    def merge(self, later: Self) -> None:
        """Add the rows that follow, as if they had been observed here."""


@dataclass(slots=True)
class Tally(RowCount):
    """Counts of rows by status, kind, fault and port."""

    frames: int = 0
    """Rows whose framing holds, malformed or not."""
    by_status: Counter[Status] = field(default_factory=Counter)
    by_kind: Counter[str] = field(default_factory=Counter)
    """Frames by kind, without those of an unknown CMD."""
    by_fault: Counter[Fault] = field(default_factory=Counter)
    """Rows by fault; a row counts once for each of its faults."""
    by_port: Counter[str] = field(default_factory=Counter)

    def update(self, rows: Sequence[Row]) -> None:
        """Count rows."""
        if not isinstance(rows, list | tuple):
            from fte_sniff.row_batch import RowBatch

            if isinstance(rows, RowBatch):
                self._update_batch(rows)
                return
        times = [row.t_ns for row in rows if row.t_ns is not None]
        first_last = (min(times), max(times)) if times else None
        self.count(len(rows), sum(len(row.raw) for row in rows), first_last)
        self.by_port.update(row.port for row in rows)
        for faults, count in Counter(row.faults for row in rows).items():
            self._count_faults(faults, count)
        frames = [row for row in rows if isinstance(row, Frame)]
        self.frames += len(frames)
        self.by_kind.update(kind.name for frame in frames if (kind := frame.kind))

    def merge(self, other: Tally) -> None:
        """Add the rows of another tally."""
        self.include(other)
        self.frames += other.frames
        self.by_status += other.by_status
        self.by_kind += other.by_kind
        self.by_fault += other.by_fault
        self.by_port += other.by_port

    def _update_batch(self, rows: RowBatch) -> None:
        import numpy as np

        self.count_batch(rows)
        codebook = rows.codebook
        self.frames += int(np.count_nonzero(rows.framed))
        for port, count in enumerate(np.bincount(rows.port).tolist()):
            if count:
                self.by_port[codebook.ports[port]] += count
        for code, count in enumerate(np.bincount(rows.faults).tolist()):
            if count:
                self._count_faults(codebook.faults[code], count)
        counts = np.bincount(rows.kinds, minlength=len(KINDS)).tolist()
        for kind, count in zip(KINDS, counts, strict=False):
            if count:
                self.by_kind[kind.name] += count

    def _count_faults(self, faults: tuple[Fault, ...], count: int) -> None:
        self.by_status[status_of(faults)] += count
        for fault in dict.fromkeys(faults):
            self.by_fault[fault] += count

    @property
    def malformed(self) -> int:
        """Malformed rows."""
        return self.by_status[Status.MALFORMED]

    @property
    def malformed_share(self) -> float:
        """Share of malformed rows, 0 to 1."""
        return self.malformed / self.rows if self.rows else 0.0
