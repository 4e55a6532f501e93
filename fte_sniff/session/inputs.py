"""Inputs, and the reading of them: recordings, logs and raw bytes as one stream of items.

    a.mcap a_00002.mcap   one capture      ──items──┐
    rx.mcap + tx.mcap     a pair of wires  ──items──┼─facts─filter─→ merged by time
    x.log                 alone            ──items──┘

An `Input` is a name, what is known before reading, and a function that reads it. `InputReading`
reads several: it counts all rows, marks the gaps, adds the facts that depend on other rows once for
each group of inputs that belong together, and yields the rows that pass a filter.
"""

from __future__ import annotations

import sys
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from datetime import UTC, tzinfo
from enum import StrEnum
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeAlias

from fte_sniff.analysis.tally import Tally
from fte_sniff.errors import (
    FileError,
    FteSniffError,
    InputTextError,
    TranslatableText,
    encodable,
)
from fte_sniff.formats.known_files import refuse_known
from fte_sniff.formats.log_text import is_text
from fte_sniff.formats.writers import ALL_COLUMNS
from fte_sniff.protocol.columns import iso_time
from fte_sniff.protocol.items import BaudChange, Chunk, Gap, GapKind, PortEvent, PortEventKind
from fte_sniff.protocol.rows import Item, Rows
from fte_sniff.protocol.spec import DEFAULT_BAUD, Direction, byte_time_ns
from fte_sniff.recording.chunks import MAGIC
from fte_sniff.recording.metadata import Part, PortFacts, Selection, part_of
from fte_sniff.recording.reader import EVERYTHING, Recording, TimeRange
from fte_sniff.session.framing import rows_of_chunks
from fte_sniff.session.merge import Timed, merged
from fte_sniff.session.save import ExportSource

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter
    from fte_sniff.analysis.table import Table


# The format of an input


class InputKind(StrEnum):
    """The format of an input."""

    MCAP = "mcap"
    RAW = "raw"
    HEX = "hex"


SUFFIXES: Final = {
    InputKind.MCAP: {".mcap"},
    InputKind.RAW: {".bin", ".raw"},
    InputKind.HEX: {".hex", ".txt", ".log", ".csv", ".jsonl"},
}
"""Of file names, in lower case."""


def input_kind(name: str, first: bytes) -> InputKind:
    """The format of a file or stream by the suffix of its name, else by its first bytes.

    Text is hex, and what is neither MCAP nor text is raw bytes. Raises FileError if it is known to
    hold no bytes of the wire.
    """
    refuse_known(name, first)
    for kind, suffixes in SUFFIXES.items():
        if Path(name).suffix.lower() in suffixes:
            return kind
    if first.startswith(MAGIC):
        return InputKind.MCAP
    return InputKind.HEX if is_text(first) else InputKind.RAW


# An input


STDIN_NAME = "stdin"
"""The port of rows that came through standard input."""

Note: TypeAlias = Callable[[str], None]
"""Receives one line for the user about an input, such as that a part of it is damaged."""

Times: TypeAlias = tuple[int, int] | None
"""First and last time, nanoseconds since 1970 UTC; None without times."""


@dataclass(slots=True, weakref_slot=True)
class Input:
    """What is known about a source of rows, and how to read it."""

    name: str
    """For display; may hold text from outside, so escape it."""
    read: Callable[[TimeRange | None, Note], Iterator[Item]]
    """Reads the items in a span, or all. The note is called after the last row with what is wrong
    with the input. Raises FileError, and InputTextError for text that is not hex."""
    times: Callable[[], Times] = lambda: None
    """Finds the times of a recording, or of the rows of other inputs."""
    first_ns: Callable[[], int | None] = lambda: None
    """Finds the first of them, which may take less than `times`."""
    ports: Sequence[PortFacts] = ()
    """The ports that are known before reading."""
    count: int | None = None
    """Number of rows, about; None if it is unknown before reading."""
    recording: Recording | None = None
    """The file, if it is a recording."""


def recording_input(reader: Recording) -> Input:
    """A recording."""

    def read(span: TimeRange | None, note: Note) -> Iterator[Item]:
        yield from beginning_of(reader)
        try:
            yield from reader.items(span or EVERYTHING)
        finally:
            note_losses(reader, note)
        if reader.nothing_read is not None:
            raise reader.nothing_read

    return Input(
        encodable(str(reader.path)),
        read,
        lambda: reader.times,
        lambda: reader.times and reader.times[0],
        reader.ports,
        reader.count,
        reader,
    )


def beginning_of(reader: Recording) -> list[Gap]:
    """The gaps before the first row of a recording: a filter may have hidden any row."""
    return [Gap(GapKind.SELECTED, reason=one.filter_text) for one in reader.selections()]


