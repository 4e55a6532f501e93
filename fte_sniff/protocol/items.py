"""What the framer reads, and what else happens: all that is not a row.

Chunk            the bytes of one read, with its time
PortEvent        something that happened to the port rather than on the wire
Gap              rows that are missing between others
BaudChange       another speed of a port, from here on
Change           one of the two, with the index of the row after it
LineErrorCounts  how many errors of each kind the UART reported
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple


class Chunk(NamedTuple):
    """The bytes of one read, with its time; without bytes it reports that the line was idle."""

    port: str
    """The wire: the port's name, or the file's."""
    t_ns: int | None
    """When the read returned, nanoseconds since 1970 UTC; None where the input has no time."""
    data: bytes
    has_line_errors: bool = False
    """Whether the UART reported errors: in these bytes, or in the one after them, since an error is
    counted before its byte is read."""
    is_late: bool = False
    """Whether the reader was held up before it read, so that no silence before it is known."""
    at_once: bool = False
    """Whether `t_ns` is the time of every byte: that of a call of a program, not of a line."""


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
    SHARED = "shared"
    """Another program has the port open too."""
    SILENT = "silent"
    """No byte came for some time."""
    BYTES_AGAIN = "bytes_again"


class LineErrorCounts(NamedTuple):
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

    def __bool__(self) -> bool:
        return any(self)

    def __str__(self) -> str:
        """The counts that are not 0: `2 framing, 1 break`."""
        names = "framing", "parity", "break", "overrun", "buffer overrun"
        counts = zip(self, names, strict=True)
        return ", ".join(f"{count:,} {name}" for count, name in counts if count)


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
    """Bytes (overrun, not passed on), errors (line error), milliseconds (silent, bytes again), or
    the new bits per second (baud changed); else 0."""


class GapKind(StrEnum):
    """Why rows are missing."""

    WRITE_ERROR = "write_error"
    LEFT_OUT = "left_out"
    """They are not in the file: a trigger dropped them, or the copied file has a gap."""
    DAMAGE = "damage"
    OTHER_RECORDING = "other_recording"
    PORT = "port"
    """The port was lost, or bytes of it were."""
    SELECTED = "selected"
    """A filter selected the rows that follow; `reason` is its text."""
    NOT_SHOWN = "not_shown"
    """They are in a file that the view could not read."""


class Gap(NamedTuple):
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

    def within(self, first_ns: int, last_ns: int) -> Gap | None:
        """The part between two times, both included, or None; its number of rows is unknown."""
        if self.start_ns is None or self.end_ns is None:
            return self
        first, last = max(first_ns, self.start_ns), min(last_ns, self.end_ns)
        if (first, last) == (self.start_ns, self.end_ns):
            return self
        return self._replace(rows=None, start_ns=first, end_ns=last) if first <= last else None


@dataclass(frozen=True, slots=True)
class BaudChange:
    """From here on a port has another speed."""

    port: str
    baud: int
    """Bits per second."""


@dataclass(frozen=True, slots=True)
class Change:
    """A gap, a change of speed, or what happened at a port between two rows."""

    index: int
    """Of the first row after it, among the rows that it is reported with."""
    what: Gap | BaudChange | PortEvent
