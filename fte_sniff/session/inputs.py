"""Inputs and the reading of them: recordings, logs, raw bytes and pipes as batches of rows.

An `Input` is one of them. `InputReading` reads several: the files of one capture after each other,
others merged by time. It counts all rows, finds the gaps, completes the rows with their facts, and
yields those that match a filter.
"""

from __future__ import annotations

import stat
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, tzinfo
from enum import StrEnum
from functools import partial
from operator import attrgetter
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

import numpy as np

from fte_sniff.analysis.model import GapDetector, StreamChange, Tally, rising_times, shifted
from fte_sniff.errors import (
    FileError,
    FteSniffError,
    InputTextError,
    TranslatableText,
    UsageError,
    unreadable,
)
from fte_sniff.formats.known_files import refuse_binary
from fte_sniff.formats.log_text import is_text
from fte_sniff.protocol import (
    DEFAULT_BAUD,
    FRAME_LENGTH,
    Chunk,
    Gap,
    GapKind,
    PortEvent,
    PortEventKind,
    Row,
    byte_time_ns,
    iso_time,
)
from fte_sniff.protocol.rows import NO_ROWS, Rows
from fte_sniff.session.framing import rows_of_chunks
from fte_sniff.session.save import ExportSource

if TYPE_CHECKING:
    from fte_sniff.analysis.facts import Facts
    from fte_sniff.analysis.filter.row_filter import RowFilter
    from fte_sniff.formats.log import Log
    from fte_sniff.protocol.rows import Ints
    from fte_sniff.recording.chunks import ChunkRef
    from fte_sniff.recording.metadata import Part, PortFacts, Selection
    from fte_sniff.recording.reader import Batch, Recording, TimeRange
    from fte_sniff.session.merge import Slice, Taken


# The format of an input

_MCAP_MAGIC = b"\x89MCAP0\r\n"
"""The first bytes of an MCAP file."""

_FIRST = 4096
"""Bytes that show the format of a file."""


class InputKind(StrEnum):
    """The format of an input."""

    MCAP = "mcap"
    RAW = "raw"
    HEX = "hex"


KIND_OF_SUFFIX: Mapping[str, InputKind] = MappingProxyType(
    {
        ".mcap": InputKind.MCAP,
        ".bin": InputKind.RAW,
        ".raw": InputKind.RAW,
        ".hex": InputKind.HEX,
        ".txt": InputKind.HEX,
        ".log": InputKind.HEX,
        ".csv": InputKind.HEX,
        ".jsonl": InputKind.HEX,
    }
)
"""By file name suffix, in lower case."""


def kind_of_file(path: Path) -> InputKind:
    """Return the format of a file by its suffix, or by its first bytes if it is MCAP or text.

    Raises FileError if it cannot be read, or is known to hold no bytes of the wire; UsageError if
    its format is unknown.
    """
    try:
        with path.open("rb") as file:
            first = file.read(_FIRST)
    except OSError as error:
        raise unreadable(path, error) from error
    refuse_binary(str(path), first)
    named = KIND_OF_SUFFIX.get(path.suffix.lower())
    if named is not None:
        return named
    found = kind_of_content(first)
    if first and found is not InputKind.RAW:
        return found
    names = ", ".join(KIND_OF_SUFFIX)
    raise UsageError(
        f"{path}: its name does not show its format ({names}); use --input {'|'.join(InputKind)}"
    )


def kind_of_content(first: bytes) -> InputKind:
    """Guess the format of a stream by its first bytes: text is hex, anything else raw bytes."""
    if first.startswith(_MCAP_MAGIC):
        return InputKind.MCAP
    return InputKind.HEX if is_text(first) else InputKind.RAW


# An input


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
        rows = self.rows[:count].replace(self.rows.events)
        return replace(self, rows=rows, reload=None, changes=changes, origin=origin)


STDIN_NAME = "stdin"
"""The port of rows that came through standard input."""

TROUBLES = (
    PortEventKind.OVERRUN,
    PortEventKind.LINE_ERROR,
    PortEventKind.LOST,
    PortEventKind.NOT_PASSED_ON,
    PortEventKind.SHARED,
)
"""Events of a recording that report bytes as missing or damaged."""


