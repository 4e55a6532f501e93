"""Line errors of a UART: the driver's counters (TIOCGICOUNT) and its marks (PARMRK).

A driver reports two things, and both are requested:

    how many   counters by kind, since the driver was loaded (TIOCGICOUNT)
    which      the byte in error, marked in the data that is read (INPCK with PARMRK)

Some drivers (cp210x) check for errors only with INPCK. INPCK alone replaces a byte in error by 00;
with PARMRK it is kept, as `FF 00 byte`, a break as `FF 00 00`, and an ordinary FF as `FF FF`.
`Unmarker` removes the marks, so that the bytes are those of the wire. Some adapters mark all bytes
that they deliver together with one in error.

Only a port that has counters is asked: a pseudo-terminal has no UART, and a port without a file
descriptor has no driver on this machine.
"""

from __future__ import annotations

import contextlib
import re
import struct
from collections.abc import Callable
from typing import Final, TypeAlias

import serial

from fte_sniff.errors import TranslatableText
from fte_sniff.platform import POSIX, TerminalError
from fte_sniff.protocol import FRAME_LENGTH, LineErrorCounts

if POSIX:
    import fcntl
    import termios

Counters: TypeAlias = Callable[[], LineErrorCounts]
"""Reads what the driver has counted so far; each count is a 32-bit number that wraps."""

Spans: TypeAlias = tuple[tuple[int, int], ...]
"""Ranges of bytes, each as (start, end), `end` excluded."""

REPORT_INTERVAL_NS: Final = 1_000_000_000
"""Least time between two reports of line errors: a wrong baud causes some with every byte."""

AVAILABLE: Final[str] = TranslatableText("line errors counted and marked")
UNAVAILABLE: Final[str] = TranslatableText("line errors unavailable")


class LineWatch:
    """Line errors of one open port; this base class is for ports without them."""

    description: str = UNAVAILABLE
    """Whether errors are available, as text for users."""

    def feed(self, data: bytes) -> tuple[bytes, Spans]:
        """Return the wire's bytes in what was just read, and the spans with errors."""
        return data, ()

    def report(self, now_ns: int) -> LineErrorCounts | None:
        """The errors since the last report; None if there are none, or it is too early."""
        return None

    def flush(self) -> LineErrorCounts | None:
        """The errors since the last report; None if there are none."""
        return None


class UartWatch(LineWatch):
    """Line errors of a port with counters and marks."""

    description = AVAILABLE

    def __init__(self, counters: Counters) -> None:
        """Start now; errors that were counted before are ignored."""
        self._counters = counters
        self._counted = counters()
        self._unmarker = Unmarker()
        self._unreported = LineErrorCounts()
        self._reported_ns = -REPORT_INTERVAL_NS
        self._counts_errors = False

    def feed(self, data: bytes) -> tuple[bytes, Spans]:
        """As `LineWatch`. An error that is counted but not marked may be in any of these bytes, or
        in the next one: a driver can count a byte before it delivers it.
        """
        clean, offsets = self._unmarker.feed(data)
        new = self._new_counts()
        self._counts_errors = self._counts_errors or bool(new)
        if offsets and not self._counts_errors:
            # Some drivers (pl2303) only mark. It cannot be parity: the line has none.
            breaks = sum(not clean[offset] for offset in offsets)
            new = LineErrorCounts(framing=len(offsets) - breaks, breaks=breaks)
        self._unreported += new
        if new and not offsets:
            return clean, ((0, len(clean) + 1),)
        return clean, _spans(offsets)

    def report(self, now_ns: int) -> LineErrorCounts | None:
        """As `LineWatch`: the first at once, then at most every REPORT_INTERVAL_NS."""
        if not self._unreported or now_ns - self._reported_ns < REPORT_INTERVAL_NS:
            return None
        self._reported_ns = now_ns
        return self.flush()

    def flush(self) -> LineErrorCounts | None:
        """As `LineWatch`."""
        counts, self._unreported = self._unreported, LineErrorCounts()
        return counts or None

    def _new_counts(self) -> LineErrorCounts:
        now = self._counted
        # A port that is unplugged fails here first; the next read reports it.
        with contextlib.suppress(OSError):
            now = self._counters()
        new, self._counted = counted_since(now, self._counted), now
        return new


