"""Recordings, logs, raw bytes and standard input, read as batches of rows; the progress of that."""

from __future__ import annotations

import stat
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from fte_sniff.analysis.feed import StreamChange
from fte_sniff.analysis.tally import Tally
from fte_sniff.errors import FileError, FteSniffError, InputTextError, UsageError
from fte_sniff.protocol import (
    DEFAULT_BAUD,
    FRAME_LENGTH,
    Chunk,
    Gap,
    PortEvent,
    PortEventKind,
    byte_time_ns,
    iso_time,
)
from fte_sniff.protocol.rows import NO_ROWS, Rows
from fte_sniff.session.log_rows import rows_of_chunks, rows_of_log

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter
    from fte_sniff.formats.log_reader import LogReader
    from fte_sniff.formats.parquet import ParquetRows
    from fte_sniff.protocol.rows import Ints
    from fte_sniff.recording.metadata import Part, PortFacts, Selection
    from fte_sniff.recording.reader import RecordingReader
    from fte_sniff.recording.reading_pass import RowRange, TimeRange


@dataclass(slots=True)
class Progress:
    """How far the reading of files has come; another thread may read it at any time."""

    step: str = ""
    """What happens before rows are read; empty then. May hold text from outside."""
    files: int = 0
    """Number of files; 0 before they are known."""
    files_done: int = 0
    size: int = 0
    """Bytes of all files; 0 if unknown."""
    position: int = 0
    """Bytes of them that were read."""
    rows: int = 0

    def expect(self, sizes: Sequence[int | None]) -> None:
        """Set the files by their bytes; None if unknown."""
        self.files = len(sizes)
        self.size = 0 if None in sizes else sum(size or 0 for size in sizes)

    def advance(self, bytes_: int, rows: int = 0) -> None:
        """Add bytes and rows that were read."""
        self.position += bytes_
        self.rows += rows


