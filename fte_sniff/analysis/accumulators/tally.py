"""Owns the running numbers of a capture: how many rows of what, and how fast they come.

It must not know a clock, a screen or a file: times come with the rows, or from the caller.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from fte_sniff.protocol import Fault, Frame, Row, Status, status_of


@dataclass(slots=True)
class Tally:
    """Counts over all rows added so far."""

    rows: int = 0
    """Frames and damage together."""
    frames: int = 0
    """Rows whose framing holds, malformed or not."""
    bytes: int = 0
    """Bytes on the wire."""
    by_status: Counter[Status] = field(default_factory=Counter)
    by_kind: Counter[str] = field(default_factory=Counter)
    """Frames by kind; those whose CMD names none are in no count here."""
    by_fault: Counter[Fault] = field(default_factory=Counter)
    """Rows by fault; a row counts once for each of its faults."""
    by_port: Counter[str] = field(default_factory=Counter)
    first_ns: int | None = None
    """The earliest time of a row, nanoseconds since 1970 UTC; None while no row has one."""
    last_ns: int | None = None
    """The latest time of a row, nanoseconds since 1970 UTC; None while no row has one."""

    def add(self, rows: Sequence[Row]) -> None:
        """Count these rows too."""
        self.rows += len(rows)
        self.bytes += sum(len(row.raw) for row in rows)
        self.by_port.update(row.port for row in rows)
        for faults, count in Counter(row.faults for row in rows).items():
            self.by_status[status_of(faults)] += count
            for fault in set(faults):
                self.by_fault[fault] += count
        frames = [row for row in rows if isinstance(row, Frame)]
        self.frames += len(frames)
        self.by_kind.update(kind.name for frame in frames if (kind := frame.kind))
        self._stretch([row.t_ns for row in rows if row.t_ns is not None])

    def _stretch(self, times: Sequence[int]) -> None:
        if not times:
            return
        first, last = min(times), max(times)
        self.first_ns = first if self.first_ns is None else min(first, self.first_ns)
        self.last_ns = last if self.last_ns is None else max(last, self.last_ns)

    @property
    def malformed(self) -> int:
        """Rows that cannot be believed."""
        return self.by_status[Status.MALFORMED]

    @property
    def malformed_share(self) -> float:
        """Malformed rows of all, 0 to 1; 0 while there are none."""
        return self.malformed / self.rows if self.rows else 0.0

    @property
    def duration_ns(self) -> int | None:
        """From the first row's time to the last one's, nanoseconds; None without times."""
        if self.first_ns is None or self.last_ns is None:
            return None
        return self.last_ns - self.first_ns


class Rate:
    """How many per second, over a window that slides with the times it is given."""

    def __init__(self, window_ns: int = 2_000_000_000) -> None:
        """`window_ns` is how far back it looks, nanoseconds, more than 0."""
        self._window_ns = window_ns
        self._counts: deque[tuple[int, int]] = deque()
        self._total = 0
        self._since_ns: int | None = None

    def add(self, count: int, t_ns: int) -> None:
        """So many came, up to `t_ns`; times must not fall."""
        if self._since_ns is None:
            self._since_ns = t_ns
        self._counts.append((t_ns, count))
        self._total += count
        self._forget(t_ns)

    def per_second(self, now_ns: int) -> float:
        """The rate over the window that ends now; while it fills, over the time since it began."""
        self._forget(now_ns)
        if self._since_ns is None:
            return 0.0
        span_ns = min(self._window_ns, now_ns - self._since_ns)
        return self._total * 1e9 / span_ns if span_ns > 0 else 0.0

    def _forget(self, now_ns: int) -> None:
        while self._counts and self._counts[0][0] <= now_ns - self._window_ns:
            self._total -= self._counts.popleft()[1]