def note_losses(reader: Recording, note: Note) -> None:
    """Note what is lost of a recording that was read."""
    for loss in reader.losses:
        note(f"{encodable(str(reader.path))}: {loss}")


def chunk_input(
    name: str,
    chunks: Iterable[Chunk],
    again: Callable[[], Iterable[Chunk]] = tuple,
    baud: int = DEFAULT_BAUD,
    *,
    ports: Sequence[str] = (),
    count: int | None = None,
    is_guess: bool = False,
    notes: Callable[[], Iterable[str]] = tuple,
) -> Input:
    """Chunks, which are framed here: a log, raw bytes, or topics of another program.

    Args:
        name: of the input, and the port of its rows if there are no `ports`.
        chunks: the bytes.
        again: opens them again to find the times; no chunks if they can be read only once.
        baud: bits per second.
        ports: the ports of the chunks.
        count: number of rows, about.
        is_guess: whether nothing says that these are bytes of a wire: then a frame has to be there.
        notes: returns what else is remarkable, once all chunks are read.
    """

    @cache
    def first_ns() -> int | None:
        with suppress(FteSniffError):  # raised when the rows are read
            for chunk in again():
                return chunk.t_ns and chunk.t_ns - len(chunk.data) * byte_time_ns(baud)
        return None

    def times() -> Times:
        tally = Tally()
        with suppress(InputTextError):  # raised when the rows are read
            for rows in rows_of_chunks(again(), lambda _note: None, baud):
                tally.observe(rows)
        return tally.times

    def read(span: TimeRange | None, note: Note) -> Iterator[Rows]:
        frames = 0
        try:
            for rows in rows_of_chunks(chunks, note, baud):
                frames += int(rows.framed.sum())
                yield rows if span is None else rows.select(span.mask(rows.t_ns))
        finally:
            for text in notes():
                note(f"{name}: {text}")
        if is_guess and not frames:
            raise FileError(
                f"{name}: has no text and no frame, so these are probably not the bytes of a wire;"
                " --input raw reads them as such"
            )

    return Input(name, read, times, first_ns, [PortFacts(port) for port in ports or [name]], count)


# What port events mean for the rows around them

_GAP_EVENTS: Final = (PortEventKind.LOST, PortEventKind.FOUND_AGAIN, PortEventKind.OVERRUN)
"""Events at which bytes of a port are missing."""


def with_effects(items: Iterable[Item], lost: set[str]) -> Iterator[Item]:
    """The items, and behind port events the gaps and changes of the baud that they mean.

    `lost` receives the ports that are lost and were not found again.
    """
    for item in items:
        yield item
        if not isinstance(item, PortEvent):
            continue
        if item.kind is PortEventKind.LOST:
            lost.add(item.port)
        elif item.kind is PortEventKind.FOUND_AGAIN:
            lost.discard(item.port)
        if item.kind in _GAP_EVENTS:
            t_ns, is_lost = item.t_ns, bool(lost)
            yield Gap(GapKind.PORT, None, t_ns, t_ns, item.detail, item.port, is_lost)
        elif item.kind is PortEventKind.BAUD_CHANGED and item.count:
            yield BaudChange(item.port, item.count)


def with_facts(items: Iterable[Item]) -> Iterator[Item]:
    """The items of one input, or of inputs that belong together, with the facts of their rows.

    Rows wait for those that decide their facts, and everything among them waits too.
    """
    from fte_sniff.analysis.segments import Segments

    cutter, others, pushed, done = Segments(), deque[tuple[int, Item]](), 0, 0

    def tables() -> Iterator[Table]:
        nonlocal pushed
        for item in items:
            if isinstance(item, Rows):
                pushed += len(item)
            else:
                others.append((pushed, item))
            yield from cutter.push(item)
        yield cutter.rest()

    for table in tables():
        rows = table.with_facts[table.start : table.stop]
        while others and others[0][0] <= done + len(rows):
            place, other = others.popleft()
            yield from (rows[: place - done], other)
            rows, done = rows[place - done :], place
        yield rows
        done += len(rows)
    yield from (other for _, other in others)


# Inputs that belong together


def groups_of(inputs: Sequence[Input], *, pair: bool = False) -> list[Sequence[Input]]:
    """Inputs of one line: the files of a capture, one after the other; with `pair`, all.

    The groups are in the order of their first inputs.
    """
    if pair:
        return [inputs]
    chains = list[list[Input]]()
    by_next: dict[Part, list[Input]] = {}
    parts = [None if one.recording is None else part_of(one.recording.facts) for one in inputs]
    for part, one in sorted(zip(parts, inputs, strict=True), key=lambda own: own[0] or ("", "", 0)):
        if part is None or (chain := by_next.pop(part, None)) is None:
            chains.append(chain := [])
        chain.append(one)
        if part is not None:
            by_next[part._replace(number=part.number + 1)] = chain
    return sorted(chains, key=lambda chain: inputs.index(chain[0]))


