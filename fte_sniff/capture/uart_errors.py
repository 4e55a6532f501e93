"""Parity/framing/overrun marks (PARMRK) and counters.

A UART's driver can tell two things, and both are asked for:

    how many   counters by kind, since the driver was loaded (TIOCGICOUNT)
    which      the byte in question, marked in what is read (INPCK with PARMRK)

INPCK makes some drivers (cp210x) look for errors at all. Alone it would turn every such byte into
00; with PARMRK the byte is kept, and stands as `FF 00 byte` in what is read, a break as `FF 00 00`,
and an ordinary FF as `FF FF`. `Unmarker` undoes that, so the bytes are those of the wire. Some
adapters mark all bytes that they deliver at once, where one was in error.

Only a port that has counters is asked: a pseudo-terminal has no UART, and a port without descriptor
has no driver here.
"""

from __future__ import annotations

import contextlib
import fcntl
import re
import struct
import termios
from collections.abc import Callable
from typing import Final, Protocol, TypeAlias

import serial

from fte_sniff.errors import TranslatableText
from fte_sniff.protocol import FRAME_LENGTH, LineErrorCounts

Counters: TypeAlias = Callable[[], LineErrorCounts]
"""Reads what the driver has counted so far; each count is a 32-bit number that wraps."""

Places: TypeAlias = tuple[tuple[int, int], ...]
"""Stretches of bytes, each from its first place to the one behind its last."""

TELL_EVERY_NS: Final = 1_000_000_000
"""Between two tellings of line errors at least: a wrong baud makes some with every byte."""

AVAILABLE: Final[str] = TranslatableText("line errors counted and marked")
UNAVAILABLE: Final[str] = TranslatableText("line errors unavailable")

_COUNT_WRAPS = 2**32
_ICOUNTER = struct.Struct("=20I")
"""`struct serial_icounter_struct`: cts dsr rng dcd rx tx frame overrun parity brk buf_overrun."""
_FRAME, _OVERRUN, _PARITY, _BREAK, _BUFFER_OVERRUN = range(6, 11)
_TIOCGICOUNT = getattr(termios, "TIOCGICOUNT", 0x545D)

_ESCAPE = re.compile(rb"\xff(?:\xff|\x00([\x00-\xff]))")
_BEGUN = re.compile(rb"\xff\x00?\Z")


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
    """What was counted between two readings, also where a counter wrapped."""
    return LineErrorCounts(
        *((a - b) % _COUNT_WRAPS for a, b in zip(now.by_kind, before.by_kind, strict=True))
    )


def counters_of(port: serial.Serial) -> Counters | None:
    """The counters behind an open port; None where there are none."""
    try:
        descriptor = port.fileno()
    except (AttributeError, OSError):
        return None

    def counters() -> LineErrorCounts:
        return parse_counters(fcntl.ioctl(descriptor, _TIOCGICOUNT, bytes(_ICOUNTER.size)))

    try:
        counters()
    except OSError:
        return None
    return counters


def ask_for_marks(descriptor: int) -> None:
    """Have the terminal mark what was in error; what came unmarked before is thrown away."""
    attributes = termios.tcgetattr(descriptor)
    attributes[0] &= ~(termios.BRKINT | termios.IGNBRK | termios.IGNPAR)
    attributes[0] |= termios.INPCK | termios.PARMRK
    termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
    termios.tcflush(descriptor, termios.TCIFLUSH)


class Unmarker:
    """Takes the terminal's marks out of what is read, however it was cut into reads."""

    def __init__(self) -> None:
        self._held = b""
        """The beginning of a mark, the rest of which has not come."""

    def take(self, marked: bytes) -> tuple[bytes, list[int]]:
        """The bytes of the wire, and the places of those that were in error."""
        marked, self._held = self._held + marked, b""
        if b"\xff" not in marked:
            return marked, []
        clean, places, at = bytearray(), [], 0
        for mark in _ESCAPE.finditer(marked):
            clean += marked[at : mark.start()]
            if mark[1] is not None:
                places.append(len(clean))
            clean += mark[1] or b"\xff"
            at = mark.end()
        begun = _BEGUN.search(marked, at)
        if begun:
            self._held = begun[0]
        return bytes(clean + marked[at : len(marked) - len(self._held)]), places


def stretches(places: list[int]) -> Places:
    """The places as stretches; those with less than a frame between them are one."""
    found: list[tuple[int, int]] = []
    for place in places:
        if found and place - found[-1][1] < FRAME_LENGTH:
            found[-1] = found[-1][0], place + 1
        else:
            found.append((place, place + 1))
    return tuple(found)


class LineWatch(Protocol):
    """Knows of the errors on one open port's line."""

    words: str
    """Whether it does, in words."""

    def take(self, data: bytes) -> tuple[bytes, Places]:
        """The bytes of the wire in what was just read, and where among them errors happened."""
        ...

    def news(self, now_ns: int) -> LineErrorCounts | None:
        """What is to be told now: the errors since the last time; None where there is nothing."""
        ...

    def rest(self) -> LineErrorCounts | None:
        """What has not been told yet, at the end."""
        ...


class BlindWatch:
    """For ports that tell of no errors."""

    words = UNAVAILABLE

    def take(self, data: bytes) -> tuple[bytes, Places]:
        """The bytes as they are."""
        return data, ()

    def news(self, now_ns: int) -> LineErrorCounts | None:
        """Nothing, ever."""
        return None

    def rest(self) -> LineErrorCounts | None:
        """Nothing."""
        return None


class UartWatch:
    """For ports that count and mark."""

    words = AVAILABLE

    def __init__(self, counters: Counters) -> None:
        """Watch from now on; errors that were counted earlier are others' errors."""
        self._counters = counters
        self._before = counters()
        self._unmarker = Unmarker()
        self._untold = LineErrorCounts()
        self._told_ns = -TELL_EVERY_NS
        self._does_count = False

    def take(self, data: bytes) -> tuple[bytes, Places]:
        """As `LineWatch`; errors that are counted but not marked lie anywhere in these bytes, or in
        the next: it can be counted before it is read.
        """
        clean, places = self._unmarker.take(data)
        new = self._new_counts()
        self._does_count = self._does_count or bool(new)
        if places and not self._does_count:
            # Some drivers (pl2303) mark and do not count. The line has no parity to be wrong.
            breaks = sum(not clean[place] for place in places)
            new = LineErrorCounts(framing=len(places) - breaks, breaks=breaks)
        self._untold += new
        if new and not places:
            return clean, ((0, len(clean) + 1),)
        return clean, stretches(places)

    def news(self, now_ns: int) -> LineErrorCounts | None:
        """As `LineWatch`; the first at once, more of them at most every TELL_EVERY_NS."""
        if not self._untold or now_ns - self._told_ns < TELL_EVERY_NS:
            return None
        self._told_ns = now_ns
        return self.rest()

    def rest(self) -> LineErrorCounts | None:
        """As `LineWatch`."""
        told, self._untold = self._untold, LineErrorCounts()
        return told or None

    def _new_counts(self) -> LineErrorCounts:
        now = self._before
        # A port that is going away fails here first; the next read tells that.
        with contextlib.suppress(OSError):
            now = self._counters()
        new, self._before = counted_since(now, self._before), now
        return new


def line_watch_of(port: serial.Serial) -> LineWatch:
    """Ask an open port for its line errors, if it has a UART; before anything is read of it."""
    counters = counters_of(port)
    if counters is None:
        return BlindWatch()
    try:
        ask_for_marks(port.fileno())
        return UartWatch(counters)
    except (OSError, termios.error):
        # It has just been unplugged; the first read tells.
        return BlindWatch()