@dataclass(frozen=True, slots=True)
class InputEnds:
    """The ends of an input: its file of a capture, and its first and last bytes of each port."""

    part: Part | None = None
    """Which file of the capture it is; None if it is none."""
    first: tuple[str, int] | None = None
    """Port and offset of its first row; None without rows, and where offsets are not recorded."""
    stops: Mapping[str, int] = field(default_factory=dict)
    """By port, the offset after the last row that was read."""

    def follows(self, before: InputEnds) -> bool:
        """Whether it is the next file of a capture, or begins at the byte where the other ended.

        The other must have been read.
        """
        if self.part is not None and before.part is not None and before.part.next == self.part:
            return True
        return self.first is not None and before.stops.get(self.first[0]) == self.first[1]


Note = Callable[[str], None]
"""Receives one line for the user about an input, such as that it ends within a frame."""


class Input(ABC):
    """A source of rows; the defaults are those of an input without metadata."""

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

    @property
    def ends(self) -> InputEnds:
        """Its ends, as far as it was read; a log continues no other input."""
        return InputEnds()

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
            inside = within(rows, span)
            found += len(inside)
            yield inside
        if not found and tally.first_ns is not None and tally.last_ns is not None:
            held = f"{tally.rows:,} rows"
            note(f"{self.name}: {_none_in_span(held, tally.first_ns, tally.last_ns)}")


def within(rows: Rows, span: TimeRange) -> Rows:
    """The rows and events in a range of time."""
    if span.everything:
        return rows
    events = tuple(event for event in rows.events if span.contains(event.t_ns))
    return rows.select(span.mask(rows.t_ns), events)


class RecordingInput(Input):
    """A recording."""

    def __init__(self, reader: Recording) -> None:
        from fte_sniff.recording.metadata import part_of

        super().__init__(str(reader.path))
        self.reader = reader
        self.size, self.count = reader.size, reader.count
        self.part = part_of(reader.facts)
        self.facts = {
            k: v for k, v in reader.facts.items() if not k.startswith(("library", "port."))
        }
        self._first: Row | None = None
        self._stops: dict[str, int] = {}

    @property
    def times(self) -> tuple[int, int] | None:
        """First and last time of its rows; reads some chunks."""
        first, latest_ns = self._first_row(), None
        for chunk in reversed(self.reader.contents.chunks):
            found = [rows.span_ns for rows in self._rows_in([chunk]) if len(rows)]
            latest_ns = max((span[1] for span in found if span), default=None)
            if latest_ns is not None:
                break
        if first is None or first.t_ns is None or latest_ns is None:
            return None
        return first.t_ns, max(first.t_ns, latest_ns)

    def _first_row(self) -> Row | None:
        """The first row that can be read."""
        if self._first is None:
            rows = (batch.rows for batch in self.reader.batches() if len(batch.rows))
            self._first = next((own[0] for own in rows), None)
        return self._first

    def _rows_in(self, chunks: list[ChunkRef]) -> Iterator[Rows]:
        return (item for item in self.reader.read(chunks) if isinstance(item, Rows))

    @property
    def first_ns(self) -> int | None:
        """The first time of its chunks."""
        return None if self.reader.times is None else self.reader.times[0]

    @property
    def ports(self) -> Sequence[PortFacts]:
        """The ports in the metadata."""
        return self.reader.ports

    @property
    def losses(self) -> Sequence[str]:
        """What could not be read, one line each; complete after reading."""
        return self.reader.losses

    @property
    def ends(self) -> InputEnds:
        """Its ends; reads the first row, unless it was read."""
        first = self._first_row()
        place = None if first is None else (first.port, first.offset)
        return InputEnds(self.part, place, self._stops)

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
        from fte_sniff.recording.reader import EVERYTHING

        troubles: Counter[PortEventKind] = Counter()
        some = False
        try:
            for batch in self.reader.batches(span or EVERYTHING):
                found = self._batch_of(batch, span or EVERYTHING)
                if found is not None:
                    troubles.update(event.kind for event in found.rows.events)
                    some = some or bool(len(found.rows))
                    yield found
        except GeneratorExit:
            self._note_end(None, note, troubles, some=some)
            raise
        self._note_end(span, note, troubles, some=some)
        self.failure = self.reader.nothing_read

    def _batch_of(self, batch: Batch, span: TimeRange) -> InputBatch | None:
        """The rows as a batch; None if there are none, nor anything to report."""
        events = [item for _, item in batch.between if isinstance(item, PortEvent)]
        rows = batch.rows.replace(events)
        for port in rows.used_ports:
            last = np.flatnonzero(rows.port == rows.ports.index(port))[-1]
            self._stops[port] = int(rows.offset[last]) + int(rows.length[last])
        self.position = max(self.position, batch.chunks[-1].end)
        after_gap = len(events) < len(batch.between)
        if not (len(rows) or events or after_gap):
            return None
        return InputBatch(rows, after_gap, partial(self._read_again, batch.chunks, span))

    def _read_again(self, chunks: list[ChunkRef], span: TimeRange) -> Rows:
        return within(Rows.concat([*self._rows_in(chunks)]), span)

    def _note_end(
        self, span: TimeRange | None, note: Note, troubles: Counter[PortEventKind], *, some: bool
    ) -> None:
        """Note what is wrong with it; `some` if it had rows in the span."""
        for kind in TROUBLES:
            if troubles[kind]:
                times = "once" if troubles[kind] == 1 else f"{troubles[kind]:,} times"
                what = f"the port reported {kind} {times}"
                if kind is PortEventKind.SHARED:
                    what = "another program had the port open"
                note(f"{self.name}: {what} while it was recorded")
        for loss in self.losses:
            note(f"{self.name}: {loss}")
        if span is not None and not some and (known := self.reader.times) is not None:
            count = self.reader.count
            held = "rows" if count is None else f"{count:,} rows and events"
            note(f"{self.name}: {_none_in_span(held, *known)}")


