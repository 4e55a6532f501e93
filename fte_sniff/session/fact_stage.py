"""Facts and readings of an input's rows: rows wait until they are decided, what is among them too.

rows      r1 r2 | r3 r4 r5      r3 waits for its answer
events          e               waits with r3, so that the order remains
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from typing import Final

from fte_sniff.analysis.facts import Facts
from fte_sniff.analysis.feed import StreamChange, rising_times, shifted
from fte_sniff.protocol import PortEvent
from fte_sniff.protocol.dissect import Readings
from fte_sniff.protocol.rows import NO_ROWS, Rows
from fte_sniff.session.inputs import InputBatch

MOST_BYTES: Final = 2 << 20
"""Bytes of rows that are released at once: an output needs several times as much memory."""


class FactStage:
    """Completes the rows of one input with their facts, their readings, or both."""

    def __init__(self, facts: Facts | None = None, readings: Readings | None = None) -> None:
        self._facts, self._readings = facts, readings
        self._read = self._decided = 0
        self._events = deque[tuple[int, PortEvent]]()
        """Each with the number of rows before it."""
        self._changes = deque[StreamChange]()
        """Their indices count from the first row of the input."""

    def feed(self, batch: InputBatch) -> Iterator[InputBatch]:
        """The next batch; returns the rows that are decided now, at least one batch."""
        if batch.events:
            places = rising_times(batch.rows).searchsorted([one.t_ns for one in batch.events])
            numbered = zip((places + self._read).tolist(), batch.events, strict=True)
            self._events.extend(sorted(numbered, key=lambda one: one[0]))
        self._changes.extend(shifted(batch.changes, self._read))
        self._read += len(batch.rows)
        rows = batch.rows
        if self._facts is not None:
            rows = self._facts.feed(rows, batch.changes)
        if self._readings is not None:
            rows = self._readings.feed(rows)
        first, *others = self._released(rows)
        yield replace(first, losses=batch.losses, gaps=batch.gaps)
        yield from others

    def end(self) -> Iterator[InputBatch]:
        """The rows that waited at the end of the input."""
        rows = NO_ROWS if self._facts is None else self._facts.interrupt()
        if self._readings is not None:
            rows = Rows.concat([self._readings.feed(rows), self._readings.end()])
        return self._released(rows)

    def _released(self, rows: Rows) -> Iterator[InputBatch]:
        parts = -(-rows.size // MOST_BYTES) or 1
        length = -(-len(rows) // parts) or 1
        for start in range(0, len(rows) or 1, length):
            yield self._part(rows[start : start + length])

    def _part(self, rows: Rows) -> InputBatch:
        start = self._decided
        self._decided += len(rows)
        events, changes = list[PortEvent](), list[StreamChange]()
        while self._events and self._events[0][0] <= self._decided:
            events.append(self._events.popleft()[1])
        while self._changes and self._changes[0].index <= self._decided:
            changes.append(self._changes.popleft())
        found = rows.with_columns(events=events)
        return InputBatch(found, changes=shifted(changes, -start))
