"""Recordings, logs, raw bytes and standard input, read as batches of rows that match a filter."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import IO, TYPE_CHECKING, Final

from fte_sniff.analysis.feed import GapDetector, StreamChange
from fte_sniff.analysis.tally import Tally
from fte_sniff.errors import FileError, FteSniffError, UsageError
from fte_sniff.formats.logs.reader import LogReader
from fte_sniff.protocol import (
    FRAME_LENGTH,
    Chunk,
    Fault,
    Framer,
    Gap,
    GapKind,
    PortEvent,
    PortEventKind,
    iso_time,
)
from fte_sniff.protocol.framer.segments import DecidedSpan
from fte_sniff.session.save import ExportSource

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter
    from fte_sniff.recording.batch_reader import TimeRange
    from fte_sniff.recording.metadata import PortFacts, Selection
    from fte_sniff.recording.reader import RecordingReader
    from fte_sniff.row_batch import RowBatch, Rows

SPAN_BYTES: Final = 1 << 19
"""Bytes that are framed before their rows are yielded, unless a reader waits for them."""

FEW: Final = 20_000
"""Rows of an input that come as lists, before numpy and polars are loaded for the others."""

_FEWEST: Final = 100
"""Spans of fewer rows become lists; for them numpy is slower."""


@dataclass(frozen=True, slots=True)
class InputBatch:
    """Consecutive rows of an input, and what is known about them."""

    rows: Rows
    events: Sequence[PortEvent] = ()
    """Port events between the rows."""
    after_gap: bool = False
    """Whether rows before these could not be read."""
    reload: Callable[[], RowBatch] | None = None
    """Reads the same rows again; None if that is impossible."""
    changes: Sequence[StreamChange] = ()
    """Gaps and baud changes between the rows, by ascending index."""
    losses: Sequence[str] = ()
    """What could not be read, one line each; may contain text from the input."""

    @property
    def times(self) -> tuple[int, int] | None:
        """Time of the first row and the latest time; None if a row has none, or without rows."""
        if not isinstance(self.rows, list):
            return self.rows.times
        times = [row.t_ns for row in self.rows if row.t_ns is not None]
        return (times[0], max(times)) if times and len(times) == len(self.rows) else None

    def select(self, row_filter: RowFilter) -> InputBatch:
        """The same with only the rows that match the filter."""
        rows = self.rows
        if isinstance(rows, list):
            return replace(self, rows=row_filter.select(rows))
        return replace(self, rows=rows.select(row_filter.matches(rows)), reload=None)

    def first(self, count: int) -> InputBatch:
        """The same with at most `count` rows."""
        if count >= len(self.rows):
            return self
        return replace(self, rows=self.rows[:count], reload=None)


def decided_spans(
    chunks: Iterable[Chunk], name: str, note: Callable[[str], None], drained: Callable[[], bool]
) -> Iterator[DecidedSpan]:
    """Frame all chunks, about `SPAN_BYTES` at a time.

    Args:
        chunks: of one port; their times may fall.
        name: the port.
        note: called with a message if the input ends within a frame.
        drained: whether the next chunk has to be waited for, so that rows are not held back.

    Raises:
        FileError: there is no chunk.
        FteSniffError: raised by the chunks, after the rows before it.
    """
    framer = Framer(name)
    size, empty = 0, True
    try:
        before_ns = None
        for chunk in chunks:
            if before_ns is not None and chunk.t_ns is not None and chunk.t_ns < before_ns:
                framer.reset_clock()
            before_ns = before_ns if chunk.t_ns is None else chunk.t_ns
            empty = False
            framer.push(chunk)
            size += len(chunk.data)
            if size >= SPAN_BYTES or drained():
                size = 0
                yield framer.drain()
    except FteSniffError:
        framer.finish()
        yield framer.drain()
        raise
    if empty:
        raise FileError(f"{name}: is empty; there is nothing to decode")
    framer.finish()
    last = framer.drain()
    yield last
    _note_cut_frame(last, name, note)


def _note_cut_frame(last: DecidedSpan, name: str, note: Callable[[str], None]) -> None:
    row = last.last()
    if row is None:
        return
    size, framed, faults = row
    if not framed and Fault.TRUNCATED in faults:
        note(f"{name}: ends in the middle of a frame ({size} of {FRAME_LENGTH} bytes)")


def rows_of_spans(spans: Iterable[DecidedSpan], few: int = FEW) -> Iterator[Rows]:
    """The rows of each span; the first `few` rows come as lists."""
    count = 0
    for span in spans:
        rows = len(span)
        count += rows
        if count < few or rows < min(few, _FEWEST):
            yield span.rows()
            continue
        from fte_sniff.row_batch import RowBatch

        yield RowBatch.from_span(span)


STDIN_NAME = "stdin"
"""The port of rows that came through standard input."""

TROUBLES = (
    PortEventKind.OVERRUN,
    PortEventKind.LINE_ERROR,
    PortEventKind.LOST,
    PortEventKind.NOT_PASSED_ON,
)
"""Events of a recording that report bytes as missing or damaged."""

Note = Callable[[str], None]
"""Receives one line for the user about an input, such as that it ends within a frame."""


class Input(ABC):
    """A source of rows; the defaults are those of a log."""

    def __init__(self, name: str) -> None:
        self.name = name
        """For display; may hold text from outside, so escape it."""

    @property
    def times(self) -> tuple[int, int] | None:
        """First and last time of its rows, nanoseconds since 1970 UTC; None without times."""
        return None

    @property
    def count(self) -> int | None:
        """Number of rows and events; None if it is unknown before reading."""
        return None

    @property
    def ports(self) -> Sequence[PortFacts]:
        """The ports that are known before reading."""
        from fte_sniff.recording.metadata import PortFacts

        return [PortFacts(self.name)]

    @property
    def facts(self) -> Mapping[str, str]:
        """Facts except those of the ports, such as the host and the clock."""
        return {}

    @property
    def losses(self) -> Sequence[str]:
        """What could not be read, one line each; complete after reading."""
        return ()

    def follows(self, before: Input | None) -> bool:
        """Whether its first row came directly after the last row of another input."""
        return False

    def gaps(self, span: TimeRange | None) -> Sequence[Gap]:
        """The recorded gaps in the span."""
        return ()

    def selections(self) -> Sequence[Selection]:
        """The filters that selected its rows, if it records them."""
        return ()

    @abstractmethod
    def batches(self, span: TimeRange | None, note: Note) -> Iterator[InputBatch]:
        """Read its rows.

        Args:
            span: only rows in it; None for all.
            note: called after the last row with what is wrong with the input.

        Raises:
            FileError: it cannot be read, or has another format.
            InputTextError: text in it is not hex.
            UsageError: a span is given, and rows have no times.
        """


class RecordingInput(Input):
    """A recording."""

    def __init__(self, reader: RecordingReader, copy: IO[bytes] | None = None) -> None:
        """Read nothing yet; `copy` is the temporary file that holds standard input."""
        super().__init__(str(reader.path) if copy is None else STDIN_NAME)
        self.reader = reader
        self._copy = copy
        self._ends: dict[str, int] = {}
        """By port, the offset after the last row that was read."""

    @property
    def times(self) -> tuple[int, int] | None:
        """First and last time of its rows; reads some chunks."""
        from fte_sniff.recording.reader import row_times

        return row_times(self.reader)

    @property
    def count(self) -> int | None:
        """Number of messages, from the summary."""
        return self.reader.count

    @property
    def ports(self) -> Sequence[PortFacts]:
        """The ports in the metadata."""
        return self.reader.ports

    @property
    def facts(self) -> Mapping[str, str]:
        """The metadata without the ports and the writer's name."""
        from fte_sniff.recording.metadata import PROGRAM

        facts = self.reader.metadata.get(PROGRAM, {})
        return {k: fact for k, fact in facts.items() if not k.startswith(("library", "port."))}

    @property
    def losses(self) -> Sequence[str]:
        """What could not be read, one line each; complete after reading."""
        return [loss for loss in (*self.reader.losses, self.reader.ending) if loss]

    def follows(self, before: Input | None) -> bool:
        """Whether it is the next file of a capture, or begins at the byte where the other ended.

        The other must have been read.
        """
        from fte_sniff.recording.metadata import is_next_part

        if not isinstance(before, RecordingInput):
            return False
        if is_next_part(before.facts, self.facts):
            return True
        first = next(iter(self.reader), None) if before._ends else None
        return first is not None and before._ends.get(first.port) == first.offset

    def gaps(self, span: TimeRange | None) -> Sequence[Gap]:
        """The gaps that a trigger or a write error left in it."""
        gaps = self.reader.gaps()
        return [one for one in gaps if span is None or one.within(span.first_ns, span.end_ns - 1)]

    def selections(self) -> Sequence[Selection]:
        """The filters of the commands that wrote it."""
        return self.reader.selections()

    def batches(self, span: TimeRange | None, note: Note) -> Iterator[InputBatch]:
        """Read its rows; see `Input`."""
        from fte_sniff.recording.batch_reader import EVERYTHING

        troubles: Counter[PortEventKind] = Counter()
        some = False
        for passage, rows in self.reader.ranges(span=span or EVERYTHING):
            troubles.update(event.kind for event in rows.events)
            some = some or bool(len(rows))
            self._ends.update(rows.end_offsets())
            if len(rows) or rows.events or passage.after_loss:
                reload = partial(self.reader.read, passage)
                yield InputBatch(rows, rows.events, passage.after_loss, reload)
        for kind in TROUBLES:
            if troubles[kind]:
                times = "once" if troubles[kind] == 1 else f"{troubles[kind]:,} times"
                note(f"{self.name}: the port reported {kind} {times} while it was recorded")
        for loss in self.losses:
            note(f"{self.name}: {loss}")
        if span is not None and not some and (known := self.reader.times) is not None:
            held = "rows" if self.count is None else f"{self.count:,} rows and events"
            note(f"{self.name}: {_none_in_span(held, *known)}")


