"""Input → filter → view as one iterator."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

from fte_sniff.analysis.feed import GapDetector
from fte_sniff.protocol import Gap, GapKind
from fte_sniff.recording.row_ranges import TimeRange
from fte_sniff.session.inputs import Input, InputBatch
from fte_sniff.session.replay import Read, RecordingPages
from fte_sniff.session.save import ExportSource

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter
    from fte_sniff.recording.metadata import Selection


DAMAGED = GapKind.DAMAGE, "the recording was damaged here"
ANOTHER = GapKind.OTHER_RECORDING, "another recording begins here"


class InputReading:
    """The rows on their way, and what is known of them once they are through."""

    def __init__(
        self,
        inputs: Sequence[Input],
        span: TimeRange | None,
        wanted: RowFilter | None,
        limit: int | None = None,
    ) -> None:
        """Nothing is read yet.

        Args:
            inputs: what to read, in this order.
            span: only rows in it; None for all.
            wanted: only rows that it wants; None for all.
            limit: only so many of those; None for all.
        """
        from fte_sniff.analysis.counters import Tally

        self.inputs = inputs
        self._span, self._wanted, self._limit = span, wanted, limit
        self.tally = Tally()
        """Of all rows that were read."""
        self.gaps_of = [one.gaps(span) for one in inputs]
        """The gaps in the span that each input reports."""
        self._detector = GapDetector()
        self._found: list[Gap] = []
        self._last_ns: int | None = None
        self._before: Input | None = None
        self.notes: list[str] = []
        self.written = 0
        """Rows that were handed on."""
        self._gaps: list[Gap] = []
        self._selections: list[Selection] = []
        self.source = ExportSource(
            [port.name for one in inputs for port in one.ports],
            _bauds(inputs),
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
        """All gaps between the rows that were read, reported or found; the filter makes none."""
        first_ns = None if self._span is None else self._span.first_ns
        last_ns = None if self._span is None else self._span.end_ns - 1
        if self.written == self._limit:
            last_ns = self._last_ns or 0
        clipped = (gap.within(first_ns, last_ns) for gap in (*self.reported_gaps, *self._found))
        return (gap for gap in clipped if gap is not None)

    def of(self, one: Input) -> Iterator[InputBatch]:
        """Those of one input, which is the next."""
        if not one.follows(self._before):
            self._detector.interrupt(*ANOTHER)
        self._before = one
        for batch in one.batches(self._span, self.notes.append):
            if batch.after_gap:
                self._detector.interrupt(*DAMAGED)
            if gap := self._detector.observe(batch.times):
                self._found.append(gap)
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
        if one.losses:
            self._detector.interrupt(*DAMAGED)


class Viewing:
    """All rows of the inputs, once."""

    def __init__(
        self,
        inputs: Sequence[Input],
        span: TimeRange | None,
        baud: int | None,
        pages: RecordingPages | None,
        note: Callable[[str], None],
    ) -> None:
        """Nothing is read yet, but what the inputs tell before their rows.

        Args:
            inputs: what to read, in this order.
            span: only rows in it; None for all.
            baud: of every line, whatever an input says; None to believe the inputs.
            pages: learn how rows are read again; None where they cannot be.
            note: is told what is wrong with an input.
        """
        self._inputs, self._span, self._pages, self._note = inputs, span, pages, note
        self._baud = baud
        self._reported = [one.gaps(span) for one in inputs]
        self._gaps: list[Gap] = [gap for gaps in self._reported for gap in gaps]
        self._detector = GapDetector()
        ports = [port.name for one in inputs for port in one.ports]
        self.origin = ExportSource(
            ports,
            dict.fromkeys(ports, baud) if baud else _bauds(inputs),
            self._gaps,
            [selection for one in inputs for selection in one.selections()],
        )
        """What is known of the rows; its gaps grow as they are found."""
        if span is not None:
            self._gaps[:] = self.origin.within(span.first_ns, span.end_ns - 1).gaps

    def __iter__(self) -> Iterator[Read]:
        before = None
        for one, gaps in zip(self._inputs, self._reported, strict=True):
            yield from self._reads(one, gaps, follows=one.follows(before))
            before = one

    def _reads(self, one: Input, gaps: Sequence[Gap], *, follows: bool) -> Iterator[Read]:
        changes = self._detector.begin({} if self._baud else _bauds([one]), gaps)
        if not follows:
            changes.append(self._detector.interrupt(*ANOTHER))
        for batch in one.batches(self._span, self._note):
            if batch.after_gap:
                changes.append(self._detector.interrupt(*DAMAGED))
            if gap := self._detector.observe(batch.times):
                self._gaps.append(gap)
            self._learn(batch)
            changes += self._detector.changes(batch.rows, batch.events)
            yield Read(batch.rows, batch.events, (), changes)
            changes = []
        if one.losses:
            changes.append(self._detector.interrupt(*DAMAGED))
        if changes:
            yield Read((), (), one.losses, changes)

    def _learn(self, batch: InputBatch) -> None:
        if self._pages is not None and batch.reload is not None:
            self._pages.add(batch.reload, len(batch.rows))


def _bauds(inputs: Sequence[Input]) -> dict[str, int]:
    """Bits per second by port, as the inputs tell."""
    return {port.name: port.baud for one in inputs for port in one.ports if port.baud}
