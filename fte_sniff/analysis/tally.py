"""Counts of rows by status, kind, fault and port; the base of models that can merge.

Not part of `counters`, so that commands count the rows of a short log without loading numpy.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Self

from fte_sniff.protocol import Fault, Gap, PortEvent, Rows, Status, status_of
from fte_sniff.protocol.spec import KIND_BY_HEADER_AND_CMD

if TYPE_CHECKING:
    from fte_sniff.analysis.feed import BaudChange, StreamChange


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

    def count_batch(self, rows: Rows) -> None:
        """Add the rows of a batch."""
        extent = rows.extent
        self.count(len(rows), rows.size, None if extent is None else extent[:2])

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
        rows: Rows,
        events: Sequence[PortEvent] = (),
        changes: Sequence[StreamChange] = (),
    ) -> None:
        """Add the next rows, and the port events and changes among them."""
        start = 0
        for change in changes:
            if change.index > start:
                self._observe(rows[start : change.index])
            self.observe_change(change.what)
            start = change.index
        if len(rows) > start:
            self._observe(rows[start:])
        self._observe_events(events)

    @abstractmethod
    def _observe(self, rows: Rows) -> None:
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

    def update(self, rows: Rows) -> None:
        """Count rows."""
        self.count_batch(rows)
        codebook = rows.codebook
        self.frames += rows.counts("framed").get(True, 0)
        for port, count in rows.counts("port").items():
            self.by_port[codebook.ports[port]] += count
        for code, count in rows.counts("faults").items():
            self._count_faults(codebook.faults[code], count)
        for head, count in rows.head_counts().items():
            if kind := KIND_BY_HEADER_AND_CMD.get(head):
                self.by_kind[kind.name] += count

    def merge(self, other: Tally) -> None:
        """Add the rows of another tally."""
        self.include(other)
        self.frames += other.frames
        self.by_status += other.by_status
        self.by_kind += other.by_kind
        self.by_fault += other.by_fault
        self.by_port += other.by_port

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
