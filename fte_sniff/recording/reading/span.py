"""Owns a span of time, and which chunks and rows lie in it.

It must not know how a user writes a time, nor how a file is laid out.
"""

from __future__ import annotations

from dataclasses import dataclass

from fte_sniff.protocol import PortEvent, Row
from fte_sniff.row_batch import Array, RowColumns

_LATEST = 2**63 - 1


@dataclass(frozen=True, slots=True)
class Span:
    """From one time to another, nanoseconds since 1970 UTC; the end is not part of it."""

    first_ns: int = 0
    end_ns: int = _LATEST

    @property
    def everything(self) -> bool:
        """Whether it leaves nothing out."""
        return self.first_ns <= 0 and self.end_ns >= _LATEST

    def touches(self, first_ns: int, last_ns: int) -> bool:
        """Whether something from `first_ns` to `last_ns`, both included, can lie in the span."""
        return self.first_ns <= last_ns and first_ns < self.end_ns

    def holds(self, entry: Row | PortEvent) -> bool:
        """Whether a row or event lies in the span; what has no time does not."""
        return entry.t_ns is not None and self.first_ns <= entry.t_ns < self.end_ns

    def among(self, t_ns: Array) -> Array:
        """Which of these times lie in the span."""
        found: Array = (t_ns >= self.first_ns) & (t_ns < self.end_ns)
        return found

    def part_of(self, columns: RowColumns) -> RowColumns:
        """The rows and events that lie in the span."""
        if self.everything:
            return columns
        inside = self.among(columns.t_ns)
        events = tuple(filter(self.holds, columns.events))
        if inside.all() and len(events) == len(columns.events):
            return columns
        return columns.parted(inside, events)


EVERYTHING = Span()
"""All of time."""
