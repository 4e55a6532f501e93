"""Statistics of all rows of one or more inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Self

from fte_sniff.analysis.feed import BaudChange
from fte_sniff.analysis.findings import Findings
from fte_sniff.analysis.model import Model, RowModel
from fte_sniff.analysis.motor_stats import Answers, FlagCounts
from fte_sniff.analysis.motors import motor_rows
from fte_sniff.analysis.statistics import LineSetup, Statistics
from fte_sniff.analysis.tally import RowCount
from fte_sniff.protocol import Gap, PortEvent
from fte_sniff.protocol.rows import Rows


@dataclass
class RowSource(Model):
    """One input."""

    name: str
    """May hold text from outside, so escape it when you show it."""
    count: RowCount = field(default_factory=RowCount)


class StatisticsSummary(RowModel):
    """Statistics of all rows so far."""

    def __init__(self, setup: LineSetup, *, with_findings: bool = False) -> None:
        """`setup` has the baud of ports for which no input has one."""
        self.findings = Findings() if with_findings else None
        self.sources: list[RowSource] = []
        self.statistics = Statistics(setup)
        self.answers = Answers()
        """By motor; meaningful only if `in_order`."""
        self.flags = FlagCounts()
        """By motor; `times_lost` is meaningful only if `in_order`."""

    def begin(self, name: str) -> None:
        """Start the next input."""
        self.sources.append(RowSource(name))

    def observe_events(self, events: Sequence[PortEvent]) -> None:
        """Count port events."""
        self.statistics.observe_events(events)
        if self.findings is not None:
            self.findings.observe_events(events)

    def observe_change(self, change: Gap | BaudChange) -> None:
        """Apply a change before the next rows."""
        self.statistics.observe_change(change)
        if isinstance(change, Gap):
            self.answers.interrupt(change)
        if self.findings is not None:
            self.findings.observe_change(change)

    def merge(self, later: Self) -> None:
        """Add the inputs that follow, as if they had been observed here."""
        self.sources += later.sources
        self.statistics.merge(later.statistics)
        self.answers.merge(later.answers)
        self.flags.merge(later.flags)
        if self.findings is not None and later.findings is not None:
            self.findings.merge(later.findings)

    def _observe(self, rows: Rows) -> None:
        self.sources[-1].count.observe(rows)
        self.statistics.observe(rows)
        found = motor_rows(rows)
        self.answers.observe(rows, found)
        self.flags.observe(rows, found)
        if self.findings is not None:
            self.findings.observe(rows)

    @property
    def total(self) -> RowCount:
        """All rows."""
        total = RowCount()
        for source in self.sources:
            total.merge(source.count)
        return total

    @property
    def in_order(self) -> bool:
        """Whether the inputs follow each other in time without overlap."""
        times = [source.count.times for source in self.sources if source.count.rows]
        return all(
            before is not None and after is not None and before[1] <= after[0]
            for before, after in pairwise(times)
        )
