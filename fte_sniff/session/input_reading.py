"""InputReading: the rows of inputs, once, merged by time; counts and gaps."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, tzinfo
from functools import partial
from operator import attrgetter
from typing import TYPE_CHECKING, Final

from fte_sniff.analysis.feed import GapDetector, StreamChange, rising_times
from fte_sniff.analysis.tally import Tally
from fte_sniff.errors import FileError, TranslatableText
from fte_sniff.protocol import Gap, GapKind
from fte_sniff.session.inputs import Input, InputBatch, Progress
from fte_sniff.session.save import ExportSource

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter
    from fte_sniff.protocol.rows import Ints, Rows
    from fte_sniff.recording.metadata import Part, Selection
    from fte_sniff.recording.reading_pass import TimeRange
    from fte_sniff.session.fact_stage import FactStage
    from fte_sniff.session.merge import Slice, Taken

DAMAGED: Final = GapKind.DAMAGE, TranslatableText("the recording was damaged here")
ANOTHER: Final = GapKind.OTHER_RECORDING, TranslatableText("another recording begins here")


@dataclass(slots=True)
class _Succession:
    """Inputs that are read one after the other."""

    detector: GapDetector = field(default_factory=GapDetector)
    before: Input | None = None


@dataclass(slots=True)
class ReadingCounts:
    """What is known about inputs that were read elsewhere."""

    tally: Tally
    """Counts of all rows, also those that do not match the filter."""
    written: int
    notes: Sequence[str]
    gaps: Sequence[Gap]
    """The gaps that the inputs report."""
    selections: Sequence[Selection]


class InputReading:
    """Reads the rows of inputs once; counts them and collects what is known about them."""

    def __init__(
        self,
        inputs: Sequence[Input],
        span: TimeRange | None = None,
        row_filter: RowFilter | None = None,
        limit: int | None = None,
        baud: int | None = None,
        unreadable: Sequence[FileError] = (),
        progress: Progress | None = None,
        *,
        facts: bool = False,
        readings: bool = False,
        zone: tzinfo = UTC,
    ) -> None:
        """Read no rows yet; of several inputs, read their first times.

        Args:
            inputs: what to read.
            span: only rows in it; None for all.
            row_filter: only rows that it matches; None for all.
            limit: largest number of those rows; None for all.
            baud: the baud of every port; None for that of the inputs.
            unreadable: errors of inputs that could not be opened.
            progress: shows how far reading has come.
            facts: whether rows wait for the facts that depend on later rows; they always do if the
                filter names one.
            readings: whether damaged and ambiguous rows get their readings; rows wait for them.
            zone: that of times in text.
        """
        self.inputs = inputs = _by_first_time(inputs)
        for number, one in enumerate(inputs):
            one.number = number
        self.unreadable = list(unreadable)
        self.span, self.row_filter, self.limit, self._baud = span, row_filter, limit, baud
        self._has_facts = facts or (row_filter is not None and row_filter.needs_facts)
        self._has_readings = readings
        self.tally = Tally()
        self.notes = [str(error) for error in unreadable]
        """What is wrong with the inputs, one line each."""
        self.written = 0
        """Rows that match, up to the limit."""
        self.reported_gaps = [gap for one in inputs for gap in one.gaps(span)]
        """The gaps in the span that the inputs report."""
        self.progress = progress or Progress()
        self.progress.step = ""
        if not self.progress.files:
            self.progress.expect([one.size for one in inputs])
        self._last = _Succession()
        """That of the input that ended last."""
        self._last_ns: int | None = None
        """Latest time of the rows that match, with a limit."""
        self._gaps = list(self.reported_gaps)
        self._selections = [selection for one in inputs for selection in one.selections()]
        ports = [port.name for one in inputs for port in one.ports]
        self.source = ExportSource(
            ports,
            dict.fromkeys(ports, baud) if baud else _bauds_of(inputs),
            self._gaps,
            self._selections,
            {name: fact for one in inputs for name, fact in one.facts.items()},
            zone=zone,
        )
        """What is known about the rows; complete once `__iter__` has ended."""
        self._clip_gaps()

    def _clip_gaps(self) -> None:
        """Limit the gaps to the times of the rows; the filter makes no gaps."""
        first_ns = None if self.span is None else self.span.first_ns
        last_ns = None if self.span is None else self.span.end_ns - 1
        if self.written == self.limit:
            last_ns = self._last_ns or 0
        self._gaps[:] = self.source.within(first_ns, last_ns).gaps

    def __iter__(self) -> Iterator[InputBatch]:
        """The rows that match, up to the limit, merged by time.

        The rows of inputs without times come last. Inputs are opened when their first rows are due.
        """
        chains = _chains(self.inputs)
        batches: Generator[InputBatch, None, None]
        if len(chains) == 1:
            batches = self._successive(chains[0])
        else:
            batches = merged_by_time(
                [
                    TimedInput(chain[0].first_ns, partial(self._successive, chain))
                    for chain in chains
                ]
            )
        for batch in batches:
            found = batch if self.limit is None else self._limited(batch, self.limit)
            self.written += len(found.rows)
            yield found
            if self.written == self.limit:
                batches.close()  # the inputs note what is known of them
                break
        self._clip_gaps()
        if self.row_filter is not None:
            from fte_sniff.recording.metadata import Selection

            self._selections.append(Selection(self.row_filter.text, self.tally.rows))

    def _limited(self, batch: InputBatch, limit: int) -> InputBatch:
        found = batch.first(limit - self.written)
        if found.times is not None:
            self._last_ns = max(self._last_ns or 0, found.times[1])
        return found

    def batches_of(self, one: Input) -> Iterator[InputBatch]:
        """The rows of one input that match, without a limit; for each input in order."""
        for batch in self._successive([one], succession=self._last):
            self.written += len(batch.rows)
            yield batch

    @property
    def detector(self) -> GapDetector:
        """The gaps of the input that is read, or was read last."""
        return self._last.detector

    @property
    def counts(self) -> ReadingCounts:
        """What is known so far about its inputs."""
        return ReadingCounts(
            self.tally, self.written, self.notes, self.reported_gaps, self._selections
        )

    def include(self, counts: ReadingCounts) -> None:
        """Add inputs that were read elsewhere."""
        self.tally.merge(counts.tally)
        self.written += counts.written
        self.notes += counts.notes
        self.reported_gaps += counts.gaps
        self._selections += counts.selections

    def skip(self, error: FileError) -> None:
        """Report an input that could not be read."""
        self.unreadable.append(error)
        self.notes.append(str(error))

    def _successive(
        self, chain: Sequence[Input], open_inputs: int = 0, succession: _Succession | None = None
    ) -> Generator[InputBatch, None, None]:
        """The rows of inputs that follow each other, beside those of other open inputs."""
        own = succession or (_Succession() if open_inputs else self._last)
        waiting = deque(chain)
        while waiting:
            one = waiting.popleft()
            changes, read = self._begin(one, own, is_beside=open_inputs > 0), 0
            facts = self._fact_stage()
            for batch in one.batches(self.span, self.notes.append, open_inputs):
                changes += self._observe(batch, own.detector)
                self.progress.advance(one.position - read, len(batch.rows))
                read = one.position
                yield from self._selected(replace(batch, changes=changes, origin=one.number), facts)
                changes = []
            for batch in facts.end() if facts is not None else ():
                yield from self._selected(replace(batch, origin=one.number))
            if one.failure is not None:
                self.skip(one.failure)
            self.progress.files_done += 1
            self.progress.advance((one.size or read) - read)
            if one.losses:
                changes.append(own.detector.interrupt(*DAMAGED))
            if changes:
                yield InputBatch(changes=changes, losses=one.losses)
            self._last = own
            # Not kept, so that a long follow of many files needs no more memory.
            successor, one.successor = one.successor, None
            if successor is not None:
                successor.number = one.number
                self._report(successor.gaps(self.span))
                waiting.appendleft(successor)

    def _begin(self, one: Input, succession: _Succession, *, is_beside: bool) -> list[StreamChange]:
        """Begin to read an input; the changes before its first row."""
        detector, before = succession.detector, succession.before
        succession.before = one
        changes = detector.begin({} if self._baud else _bauds_of([one]), one.gaps(self.span))
        if is_beside and before is None:
            kind, reason = ANOTHER
            gaps = [Gap(kind, reason=reason, port=port) for port in _ports_of(one)]
            changes += [StreamChange(0, gap) for gap in gaps]
        elif not one.follows(before):
            changes.append(detector.interrupt(*ANOTHER))
            if before is not None:
                detector.lost.clear()
        return changes

    def _observe(self, batch: InputBatch, detector: GapDetector) -> list[StreamChange]:
        """Count the rows of a batch; the changes before and between them."""
        changes = [detector.interrupt(*DAMAGED)] if batch.after_gap else []
        if gap := detector.observe(batch.times):
            self._gaps.append(gap)
        if batch.gaps:
            detector.expect(batch.gaps)
            self._report(batch.gaps)
        self.tally.observe(batch.rows)
        return changes + detector.changes(batch.rows, batch.events)

    def _report(self, gaps: Sequence[Gap]) -> None:
        self.reported_gaps += gaps
        self._gaps += gaps

    def _fact_stage(self) -> FactStage | None:
        if not (self._has_facts or self._has_readings):
            return None
        from fte_sniff.analysis.facts import Facts
        from fte_sniff.protocol.dissect import Readings
        from fte_sniff.session.fact_stage import FactStage

        return FactStage(
            Facts() if self._has_facts else None, Readings() if self._has_readings else None
        )

    def _selected(self, batch: InputBatch, facts: FactStage | None = None) -> Iterator[InputBatch]:
        """The batch, as far as its facts are decided, with the rows that match."""
        for found in [batch] if facts is None else facts.feed(batch):
            known = replace(found, origin=batch.origin)
            yield known if self.row_filter is None else known.select(self.row_filter)


def _ports_of(one: Input) -> list[str]:
    return list(dict.fromkeys(port.name for port in one.ports))


def _bauds_of(inputs: Sequence[Input]) -> dict[str, int]:
    return {port.name: port.baud for one in inputs for port in one.ports if port.baud}


def _by_first_time(inputs: Sequence[Input]) -> list[Input]:
    """The inputs by their first times; those without come last, in their order."""
    if len(inputs) < 2:
        return list(inputs)
    times = {id(one): one.first_ns for one in inputs}

    def place(one: Input) -> tuple[bool, int]:
        first_ns = times[id(one)]
        return first_ns is None, first_ns or 0

    return sorted(inputs, key=place)


def _chains(inputs: Sequence[Input]) -> list[list[Input]]:
    """The inputs; the files of one capture that follow each other are in one list."""
    chains: list[list[Input]] = []
    chain_before: dict[Part, list[Input]] = {}
    """The files before one that was not found yet."""
    for one in sorted(inputs, key=lambda one: one.part.number if one.part else 0):
        part = one.part
        chain = chain_before.pop(part, None) if part else None
        if chain is None:
            chain = []
            chains.append(chain)
        chain.append(one)
        if part:
            chain_before[part.next] = chain
    order = {id(one): place for place, one in enumerate(inputs)}
    return sorted(chains, key=lambda chain: order[id(chain[0])])


# The merge by time

_NEVER: Final = -(2**63)


@dataclass(frozen=True, slots=True)
class TimedInput:
    """An input that can be opened."""

    first_ns: int | None
    """No row is earlier, except those that came late; None if its rows have no times."""
    open: Callable[[int], Iterator[InputBatch]]
    """Reads its batches; the argument is the number of other open inputs."""


def merged_by_time(inputs: Sequence[TimedInput]) -> Generator[InputBatch, None, None]:
    """The batches of inputs that are sorted by their first times, those without at the end.

    Raises what reading an input raises, after the rows up to there.
    """
    if len(inputs) == 1:
        yield from inputs[0].open(0)
        return
    from fte_sniff.session.merge import Merge, MergeLane

    merge, waiting, batches = Merge(), deque(inputs), list[Iterator[InputBatch]]()

    def advance(number: int) -> None:
        """Read the next batch of an open input; at its end it is not open any more."""
        lane, found = merge.lanes[number], next(batches[number], None)
        if found is None:
            del merge.lanes[number], batches[number]
            return
        (floor_ns,) = lane.reached
        lane.put(found.rows, rising_times(found.rows, floor_ns), _Origin(found, floor_ns))
        span_ns = found.rows.span_ns
        lane.reached = (max(floor_ns, span_ns[1]) if span_ns else floor_ns,)

    while waiting or batches:
        first = min(merge.lanes, key=attrgetter("reached"), default=None)
        if first is None or (waiting and _starts_before(waiting[0], first.reached[0])):
            one = waiting.popleft()
            batches.append(one.open(len(batches)))
            merge.lanes.append(
                MergeLane(reached=(_NEVER if one.first_ns is None else one.first_ns,))
            )
            advance(len(batches) - 1)
            continue
        if (taken := merge.take()) is not None:
            yield _batch_of(taken)
        advance(merge.lanes.index(first))


def _starts_before(one: TimedInput, t_ns: int) -> bool:
    return one.first_ns is not None and one.first_ns < t_ns


@dataclass(frozen=True, slots=True)
class _Origin:
    """The batch that rows belong to; its earlier rows count as of the time `floor_ns`."""

    batch: InputBatch
    floor_ns: int


def _batch_of(taken: Taken) -> InputBatch:
    if not taken.slices:
        return InputBatch(taken.rows)
    first: InputBatch = taken.slices[0].part.origin.batch
    if taken.rows is first.rows:
        return first
    import numpy as np

    count = len(taken.rows)
    place = np.arange(count) if taken.order is None else taken.order.argsort()
    changes, losses, base = list[StreamChange](), list[str](), 0
    for one in taken.slices:
        batch, is_end = one.part.origin.batch, one.stop == len(one.part.rows)
        for change in batch.changes:
            if one.start <= change.index < one.stop:
                index = int(place[base + change.index - one.start])
                changes.append(replace(change, index=index))
            elif is_end and change.index >= one.stop:
                changes.append(replace(change, index=count))
        losses += batch.losses if is_end else ()
        base += len(one)
    origins = np.repeat([one.part.origin.batch.origin for one in taken.slices], taken.lengths)
    return InputBatch(
        taken.rows,
        reload=_reload_of(taken.slices),
        changes=sorted(changes, key=attrgetter("index")),
        losses=losses,
        origin=origins if taken.order is None else origins[taken.order],
    )


def _reload_of(slices: Sequence[Slice]) -> Callable[[], Rows] | None:
    """Reads merged rows again; None if that is impossible."""
    parts: list[tuple[Callable[[], Rows], int, int, int]] = []
    for one in slices:
        reload = one.part.origin.batch.reload
        if reload is None:
            return None
        parts.append((reload, one.part.origin.floor_ns, one.start, one.stop))
    return partial(_reread, parts)


def _reread(slices: Sequence[tuple[Callable[[], Rows], int, int, int]]) -> Rows:
    """Read the rows of slices again, from a floor of their times, and merge them again."""
    import numpy as np

    from fte_sniff.protocol.rows import Rows

    parts: list[Rows] = []
    times: list[Ints] = []
    for reload, floor_ns, start, stop in slices:
        rows = reload()
        parts.append(rows[start:stop])
        times.append(rising_times(rows, floor_ns)[start:stop])
    return Rows.concat(parts).select(np.concatenate(times).argsort(kind="stable"))