class LogInput(Input):
    """A log, raw bytes or a pipe, framed here."""

    def __init__(
        self,
        source: Iterable[Chunk] | LogReader,
        name: str,
        drained: Callable[[], bool] = lambda: False,
    ) -> None:
        """Read nothing yet; `drained` is whether the next chunk has to be waited for."""
        super().__init__(name)
        self._source, self._drained = source, drained

    @property
    def times(self) -> tuple[int, int] | None:
        """Those of a text log, which is read for them; raw bytes have none."""
        return self._source.times if isinstance(self._source, LogReader) else None

    @property
    def ports(self) -> Sequence[PortFacts]:
        """One port, named like the input; those of a text log as its first lines show them."""
        from fte_sniff.recording.metadata import PortFacts

        names = self._source.ports if isinstance(self._source, LogReader) else [self.name]
        return [PortFacts(name) for name in names]

    def explain(self) -> list[str]:
        """Where a text log has its bytes, times and directions, one line each."""
        return self._source.explain() if isinstance(self._source, LogReader) else ["raw bytes"]

    def batches(self, span: TimeRange | None, note: Note) -> Iterator[InputBatch]:
        """Read its rows; see `Input`. They are yielded at once if the next chunk is waited for."""
        if isinstance(self._source, LogReader):
            rows = self._source.rows(note)
        else:
            rows = rows_of_spans(decided_spans(self._source, self.name, note, self._drained))
        yield from map(InputBatch, rows if span is None else self._within(span, rows, note))

    def _within(self, span: TimeRange, batches: Iterable[Rows], note: Note) -> Iterator[Rows]:
        """Only rows of the span; if there are none, note the times of the input."""
        tally, found = Tally(), 0
        for rows in batches:
            if len(rows) and InputBatch(rows).times is None:
                raise UsageError(f"{self.name} has no times; --from and --to need a recording")
            tally.update(rows)
            if isinstance(rows, list):
                inside: Rows = [row for row in rows if span.contains(row)]
            else:
                inside = span.select(rows)
            found += len(inside)
            yield inside
        if not found and tally.first_ns is not None and tally.last_ns is not None:
            held = f"{tally.rows:,} rows"
            note(f"{self.name}: {_none_in_span(held, tally.first_ns, tally.last_ns)}")


