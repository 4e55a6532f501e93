"""All statistics over a source (`report` is the HTML page of a later command)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from fte_sniff.analysis.feed import BaudChange, GapDetector
from fte_sniff.analysis.fields import Decoded
from fte_sniff.analysis.motor_stats import AnswerNumbers, Answers, FlagNumbers, FlagsSeen
from fte_sniff.analysis.motors import addressed
from fte_sniff.analysis.statistics import (
    Count,
    FaultCounts,
    LineSetup,
    PortNumbers,
    Statistics,
    StreamNumbers,
)
from fte_sniff.protocol import Gap, GapKind, PortEvent, Row
from fte_sniff.row_batch import Codebook, Packed, pack


@dataclass(frozen=True, slots=True)
class RowSource:
    """One input."""

    name: str
    """May hold text from outside, so show it, never obey it."""
    count: Count = field(default_factory=Count)


class StatisticsSummary:
    """The numbers over all rows added so far."""

    def __init__(self, bench: LineSetup) -> None:
        """No rows; `bench` tells the baud of ports of which no input tells any."""
        self.sources: list[RowSource] = []
        """Every input, in its order."""
        self._codebook = Codebook()
        self._statistics = Statistics(bench)
        self._answers = Answers()
        self._flags = FlagsSeen()
        self._gaps = GapDetector()

    def begin(self, name: str, bauds: Mapping[str, int], gaps: Sequence[Gap] = ()) -> None:
        """The rows to come are of this input, which tells these ports' bits per second.

        Of ports whose baud was told, later changes of it are followed.

        Args:
            name: what people know the input by.
            bauds: by port.
            gaps: what the input reports; nothing is measured across.
        """
        self.sources.append(RowSource(name))
        for change in self._gaps.begin(bauds, gaps):
            self._observe(change.what)

    def add(self, rows: Sequence[Row], events: Sequence[PortEvent] = ()) -> None:
        """The next rows, and what happened to ports among them."""
        packed = pack(rows, self._codebook)[0]
        start = 0
        for change in self._gaps.changes(rows, events):
            self._take(packed[start : change.index])
            self._observe(change.what)
            start = change.index
        self._take(packed[start:])
        self._statistics.add_events(events)

    def interrupt(self) -> None:
        """Rows are missing here: nothing is measured across."""
        self._observe(Gap(GapKind.DAMAGE))

    def _observe(self, change: Gap | BaudChange) -> None:
        self._statistics.observe_change(change)
        if isinstance(change, Gap):
            self._answers.interrupt()

    def _take(self, packed: Packed) -> None:
        if not len(packed):
            return
        rows = Decoded(packed)
        lengths = int(packed["length"].sum(dtype=np.int64))
        self.sources[-1].count.add(len(rows), lengths, rows.t_ns[rows.has_time])
        self._statistics.add(rows, self._codebook)
        found = addressed(rows)
        self._answers.add(rows, found)
        self._flags.add(rows, found)

    @property
    def total(self) -> Count:
        """All rows."""
        total = Count()
        for source in self.sources:
            total.include(source.count)
        return total

    @property
    def in_order(self) -> bool:
        """Whether each input lies behind the one before, so that frames of both have an order."""
        counts = [source.count for source in self.sources if source.count.rows]
        return all(
            before.last_ns is not None
            and after.first_ns is not None
            and before.last_ns <= after.first_ns
            for before, after in pairwise(counts)
        )

    @property
    def faults(self) -> FaultCounts:
        """Rows by port, status and fault."""
        return self._statistics.fault_counts

    def ports(self) -> list[PortNumbers]:
        """Every port that an input tells of, or that rows or events came from, in that order."""
        return self._statistics.ports()

    def streams(self) -> list[StreamNumbers]:
        """Every stream, by port, kind and motor."""
        return self._statistics.streams(None)

    def answers(self) -> list[AnswerNumbers]:
        """Every motor, by its number; what answered what means nothing where not `in_order`."""
        return self._answers.numbers()

    def flags(self) -> list[FlagNumbers]:
        """Every motor, by its number; losses mean nothing where not `in_order`."""
        return self._flags.numbers()