class ChunkInput(Input):
    """Chunks of one port, which are framed here: raw bytes, or a topic of another program."""

    def __init__(
        self,
        chunks: Iterable[Chunk],
        name: str,
        first_ns: Callable[[], int | None] = lambda: None,
        size: int | None = None,
        baud: int = DEFAULT_BAUD,
        *,
        is_guess: bool = False,
    ) -> None:
        """Read nothing yet.

        Args:
            chunks: the bytes.
            name: of the input, and the port of its rows.
            first_ns: returns the time of the first byte, which it may read separately.
            size: bytes of a file that holds nothing else; None for others.
            baud: bits per second.
            is_guess: whether nobody says that they are raw bytes, so that they must have a frame.
        """
        super().__init__(name)
        self._chunks, self._first_ns, self.size = chunks, first_ns, size
        self._baud, self._is_guess = baud, is_guess

    @property
    def first_ns(self) -> int | None:
        """The time of the first byte."""
        try:
            return self._first_ns()
        except FteSniffError:
            return None  # raised again by `batches`

    @property
    def times(self) -> tuple[int, int | None] | None:
        """The time of the first byte; of a file also the last, if the last row is a frame."""
        first_ns = None if self.size == 0 else self._first_ns()
        if first_ns is None or self.size is None:
            return None if first_ns is None else (first_ns, None)
        return first_ns, first_ns + max(0, self.size - FRAME_LENGTH) * byte_time_ns(self._baud)

    @property
    def ports(self) -> Sequence[PortFacts]:
        """One port, named like the input."""
        from fte_sniff.recording.metadata import PortFacts

        return [PortFacts(self.name)]

    def batches(
        self, span: TimeRange | None, note: Note, open_inputs: int = 0
    ) -> Iterator[InputBatch]:
        """Read its rows; see `Input`."""
        rows = self._checked(rows_of_chunks(self._counted(self._chunks), note, self._baud))
        yield from map(InputBatch, rows if span is None else self._within(span, rows, note))

    def _checked(self, batches: Iterable[Rows]) -> Iterator[Rows]:
        has_frames = not self._is_guess
        for rows in batches:
            has_frames = has_frames or bool(rows.framed.any())
            yield rows
        if not has_frames:
            self.failure = FileError(
                f"{self.name}: has no text and no frame, so these are hardly the bytes of a wire;"
                " --input raw reads them as such"
            )

    def _counted(self, chunks: Iterable[Chunk]) -> Iterator[Chunk]:
        for chunk in chunks:
            self.position += len(chunk.data)
            yield chunk
        if not self.position:
            raise FileError(f"{self.name}: is empty; there is nothing to decode")


