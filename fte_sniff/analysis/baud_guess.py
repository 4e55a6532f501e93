"""Diagnosis of a line: sound, silent, inverted, or at another baud rate.

Without readable frames, the received bytes are compared with models: the byte frequencies that a
UART at our baud rate receives from a simulated sender at another baud rate or polarity. The most
likely models give the guesses (a naive Bayes classifier).
"""

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
from fte_sniff.protocol.spec import Role

_DATA_BITS: Final = 8
_STOP: Final = _DATA_BITS + 1


class Resync(StrEnum):
    """What a receiver does after a low stop bit (a framing error)."""

    BY_EDGE = "by edge"
    """It waits for the next falling edge."""
    AT_ONCE = "at once"
    """It takes the low bit as the next start bit; after a break it waits for an edge too."""


def line_levels(messages: Iterable[bytes], idle_bits: Sequence[int]) -> bytes:
    """The levels of an 8N1 line, one byte (0 or 1) a bit, that carries messages.

    `idle_bits` are the bit times of idle after the first message, the second, ..., repeating.
    """
    levels = bytearray(b"\1\1")
    for number, message in enumerate(messages):
        for byte in message:
            levels.append(0)
            levels += bytes(byte >> bit & 1 for bit in range(_DATA_BITS))
            levels.append(1)
        levels += b"\1" * idle_bits[number % len(idle_bits)]
    return bytes(levels)


def falling_edges(levels: bytes, low: int) -> list[int]:
    """The indices at which a line changes to the level `low`."""
    edge, found = bytes((1 - low, low)), []
    at = levels.find(edge)
    while at >= 0:
        found.append(at + 1)
        at = levels.find(edge, at + 2)
    return found


def received(
    levels: bytes, edges: Sequence[int], low: int, pace: float, resync: Resync, most: int
) -> bytes:
    """The first bytes that a UART receives from a line.

    Args:
        levels: the line.
        edges: its `falling_edges`.
        low: the level that is received as low: 0, or 1 with inverted polarity.
        pace: bits of the sender in one bit of the receiver.
        resync: behaviour after a framing error.
        most: the largest number of bytes.
    """
    out = bytearray()
    middles = [(bit + 0.5) * pace for bit in range(_STOP + 1)]
    end = len(levels) - middles[_STOP] - 1
    start: float | None = _edge_from(edges, 0)
    while start is not None and start < end and len(out) < most:
        if levels[int(start + middles[0])] != low:
            start = _edge_from(edges, start + middles[0])
            continue
        byte = 0
        for bit in range(_DATA_BITS):
            byte |= (levels[int(start + middles[bit + 1])] != low) << bit
        out.append(byte)
        stop = start + middles[_STOP]
        if resync is Resync.AT_ONCE and byte and levels[int(stop)] == low:
            start += _STOP * pace
        else:
            start = _edge_from(edges, stop)
    return bytes(out)


def _edge_from(edges: Sequence[int], at: float) -> int | None:
    found = bisect_left(edges, at)
    return edges[found] if found < len(edges) else None


COMMON_BAUDS: Final = (
    9_600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800,
    500_000, 921_600, 1_000_000, 1_500_000, 2_000_000, 3_000_000,
)  # fmt: skip
"""Baud rates of common adapters and controllers."""

SOUND_SHARE: Final = 0.9
"""Share of bytes in readable frames from which a line is sound."""

DAMAGED_SHARE: Final = 0.2
"""Share of bytes in readable frames from which the baud rate is right, but the line is bad."""

FEW_BYTES: Final = 30
"""Fewer bytes than this without a frame give no diagnosis."""

SURE: Final = 0.9
"""Probability from which a guess is reported alone."""

_LOW_SHARE: Final = 0.97
_TEXT: Final = frozenset(range(0x20, 0x7F)) | frozenset(b"\t\r\n")
_TEXT_SHARE: Final = 0.95
_MOST_BYTES: Final = 600
_MODEL_FRAMES: Final = 400
_MODEL_BYTES: Final = 1000
_MODEL_IDLE_BITS: Final = (0, 0, 3, 0, 57, 0, 211, 17)
_SMOOTHING: Final = 0.5
_POLARITY_RATIO: Final = 2.0
"""A line this much faster than the receiver gives the same bytes in both polarities."""
_CORRELATION: Final = 3.0
"""Adjacent bytes are correlated; this many count as one independent observation."""
_LEAST_PROBABILITY: Final = 0.01


class LineCondition(StrEnum):
    """State of a line."""

    SOUND = "sound"
    DAMAGED = "damaged"
    SILENT = "silent"
    LOW = "low"
    """Held low: only 00 is received."""
    TOO_LITTLE = "too little"
    WRONG_BAUD = "wrong baud"
    INVERTED = "inverted"
    TEXT = "text"
    FOREIGN = "foreign"


@dataclass(frozen=True, slots=True)
class LineSetting:
    """Baud rate and polarity of a sender."""

    baud: int
    inverted: bool


@dataclass(frozen=True, slots=True)
class LineDiagnosis:
    """State of a line, and its likely settings."""

    condition: LineCondition
    size: int
    share: float
    """Share of them in readable frames, 0 to 1."""
    directions: frozenset[Direction] = frozenset()
    guesses: tuple[tuple[LineSetting, float], ...] = ()
    """Settings that explain the bytes, with probabilities (0 to 1), the most likely first."""


