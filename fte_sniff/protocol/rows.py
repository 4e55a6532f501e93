"""Chunks, rows and port events: what the framer reads and returns.

Chunk            the bytes of one read, with its time
Frame            ten bytes between a header and a tail (a row)
Damage           bytes that no frame contains (a row)
PortEvent        something that happened to the port rather than on the wire
Gap              rows that are missing between others
LineErrorCounts  how many errors of each kind the UART reported
LineErrorMarker  adds `line_error` to the rows around such errors
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import reduce
from typing import TypeAlias

from fte_sniff.errors import TranslatableText
from fte_sniff.protocol.spec import (
    CMD_OFFSET,
    DIRECTION_OF_HEADER,
    KIND_BY_HEADER_AND_CMD,
    Direction,
    Fault,
    FrameKind,
    Status,
    status_of,
)


@dataclass(frozen=True, slots=True)
class Chunk:
    """The bytes of one read, with its time; without bytes it reports that the line was idle."""

    port: str
    """The wire: the port's name, or the file's."""
    t_ns: int | None
    """When the read returned, nanoseconds since 1970 UTC; None where the input has no time."""
    data: bytes
    line_errors: tuple[tuple[int, int], ...] = ()
    """Where the UART reported errors: half-open ranges of offsets in `data`. The last range may end
    one past the data: errors are counted before their bytes are read."""
    is_late: bool = False
    """Whether the reader was held up before it read, so that no silence before it is known."""


@dataclass(frozen=True, slots=True)
class _Row:
    port: str
    offset: int
    """Offset of the first byte in the port's stream, from 0."""
    raw: bytes
    t_ns: int | None
    """Start of the first byte on the wire, nanoseconds since 1970 UTC; never falls per port."""
    faults: tuple[Fault, ...] = ()
    read_delay_ns: int | None = field(default=None, compare=False)
    """Nanoseconds from `t_ns` until the read of the first byte returned."""
    order_uncertain: bool = field(default=False, compare=False)
    """Whether a neighbouring row of another port may belong on the other side of this one: their
    times are closer than the two ports can resolve."""

    def __reduce__(self) -> tuple[type[_Row], tuple[object, ...]]:
        """Pickle for another process, faster than dataclasses do."""
        return type(self), (
            self.port,
            self.offset,
            self.raw,
            self.t_ns,
            self.faults,
            self.read_delay_ns,
            self.order_uncertain,
        )

    @property
    def status(self) -> Status:
        """The status by the faults."""
        return status_of(self.faults)


@dataclass(frozen=True, slots=True)
class Frame(_Row):
    """Ten bytes whose framing holds: a header and a tail, in step with the stream."""

    @property
    def direction(self) -> Direction:
        """The direction that the header names."""
        return DIRECTION_OF_HEADER[self.raw[0]]

    @property
    def kind(self) -> FrameKind | None:
        """The frame kind, or None if header and CMD name none."""
        return KIND_BY_HEADER_AND_CMD.get((self.raw[0], self.cmd))

    @property
    def cmd(self) -> int:
        """CMD as on the wire."""
        return self.raw[CMD_OFFSET]

    @property
    def values(self) -> dict[str, int]:
        """The fields' values by row name, as on the wire even where out of range."""
        kind = self.kind
        return {f.name: f.read(self.raw) for f in kind.fields} if kind else {}


@dataclass(frozen=True, slots=True)
class Damage(_Row):
    """Bytes that no frame contains: kept, labelled with their cause, never decoded."""

    faults: tuple[Fault, ...]


Row: TypeAlias = Frame | Damage


class PortEventKind(StrEnum):
    """What happened to a port."""

    OPENED = "opened"
    LOST = "lost"
    FOUND_AGAIN = "found_again"
    LINE_ERROR = "line_error"
    OVERRUN = "overrun"
    CLOSED = "closed"
    WIRING = "wiring"
    CLOCK_SET = "clock_set"
    BAUD_CHANGED = "baud_changed"
    NOT_PASSED_ON = "not_passed_on"
    NOT_OPENED = "not_opened"