def line_watch_of(port: serial.Serial) -> LineWatch:
    """Enable line errors on an open port that has a UART; call it before the first read."""
    counters = counters_of(port)
    if counters is None:
        return LineWatch()
    try:
        enable_error_marks(port.fileno())
        return UartWatch(counters)
    except (OSError, TerminalError):
        # It was just unplugged; the first read reports it.
        return LineWatch()


_ESCAPE = re.compile(rb"\xff(?:\xff|\x00([\x00-\xff]))")
_INCOMPLETE = re.compile(rb"\xff\x00?\Z")


class Unmarker:
    """Incremental decoder of PARMRK data."""

    def __init__(self) -> None:
        self._pending = b""
        """The start of a mark whose end was not read yet."""

    def feed(self, marked: bytes) -> tuple[bytes, list[int]]:
        """Return the bytes of the wire, and the offsets of those in error."""
        marked, self._pending = self._pending + marked, b""
        if b"\xff" not in marked:
            return marked, []
        clean, offsets, at = bytearray(), [], 0
        for mark in _ESCAPE.finditer(marked):
            clean += marked[at : mark.start()]
            if mark[1] is not None:
                offsets.append(len(clean))
            clean += mark[1] or b"\xff"
            at = mark.end()
        incomplete = _INCOMPLETE.search(marked, at)
        if incomplete:
            self._pending = incomplete[0]
        return bytes(clean + marked[at : len(marked) - len(self._pending)]), offsets


def _spans(offsets: list[int]) -> Spans:
    """The offsets as spans; those less than a frame apart are joined."""
    found: list[tuple[int, int]] = []
    for offset in offsets:
        if found and offset - found[-1][1] < FRAME_LENGTH:
            found[-1] = found[-1][0], offset + 1
        else:
            found.append((offset, offset + 1))
    return tuple(found)


def enable_error_marks(descriptor: int) -> None:
    """Have the terminal mark bytes in error; bytes that came before are discarded."""
    assert POSIX
    attributes = termios.tcgetattr(descriptor)
    attributes[0] &= ~(termios.BRKINT | termios.IGNBRK | termios.IGNPAR)
    attributes[0] |= termios.INPCK | termios.PARMRK
    termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
    termios.tcflush(descriptor, termios.TCIFLUSH)


_COUNT_WRAPS = 2**32
_ICOUNTER = struct.Struct("=20I")
"""`struct serial_icounter_struct`: cts dsr rng dcd rx tx frame overrun parity brk buf_overrun."""
_FRAME, _OVERRUN, _PARITY, _BREAK, _BUFFER_OVERRUN = range(6, 11)


def counters_of(port: serial.Serial) -> Counters | None:
    """The driver's counters of an open port; None if it has none."""
    if not POSIX:
        return None
    try:
        descriptor = port.fileno()
    except (AttributeError, OSError):
        return None

    request = getattr(termios, "TIOCGICOUNT", 0x545D)

    def counters() -> LineErrorCounts:
        return parse_counters(fcntl.ioctl(descriptor, request, bytes(_ICOUNTER.size)))

    try:
        counters()
    except OSError:
        return None
    return counters


def parse_counters(raw: bytes) -> LineErrorCounts:
    """The counts in a `struct serial_icounter_struct`."""
    found = _ICOUNTER.unpack(raw)
    return LineErrorCounts(
        framing=found[_FRAME],
        parity=found[_PARITY],
        breaks=found[_BREAK],
        overruns=found[_OVERRUN],
        buffer_overruns=found[_BUFFER_OVERRUN],
    )


def counted_since(now: LineErrorCounts, before: LineErrorCounts) -> LineErrorCounts:
    """What was counted between two readings, modulo 2**32."""
    return LineErrorCounts(
        *((a - b) % _COUNT_WRAPS for a, b in zip(now.by_kind, before.by_kind, strict=True))
    )