class LogInput(Input):
    """A text log, whose bytes are framed here."""

    def __init__(self, log: Log, again: Callable[[], Log] | None = None) -> None:
        """A log, and what opens it again; None if it can be read only once."""
        super().__init__(log.name)
        self._log, self._again = log, again
        self.size = None if again is None else size_of(Path(log.name))

    @property
    def first_ns(self) -> int | None:
        """The time of the first row that has one; reads the start of the log."""
        if self._again is None:
            return None
        try:
            times = (chunk.t_ns for chunk in self._again().chunks())
            return next((t_ns for t_ns in times if t_ns is not None), None)
        except FteSniffError:
            return None  # raised again by `batches`

    @property
    def times(self) -> tuple[int, int | None] | None:
        """The times of its rows, which are read for them."""
        if self._again is None:
            raise UsageError(
                f"{self.name} can be read only once, so its first and last time are not known"
                " before; write the times in full, as 2026-01-31T12:00:05Z, or read a file"
            )
        tally = Tally()
        with suppress(InputTextError):  # raised when the rows are read
            for rows in rows_of_chunks(self._again().chunks(), lambda _note: None):
                tally.observe(rows)
        return tally.times

    @property
    def ports(self) -> Sequence[PortFacts]:
        """The ports that its first lines show."""
        from fte_sniff.recording.metadata import PortFacts

        return [PortFacts(name) for name in self._log.ports]

    def batches(
        self, span: TimeRange | None, note: Note, open_inputs: int = 0
    ) -> Iterator[InputBatch]:
        """Read its rows; see `Input`."""
        rows = rows_of_chunks(self._log.chunks(), note, self._log.options.baud)
        try:
            for found in rows if span is None else self._within(span, rows, note):
                self.position = self._log.position
                yield InputBatch(found)
        finally:
            for text in (*self._log.notes(), *self._log.time_notes()):
                note(f"{self.name}: {text}")


def _none_in_span(held: str, first_ns: int, last_ns: int) -> str:
    return (
        f"none of its {held} is between --from and --to;"
        f" they go from {iso_time(first_ns)} to {iso_time(last_ns)}"
    )


# Facts: rows wait until they are decided, what is among them too
#
#     rows      r1 r2 | r3 r4 r5      r3 waits for its answer
#     events          e               waits with r3, so that the order remains

MOST_BYTES: Final = 2 << 20
"""Bytes of rows that are released at once: an output needs several times as much memory."""