def diagnose(data: bytes, baud: int) -> LineDiagnosis:
    """Diagnose a line from bytes that were received at `baud`."""
    by_frames = diagnose_frames(data)
    if by_frames is not None:
        return by_frames
    guesses = tuple(_guesses(data[:_MOST_BYTES], baud)) if len(data) >= FEW_BYTES else ()
    condition = _condition(data, baud, guesses)
    return LineDiagnosis(condition, len(data), _share(data, readable_frames(data)), guesses=guesses)


def diagnose_frames(data: bytes) -> LineDiagnosis | None:
    """Diagnose a line by its frames alone, which is fast; None if there are too few.

    Frames prove that the baud rate is right.
    """
    if not data:
        return LineDiagnosis(LineCondition.SILENT, 0, 0.0)
    frames = readable_frames(data)
    share = _share(data, frames)
    if share < DAMAGED_SHARE or (share < SOUND_SHARE and len(frames) < 2):
        return None
    directions = frozenset(frame.direction for frame in frames)
    condition = LineCondition.SOUND if share >= SOUND_SHARE else LineCondition.DAMAGED
    return LineDiagnosis(condition, len(data), share, directions)


def _share(data: bytes, frames: list[Frame]) -> float:
    return sum(len(frame.raw) for frame in frames) / len(data)


def readable_frames(data: bytes) -> list[Frame]:
    """The frames in `data` that are neither malformed nor ambiguous."""
    framer = Framer("line")
    rows = framer.feed(Chunk("line", None, data)) + framer.flush()
    return [
        row
        for row in rows
        if isinstance(row, Frame)
        and row.status is not Status.MALFORMED
        and Fault.AMBIGUOUS not in row.faults
    ]


def _condition(
    data: bytes, baud: int, guesses: tuple[tuple[LineSetting, float], ...]
) -> LineCondition:
    if data.count(0) >= _LOW_SHARE * len(data):
        return LineCondition.LOW
    if len(data) < FEW_BYTES:
        return LineCondition.TOO_LITTLE
    if sum(byte in _TEXT for byte in data) >= _TEXT_SHARE * len(data):
        return LineCondition.TEXT
    if not guesses:
        return LineCondition.FOREIGN
    inverted = sum(
        probability
        for setting, probability in guesses
        if setting.inverted and setting.baud <= _POLARITY_RATIO * baud
    )
    return LineCondition.INVERTED if inverted > 0.5 else LineCondition.WRONG_BAUD


def _guesses(data: bytes, baud: int) -> Iterator[tuple[LineSetting, float]]:
    """The settings that explain the bytes better than chance, with their probabilities."""
    counts = Counter(data)
    scores: dict[LineSetting, float] = {}
    for setting, logs in _models(baud):
        score = sum(count * logs[byte] for byte, count in counts.items()) / _CORRELATION
        scores[setting] = max(score, scores.get(setting, score))
    chance = -len(data) * log(256) / _CORRELATION
    best = max(scores.values())
    if best <= chance:
        return
    likelihoods = {setting: exp(score - best) for setting, score in scores.items()}
    total = sum(likelihoods.values())
    for setting, likelihood in sorted(likelihoods.items(), key=lambda pair: -pair[1]):
        if likelihood / total >= _LEAST_PROBABILITY:
            yield setting, likelihood / total


@cache
def _models(baud: int) -> tuple[tuple[LineSetting, list[float]], ...]:
    """Log-probabilities of bytes received at `baud`, by setting, traffic and resync."""
    found = []
    for messages in _traffic():
        levels = line_levels(messages, _MODEL_IDLE_BITS)
        edges = falling_edges(levels, 0), falling_edges(levels, 1)
        for setting in _settings_except(baud):
            low, pace = int(setting.inverted), setting.baud / baud
            for resync in Resync:
                data = received(levels, edges[low], low, pace, resync, _MODEL_BYTES)
                found.append((setting, _log_probabilities(data)))
    return tuple(found)


def _settings_except(baud: int) -> Iterator[LineSetting]:
    for inverted in (False, True):
        for other in sorted({*COMMON_BAUDS, baud}):
            if inverted or other != baud:
                yield LineSetting(other, inverted)


def _log_probabilities(data: bytes) -> list[float]:
    counts = Counter(data)
    total = len(data) + 256 * _SMOOTHING
    return [log((counts[byte] + _SMOOTHING) / total) for byte in range(256)]


def _traffic() -> Iterator[list[bytes]]:
    """Typical frames of each kind, of each direction, and of all; always the same."""
    random = Random("traffic")
    kinds = [kind for kind in KINDS if kind.fields]
    groups = [[kind] for kind in kinds]
    groups += [[kind for kind in kinds if kind.direction is way] for way in Direction]
    for group in (*groups, kinds):
        yield [_frame(random, random.choice(group)) for _ in range(_MODEL_FRAMES)]


def _frame(random: Random, kind: FrameKind) -> bytes:
    values = {field.name: _value(random, field) for field in kind.fields}
    return encode(kind, values, kind.cmds[0])


def _value(random: Random, field: Field) -> int:
    if field.default is not None:
        return field.default
    if field.role is Role.MOTOR:
        return random.randint(field.low, field.high)
    if random.random() < 0.3:
        return 0
    spread = 600 if field.size == 2 else 20_000
    return max(field.low, min(field.high, round(random.gauss(0, spread))))
