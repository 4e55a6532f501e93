"""Inputs, and the reading of them: recordings, logs, raw bytes and pipes as one stream of items.

    a.mcap a_00002.mcap   one capture      ──items──┐
    rx.mcap + tx.mcap     a pair of wires  ──items──┼─facts─filter─→ merged by time
    x.log                 alone            ──items──┘

An `Input` is a name, what is known before reading, and a function that reads it. `InputReading`
reads several: it counts all rows, marks the gaps, adds the facts that depend on other rows once for
each group of inputs that belong together, and yields the rows that pass a filter.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, tzinfo
from enum import StrEnum
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, TypeAlias

from fte_sniff.analysis.tally import Tally
from fte_sniff.errors import (
    FileError,
    FteSniffError,
    InputTextError,
    TranslatableText,
    UsageError,
)
from fte_sniff.formats.known_files import refuse_known
from fte_sniff.formats.log_text import is_text
from fte_sniff.protocol.columns import iso_time
from fte_sniff.protocol.items import BaudChange, Chunk, Gap, GapKind, PortEvent, PortEventKind
from fte_sniff.protocol.rows import Item, Rows
from fte_sniff.protocol.spec import DEFAULT_BAUD, Direction, byte_time_ns
from fte_sniff.recording.chunks import ChunkRef
from fte_sniff.recording.metadata import Part, PortFacts, Selection, part_of
from fte_sniff.recording.reader import EVERYTHING, Recording, TimeRange
from fte_sniff.session.framing import rows_of_chunks
from fte_sniff.session.merge import Timed, merged
from fte_sniff.session.save import ExportSource

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter
    from fte_sniff.analysis.table import Table


# The format of an input

_MCAP_MAGIC = b"\x89MCAP0\r\n"


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


def kind_of(name: str, first: bytes) -> InputKind:
    """The format of a file or stream by the suffix of its name, else by its first bytes.

    Text is hex, and what is neither MCAP nor text is raw bytes. Raises FileError if it is known to
    hold no bytes of the wire.
    """
    refuse_known(name, first)
    named = KIND_OF_SUFFIX.get(Path(name).suffix.lower())
    if named is not None:
        return named
    if first.startswith(_MCAP_MAGIC):
        return InputKind.MCAP
    return InputKind.HEX if is_text(first) else InputKind.RAW


# An input


@dataclass(slots=True)
class Progress:
    """How far the reading of files has come; another thread may read it at any time."""

    step: str = ""
    """What happens before rows are read; empty then. May hold text from outside."""
    total: int | None = None
    """Rows of all files, about; None if unknown."""
    rows: int = 0


STDIN_NAME = "stdin"
"""The port of rows that came through standard input."""

TROUBLES: Final = MappingProxyType(
    {
        PortEventKind.OVERRUN: "the port reported overrun {times}",
        PortEventKind.LINE_ERROR: "the port reported line_error {times}",
        PortEventKind.LOST: "the port reported lost {times}",
        PortEventKind.NOT_PASSED_ON: "the port reported not_passed_on {times}",
        PortEventKind.SHARED: "another program had the port open",
    }
)
"""What the events mean that report bytes of a recording as missing or damaged."""

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
    with the input. Raises FileError; InputTextError for text that is not hex; UsageError for a span
    of rows without times."""
    times: Callable[[], Times] = lambda: None
    """Finds the times of its rows; raises UsageError if they can be read only once."""
    first_ns: Callable[[], int | None] = lambda: None
    """Finds the first of them, which may take less than `times`."""
    ports: Sequence[PortFacts] = ()
    """The ports that are known before reading."""
    count: int | None = None
    """Number of rows, about; None if it is unknown before reading."""
    part: Part | None = None
    """Which file of a capture it is; None if it has no number."""
    facts: Mapping[str, str] = field(default_factory=dict)
    """Facts except those of the ports, such as the host and the clock."""
    selections: Sequence[Selection] = ()
    """The filters that selected its rows, if it records them."""
    path: Path | None = None
    """Of a recording."""


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

    facts = reader.facts
    return Input(
        str(reader.path),
        read,
        partial(row_times, reader),
        lambda: None if reader.times is None else reader.times[0],
        reader.ports,
        reader.count,
        part_of(facts),
        {k: v for k, v in facts.items() if not k.startswith(("library", "port."))},
        reader.selections(),
        reader.path,
    )