_SURE: Final = 20
"""Frames after which a wire is known to carry one direction."""


def are_both_wires(inputs: Sequence[Input]) -> bool:
    """Whether two recordings are, without doubt, the wires of one line.

    They overlap in time, each has one port, another one, and frames of one direction, the other.
    """
    if len(inputs) != 2 or any(one.recording is None or len(one.ports) != 1 for one in inputs):
        return False
    first, second = inputs
    spans = [span for one in inputs if (span := one.times()) is not None]
    if first.ports[0].name == second.ports[0].name or len(spans) < len(inputs):
        return False
    if max(start for start, _ in spans) > min(stop for _, stop in spans):
        return False
    return {_direction_of(one) for one in inputs} == {*Direction}


def _direction_of(one: Input) -> Direction | None:
    """The direction that the first frames of an input all have; None if there are too few."""
    found = Counter[int]()
    with suppress(FteSniffError):
        for item in one.read(None, lambda _note: None):
            if isinstance(item, Rows):
                found.update(item.directions[item.framed & (item.faults == 0)].tolist())
            if found.total() >= _SURE:
                break
    return tuple(Direction)[min(found)] if len(found) == 1 and found.total() >= _SURE else None


# The reading of several inputs


ReadingCounts: TypeAlias = tuple[Tally, list[str], list[Gap], list[FileError]]
"""The rows, notes, reported gaps and unreadable inputs of a reading."""


