"""Owns one input, a recording or a log, on its way to batches of rows, and what is told at its end.

It must not know what the user calls it, nor what a command does with the rows. A recording is read
by `recording`; bytes of anything else are framed by `framing`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import IO, TYPE_CHECKING, Protocol

from fte_sniff.cli.inputs.batches import Batch, LogBatch
from fte_sniff.cli.inputs.framing import decided
from fte_sniff.cli.inputs.log_batches import log_batches
from fte_sniff.cli.inputs.packed_batches import ColumnBatch
from fte_sniff.errors import UsageError
from fte_sniff.formats.logs.hex_log import HexLog
from fte_sniff.protocol import Chunk, PortEventKind, iso_time
from fte_sniff.protocol.framer.segments import Decided

if TYPE_CHECKING:
    from fte_sniff.recording.metadata import PortFacts, Selection, Stretch
    from fte_sniff.recording.passages import Span
    from fte_sniff.recording.reader import RecordingReader

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

    def left_out(self, span: Span | None) -> Sequence[Stretch]:
        """The rows that came in the span and that it does not hold, as far as it tells."""
        ...

    def selections(self) -> Sequence[Selection]:
        """The filters that chose its rows, as far as it tells."""
        ...

    def batches(self, span: Span | None, note: Note) -> Iterator[Batch]:
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

    def left_out(self, span: Span | None) -> Sequence[Stretch]:
        """What a trigger, or a disk that failed, kept from it."""
        told = self.reader.left_out()
        return [one for one in told if span is None or span.touches(one.first_ns, one.last_ns)]

    def selections(self) -> Sequence[Selection]:
        """What `decode --filter`, or a screen, chose from another."""
        return self.reader.selections()

    def batches(self, span: Span | None, note: Note) -> Iterator[Batch]:
        """Its rows, many thousands side by side; see `Input`."""
        from fte_sniff.recording.passages import EVERYTHING

        troubles: Counter[PortEventKind] = Counter()
        some = False
        for passage, columns in self.reader.passages(span=span or EVERYTHING):
            troubles.update(event.kind for event in columns.events)
            some = some or bool(len(columns))
            self.ends.update(columns.ends())
            if len(columns) or columns.events or passage.after_loss:
                again = partial(self.reader.again, passage)
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

    def left_out(self, span: Span | None) -> Sequence[Stretch]:
        """A log does not tell of what it does not hold."""
        return ()

    def selections(self) -> Sequence[Selection]:
        """A log does not tell of any."""
        return ()

    def batches(self, span: Span | None, note: Note) -> Iterator[Batch]:
        """Its rows, some thousands at once; see `Input`."""
        portions = decided(self.chunks, self.name, note, self.drained)
        if isinstance(self.chunks, HexLog):
            portions = _compared(portions, self.chunks, note)
        batches = log_batches(portions)
        yield from batches if span is None else self._spanned(batches, span, note)

    def _spanned(self, batches: Iterable[LogBatch], span: Span, note: Note) -> Iterator[LogBatch]:
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


def _compared(portions: Iterable[Decided], log: HexLog, note: Note) -> Iterator[Decided]:
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
