"""Open any input (MCAP, log, raw, stdin) as batches."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import IO, TYPE_CHECKING, Final, Protocol, Self

from fte_sniff.errors import FileError, FteSniffError, UsageError
from fte_sniff.formats.logs.hex_log import HexLog, at_own_times
from fte_sniff.formats.writers import FrameWriter, RowWriter
from fte_sniff.protocol import (
    FRAME_LENGTH,
    Chunk,
    Fault,
    Framer,
    Gap,
    PortEvent,
    PortEventKind,
    Row,
    iso_time,
)
from fte_sniff.protocol.framer.segments import DecidedSpan

if TYPE_CHECKING:
    import polars as pl

    from fte_sniff.analysis.counters import Tally
    from fte_sniff.analysis.filter.row_filter import RowFilter
    from fte_sniff.recording.metadata import PortFacts, Selection
    from fte_sniff.recording.reader import RecordingReader
    from fte_sniff.recording.row_ranges import TimeRange
    from fte_sniff.row_batch import Codebook, PackedRows, RowBatch, SideBySide


class InputBatch(Protocol):
    """Some rows, in their order."""

    def __len__(self) -> int: ...

    def count(self, tally: Tally) -> None:
        """Add them to a tally."""
        ...

    def wanted(self, row_filter: RowFilter) -> Self:
        """Only those that the filter wants."""
        ...

    def first(self, count: int) -> Self:
        """Only so many of them."""
        ...

    def rows(self) -> list[Row]:
        """As objects."""
        ...

    def sequence(self) -> Sequence[Row]:
        """For a view: objects, or what takes their place and is cheaper."""
        ...

    @property
    def events(self) -> Sequence[PortEvent]:
        """What happened to ports among them."""
        ...

    @property
    def after_loss(self) -> bool:
        """Whether rows before them could not be read."""
        ...

    @property
    def times(self) -> tuple[int, int] | None:
        """Time of the first of them, and the latest; None where one has none, or there is none."""
        ...

    def write_to(self, writer: RowWriter) -> None:
        """Write them, in the way that is fastest."""
        ...

    def frame(self) -> pl.DataFrame:
        """As a frame of `analysis.table.TABLE_SCHEMA`."""
        ...

    def columns(self, codebook: Codebook) -> RowBatch:
        """Side by side; only rows that have a time can be."""
        ...


class LogBatch(InputBatch, Protocol):
    """Some rows of a log, which may have no times."""

    @property
    def timed(self) -> bool:
        """Whether each has a time."""
        ...

    def within(self, span: TimeRange) -> Self:
        """Only those that lie in the span."""
        ...


@dataclass(frozen=True, slots=True)
class ListBatch:
    """Rows as objects."""

    held: Sequence[Row]

    def __len__(self) -> int:
        return len(self.held)

    def count(self, tally: Tally) -> None:
        """Add them to a tally."""
        tally.update(self.held)

    def wanted(self, row_filter: RowFilter) -> ListBatch:
        """Only those that the filter wants."""
        return ListBatch(row_filter.select(self.held))

    def first(self, count: int) -> ListBatch:
        """Only so many of them."""
        return ListBatch(self.held[:count])

    def rows(self) -> list[Row]:
        """As objects."""
        return list(self.held)

    @property
    def timed(self) -> bool:
        """Whether each has a time."""
        return all(row.t_ns is not None for row in self.held)

    def within(self, span: TimeRange) -> ListBatch:
        """Only those that lie in the span."""
        return ListBatch([row for row in self.held if span.contains(row)])

    def sequence(self) -> Sequence[Row]:
        """The objects."""
        return self.held

    @property
    def events(self) -> Sequence[PortEvent]:
        """None: a log tells of no port."""
        return ()

    @property
    def after_loss(self) -> bool:
        """Never: a log is read whole, or not at all."""
        return False

    @property
    def times(self) -> tuple[int, int] | None:
        """Time of the first, and the latest."""
        times = [row.t_ns for row in self.held if row.t_ns is not None]
        return (times[0], max(times)) if times and len(times) == len(self.held) else None

    def write_to(self, writer: RowWriter) -> None:
        """Write them one by one."""
        writer.write(self.held)

    def frame(self) -> pl.DataFrame:
        """As a frame of `analysis.table.TABLE_SCHEMA`."""
        from fte_sniff.analysis.dataframe import rows_table

        return rows_table(self.held)

    def columns(self, codebook: Codebook) -> RowBatch:
        """Side by side; only rows that have a time can be."""
        from fte_sniff.row_batch import RowBatch

        return RowBatch.from_rows(self.held, codebook)


PORTION: Final = 1 << 19
"""Bytes that are handed on at once, more or less, where nobody waits for them."""


def decided(
    chunks: Iterable[Chunk], name: str, note: Callable[[str], None], drained: Callable[[], bool]
) -> Iterator[DecidedSpan]:
    """All that the chunks hold, portion by portion.

    Args:
        chunks: of one port; their times may fall.
        name: the port.
        note: is told where they end within a frame.
        drained: whether the chunk behind the latest has to be waited for.

    Raises:
        FileError: there is no chunk.
        FteSniffError: what the chunks raise; what stood before is not lost with it.
    """
    framer = Framer(name)
    gathered, some = 0, False
    try:
        for chunk in at_own_times(chunks, framer):
            some = True
            framer.push(chunk)
            gathered += len(chunk.data)
            if gathered >= PORTION or drained():
                gathered = 0
                yield framer.drain()
    except FteSniffError:
        framer.finish()
        yield framer.drain()
        raise
    if not some:
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


@dataclass(frozen=True, slots=True)
class PackedBatch:
    """Rows packed, with or without times."""

    held: PackedRows

    def __len__(self) -> int:
        return len(self.held)

    def count(self, tally: Tally) -> None:
        """Add them to a tally."""
        tally.update_columns(self.held)

    def wanted(self, row_filter: RowFilter) -> PackedBatch:
        """Only those that the filter wants."""
        return PackedBatch(self.held.select(row_filter.among(self.held).to_numpy()))

    def first(self, count: int) -> PackedBatch:
        """Only so many of them."""
        return self if count >= len(self) else PackedBatch(self.held.select(slice(count)))

    def rows(self) -> list[Row]:
        """As objects."""
        return list(self.held)

    @property
    def timed(self) -> bool:
        """Whether each has a time."""
        return bool(self.held.timed.all())

    def within(self, span: TimeRange) -> PackedBatch:
        """Only those that lie in the span."""
        return PackedBatch(self.held.select(span.mask(self.held.t_ns) & self.held.timed))

    def sequence(self) -> Sequence[Row]:
        """As they are."""
        return self.held

    @property
    def events(self) -> Sequence[PortEvent]:
        """None: a log tells of no port."""
        return ()

    @property
    def after_loss(self) -> bool:
        """A log is read from its first row on."""
        return False

    @property
    def times(self) -> tuple[int, int] | None:
        """Time of the first, and the latest."""
        t_ns = self.held.t_ns
        return (int(t_ns[0]), int(t_ns.max())) if len(t_ns) and self.timed else None

    def write_to(self, writer: RowWriter) -> None:
        """Write them at once where the format can."""
        _write(self, writer)

    def frame(self) -> pl.DataFrame:
        """As a frame of `analysis.table.TABLE_SCHEMA`."""
        return _frame(self.held)

    def columns(self, codebook: Codebook) -> RowBatch:
        """In the columns of a recording; only rows that have a time can be."""
        from fte_sniff.row_batch import row_columns

        return row_columns(codebook, self.held)


@dataclass(frozen=True, slots=True)
class ColumnBatch:
    """Rows in the columns of a recording."""

    held: RowBatch
    again: Callable[[], RowBatch] | None = None
    """Reads the same rows again, where that can be done."""
    after_loss: bool = False
    """Whether rows before them could not be read."""

    def __len__(self) -> int:
        return len(self.held)

    def count(self, tally: Tally) -> None:
        """Add them to a tally."""
        tally.update_columns(self.held)

    def wanted(self, row_filter: RowFilter) -> ColumnBatch:
        """Only those that the filter wants."""
        mask = row_filter.among(self.held).to_numpy()
        return replace(self, held=self.held.select(mask, self.held.events), again=None)

    def first(self, count: int) -> ColumnBatch:
        """Only so many of them."""
        if count >= len(self):
            return self
        held = self.held.select(slice(count), self.held.events)
        return replace(self, held=held, again=None)

    def rows(self) -> list[Row]:
        """As objects."""
        return list(self.held)

    def sequence(self) -> Sequence[Row]:
        """Packed."""
        from fte_sniff.row_batch import packed_rows

        return packed_rows(self.held)

    @property
    def events(self) -> Sequence[PortEvent]:
        """What happened to ports among them."""
        return self.held.events

    @property
    def times(self) -> tuple[int, int] | None:
        """Time of the first, and the latest."""
        t_ns = self.held.t_ns
        return (int(t_ns[0]), int(t_ns.max())) if len(t_ns) else None

    def write_to(self, writer: RowWriter) -> None:
        """Write them at once where the format can."""
        _write(self, writer)

    def frame(self) -> pl.DataFrame:
        """As a frame of `analysis.table.TABLE_SCHEMA`."""
        return _frame(self.held)

    def columns(self, codebook: Codebook) -> RowBatch:
        """As they are: their words are their own."""
        return self.held


def _write(batch: PackedBatch | ColumnBatch, writer: RowWriter) -> None:
    if isinstance(writer, FrameWriter) and not (writer.shows_order and batch.held.unordered.any()):
        writer.write_frame(batch.frame())
    else:
        writer.write(batch.rows())


def _frame(rows: SideBySide) -> pl.DataFrame:
    from fte_sniff.analysis.dataframe import table_frame

    return table_frame(rows)


FEW: Final = 20_000
"""Fewer rows are read one by one before what takes many at once is loaded."""

_FEWEST: Final = 100
"""Fewer rows are never taken at once."""


def log_batches(portions: Iterable[DecidedSpan], few: int = FEW) -> Iterator[LogBatch]:
    """The rows of all that was decided, in the form that is quickest.

    Args:
        portions: as they come.
        few: so many rows come as objects, whatever is behind them.
    """
    count = 0
    for portion in portions:
        rows = len(portion)
        count += rows
        if count < few or rows < min(few, _FEWEST):
            yield ListBatch(portion.rows())
            continue
        from fte_sniff.row_batch import packed_tiles

        yield PackedBatch(packed_tiles(portion))


STDIN_NAME = "stdin"
"""The port of rows that came through standard input."""

TROUBLES = (
    PortEventKind.OVERRUN,
    PortEventKind.LINE_ERROR,
    PortEventKind.LOST,
    PortEventKind.NOT_PASSED_ON,
)
"""Events of a recording that tell of bytes that are not in it, or not as they were sent."""

Note = Callable[[str], None]
"""Takes one line for people about an input, such as that it ends in the middle."""


class Input(Protocol):
    """One thing to read rows from."""

    @property
    def name(self) -> str:
        """What people know it by; may hold text from outside, so show it, never obey it."""
        ...

    @property
    def times(self) -> tuple[int, int] | None:
        """First and last time of its rows, nanoseconds since 1970 UTC; None where it has none."""
        ...

    @property
    def count(self) -> int | None:
        """How many rows and events it holds, as far as that can be told before it is read."""
        ...

    @property
    def ports(self) -> Sequence[PortFacts]:
        """The ports that it names before it is read."""
        ...

    @property
    def facts(self) -> Mapping[str, str]:
        """What it says about itself beside the ports: the host, the clock."""
        ...

    @property
    def losses(self) -> Sequence[str]:
        """What could not be read, one line each, once all is read."""
        ...

    def follows(self, before: Input | None) -> bool:
        """Whether its first row is the next that came behind the last of another."""
        ...

    def gaps(self, span: TimeRange | None) -> Sequence[Gap]:
        """The gaps in the span that it reports."""
        ...

    def selections(self) -> Sequence[Selection]:
        """The filters that chose its rows, as far as it tells."""
        ...

    def batches(self, span: TimeRange | None, note: Note) -> Iterator[InputBatch]:
        """Its rows, batch by batch.

        Args:
            span: only rows in it; None for all.
            note: is told, at the end, what is wrong with the input.

        Raises:
            FileError: it cannot be read, or is not what it should be.
            InputTextError: text in it is not hex.
            UsageError: rows of a span are asked for, and they have no times.
        """
        ...


@dataclass(frozen=True, slots=True)
class RecordingInput:
    """A recording."""

    reader: RecordingReader
    copy: IO[bytes] | None = None
    """The temporary file that it is, to be kept as long as this."""
    ends: dict[str, int] = field(default_factory=dict)
    """By port, the offset behind the last of its rows that were read."""

    @property
    def name(self) -> str:
        """Its path, or that it came through standard input."""
        return str(self.reader.path) if self.copy is None else STDIN_NAME

    @property
    def times(self) -> tuple[int, int] | None:
        """First and last time of its rows, for which some of it is read."""
        from fte_sniff.recording.reader import row_times

        return row_times(self.reader)

    @property
    def count(self) -> int | None:
        """How many messages the file tells of."""
        return self.reader.count

    @property
    def ports(self) -> Sequence[PortFacts]:
        """The ports that the file names."""
        return self.reader.ports

    @property
    def facts(self) -> Mapping[str, str]:
        """What the file says about itself, but not who wrote it."""
        from fte_sniff.recording.metadata import PROGRAM

        told = self.reader.metadata.get(PROGRAM, {})
        own = ("library", "port.")
        return {name: fact for name, fact in told.items() if not name.startswith(own)}

    @property
    def losses(self) -> Sequence[str]:
        """What could not be read, one line each, once all is read."""
        return [loss for loss in (*self.reader.losses, self.reader.ending) if loss]

    def follows(self, before: Input | None) -> bool:
        """Whether it is the next file of the same capture, or goes on at the byte where that ended.

        The other has to be read by now.
        """
        from fte_sniff.recording.metadata import is_next_part

        if not isinstance(before, RecordingInput):
            return False
        if is_next_part(before.facts, self.facts):
            return True
        first = next(iter(self.reader), None) if before.ends else None
        return first is not None and before.ends.get(first.port) == first.offset

    def gaps(self, span: TimeRange | None) -> Sequence[Gap]:
        """The gaps that a trigger or a write error left in it."""
        gaps = self.reader.gaps()
        return [one for one in gaps if span is None or one.within(span.first_ns, span.end_ns - 1)]

    def selections(self) -> Sequence[Selection]:
        """What `decode --filter`, or a screen, chose from another."""
        return self.reader.selections()

    def batches(self, span: TimeRange | None, note: Note) -> Iterator[InputBatch]:
        """Its rows, many thousands side by side; see `Input`."""
        from fte_sniff.recording.row_ranges import EVERYTHING

        troubles: Counter[PortEventKind] = Counter()
        some = False
        for passage, columns in self.reader.ranges(span=span or EVERYTHING):
            troubles.update(event.kind for event in columns.events)
            some = some or bool(len(columns))
            self.ends.update(columns.end_offsets())
            if len(columns) or columns.events or passage.after_loss:
                again = partial(self.reader.read, passage)
                yield ColumnBatch(columns, again, passage.after_loss)
        for kind in TROUBLES:
            if troubles[kind]:
                times = "once" if troubles[kind] == 1 else f"{troubles[kind]:,} times"
                note(f"{self.name}: the port reported {kind} {times} while it was recorded")
        for loss in self.losses:
            note(f"{self.name}: {loss}")
        if span is not None and not some and (known := self.reader.times) is not None:
            held = "rows" if self.count is None else f"{self.count:,} rows and events"
            note(f"{self.name}: {_none_in_span(held, *known)}")


@dataclass(frozen=True, slots=True)
class LogInput:
    """Anything else: bytes that are framed here."""

    chunks: Iterable[Chunk]
    name: str
    drained: Callable[[], bool] = field(default=lambda: False)
    """Whether the next chunk has to be waited for, so that rows are not held back."""

    @property
    def times(self) -> tuple[int, int] | None:
        """Those of a log of text, which is read for them; raw bytes have none."""
        return self.chunks.times if isinstance(self.chunks, HexLog) else None

    @property
    def count(self) -> None:
        """Nothing tells how many rows a log has before it is read."""
        return

    @property
    def ports(self) -> Sequence[PortFacts]:
        """A log names none but itself."""
        from fte_sniff.recording.metadata import PortFacts

        return [PortFacts(self.name)]

    @property
    def facts(self) -> Mapping[str, str]:
        """A log says nothing."""
        return {}

    @property
    def losses(self) -> Sequence[str]:
        """None: a log is read whole, or not at all."""
        return ()

    def follows(self, before: Input | None) -> bool:
        """Nothing tells whether it does."""
        return False

    def gaps(self, span: TimeRange | None) -> Sequence[Gap]:
        """A log reports none."""
        return ()

    def selections(self) -> Sequence[Selection]:
        """A log does not tell of any."""
        return ()

    def batches(self, span: TimeRange | None, note: Note) -> Iterator[InputBatch]:
        """Its rows, some thousands at once; see `Input`."""
        portions = decided(self.chunks, self.name, note, self.drained)
        if isinstance(self.chunks, HexLog):
            portions = _compared(portions, self.chunks, note)
        batches = log_batches(portions)
        yield from batches if span is None else self._spanned(batches, span, note)

    def _spanned(
        self, batches: Iterable[LogBatch], span: TimeRange, note: Note
    ) -> Iterator[LogBatch]:
        """Only rows of the span; where there is none, which there are is told."""
        from fte_sniff.analysis.counters import Tally

        tally, some = Tally(), False
        for batch in batches:
            if not batch.timed:
                raise UsageError(f"{self.name} has no times; --from and --to need a recording")
            batch.count(tally)
            found = batch.within(span)
            some = some or bool(len(found))
            yield found
        if not some and tally.first_ns is not None and tally.last_ns is not None:
            held = f"{tally.rows:,} rows"
            note(f"{self.name}: {_none_in_span(held, tally.first_ns, tally.last_ns)}")


def _compared(portions: Iterable[DecidedSpan], log: HexLog, note: Note) -> Iterator[DecidedSpan]:
    """The same rows; what the log says of them, and they of the log, is told in the end."""
    for portion in portions:
        log.compare(portion.headers())
        yield portion
    for doubt in (*log.doubts, *log.about_times):
        note(f"{log.name}: {doubt}")


def _none_in_span(held: str, first_ns: int, last_ns: int) -> str:
    return (
        f"none of its {held} lies between --from and --to;"
        f" they go from {iso_time(first_ns)} to {iso_time(last_ns)}"
    )
