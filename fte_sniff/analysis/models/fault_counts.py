"""Owns how many rows and bytes had which faults, on which port, and when first and last.

It must not know what a fault is. Counts are kept by combination of faults, as rows have them, so
that how many rows are malformed and how many have a certain fault come from the same numbers.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fte_sniff.analysis.columns.fields import Decoded, Ints
from fte_sniff.analysis.columns.packing import Codebook
from fte_sniff.protocol import Fault, Status, status_of


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