@dataclass(slots=True, eq=False)
class InputReading:
    """Reads the rows of inputs once; counts them and collects what is known about them."""

    inputs: Sequence[Input]
    """In the order of their first times; those without come last, in their order."""
    span: TimeRange | None = None
    """Only rows in it; None for all."""
    row_filter: RowFilter | None = None
    """Only rows that it matches; None for all."""
    limit: int = sys.maxsize
    """Largest number of those rows."""
    baud: int | None = None
    """The baud of every port; None for that of the inputs."""
    has_facts: bool = False
    """Whether rows wait for the facts that depend on later rows; they always do if the filter names
    one."""
    is_pair: bool = False
    """Whether all inputs are wires of one line; two recordings that leave no doubt are."""
    zone: tzinfo = UTC
    """That of times in text."""
    unreadable: list[FileError] = field(default_factory=list)
    """Errors of inputs that could not be opened or read."""
    total: int | None = field(init=False)
    """Rows of all inputs, about; None if unknown."""
    groups: list[Sequence[Input]] = field(init=False)
    """The inputs that belong together."""
    tally: Tally = field(default_factory=Tally)
    """All rows so far, and `written`: those that match, up to the limit."""
    written: int = 0
    notes: list[str] = field(default_factory=list)
    """What is wrong with the inputs, one line each."""
    reported_gaps: list[Gap] = field(default_factory=list)
    """The gaps in the span that recordings report."""
    on_input: Callable[[str], None] = lambda _name: None
    """Is called with the name of each input, or of both of a pair, before its first item."""

    def __post_init__(self) -> None:
        self.inputs = sorted(self.inputs, key=lambda one: _order(one.first_ns()))
        self.is_pair = self.is_pair or are_both_wires(self.inputs)
        self.groups = groups_of(self.inputs, pair=self.is_pair)
        self.notes += map(str, self.unreadable)
        counts = [one.count for one in self.inputs if one.count is not None]
        is_known = len(counts) == len(self.inputs) and self.span is None
        self.total = sum(counts) if is_known else None

    @property
    def selections(self) -> list[Selection]:
        """The filters that selected the rows of the inputs when they were written."""
        return [selection for one in self._recordings for selection in one.selections()]

    @property
    def _recordings(self) -> list[Recording]:
        return [one.recording for one in self.inputs if one.recording is not None]

    def source(self, columns: Sequence[str] | None = None) -> ExportSource:
        """What is known about the rows before they are read."""
        ports = [port.name for one in self.inputs for port in one.ports]
        bauds = dict.fromkeys(ports, self.baud) if self.baud else _bauds_of(self.inputs)
        known = {name: fact for one in self._recordings for name, fact in one.facts.items()}
        return ExportSource(ports, bauds, self.selections, known, columns or ALL_COLUMNS, self.zone)

    @property
    def counts(self) -> ReadingCounts:
        """What is known so far about its inputs."""
        return self.tally, self.notes, self.reported_gaps, self.unreadable

    def include(self, counts: ReadingCounts) -> None:
        """Add inputs that were read elsewhere."""
        tally, notes, gaps, unreadable = counts
        self.tally.merge(tally)
        self.notes += notes
        self.reported_gaps += gaps
        self.unreadable += unreadable

    def streams(self) -> Iterator[Iterator[Item]]:
        """The items of each group of inputs, to be read one after the other."""
        yield from map(self._selected, self.groups)

    def __iter__(self) -> Iterator[Item]:
        """The rows that match, up to the limit, merged by time, and what is between them.

        The rows of inputs without times come last.
        """
        streams = (Timed(own[0].first_ns(), partial(self._selected, own)) for own in self.groups)
        with closing(merged(streams)) as items:  # the inputs note what is known of them
            for item in items:
                if isinstance(item, Rows):
                    rows = item[: self.limit - self.written]
                    self.written += len(rows)
                    yield rows
                    if self.written == self.limit:
                        return
                else:
                    yield item

    def _selected(self, group: Sequence[Input], is_beside: bool = False) -> Iterator[Item]:
        """The items of a group with the facts of its rows, of which only those that match."""
        items, wanted = with_effects(self._items_of(group, is_beside), set()), self.row_filter
        needs_facts = self.has_facts or (wanted is not None and wanted.needs_facts)
        for item in self._counted(with_facts(items) if needs_facts else items):
            if isinstance(item, Rows) and wanted is not None:
                yield item.select(wanted.matches(item))
            elif not (isinstance(item, BaudChange) and self.baud):
                yield item

    def _items_of(self, group: Sequence[Input], is_beside: bool) -> Iterator[Item]:
        """The items of a group, without its filter.

        They begin with a gap, which beside other inputs is one of their own ports only.
        """
        ports = [port.name for one in group for port in one.ports] if is_beside else [None]
        for name in dict.fromkeys(ports):
            yield Gap(GapKind.OTHER_RECORDING, reason=_ANOTHER, port=name, port_lost=False)
        if self.is_pair:
            self.on_input(" + ".join(one.name for one in group))
            yield from merged(Timed(one.first_ns(), partial(self._read, one)) for one in group)
            return
        for one in group:
            self.on_input(one.name)
            yield from self._read(one)

    def _read(self, one: Input, _is_beside: bool = False) -> Iterator[Item]:
        """The items of one input; an error of one of several is noted."""
        count, troubles = 0, Counter[PortEventKind]()
        yield from (BaudChange(port, baud) for port, baud in _bauds_of([one]).items())
        try:
            for item in one.read(self.span, self.notes.append):
                if isinstance(item, Rows):
                    count += len(item)
                elif isinstance(item, PortEvent) and item.kind in _GAP_EVENTS:
                    troubles[item.kind] += 1
                yield item
        except FileError as error:
            if len(self.inputs) == 1 and not count:
                raise
            self.unreadable.append(error)
            self.notes.append(str(error))
        finally:
            if troubles:
                listed = ", ".join(f"{kind} {times:,}" for kind, times in troubles.items())
                self.notes.append(f"{one.name}: the port reported {listed} while it was recorded")
            if self.span is not None and not count:
                self._note_times(one)

    def _note_times(self, one: Input) -> None:
        """Note that an input has no rows in the span."""
        with suppress(FteSniffError):
            text = f"{one.name}: none of its rows is between --from and --to"
            if (times := one.times()) is not None:
                text += f"; it goes from {iso_time(times[0])} to {iso_time(times[1])}"
            self.notes.append(text)

    def _counted(self, items: Iterable[Item]) -> Iterator[Item]:
        """Count the rows of items; of gaps, only the part in the span, and each only once."""
        for item in items:
            if isinstance(item, Rows):
                self.tally.observe(item)
            elif isinstance(item, Gap) and item.kind in (GapKind.WRITE_ERROR, GapKind.LEFT_OUT):
                span = self.span or EVERYTHING
                gap = item.within(span.first_ns, span.end_ns - 1)
                # A later file of a capture reports it again.
                if gap is not None and gap not in self.reported_gaps:
                    self.reported_gaps.append(gap)
                    yield gap
                continue
            yield item


_ANOTHER: Final = TranslatableText("another recording begins here")


def _order(first_ns: int | None) -> tuple[bool, int]:
    return first_ns is None, first_ns or 0


def _bauds_of(inputs: Sequence[Input]) -> dict[str, int]:
    return {port.name: port.baud for one in inputs for port in one.ports if port.baud}