def _none_in_span(held: str, first_ns: int, last_ns: int) -> str:
    return (
        f"none of its {held} lies between --from and --to;"
        f" they go from {iso_time(first_ns)} to {iso_time(last_ns)}"
    )


DAMAGED: Final = GapKind.DAMAGE, "the recording was damaged here"
ANOTHER: Final = GapKind.OTHER_RECORDING, "another recording begins here"


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
    ) -> None:
        """Read nothing yet.

        Args:
            inputs: what to read, in this order.
            span: only rows in it; None for all.
            row_filter: only rows that it matches; None for all.
            limit: largest number of those rows; None for all.
            baud: the baud of every port; None for that of the inputs.
            unreadable: errors of inputs that could not be opened.
        """
        self.inputs, self.unreadable = inputs, unreadable
        self.span, self.row_filter, self.limit, self._baud = span, row_filter, limit, baud
        self.tally = Tally()
        """Counts of all rows that were read."""
        self.notes = [str(error) for error in unreadable]
        """What is wrong with the inputs, one line each."""
        self.written = 0
        """Rows that match, up to the limit."""
        self.reported_gaps = [gap for one in inputs for gap in one.gaps(span)]
        """The gaps in the span that the inputs report."""
        self._detector = GapDetector()
        self._before: Input | None = None
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
        """The rows that match, up to the limit."""
        for one in self.inputs:
            yield from self.batches_of(one)
            if self.written == self.limit:
                break
        self._clip_gaps()
        if self.row_filter is not None:
            from fte_sniff.recording.metadata import Selection

            self._selections.append(Selection(self.row_filter.text, self.tally.rows))

    def batches_of(self, one: Input) -> Iterator[InputBatch]:
        """The rows of one input, which is the next."""
        changes = self._detector.begin({} if self._baud else _bauds_of([one]), one.gaps(self.span))
        if not one.follows(self._before):
            changes.append(self._detector.interrupt(*ANOTHER))
        self._before = one
        for batch in one.batches(self.span, self.notes.append):
            if batch.after_gap:
                changes.append(self._detector.interrupt(*DAMAGED))
            if gap := self._detector.observe(batch.times):
                self._gaps.append(gap)
            self.tally.update(batch.rows)
            found = self._matching(batch)
            changes += self._detector.changes(found.rows, found.events)
            yield replace(found, changes=changes)
            if self.written == self.limit:
                return
            changes = []
        if one.losses:
            changes.append(self._detector.interrupt(*DAMAGED))
        if changes:
            yield InputBatch([], changes=changes, losses=one.losses)

    def _matching(self, batch: InputBatch) -> InputBatch:
        """The rows of a batch that match, up to the limit."""
        found = batch if self.row_filter is None else batch.select(self.row_filter)
        if self.limit is not None:
            found = found.first(self.limit - self.written)
            if found.times is not None:
                self._last_ns = max(self._last_ns or 0, found.times[1])
        self.written += len(found.rows)
        return found


def _bauds_of(inputs: Sequence[Input]) -> dict[str, int]:
    """Bits per second by port, as the inputs report them."""
    return {port.name: port.baud for one in inputs for port in one.ports if port.baud}
