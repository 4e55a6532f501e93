"""Model of a UART in hardware: clocked at sixteen times its baud, three samples for each bit.

Tests derive from it the bytes that a receiver with another baud or polarity reads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from enum import StrEnum
from random import Random

OVERSAMPLING = 16
_MIDDLE = (7, 8, 9)


class AfterError(StrEnum):
    """What a receiver does after a low stop bit."""

    WAITS = "waits"
    """Wait for a high level, then for the next falling edge."""
    GOES_ON = "goes on"
    """Use the low stop bit as the next start bit, unless all bits were low: a break."""


def levels(pieces: Iterable[bytes], idle_bits: Callable[[], int]) -> Iterator[int]:
    """The line's level for each bit of the sender: the pieces, with idle time after each."""
    yield from [1] * 25
    for piece in pieces:
        for byte in piece:
            yield 0
            yield from (byte >> bit & 1 for bit in range(8))
            yield 1
        yield from [1] * idle_bits()
    yield from [1] * 25


def receive(
    line: list[int],
    sender_baud: float,
    baud: float,
    *,
    inverted: bool = False,
    after_error: AfterError = AfterError.WAITS,
    phase: float = 0.0,
) -> bytes:
    """The bytes that a receiver at `baud` reads; `phase` (0-1) is that of its clock."""
    step = sender_baud / (baud * OVERSAMPLING)
    count = int((len(line) - 1) / step - phase)
    ticks = [line[int((n + phase) * step)] ^ inverted for n in range(count)]
    out = bytearray()
    at, high = 0, False
    while at + OVERSAMPLING * 10 < count:
        if ticks[at] or not high:
            high = high or bool(ticks[at])
            at += 1
            continue
        if _bit(ticks, at):
            at += 1  # a glitch, no start bit
            continue
        byte = sum(_bit(ticks, at + OVERSAMPLING * (n + 1)) << n for n in range(8))
        out.append(byte)
        stop = at + OVERSAMPLING * 9
        good = _bit(ticks, stop)
        if good or after_error is AfterError.WAITS or not byte:
            at, high = stop + _MIDDLE[-1], bool(good)
        else:
            at, high = stop, True
    return bytes(out)


def _bit(ticks: list[int], start: int) -> int:
    return int(sum(ticks[start + n] for n in _MIDDLE) >= 2)


def received(
    seed: int,
    frames: Iterable[bytes],
    sender_baud: int,
    baud: int,
    *,
    inverted: bool = False,
    after_error: AfterError = AfterError.WAITS,
    busy: float = 0.7,
) -> bytes:
    """The bytes received of frames with random gaps; `busy` is the share without a gap.

    The sender's clock is up to 1.5 % off.
    """
    random = Random(seed)
    off = 1 + random.uniform(-0.015, 0.015)
    gap = lambda: 0 if random.random() < busy else random.randint(1, 400)  # noqa: E731
    line = list(levels(frames, gap))
    return receive(
        line,
        sender_baud * off,
        baud,
        inverted=inverted,
        after_error=after_error,
        phase=random.random(),
    )
