"""Is a line at the wrong baud rate."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from math import exp, log
from random import Random
from typing import Final

from fte_sniff.protocol import (
    KINDS,
    Chunk,
    Direction,
    Fault,
    Field,
    Frame,
    FrameKind,
    Framer,
    Status,
    encode,
)

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


COMMON_BAUDS: Final = (
    9_600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800,
    500_000, 921_600, 1_000_000, 1_500_000, 2_000_000, 3_000_000,
)  # fmt: skip
"""Bauds that adapters and controllers are set to."""

SOUND_SHARE: Final = 0.9
"""Share of bytes in readable frames from which on a line is sound."""

DAMAGED_SHARE: Final = 0.2
"""Share of bytes in readable frames from which on it is the right line, but a bad one."""

FEW_BYTES: Final = 30
"""Fewer bytes than this, without a frame, tell nothing."""

SURE: Final = 0.9
"""Probability from which on a guess is named alone."""

_LOW_SHARE = 0.97
_TEXT = frozenset(range(0x20, 0x7F)) | frozenset(b"\t\r\n")
_TEXT_SHARE = 0.95
_MOST_BYTES = 600
_FRAMES_EACH = 400
_MOST_HEARD = 1000
_IDLE_BITS = (0, 0, 3, 0, 57, 0, 211, 17)
_SMOOTHING = 0.5
_POLARITY_SHOWS = 2.0
"""A line that is so many times faster than the receiver looks the same with swapped polarity."""
_CAUTION = 3.0
"""Neighbouring bytes are not independent: so many tell as much as one would."""


class Condition(StrEnum):
    """What a line is like."""

    SOUND = "sound"
    DAMAGED = "damaged"
    SILENT = "silent"
    LOW = "low"
    """Held low: nothing but 00 comes."""
    TOO_LITTLE = "too little"
    WRONG_BAUD = "wrong baud"
    INVERTED = "inverted"
    TEXT = "text"
    FOREIGN = "foreign"
    """None of all these."""


@dataclass(frozen=True, slots=True)
class Setting:
    """How a line may truly be set."""

    baud: int
    inverted: bool


@dataclass(frozen=True, slots=True)
class Verdict:
    """What is thought of a line."""

    condition: Condition
    size: int
    """Bytes that came."""
    share: float
    """Share of them in readable frames, 0-1."""
    directions: frozenset[Direction] = frozenset()
    """Which way the readable frames go."""
    guesses: tuple[tuple[Setting, float], ...] = ()
    """Settings that would explain the bytes, with probabilities (0-1), the likeliest first."""


def judge(data: bytes, baud: int) -> Verdict:
    """What the bytes that came at `baud` say of the line."""
    plain = judge_frames(data)
    if plain is not None:
        return plain
    guesses = tuple(_guesses(data[:_MOST_BYTES], baud)) if len(data) >= FEW_BYTES else ()
    condition = _condition_without_frames(data, baud, guesses)
    return Verdict(condition, len(data), _share(data, readable_frames(data)), guesses=guesses)


def judge_frames(data: bytes) -> Verdict | None:
    """The verdict where there are frames enough for one, or nothing at all; quick. None elsewhere.

    Whatever the baud is at which the bytes came, frames in them prove it right.
    """
    if not data:
        return Verdict(Condition.SILENT, 0, 0.0)
    frames = readable_frames(data)
    share = _share(data, frames)
    if share < DAMAGED_SHARE or (share < SOUND_SHARE and len(frames) < 2):
        return None
    directions = frozenset(frame.direction for frame in frames)
    condition = Condition.SOUND if share >= SOUND_SHARE else Condition.DAMAGED
    return Verdict(condition, len(data), share, directions)


def _share(data: bytes, frames: list[Frame]) -> float:
    return sum(len(frame.raw) for frame in frames) / len(data)


def readable_frames(data: bytes) -> list[Frame]:
    """The frames in `data` that can be believed."""
    framer = Framer("line")
    rows = framer.feed(Chunk("line", None, data)) + framer.flush()
    return [
        row
        for row in rows
        if isinstance(row, Frame)
        and row.status is not Status.MALFORMED
        and Fault.AMBIGUOUS not in row.faults
    ]


def _condition_without_frames(
    data: bytes, baud: int, guesses: tuple[tuple[Setting, float], ...]
) -> Condition:
    if data.count(0) >= _LOW_SHARE * len(data):
        return Condition.LOW
    if len(data) < FEW_BYTES:
        return Condition.TOO_LITTLE
    if sum(byte in _TEXT for byte in data) >= _TEXT_SHARE * len(data):
        return Condition.TEXT
    if not guesses:
        return Condition.FOREIGN
    inverted = sum(
        probability
        for setting, probability in guesses
        if setting.inverted and setting.baud <= _POLARITY_SHOWS * baud
    )
    return Condition.INVERTED if inverted > 0.5 else Condition.WRONG_BAUD


def _guesses(data: bytes, baud: int) -> Iterator[tuple[Setting, float]]:
    """The settings that explain the bytes better than chance does, each with its probability."""
    counts = Counter(data)
    best_of: dict[Setting, float] = {}
    for setting, logs in _models(baud):
        score = sum(count * logs[byte] for byte, count in counts.items()) / _CAUTION
        best_of[setting] = max(score, best_of.get(setting, score))
    chance = -len(data) * log(256) / _CAUTION
    top = max(best_of.values())
    if top <= chance:
        return
    weights = {setting: exp(score - top) for setting, score in best_of.items()}
    whole = sum(weights.values())
    for setting, weight in sorted(weights.items(), key=lambda pair: -pair[1]):
        if weight / whole >= 0.01:
            yield setting, weight / whole


@cache
def _models(baud: int) -> tuple[tuple[Setting, list[float]], ...]:
    """How likely each byte is that is heard at `baud`, for each setting and kind of traffic."""
    found = []
    for pieces in _traffics():
        levels = line_levels(pieces, _IDLE_BITS)
        falls = falls_of(levels, 0), falls_of(levels, 1)
        for setting in _settings_but(baud):
            low, pace = int(setting.inverted), setting.baud / baud
            for resync in Resync:
                data = heard(levels, falls[low], low, pace, resync, _MOST_HEARD)
                found.append((setting, _logs(data)))
    return tuple(found)


def _settings_but(baud: int) -> Iterator[Setting]:
    for inverted in (False, True):
        for other in sorted({*COMMON_BAUDS, baud}):
            if inverted or other != baud:
                yield Setting(other, inverted)


def _logs(data: bytes) -> list[float]:
    counts = Counter(data)
    whole = len(data) + 256 * _SMOOTHING
    return [log((counts[byte] + _SMOOTHING) / whole) for byte in range(256)]


def _traffics() -> Iterator[list[bytes]]:
    """Frames as they are on a wire, of each kind alone, of each direction and of all; always the
    same ones.
    """
    random = Random("traffic")
    told = [kind for kind in KINDS if kind.fields]
    groups = [[kind] for kind in told]
    groups += [[kind for kind in told if kind.direction is way] for way in Direction]
    for kinds in (*groups, told):
        yield [_frame(random, random.choice(kinds)) for _ in range(_FRAMES_EACH)]


def _frame(random: Random, kind: FrameKind) -> bytes:
    values = {field.name: _value(random, field) for field in kind.fields}
    return encode(kind, values, kind.cmds[0])


def _value(random: Random, field: Field) -> int:
    if field.name in ("error", "online"):
        return 0x0F if field.name == "online" else 0
    if field.name == "motor":
        return random.randint(field.low, field.high)
    if random.random() < 0.3:
        return 0
    spread = 600 if field.size == 2 else 20_000
    return max(field.low, min(field.high, round(random.gauss(0, spread))))
