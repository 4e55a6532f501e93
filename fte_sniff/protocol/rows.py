"""Chunk, Frame, Damage, PortEvent, Fault, Status.

Chunk      the bytes of one read, stamped once
Frame      ten bytes between a header and a tail (a row)
Damage     bytes that no frame claims (a row)
PortEvent  something that happened to the port rather than on the wire
LineErrorCounts  how often the UART reported what kind of error
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
    """The bytes of one read, stamped once; no bytes at all means that time passed in silence."""

    port: str
    """Which wire: the port's name, or the file's."""
    t_ns: int | None
    """When the read returned, nanoseconds since 1970 UTC; None where the input has no time."""
    data: bytes
    line_errors: tuple[tuple[int, int], ...] = ()
    """Where in `data` the UART reported errors: stretches, each from its first place to the one
    behind its last. The last may reach one place past the data: errors are counted before their
    bytes are read."""


@dataclass(frozen=True, slots=True)
class Frame:
    """Ten bytes whose framing holds: a header, a tail, and a place in step."""

    port: str
    offset: int
    """Of the first byte in that port's stream, from 0."""
    raw: bytes
    t_ns: int | None
    """When the first byte began on the wire, nanoseconds since 1970 UTC, never falling per port."""
    faults: tuple[Fault, ...] = ()
    read_delay_ns: int | None = field(default=None, compare=False)
    """From `t_ns` to the return of the read that brought the first byte, nanoseconds."""
    order_uncertain: bool = field(default=False, compare=False)
    """Whether a row of another port, although it stands before or behind, may be the later or the
    earlier one: their times are closer than the two ports can tell apart."""

    def __reduce__(self) -> tuple[type[Frame], tuple[object, ...]]:
        """For pickling: a row on its way to a view. What dataclasses do by themselves is slow."""
        return Frame, (
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
        """How far the row can be believed."""
        return status_of(self.faults)

    @property
    def direction(self) -> Direction:
        """Which way the frame goes."""
        return DIRECTION_OF_HEADER[self.raw[0]]

    @property
    def kind(self) -> FrameKind | None:
        """The table's entry, or None where header and CMD name none."""
        return KIND_BY_HEADER_AND_CMD.get((self.raw[0], self.cmd))

    @property
    def cmd(self) -> int:
        """CMD as it stands on the wire."""
        return self.raw[CMD_OFFSET]

    @property
    def values(self) -> dict[str, int]:
        """The fields' values by row name, as on the wire even where out of range."""
        kind = self.kind
        return {f.name: f.read(self.raw) for f in kind.fields} if kind else {}


@dataclass(frozen=True, slots=True)
class Damage:
    """Bytes that no frame claims. They are kept, labelled with their cause, and never decoded."""

    port: str
    offset: int
    """Of the first byte in that port's stream, from 0."""
    raw: bytes
    t_ns: int | None
    """When the first byte began on the wire, nanoseconds since 1970 UTC, never falling per port."""
    faults: tuple[Fault, ...]
    read_delay_ns: int | None = field(default=None, compare=False)
    """From `t_ns` to the return of the read that brought the first byte, nanoseconds."""
    order_uncertain: bool = field(default=False, compare=False)
    """Whether a row of another port, although it stands before or behind, may be the later or the
    earlier one: their times are closer than the two ports can tell apart."""

    def __reduce__(self) -> tuple[type[Damage], tuple[object, ...]]:
        """For pickling: a row on its way to a view. What dataclasses do by themselves is slow."""
        return Damage, (
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
        """How far the row can be believed."""
        return status_of(self.faults)


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
    """How many errors a UART reported, by kind; false where there are none."""

    framing: int = 0
    """Stop bits that were none: another baud, another polarity, or a disturbed line."""
    parity: int = 0
    breaks: int = 0
    """Times that the line was held low for longer than a byte."""
    overruns: int = 0
    """Bytes lost in the UART, because the system was too slow to fetch them."""
    buffer_overruns: int = 0
    """Bytes lost in the driver, because nobody read them in time."""

    @property
    def by_kind(self) -> tuple[int, int, int, int, int]:
        """The counts in the order of their definition."""
        return self.framing, self.parity, self.breaks, self.overruns, self.buffer_overruns

    @property
    def total(self) -> int:
        """All of them."""
        return sum(self.by_kind)

    def __bool__(self) -> bool:
        return any(self.by_kind)

    def __add__(self, other: LineErrorCounts) -> LineErrorCounts:
        return LineErrorCounts(*map(int.__add__, self.by_kind, other.by_kind))

    def __str__(self) -> str:
        """Those that there are: `2 framing, 1 break`."""
        told = [words for words in self._words() if words.values["count"]]
        if not told:
            return ""
        return reduce(
            lambda one, other: TranslatableText("{one}, {other}", one=one, other=other), told
        )

    def _words(self) -> Iterator[TranslatableText]:
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
    """One line for people; may hold text from outside, so show it, never obey it."""
    count: int = 0
    """What there is to count: bytes of an overrun or not passed on, errors on the line, bits per
    second from here on where the baud changed; else 0."""


class LineErrorMarker:
    """Marks the rows of one port; give it each chunk before the rows that the chunk completes."""

    def __init__(self) -> None:
        self._offset = 0
        """In the port's stream, of the next chunk."""
        self._errors: deque[tuple[int, int]] = deque()
        """Stretches of the stream with errors in them that rows may yet come for, rising."""

    def heed(self, chunk: Chunk) -> None:
        """Take in where errors were reported."""
        self._errors.extend(
            (self._offset + start, self._offset + stop) for start, stop in chunk.line_errors
        )
        self._offset += len(chunk.data)

    def mark(self, rows: Sequence[Row]) -> list[Row]:
        """These rows, which must follow those marked before, with `line_error` where it is due."""
        return [self._marked(row) for row in rows] if self._errors else list(rows)

    def _marked(self, row: Row) -> Row:
        while self._errors and self._errors[0][1] <= row.offset:
            self._errors.popleft()
        if not self._errors or self._errors[0][0] >= row.offset + len(row.raw):
            return row
        return replace(row, faults=(*row.faults, Fault.LINE_ERROR))
