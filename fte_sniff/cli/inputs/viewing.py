"""Owns inputs on their way to a view: their rows, what stands between them, and all that is told.

It must not know what the view shows. Nothing may be measured between rows where others are missing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from fte_sniff.analysis.feed import Missing, SeamFinder
from fte_sniff.cli.inputs.batches import Batch
from fte_sniff.cli.inputs.holes import ANOTHER, DAMAGED, Holes
from fte_sniff.cli.inputs.one_input import Input
from fte_sniff.cli.inputs.packed_batches import ColumnBatch
from fte_sniff.recording.metadata import Stretch
from fte_sniff.recording.passages import Span
from fte_sniff.session.files.pages import RecordedPages
from fte_sniff.session.files.replay import Read
from fte_sniff.session.saving.origin import Origin


class Viewing:
    """All rows of the inputs, once."""

    def __init__(
        self,
        inputs: Sequence[Input],
        span: Span | None,
        baud: int | None,
        pages: RecordedPages | None,
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
        missing: list[Stretch] = [stretch for told in self._left_out for stretch in told]
        self._holes = Holes(missing)
        self._finder = SeamFinder()
        ports = [port.name for one in inputs for port in one.ports]
        self.origin = Origin(
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

    def _reads(self, one: Input, left_out: Sequence[Stretch], *, follows: bool) -> Iterator[Read]:
        gaps = [(gap.first_ns, gap.last_ns) for gap in left_out]
        seams = self._finder.begin({} if self._baud else _bauds([one]), gaps)
        if not follows:
            seams.append(Missing(0))
            self._holes.open(ANOTHER)
        for batch in one.batches(self._span, self._note):
            if batch.after_loss:
                seams.append(Missing(0))
                self._holes.open(DAMAGED)
            self._holes.look(batch.times)
            self._learn(batch)
            rows = batch.sequence()
            found = self._finder.seams(rows, batch.events)
            yield Read(rows, batch.events, (), [*seams, *found])
            seams = []
        if one.losses:
            self._holes.open(DAMAGED)
            seams.append(Missing(0))
        if one.losses or seams:
            yield Read((), (), one.losses, seams)

    def _learn(self, batch: Batch) -> None:
        if self._pages is not None and isinstance(batch, ColumnBatch) and batch.again is not None:
            self._pages.add(batch.again, len(batch))


def _bauds(inputs: Sequence[Input]) -> dict[str, int]:
    """Bits per second by port, as the inputs tell."""
    return {port.name: port.baud for one in inputs for port in one.ports if port.baud}