class FactStage:
    """Completes the rows of one input with their facts."""

    def __init__(self, facts: Facts, origin: int = 0) -> None:
        """`origin` is the number of the input."""
        self._facts, self._origin = facts, origin
        self._read = self._decided = 0
        self._events = deque[tuple[int, PortEvent]]()
        """Each with the number of rows before it."""
        self._changes = deque[StreamChange]()
        """Their indices count from the first row of the input."""

    def feed(self, batch: InputBatch) -> Iterator[InputBatch]:
        """The next batch; returns the rows that are decided now, at least one batch."""
        if batch.rows.events:
            places = rising_times(batch.rows).searchsorted([one.t_ns for one in batch.rows.events])
            numbered = zip((places + self._read).tolist(), batch.rows.events, strict=True)
            self._events.extend(sorted(numbered, key=lambda one: one[0]))
        self._changes.extend(shifted(batch.changes, self._read))
        self._read += len(batch.rows)
        first, *others = self._released(self._facts.feed(batch.rows, batch.changes))
        yield replace(first, losses=batch.losses, gaps=batch.gaps)
        yield from others

    def end(self) -> Iterator[InputBatch]:
        """The rows that waited at the end of the input."""
        return self._released(self._facts.interrupt())

    def _released(self, rows: Rows) -> Iterator[InputBatch]:
        parts = -(-rows.size // MOST_BYTES) or 1
        length = -(-len(rows) // parts) or 1
        for start in range(0, len(rows) or 1, length):
            yield self._part(rows[start : start + length])

    def _part(self, rows: Rows) -> InputBatch:
        start = self._decided
        self._decided += len(rows)
        events, changes = list[PortEvent](), list[StreamChange]()
        while self._events and self._events[0][0] <= self._decided:
            events.append(self._events.popleft()[1])
        while self._changes and self._changes[0].index <= self._decided:
            changes.append(self._changes.popleft())
        found = rows.replace(events)
        return InputBatch(found, changes=shifted(changes, -start), origin=self._origin)


# The reading of several inputs

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
            zone: that of times in text.
        """
        # The first time of a single input is not needed.
        self.inputs = inputs = sorted(inputs, key=by_first_time) if inputs[1:] else list(inputs)
        for number, one in enumerate(inputs):
            one.number = number
        self.unreadable = list(unreadable)
        self.span, self.row_filter, self.limit, self._baud = span, row_filter, limit, baud
        self._has_facts = facts or (row_filter is not None and row_filter.needs_facts)
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
        self.selections = [selection for one in inputs for selection in one.selections()]
        """The filters that selected the rows of the inputs when they were written."""
        self._all_selections = [*self.selections]
        ports = [port.name for one in inputs for port in one.ports]
        self.source = ExportSource(
            ports,
            dict.fromkeys(ports, baud) if baud else _bauds_of(inputs),
            self._gaps,
            self._all_selections,
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

            self._all_selections.append(Selection(self.row_filter.text, self.tally.rows))

    def _limited(self, batch: InputBatch, limit: int) -> InputBatch:
        found = batch.first(limit - self.written)
        if found.rows.times is not None:
            self._last_ns = max(self._last_ns or 0, found.rows.times[1])
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
            self.tally, self.written, self.notes, self.reported_gaps, self.selections
        )

    def include(self, counts: ReadingCounts) -> None:
        """Add inputs that were read elsewhere."""
        self.tally.merge(counts.tally)
        self.written += counts.written
        self.notes += counts.notes
        self.reported_gaps += counts.gaps
        self.selections += counts.selections

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
            facts = self._fact_stage(one)
            for batch in one.batches(self.span, self.notes.append, open_inputs):
                changes += self._observe(batch, own.detector)
                self.progress.advance(one.position - read, len(batch.rows))
                read = one.position
                known = replace(batch, changes=changes, origin=one.number)
                changes = []
                for found in [known] if facts is None else facts.feed(known):
                    yield self._selected(found)
            for found in () if facts is None else facts.end():
                yield self._selected(found)
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
        elif before is None or not one.ends.follows(before.ends):
            changes.append(detector.interrupt(*ANOTHER))
            if before is not None:
                detector.lost.clear()
        return changes

    def _observe(self, batch: InputBatch, detector: GapDetector) -> list[StreamChange]:
        """Count the rows of a batch; the changes before and between them."""
        changes = [detector.interrupt(*DAMAGED)] if batch.after_gap else []
        if gap := detector.observe(batch.rows.times):
            self._gaps.append(gap)
        if batch.gaps:
            detector.expect(batch.gaps)
            self._report(batch.gaps)
        self.tally.observe(batch.rows)
        return changes + detector.changes(batch.rows)

    def _report(self, gaps: Sequence[Gap]) -> None:
        self.reported_gaps += gaps
        self._gaps += gaps

    def _fact_stage(self, one: Input) -> FactStage | None:
        if not self._has_facts:
            return None
        from fte_sniff.analysis.facts import Facts

        return FactStage(Facts(), one.number)

    def _selected(self, batch: InputBatch) -> InputBatch:
        """The batch with the rows that match."""
        return batch if self.row_filter is None else batch.select(self.row_filter)


def _ports_of(one: Input) -> list[str]:
    return list(dict.fromkeys(port.name for port in one.ports))


def _bauds_of(inputs: Sequence[Input]) -> dict[str, int]:
    return {port.name: port.baud for one in inputs for port in one.ports if port.baud}


def by_first_time(one: Input) -> tuple[bool, int]:
    """The sort key of inputs: their first times; those without come last, in their order."""
    first_ns = one.first_ns
    return first_ns is None, first_ns or 0


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
