"""Input → filter → view as one iterator."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from fte_sniff.analysis.feed import GapDetector
from fte_sniff.protocol import Gap, GapKind
from fte_sniff.session.inputs import Input, InputBatch
from fte_sniff.session.save import ExportSource

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter
    from fte_sniff.recording.metadata import Selection
    from fte_sniff.recording.row_ranges import TimeRange


DAMAGED = GapKind.DAMAGE, "the recording was damaged here"
ANOTHER = GapKind.OTHER_RECORDING, "another recording begins here"


class InputReading:
    """Reads the rows of inputs once; counts them and collects what is known about them."""

    def __init__(
        self,
        inputs: Sequence[Input],
        span: TimeRange | None,
        wanted: RowFilter | None,
        limit: int | None = None,
        *,
        find_gaps: bool = False,
    ) -> None:
        """Read nothing yet.

        Args:
            inputs: what to read, in this order.
            span: only rows in it; None for all.
            wanted: only rows that it matches; None for all.
            limit: largest number of those rows; None for all.
            find_gaps: find gaps between the rows that the inputs do not report.
        """
        from fte_sniff.analysis.tally import Tally

        self.inputs = inputs
        self._span, self._wanted, self._limit = span, wanted, limit
        self.tally = Tally()
        """Counts of all rows that were read."""
        self.gaps_of = [one.gaps(span) for one in inputs]
        """The gaps in the span that each input reports."""
        self._detector = GapDetector() if find_gaps else None
        self._found: list[Gap] = []
        self._last_ns: int | None = None
        self._before: Input | None = None
        self.notes: list[str] = []
        self.written = 0
        """Rows that match, up to the limit."""
        self._gaps: list[Gap] = []
        self._selections: list[Selection] = []
        self.source = ExportSource(
            [port.name for one in inputs for port in one.ports],
            bauds_of(inputs),
            self._gaps,
            self._selections,
            {name: fact for one in inputs for name, fact in one.facts.items()},
        )
        """What is known about the rows; complete once `__iter__` has ended."""

    @property
    def reported_gaps(self) -> list[Gap]:
        """The gaps in the span that the inputs report."""
        return [gap for gaps in self.gaps_of for gap in gaps]

    def __iter__(self) -> Iterator[InputBatch]:
        """The rows that are wanted, up to the limit."""
        for one in self.inputs:
            yield from self.of(one)
            if self.written == self._limit:
                break
        self._gaps += self._gaps_between_rows()
        self._selections += [selection for one in self.inputs for selection in one.selections()]
        if self._wanted is not None:
            from fte_sniff.recording.metadata import Selection

            self._selections.append(Selection(self._wanted.text, self.tally.rows))

    def _gaps_between_rows(self) -> Iterator[Gap]:
        """The gaps between the rows that were read, reported or found; the filter makes none."""
        first_ns = None if self._span is None else self._span.first_ns
        last_ns = None if self._span is None else self._span.end_ns - 1
        if self.written == self._limit:
            last_ns = self._last_ns or 0
        clipped = (gap.within(first_ns, last_ns) for gap in (*self.reported_gaps, *self._found))
        return (gap for gap in clipped if gap is not None)

    def of(self, one: Input) -> Iterator[InputBatch]:
        """The rows of one input, which is the next."""
        batches = one.batches(self._span, self.notes.append)
        if self._detector is not None:
            batches = self._with_gaps_found(one, batches, self._detector)
        for batch in batches:
            self.tally.update(batch.rows)
            found = batch if self._wanted is None else batch.select(self._wanted)
            if self._limit is not None:
                found = found.first(self._limit - self.written)
            self.written += len(found.rows)
            if self._limit is not None and found.times is not None:
                self._last_ns = max(self._last_ns or 0, found.times[1])
            yield found
            if self.written == self._limit:
                return

    def _with_gaps_found(
        self, one: Input, batches: Iterator[InputBatch], detector: GapDetector
    ) -> Iterator[InputBatch]:
        if not one.follows(self._before):
            detector.interrupt(*ANOTHER)
        self._before = one
        for batch in batches:
            if batch.after_gap:
                detector.interrupt(*DAMAGED)
            if gap := detector.observe(batch.times):
                self._found.append(gap)
            yield batch
        if one.losses:
            detector.interrupt(*DAMAGED)


def bauds_of(inputs: Sequence[Input]) -> dict[str, int]:
    """Bits per second by port, as the inputs report them."""
    return {port.name: port.baud for one in inputs for port in one.ports if port.baud}
