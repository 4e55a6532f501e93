"""Input → filter → view as one iterator."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

from fte_sniff.analysis.feed import GapDetector, MissingRows
from fte_sniff.recording.metadata import RecordedGap
from fte_sniff.recording.row_ranges import TimeRange
from fte_sniff.session.inputs import ColumnBatch, Input, InputBatch
from fte_sniff.session.replay import Read, RecordingPages
from fte_sniff.session.save import ExportSource

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter
    from fte_sniff.recording.metadata import Selection


DAMAGED = "the recording was damaged here"
ANOTHER = "another recording begins here"


class GapTracker:
    """Watches the rows on their way."""

    def __init__(self, found: list[RecordedGap]) -> None:
        """No row came yet; what is missing is put into `found`."""
        self.found = found
        self._reason = ""
        self._last_ns: int | None = None

    def open(self, reason: str) -> None:
        """Rows are missing behind those that came, if others come."""
        self._reason = reason

    def look(self, times: tuple[int, int] | None) -> None:
        """Rows came: the time of the first of them, and the latest."""
        if times is None:
            return
        first_ns, last_ns = times
        before_ns = self._last_ns
        if self._reason and before_ns is not None and first_ns - before_ns > 1:
            self.found.append(RecordedGap(None, before_ns + 1, first_ns - 1, self._reason))
        self._reason = ""
        self._last_ns = last_ns if before_ns is None else max(before_ns, last_ns)


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
        self.left_out_of = [one.left_out(span) for one in inputs]
        """By input, rows that came in the span and that it does not hold, as far as it tells."""
        self._holes = GapTracker([])
        self._last_ns: int | None = None
        self._before: Input | None = None
        self.notes: list[str] = []
        self.written = 0
        """Rows that were handed on."""

    @property
    def left_out(self) -> list[RecordedGap]:
        """The same of all inputs."""
        return [stretch for told in self.left_out_of for stretch in told]

    @property
    def missing(self) -> list[RecordedGap]:
        """The rows that are missing between those that were handed on, by whatever cause.

        Those that the filter did not want are not among them.
        """
        first_ns = None if self._span is None else self._span.first_ns
        last_ns = None if self._span is None else self._span.end_ns - 1
        if self.written == self._limit:
            last_ns = self._last_ns or 0
        told = [*self.left_out, *self._holes.found]
        cut = [one.within(first_ns, last_ns) for one in told]
        return [one for one in cut if one is not None]

    @property
    def selections(self) -> list[Selection]:
        """The filters that chose the rows, those before them included."""
        from fte_sniff.recording.metadata import Selection

        found = [selection for one in self.inputs for selection in one.selections()]
        if self._wanted is not None:
            found.append(Selection(self._wanted.text, self.tally.rows))
        return found

    def __iter__(self) -> Iterator[InputBatch]:
        """The rows that are wanted, up to the limit."""
        for one in self.inputs:
            yield from self.of(one)
            if self.written == self._limit:
                return

    def of(self, one: Input) -> Iterator[InputBatch]:
        """Those of one input, which is the next."""
        if not one.follows(self._before):
            self._holes.open(ANOTHER)
        self._before = one
        for batch in one.batches(self._span, self.notes.append):
            if batch.after_loss:
                self._holes.open(DAMAGED)
            self._holes.look(batch.times)
            batch.count(self.tally)
            found = batch if self._wanted is None else batch.wanted(self._wanted)
            if self._limit is not None:
                found = found.first(self._limit - self.written)
            self.written += len(found)
            if self._limit is not None and found.times is not None:
                self._last_ns = max(self._last_ns or 0, found.times[1])
            yield found
            if self.written == self._limit:
                return
        if one.losses:
            self._holes.open(DAMAGED)


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
        self._left_out = [one.left_out(span) for one in inputs]
        missing: list[RecordedGap] = [stretch for told in self._left_out for stretch in told]
        self._holes = GapTracker(missing)
        self._finder = GapDetector()
        ports = [port.name for one in inputs for port in one.ports]
        self.origin = ExportSource(
            ports,
            dict.fromkeys(ports, baud) if baud else _bauds(inputs),
            missing,
            [selection for one in inputs for selection in one.selections()],
        )
        """What is known of the rows beside them; holes are put into it as they are found."""
        if span is not None:
            missing[:] = self.origin.within(span.first_ns, span.end_ns - 1).left_out

    def __iter__(self) -> Iterator[Read]:
        before = None
        for one, left_out in zip(self._inputs, self._left_out, strict=True):
            yield from self._reads(one, left_out, follows=one.follows(before))
            before = one

    def _reads(
        self, one: Input, left_out: Sequence[RecordedGap], *, follows: bool
    ) -> Iterator[Read]:
        gaps = [(gap.first_ns, gap.last_ns) for gap in left_out]
        seams = self._finder.begin({} if self._baud else _bauds([one]), gaps)
        if not follows:
            seams.append(MissingRows(0))
            self._holes.open(ANOTHER)
        for batch in one.batches(self._span, self._note):
            if batch.after_loss:
                seams.append(MissingRows(0))
                self._holes.open(DAMAGED)
            self._holes.look(batch.times)
            self._learn(batch)
            rows = batch.sequence()
            found = self._finder.seams(rows, batch.events)
            yield Read(rows, batch.events, (), [*seams, *found])
            seams = []
        if one.losses:
            self._holes.open(DAMAGED)
            seams.append(MissingRows(0))
        if one.losses or seams:
            yield Read((), (), one.losses, seams)

    def _learn(self, batch: InputBatch) -> None:
        if self._pages is not None and isinstance(batch, ColumnBatch) and batch.again is not None:
            self._pages.add(batch.again, len(batch))


def _bauds(inputs: Sequence[Input]) -> dict[str, int]:
    """Bits per second by port, as the inputs tell."""
    return {port.name: port.baud for one in inputs for port in one.ports if port.baud}
