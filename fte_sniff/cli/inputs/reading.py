"""Owns reading inputs through a filter, and what is known of them once that is done.

It must not know formats, nor what a command does with the rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from fte_sniff.cli.inputs.batches import Batch
from fte_sniff.cli.inputs.holes import ANOTHER, DAMAGED, Holes
from fte_sniff.cli.inputs.one_input import Input

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter
    from fte_sniff.recording.metadata import Selection, Stretch
    from fte_sniff.recording.passages import Span


class Reading:
    """The rows on their way, and what is known of them once they are through."""

    def __init__(
        self,
        inputs: Sequence[Input],
        span: Span | None,
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
        self._holes = Holes([])
        self._last_ns: int | None = None
        self._before: Input | None = None
        self.notes: list[str] = []
        self.written = 0
        """Rows that were handed on."""

    @property
    def left_out(self) -> list[Stretch]:
        """The same of all inputs."""
        return [stretch for told in self.left_out_of for stretch in told]

    @property
    def missing(self) -> list[Stretch]:
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

    def __iter__(self) -> Iterator[Batch]:
        """The rows that are wanted, up to the limit."""
        for one in self.inputs:
            yield from self.of(one)
            if self.written == self._limit:
                return

    def of(self, one: Input) -> Iterator[Batch]:
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
