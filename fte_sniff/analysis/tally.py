"""Counts of rows by fault, and the time that they span."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from fte_sniff.protocol.rows import Rows, faults_in
from fte_sniff.protocol.spec import Fault, Status, status_of


@dataclass
class Tally:
    """Counts of rows that come in batches."""

    rows: int = 0
    frames: int = 0
    """Rows whose framing holds, malformed or not."""
    times: tuple[int, int] | None = None
    """Earliest and latest time, nanoseconds since 1970 UTC; None if no row has one."""
    by_bits: Counter[int] = field(default_factory=Counter)
    """Rows by combination of faults as bits, in order of first occurrence."""

    def observe(self, rows: Rows) -> None:
        """Add rows."""
        found, first, counts = np.unique(rows.faults, return_index=True, return_counts=True)
        bits = {int(found[at]): int(counts[at]) for at in first.argsort().tolist()}
        frames = int(np.count_nonzero(rows.framed))
        self.merge(Tally(len(rows), frames, rows.span_ns, Counter(bits)))

    def merge(self, other: Tally) -> None:
        """Add the rows of another tally."""
        self.rows += other.rows
        self.frames += other.frames
        self.by_bits.update(other.by_bits)
        times = [*(self.times or ()), *(other.times or ())]
        self.times = (min(times), max(times)) if times else None

    @property
    def by_fault(self) -> Counter[Fault]:
        """Rows by fault, in order of first occurrence; a row counts for each of its faults."""
        found = Counter[Fault]()
        for bits, count in self.by_bits.items():
            found.update(dict.fromkeys(faults_in(bits), count))
        return found

    @property
    def by_status(self) -> Counter[Status]:
        """Rows by status."""
        found = Counter[Status]()
        for bits, count in self.by_bits.items():
            found[status_of(faults_in(bits))] += count
        return found