def row_times(reader: Recording) -> Times:
    """The first and the latest time of the rows of a recording; reads its first and last chunks."""
    chunks = reader.contents.chunks
    first, last = (
        next((own for chunk in some if (own := _times_in(reader, chunk)) is not None), None)
        for some in (chunks, chunks[::-1])
    )
    return None if first is None or last is None else (first[0], max(first[0], last[1]))


def _times_in(reader: Recording, chunk: ChunkRef) -> tuple[int, int] | None:
    """The first row's time and the latest one in a chunk."""
    rows = Rows.concat([item for item in reader.read([chunk]) if isinstance(item, Rows)])
    t_ns = rows.t_ns[rows.timed]
    return (int(t_ns[0]), int(t_ns.max())) if len(t_ns) else None


def beginning_of(reader: Recording) -> list[Gap]:
    """The gaps before the first row of a recording: a filter may have hidden any row."""
    return [Gap(GapKind.SELECTED, reason=one.filter_text) for one in reader.selections()]


def note_losses(reader: Recording, note: Note) -> None:
    """Note what is lost of a recording that was read."""
    for loss in reader.losses:
        note(f"{reader.path}: {loss}")


def chunk_input(
    name: str,
    chunks: Iterable[Chunk],
    again: Callable[[], Iterable[Chunk]] | None,
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
        again: opens them again to find the times; None if they can be read only once.
        baud: bits per second.
        ports: the ports of the chunks.
        count: number of rows, about.
        is_guess: whether nobody says that they are raw bytes, so that they must have a frame.
        notes: returns what else is remarkable, once all chunks are read.
    """

    def first_ns() -> int | None:
        with suppress(FteSniffError):  # raised when the rows are read
            for chunk in again() if again else ():
                if chunk.t_ns is not None:
                    return chunk.t_ns - len(chunk.data) * byte_time_ns(baud)
        return None

    def times() -> Times:
        if again is None:
            raise UsageError(
                f"{name} can be read only once, so its first and last time are not known"
                " before; write the times in full, as 2026-01-31T12:00:05Z, or read a file"
            )
        tally = Tally()
        with suppress(InputTextError):  # raised when the rows are read
            for rows in rows_of_chunks(again(), lambda _note: None, baud):
                tally.observe(rows)
        return tally.times

    def read(span: TimeRange | None, note: Note) -> Iterator[Rows]:
        rows_read = frames = 0
        try:
            for rows in rows_of_chunks(chunks, note, baud):
                rows_read += len(rows)
                frames += int(rows.framed.sum())
                if span is not None and len(rows) and rows.span_ns is None:
                    raise UsageError(f"{name} has no times; set with --start when its bytes began")
                yield rows if span is None else rows.select(span.mask(rows.t_ns))
        finally:
            for text in notes():
                note(f"{name}: {text}")
        if not rows_read:
            raise FileError(f"{name} is empty; there is nothing to read")
        if is_guess and not frames:
            raise FileError(
                f"{name}: has no text and no frame, so these are hardly the bytes of a wire;"
                " --input raw reads them as such"
            )

    return Input(name, read, times, first_ns, [PortFacts(port) for port in ports or [name]], count)


# What port events mean for the rows around them

_GAP_EVENTS: Final = (PortEventKind.LOST, PortEventKind.FOUND_AGAIN, PortEventKind.OVERRUN)
"""Events at which bytes of a port are missing."""


class EventEffects:
    """Adds the gaps and changes of the baud that port events are."""

    def __init__(self, bauds: Mapping[str, int]) -> None:
        """Follow the baud of these ports, bits per second."""
        self._bauds = bauds
        self.lost: set[str] = set()
        """Ports that are lost and were not found again."""

    def of(self, items: Iterable[Item]) -> Iterator[Item]:
        """The items, with what the port events among them mean behind each."""
        for item in items:
            yield item
            if isinstance(item, PortEvent) and (effect := self._effect(item)) is not None:
                yield effect

    def _effect(self, event: PortEvent) -> Gap | BaudChange | None:
        if event.kind in _GAP_EVENTS:
            if event.kind is PortEventKind.LOST:
                self.lost.add(event.port)
            elif event.kind is PortEventKind.FOUND_AGAIN:
                self.lost.discard(event.port)
            t_ns, is_lost = event.t_ns, bool(self.lost)
            return Gap(GapKind.PORT, None, t_ns, t_ns, event.detail, event.port, is_lost)
        if event.kind is PortEventKind.BAUD_CHANGED and event.count and event.port in self._bauds:
            return BaudChange(event.port, event.count)
        return None


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
        yield from cutter.finish()

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
    for one in sorted(inputs, key=lambda one: one.part.number if one.part else 0):
        if one.part is None or (chain := by_next.pop(one.part, None)) is None:
            chains.append(chain := [])
        chain.append(one)
        if one.part:
            by_next[one.part.next] = chain
    return sorted(chains, key=lambda chain: inputs.index(chain[0]))


_SURE: Final = 20
"""Frames after which a wire is known to carry one direction."""


def are_both_wires(inputs: Sequence[Input]) -> bool:
    """Whether two recordings are, without doubt, the wires of one line.

    They overlap in time, each has one port, another one, and frames of one direction, the other.
    """
    if len(inputs) != 2 or any(one.path is None or len(one.ports) != 1 for one in inputs):
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
        pair: bool = False,
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
            pair: whether all inputs are wires of one line; two recordings that leave no doubt are.
            zone: that of times in text.
        """
        # The first time of a single input is not needed.
        self._first_ns = {id(one): one.first_ns() if inputs[1:] else None for one in inputs}
        self.inputs = sorted(inputs, key=self._order)
        self._is_pair = pair or are_both_wires(self.inputs)
        self.groups = groups_of(self.inputs, pair=self._is_pair)
        self.unreadable = list(unreadable)
        self.span, self.row_filter, self.limit, self._baud = span, row_filter, limit, baud
        self._has_facts = facts or (row_filter is not None and row_filter.needs_facts)
        self.tally = Tally()
        self.notes = [str(error) for error in unreadable]
        """What is wrong with the inputs, one line each."""
        self._note_copies()
        self.written = 0
        """Rows that match, up to the limit."""
        self.progress = progress or Progress()
        self.progress.step = ""
        counts = [one.count for one in inputs if one.count is not None]
        self.progress.total = sum(counts) if len(counts) == len(inputs) and not span else None
        self.on_input: Callable[[str], None] = lambda _name: None
        """Is called with the name of each input, or of both of a pair, before its first item."""
        self.reported_gaps: list[Gap] = []
        """The gaps in the span that recordings report."""
        self.selections = [selection for one in inputs for selection in one.selections]
        """The filters that selected the rows of the inputs when they were written."""
        self._all_selections = list(self.selections)
        ports = [port.name for one in inputs for port in one.ports]
        bauds = dict.fromkeys(ports, baud) if baud else _bauds_of(inputs)
        known = {name: fact for one in inputs for name, fact in one.facts.items()}
        self.source = ExportSource(ports, bauds, self._all_selections, known, zone=zone)
        """What is known about the rows; complete once `__iter__` has ended."""

    def _order(self, one: Input) -> tuple[bool, int]:
        """The sort key of inputs: their first times; those without come last, in their order."""
        first_ns = self._first_ns[id(one)]
        return first_ns is None, first_ns or 0

    def _note_copies(self) -> None:
        seen = dict[object, Input]()
        for one in self.inputs:
            first_ns = self._first_ns[id(one)]
            other = seen.setdefault((first_ns, *(port.name for port in one.ports)), one)
            if first_ns is not None and other is not one:
                self.notes.append(
                    f"{one.name}: begins at the same time as {other.name}, on the same port; rows"
                    " that are in both count twice"
                )

    @property
    def counts(self) -> ReadingCounts:
        """What is known so far about its inputs."""
        return self.tally, self.notes, self.reported_gaps, self.unreadable

    def include(self, counts: ReadingCounts) -> None:
        """Add inputs that were read elsewhere."""
        tally, notes, gaps, unreadable = counts
        self.tally.merge(tally)
        self.progress.rows += tally.rows
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
        items = merged(
            Timed(self._first_ns[id(group[0])], partial(self._selected, group))
            for group in self.groups
        )
        for item in items:
            yield self._limited(item) if isinstance(item, Rows) else item
            if isinstance(item, Rows) and self.written == self.limit:
                items.close()  # type: ignore[attr-defined]  # the inputs note what is known of them
                break
        if self.row_filter is not None:
            self._all_selections.append(Selection(self.row_filter.text, self.tally.rows))

    def _selected(self, group: Sequence[Input], is_beside: bool = False) -> Iterator[Item]:
        """The items of a group with the facts of its rows, of which only those that match."""
        items = self._items_of(group, is_beside)
        for item in self._counted(with_facts(items) if self._has_facts else items):
            if isinstance(item, Rows) and self.row_filter is not None:
                yield item.select(self.row_filter.matches(item))
            else:
                yield item

    def _limited(self, rows: Rows) -> Rows:
        if self.limit is not None and len(rows) > self.limit - self.written:
            rows = rows[: self.limit - self.written]
        self.written += len(rows)
        return rows

    def _items_of(self, group: Sequence[Input], is_beside: bool) -> Iterator[Item]:
        """The items of a group, without its filter: gaps, changes of the baud, all rows.

        They begin with a gap, which beside other inputs is one of their own ports only.
        """
        bauds = {} if self._baud else _bauds_of(group)
        yield from (BaudChange(port, baud) for port, baud in bauds.items())
        ports = [port.name for one in group for port in one.ports] if is_beside else [None]
        for name in dict.fromkeys(ports):
            yield Gap(GapKind.OTHER_RECORDING, reason=_ANOTHER, port=name, port_lost=False)
        if self._is_pair:
            self.on_input(" + ".join(one.name for one in group))
            items = merged(
                Timed(self._first_ns[id(one)], partial(self._read, one)) for one in group
            )
        else:
            items = self._chained(group)
        yield from EventEffects(bauds).of(items)

    def _chained(self, inputs: Sequence[Input]) -> Iterator[Item]:
        bauds = _bauds_of(inputs[:1])
        for one in inputs:
            self.on_input(one.name)
            before, bauds = bauds, _bauds_of([one])
            if self._baud is None and bauds != before:
                yield from (BaudChange(port, baud) for port, baud in bauds.items())
            yield from self._read(one)

    def _read(self, one: Input, _is_beside: bool = False) -> Iterator[Item]:
        """The items of one input; an error of one of several is noted."""
        count, troubles = 0, Counter[PortEventKind]()
        try:
            for item in one.read(self.span, self.notes.append):
                if isinstance(item, Rows):
                    count += len(item)
                elif isinstance(item, PortEvent):
                    troubles[item.kind] += 1
                yield item
        except FileError as error:
            if len(self.inputs) == 1 and not count:
                raise
            self.unreadable.append(error)
            self.notes.append(str(error))
        finally:
            self._note_end(one, count, troubles)

    def _note_end(self, one: Input, count: int, troubles: Counter[PortEventKind]) -> None:
        """Note what was wrong with an input, and that it has no rows in the span."""
        for kind, text in TROUBLES.items():
            if number := troubles[kind]:
                what = text.format(times="once" if number == 1 else f"{number:,} times")
                self.notes.append(f"{one.name}: {what} while it was recorded")
        if self.span is not None and not count:
            with suppress(FteSniffError):
                if (times := one.times()) is not None:
                    first, last = map(iso_time, times)
                    self.notes.append(
                        f"{one.name}: none of its rows is between --from and --to; they go from"
                        f" {first} to {last}"
                    )

    def _counted(self, items: Iterable[Item]) -> Iterator[Item]:
        """Count the rows of items; of gaps, only the part in the span, and each only once."""
        for item in items:
            if isinstance(item, Rows):
                self.tally.observe(item)
                self.progress.rows += len(item)
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


def _bauds_of(inputs: Sequence[Input]) -> dict[str, int]:
    return {port.name: port.baud for one in inputs for port in one.ports if port.baud}