def size_of(path: Path) -> int | None:
    """The bytes of a regular file; None if it is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_size if stat.S_ISREG(found.st_mode) else None


@dataclass(frozen=True, slots=True)
class InputBatch:
    """Consecutive rows of an input, and what is known about them."""

    rows: Rows = NO_ROWS
    after_gap: bool = False
    """Whether rows before these could not be read."""
    reload: Callable[[], Rows] | None = None
    """Reads the same rows again; None if that is impossible."""
    changes: Sequence[StreamChange] = ()
    """Gaps and baud changes between the rows, by ascending index."""
    losses: Sequence[str] = ()
    """What could not be read, one line each; may contain text from the input."""
    gaps: Sequence[Gap] = ()
    """Gaps that the input did not report before."""
    origin: int | Ints = 0
    """The number of the input, or for each row that of its input."""

    @property
    def events(self) -> Sequence[PortEvent]:
        """The port events between the rows."""
        return self.rows.events

    @property
    def times(self) -> tuple[int, int] | None:
        """Time of the first row and the latest time; None if a row has none, or without rows."""
        return self.rows.times

    def select(self, row_filter: RowFilter) -> InputBatch:
        """A batch of the rows that match the filter."""
        if not self.changes:
            return replace(self, rows=row_filter.select(self.rows), reload=None)
        matches = row_filter.matches(self.rows)
        rows = self.rows.select(matches, self.rows.events)
        changes = [
            replace(change, index=int(matches[: change.index].sum())) for change in self.changes
        ]
        return replace(self, rows=rows, changes=changes, reload=None)

    def first(self, count: int) -> InputBatch:
        """A batch of the first `count` rows; this one if it has no more."""
        if count >= len(self.rows):
            return self
        changes = [change for change in self.changes if change.index <= count]
        origin = self.origin if isinstance(self.origin, int) else self.origin[:count]
        rows = self.rows[:count].with_columns(events=self.events)
        return replace(self, rows=rows, reload=None, changes=changes, origin=origin)


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
        self.number = 0
        """Its place among the inputs that are read together; a successor has the same."""
        self.size: int | None = None
        """Bytes of its file; None if unknown."""
        self.position = 0
        """Bytes of its file that were read so far; 0 if unknown."""
        self.failure: FileError | None = None
        """Why reading ended early; the rows before it are valid."""
        self.successor: Input | None = None
        """The input that continues it; known when it has been read."""
        self.part: Part | None = None
        """Which file of a capture it is; None if it is none."""
        self.count: int | None = None
        """Number of rows and events; None if it is unknown before reading."""
        self.facts: Mapping[str, str] = {}
        """Facts except those of the ports, such as the host and the clock."""

    @property
    @abstractmethod
    def times(self) -> tuple[int, int | None] | None:
        """First and last time of its rows, nanoseconds since 1970 UTC; None without times.

        The last is None if it is not known before reading.
        """

    @property
    @abstractmethod
    def first_ns(self) -> int | None:
        """The time of its first row or event, nanoseconds since 1970 UTC; None without times.

        None too if it is not known before reading, because the input can be read only once.
        """

    @property
    @abstractmethod
    def ports(self) -> Sequence[PortFacts]:
        """The ports that are known before reading."""

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
    def batches(
        self, span: TimeRange | None, note: Note, open_inputs: int = 0
    ) -> Iterator[InputBatch]:
        """Read its rows.

        Args:
            span: only rows in it; None for all.
            note: called after the last row with what is wrong with the input; with what is known
                of it if the iterator is closed before.
            open_inputs: the number of other inputs that are read at the same time.

        Raises:
            FileError: it cannot be read, or has another format.
            InputTextError: text in it is not hex.
            UsageError: a span is given, and rows have no times.
        """

    def _within(self, span: TimeRange, batches: Iterable[Rows], note: Note) -> Iterator[Rows]:
        """Only rows of the span; if there are none, note the times of the input."""
        tally, found = Tally(), 0
        for rows in batches:
            if len(rows) and rows.times is None:
                raise UsageError(f"{self.name} has no times; set with --start when its bytes began")
            tally.observe(rows)
            inside = span.select(rows)
            found += len(inside)
            yield inside
        if not found and tally.first_ns is not None and tally.last_ns is not None:
            held = f"{tally.rows:,} rows"
            note(f"{self.name}: {_none_in_span(held, tally.first_ns, tally.last_ns)}")


class RecordingInput(Input):
    """A recording."""

    def __init__(self, reader: RecordingReader) -> None:
        from fte_sniff.recording.metadata import PROGRAM, part_of

        super().__init__(str(reader.path))
        self.reader = reader
        self.size, self.count = reader.size, reader.count
        facts = reader.metadata.get(PROGRAM, {})
        self.part = part_of(facts)
        self.facts = {k: v for k, v in facts.items() if not k.startswith(("library", "port."))}
        self.ends: dict[str, int] = {}
        """By port, the offset after the last row that was read."""

    @property
    def times(self) -> tuple[int, int] | None:
        """First and last time of its rows; reads some chunks."""
        from fte_sniff.recording.reader import row_times

        return row_times(self.reader)

    @property
    def first_ns(self) -> int | None:
        """The first time in the summary; without one, that of the first row that can be read."""
        if self.reader.times is not None:
            return self.reader.times[0]
        try:
            first = next(iter(self.reader), None)
        except FileError:
            return None  # raised again by `batches`
        return None if first is None else first.t_ns

    @property
    def ports(self) -> Sequence[PortFacts]:
        """The ports in the metadata."""
        return self.reader.ports

    @property
    def losses(self) -> Sequence[str]:
        """What could not be read, one line each; complete after reading."""
        return [loss for loss in (*self.reader.losses, self.reader.ending) if loss]

    def follows(self, before: Input | None) -> bool:
        """Whether it is the next file of a capture, or begins at the byte where the other ended.

        The other must have been read.
        """
        if not isinstance(before, RecordingInput):
            return False
        if self.part is not None and before.part is not None and before.part.next == self.part:
            return True
        first = self.first_place() if before.ends else None
        return first is not None and before.ends.get(first[0]) == first[1]

    def first_place(self) -> tuple[str, int] | None:
        """Port and offset of its first row; None without rows."""
        first = next(iter(self.reader), None)
        return None if first is None else (first.port, first.offset)

    def gaps(self, span: TimeRange | None) -> Sequence[Gap]:
        """The gaps that a trigger or a write error left in it."""
        gaps = self.reader.gaps()
        return [one for one in gaps if span is None or one.within(span.first_ns, span.end_ns - 1)]

    def selections(self) -> Sequence[Selection]:
        """The filters of the commands that wrote it."""
        return self.reader.selections()

    def batches(
        self, span: TimeRange | None, note: Note, open_inputs: int = 0
    ) -> Iterator[InputBatch]:
        """Read its rows; see `Input`."""
        from fte_sniff.recording.reading_pass import EVERYTHING

        troubles: Counter[PortEventKind] = Counter()
        some = False
        ranges = self.reader.ranges(span=span or EVERYTHING, share=open_inputs + 1)
        try:
            for passage, rows in ranges:
                if (found := self._batch_of(passage, rows)) is not None:
                    troubles.update(event.kind for event in rows.events)
                    some = some or bool(len(rows))
                    yield found
        except GeneratorExit:
            ranges.close()  # with it the reader knows the damage up to here
            self._note_end(None, note, troubles, some=some)
            if not self.reader.has_summary and not self.reader.ending:
                note(f"{self.name}: it has no summary, so its end is cut off, or not written yet")
            raise
        self._note_end(span, note, troubles, some=some)
        self.failure = self.reader.nothing_read

    def _batch_of(self, passage: RowRange, rows: Rows) -> InputBatch | None:
        """The rows as a batch; None if there are none, nor anything to report."""
        self.ends.update(rows.end_offsets())
        self.position = max(self.position, passage.stop)
        if not (len(rows) or rows.events or passage.after_loss):
            return None
        return InputBatch(rows, passage.after_loss, partial(self.reader.read, passage))

    def _note_end(
        self, span: TimeRange | None, note: Note, troubles: Counter[PortEventKind], *, some: bool
    ) -> None:
        """Note what is wrong with it; `some` if it had rows in the span."""
        for kind in TROUBLES:
            if troubles[kind]:
                times = "once" if troubles[kind] == 1 else f"{troubles[kind]:,} times"
                note(f"{self.name}: the port reported {kind} {times} while it was recorded")
        for loss in self.losses:
            note(f"{self.name}: {loss}")
        if span is not None and not some and (known := self.reader.times) is not None:
            count = self.reader.count
            held = "rows" if count is None else f"{count:,} rows and events"
            note(f"{self.name}: {_none_in_span(held, *known)}")


class LogInput(Input):
    """A log, raw bytes or a pipe, framed here."""

    def __init__(
        self,
        source: Iterable[Chunk] | LogReader,
        name: str,
        drained: Callable[[], bool] = lambda: False,
        first_ns: Callable[[], int | None] = lambda: None,
        baud: int | None = None,
    ) -> None:
        """Read nothing yet of a log, or of the chunks of one port.

        Of chunks, `drained` is whether the next one has to be waited for, `first_ns` the time of
        the first one, which it may read separately, `baud` bits per second; None for the default.
        """
        super().__init__(name)
        from fte_sniff.formats.log_reader import LogReader

        self._drained, self._first_ns, self._baud = drained, first_ns, baud or DEFAULT_BAUD
        self._log = source if isinstance(source, LogReader) else None
        self._chunks = () if isinstance(source, LogReader) else source
        self.size = size_of(Path(name))

    @property
    def first_ns(self) -> int | None:
        """The time of the first row that has one; reads the start of a text log."""
        try:
            if self._log is not None:
                rows = next(rows_of_log(self._log.again()), NO_ROWS)
                return next((row.t_ns for row in rows if row.t_ns is not None), None)
            return self._first_ns()
        except FteSniffError:
            return None  # raised again by `batches`

    @property
    def times(self) -> tuple[int, int | None] | None:
        """Those of a text log, which is read for them; of a raw file, those that its start gives.

        Of a raw file the last row is taken for a frame. The last time of a pipe is not known.
        """
        if self._log is None:
            first_ns = None if self.size == 0 else self._first_ns()
            if first_ns is None or self.size is None:
                return None if first_ns is None else (first_ns, None)
            frames_ns = max(0, self.size - FRAME_LENGTH) * byte_time_ns(self._baud)
            return first_ns, first_ns + frames_ns
        tally = Tally()
        with suppress(InputTextError):  # raised when the rows are read
            for rows in rows_of_log(self._log.again()):
                tally.observe(rows)
        return tally.times

    @property
    def ports(self) -> Sequence[PortFacts]:
        """One port, named like the input; those of a text log as its first lines show them."""
        from fte_sniff.recording.metadata import PortFacts

        names = [self.name] if self._log is None else self._log.form.ports(self._log.name)
        return [PortFacts(name) for name in names]

    def explain(self) -> Iterable[str]:
        """Where a text log has its bytes, times and directions, one line each.

        Raises InputTextError after the candidates of a log that is refused.
        """
        return ["raw bytes"] if self._log is None else self._log.explain()

    def batches(
        self, span: TimeRange | None, note: Note, open_inputs: int = 0
    ) -> Iterator[InputBatch]:
        """Read its rows; see `Input`. They are yielded at once if the next chunk is waited for."""
        if self._log is not None:
            rows = rows_of_log(self._log, note)
        else:
            chunks = self._counted(self._chunks)
            rows = rows_of_chunks(chunks, self.name, note, self._drained, self._baud)
        for found in rows if span is None else self._within(span, rows, note):
            if self._log is not None:
                self.position = self._log.position
            yield InputBatch(found)

    def _counted(self, chunks: Iterable[Chunk]) -> Iterator[Chunk]:
        for chunk in chunks:
            self.position += len(chunk.data)
            yield chunk


class ParquetInput(Input):
    """A Parquet file that `decode` wrote."""

    def __init__(self, rows: ParquetRows, name: str) -> None:
        super().__init__(name)
        self._rows = rows
        self.size, self.count = size_of(Path(name)), rows.count

    @property
    def times(self) -> tuple[int, int] | None:
        """First and last time of its rows; reads the column of times."""
        return self._rows.times()

    @property
    def first_ns(self) -> int | None:
        """The time of its first row."""
        times = self._rows.times()
        return None if times is None else times[0]

    @property
    def ports(self) -> Sequence[PortFacts]:
        """The ports of its rows."""
        from fte_sniff.recording.metadata import PortFacts

        return [PortFacts(name) for name in self._rows.ports()]

    def batches(
        self, span: TimeRange | None, note: Note, open_inputs: int = 0
    ) -> Iterator[InputBatch]:
        """Read its rows; see `Input`."""
        rows, read = self._rows.batches(), 0
        for found in rows if span is None else self._within(span, rows, note):
            read += len(found)
            self.position = (self.size or 0) * read // max(1, self._rows.count)
            yield InputBatch(found)


def _none_in_span(held: str, first_ns: int, last_ns: int) -> str:
    return (
        f"none of its {held} is between --from and --to;"
        f" they go from {iso_time(first_ns)} to {iso_time(last_ns)}"
    )