@dataclass(frozen=True, slots=True)
class LineErrorCounts:
    """How many errors a UART reported, by kind; false if there are none."""

    framing: int = 0
    """Missing stop bits: another baud, another polarity, or a disturbed line."""
    parity: int = 0
    breaks: int = 0
    """Times that the line was low for longer than a byte."""
    overruns: int = 0
    """Bytes lost in the UART: the system fetched them too late."""
    buffer_overruns: int = 0
    """Bytes lost in the driver: no program read them in time."""

    @property
    def by_kind(self) -> tuple[int, int, int, int, int]:
        """The counts in the order of their definition."""
        return self.framing, self.parity, self.breaks, self.overruns, self.buffer_overruns

    @property
    def total(self) -> int:
        """The number of all errors."""
        return sum(self.by_kind)

    def __bool__(self) -> bool:
        return any(self.by_kind)

    def __add__(self, other: LineErrorCounts) -> LineErrorCounts:
        return LineErrorCounts(*map(int.__add__, self.by_kind, other.by_kind))

    def __str__(self) -> str:
        """The counts that are not 0: `2 framing, 1 break`."""
        counts = [text for text in self._texts() if text.values["count"]]
        if not counts:
            return ""
        return reduce(
            lambda one, other: TranslatableText("{one}, {other}", one=one, other=other), counts
        )

    def _texts(self) -> Iterator[TranslatableText]:
        yield TranslatableText("{count:,} framing", count=self.framing)
        yield TranslatableText("{count:,} parity", count=self.parity)
        yield TranslatableText("{count:,} break", count=self.breaks)
        yield TranslatableText("{count:,} overrun", count=self.overruns)
        yield TranslatableText("{count:,} buffer overrun", count=self.buffer_overruns)


@dataclass(frozen=True, slots=True)
class PortEvent:
    """Something that happened to a port rather than on its wire."""

    t_ns: int
    """Nanoseconds since 1970 UTC."""
    port: str
    kind: PortEventKind
    detail: str
    """One line of text for the user; may contain text from outside."""
    count: int = 0
    """Bytes (overrun, not passed on), errors (line error), or the new bits per second (baud
    changed); else 0."""


class GapKind(StrEnum):
    """Why rows are missing."""

    WRITE_ERROR = "write_error"
    LEFT_OUT = "left_out"
    """They are not in the file: a trigger dropped them, or the copied file has a gap."""
    DAMAGE = "damage"
    OTHER_RECORDING = "other_recording"
    PORT = "port"
    """The port was lost, or bytes of it were."""
    NOT_SHOWN = "not_shown"
    """The view was too slow to receive them."""


@dataclass(frozen=True, slots=True)
class Gap:
    """Rows that are missing between others: no period, rate or silence spans a gap."""

    kind: GapKind
    rows: int | None = None
    """How many rows are missing; None if unknown."""
    start_ns: int | None = None
    """First time at which a row may be missing, nanoseconds since 1970 UTC; None if unknown."""
    end_ns: int | None = None
    """Last time at which a row may be missing; None if unknown."""
    reason: str = ""
    """One line of text for the user; may contain text from outside."""
    port: str | None = None
    """The port whose rows are missing; None for all ports."""
    port_lost: bool | None = None
    """Whether a port remains lost after it, so that no command can be unanswered; None if the gap
    does not change that."""

    def including(self, t_ns: int, rows: int = 1) -> Gap:
        """The gap, with more missing rows of one time."""
        start = t_ns if self.start_ns is None else min(self.start_ns, t_ns)
        end = t_ns if self.end_ns is None else max(self.end_ns, t_ns)
        return Gap(self.kind, (self.rows or 0) + rows, start, end, self.reason, self.port)

    def within(self, first_ns: int | None, last_ns: int | None) -> Gap | None:
        """The part between two times, both included (None: unbounded), or None; rows unknown."""
        if self.start_ns is None or self.end_ns is None:
            return self
        first = self.start_ns if first_ns is None else max(first_ns, self.start_ns)
        last = self.end_ns if last_ns is None else min(last_ns, self.end_ns)
        if (first, last) == (self.start_ns, self.end_ns):
            return self
        return replace(self, rows=None, start_ns=first, end_ns=last) if first <= last else None


class LineErrorMarker:
    """Adds `line_error` to the rows of one port for which the UART reported errors."""

    def __init__(self) -> None:
        self._next_offset = 0
        self._errors: deque[tuple[int, int]] = deque()
        """Half-open ranges of stream offsets with errors, rising; those of future rows."""

    def observe(self, chunk: Chunk) -> None:
        """Note the errors of a chunk; call before `mark` for the rows that the chunk completes."""
        self._errors.extend(
            (self._next_offset + start, self._next_offset + stop)
            for start, stop in chunk.line_errors
        )
        self._next_offset += len(chunk.data)

    def mark(self, rows: Sequence[Row]) -> list[Row]:
        """Return the rows, with `line_error` where errors were; call in stream order."""
        return [self._marked(row) for row in rows] if self._errors else list(rows)

    def _marked(self, row: Row) -> Row:
        while self._errors and self._errors[0][1] <= row.offset:
            self._errors.popleft()
        if not self._errors or self._errors[0][0] >= row.offset + len(row.raw):
            return row
        return replace(row, faults=(*row.faults, Fault.LINE_ERROR))
