"""Line errors of a UART, as its driver counts them (TIOCGICOUNT).

Which byte an error was in is not known: a driver can count a byte before it delivers it. So an
error may be in any byte of the read that finds it counted, or in the byte after it. A
pseudo-terminal has no UART, and a port without a file descriptor has no driver on this machine.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Final, TypeAlias

import serial

from fte_sniff.errors import TranslatableText
from fte_sniff.platform import POSIX
from fte_sniff.protocol.items import LineErrorCounts, PortEvent, PortEventKind

if POSIX:
    import fcntl
    import termios

Counters: TypeAlias = Callable[[], LineErrorCounts | None]
"""Reads what the driver has counted so far; each count is a 32-bit number that wraps."""

REPORT_NS: Final = 1_000_000_000
"""Least time between two reports: a wrong baud causes an error with every byte."""

_COUNT_WRAPS: Final = 2**32
_COUNTERS: Final = struct.Struct("=20I")
"""`struct serial_icounter_struct`: cts dsr rng dcd rx tx frame overrun parity brk buf_overrun."""


class LineErrors:
    """The errors of one open port since it was opened."""

    def __init__(self, name: str, counters: Counters) -> None:
        """Start now; errors that were counted before are ignored. `name` is that of the events."""
        self._name, self._counters = name, counters
        self._counted = self._reported = counters()
        self._reported_ns = -REPORT_NS

    @property
    def description(self) -> TranslatableText:
        """Whether errors are available, as text for users."""
        if self._counted is None:
            return TranslatableText("line errors unavailable")
        return TranslatableText("line errors counted")

    def came(self) -> bool:
        """Whether errors were counted since the last call."""
        if self._counted is None or (now := self._counters()) in (None, self._counted):
            return False
        self._counted = now
        return True

    def report(self, now_ns: int, *, at_end: bool = False) -> tuple[PortEvent, ...]:
        """The errors since the last report: the first at once, then at most every REPORT_NS."""
        now, before = self._counted, self._reported
        if now is None or before is None or now == before:
            return ()
        if now_ns - self._reported_ns < REPORT_NS and not at_end:
            return ()
        self._reported, self._reported_ns = now, now_ns
        pairs = zip(now, before, strict=True)
        counts = LineErrorCounts(*((a - b) % _COUNT_WRAPS for a, b in pairs))
        kind = PortEventKind.LINE_ERROR
        return (PortEvent(now_ns, self._name, kind, str(counts), sum(counts)),)


def counters_of(port: serial.Serial) -> Counters:
    """The driver's counters of an open port; they return None if it has none, or is lost."""
    request = getattr(termios, "TIOCGICOUNT", 0x545D) if POSIX else 0

    def counters() -> LineErrorCounts | None:
        if not POSIX:
            return None
        try:
            return parsed(fcntl.ioctl(port.fileno(), request, bytes(_COUNTERS.size)))
        except (AttributeError, OSError):
            return None

    return counters


def parsed(counters: bytes) -> LineErrorCounts:
    """The counts in a `struct serial_icounter_struct`."""
    framing, overruns, parity, breaks, buffer_overruns = _COUNTERS.unpack(counters)[6:11]
    return LineErrorCounts(framing, parity, breaks, overruns, buffer_overruns)
