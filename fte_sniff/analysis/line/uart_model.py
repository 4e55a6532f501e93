"""Owns what a UART hears of a line that has another baud or polarity than it is set to.

It must not know frames. A line is a row of bits as its sender clocks them, idle high. The receiver
waits for a falling edge and samples ten bits from there at its own pace, in their middles. What
chips do when the tenth, the stop bit, is low differs; both ways are here.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Sequence
from enum import StrEnum

_DATA_BITS = 8
_STOP = _DATA_BITS + 1


class Resync(StrEnum):
    """What a receiver does behind a stop bit that is low."""

    BY_EDGE = "by edge"
    """It waits for the next falling edge."""
    AT_ONCE = "at once"
    """It takes the low bit for the next start bit; but after a break, that is nothing but low bits,
    it waits for an edge too."""


def line_levels(pieces: Iterable[bytes], idle_bits: Sequence[int]) -> bytes:
    """The levels of an 8N1 line, one a bit, that carries the pieces with idle time behind each.

    Args:
        pieces: bytes that follow each other without gaps.
        idle_bits: bit times of idle behind the first piece, the second, and so on, round and round.
    """
    levels = bytearray(b"\1\1")
    for number, piece in enumerate(pieces):
        for byte in piece:
            levels.append(0)
            levels += bytes(byte >> place & 1 for place in range(_DATA_BITS))
            levels.append(1)
        levels += b"\1" * idle_bits[number % len(idle_bits)]
    return bytes(levels)


def falls_of(levels: bytes, low: int) -> list[int]:
    """The places where a line comes to the level `low`."""
    edge, falls = bytes((1 - low, low)), []
    at = levels.find(edge)
    while at >= 0:
        falls.append(at + 1)
        at = levels.find(edge, at + 2)
    return falls


def heard(
    levels: bytes, falls: Sequence[int], low: int, pace: float, resync: Resync, most: int
) -> bytes:
    """The first bytes that a receiver makes of a line.

    Args:
        levels: as sent.
        falls: `falls_of` these levels.
        low: the level that arrives as low: 0, or 1 where the polarity is swapped.
        pace: bits of the sender in one of the receiver's.
        resync: what happens behind a stop bit that is low.
        most: how many bytes at most.
    """
    out = bytearray()
    middles = [(place + 0.5) * pace for place in range(_STOP + 1)]
    end = len(levels) - middles[_STOP] - 1
    start: float | None = _fall_behind(falls, 0)
    while start is not None and start < end and len(out) < most:
        if levels[int(start + middles[0])] != low:
            start = _fall_behind(falls, start + middles[0])
            continue
        byte = 0
        for place in range(_DATA_BITS):
            byte |= (levels[int(start + middles[place + 1])] != low) << place
        out.append(byte)
        stop = start + middles[_STOP]
        if resync is Resync.AT_ONCE and byte and levels[int(stop)] == low:
            start += _STOP * pace
        else:
            start = _fall_behind(falls, stop)
    return bytes(out)


def _fall_behind(falls: Sequence[int], place: float) -> int | None:
    found = bisect_left(falls, place)
    return falls[found] if found < len(falls) else None
