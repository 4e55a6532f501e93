"""The bytes of two wires that a log has one after the other, without saying which is whose.

A logic analyser writes a line for each byte of either wire, in the order of time. While both send,
the bytes alternate. The frames show the wires: each has frames of one header, and few other bytes.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Final, NamedTuple

from fte_sniff.protocol.spec import (
    FRAME_LENGTH,
    FTE_FORMAT,
    HEADERS,
    KINDS,
    TAIL,
    Direction,
)

WIRES: Final = ("tx", "rx")
"""Their labels: that of control frames first."""
_HEADERS: Final = (HEADERS[Direction.CONTROL], HEADERS[Direction.FEEDBACK])
_WHOLE: Final = 20.0
_NOISE: Final = -4.0
_TWICE: Final = -2.0
"""Scores of a whole frame, a byte outside frames, and two bytes of one wire while both send."""
_BEHIND: Final = 24.0
"""How much less than the best score a reading is dropped at."""
_CLEAR: Final = 16.0
"""How much less the others' scores are if one reading is clearly the best."""
_MOST_READINGS: Final = 48
_LONGEST_UNDECIDED: Final = 1000
"""Bytes that wait at most until one reading is clearly the best."""


class _Path(NamedTuple):
    """The wires of the last bytes of a reading."""

    before: _Path | None
    wire: int


class _Reading(NamedTuple):
    """A reading of the bytes so far."""

    score: float
    path: _Path | None


_State = tuple[int, int, int]
"""Bytes of the frame that each wire sends, 0 for none, and the wire of the last byte."""


@cache
def _legal(wire: int) -> tuple[frozenset[int], ...]:
    """The legal values of each byte of the frames of a wire."""
    own = [FTE_FORMAT.legal_bytes(kind) for kind in KINDS]
    own = [legal for legal in own if legal[0] and legal[0][0] == _HEADERS[wire]]
    every = frozenset(range(256))
    first = [frozenset(value for legal in own for value in (legal[at] or every)) for at in range(3)]
    return (*first, *[every] * (FRAME_LENGTH - 4), frozenset([TAIL]))


class Weave:
    """Decides to which of two wires each byte belongs, by the frames that then are whole."""

    def __init__(self) -> None:
        self._readings: dict[_State, _Reading] = {(0, 0, 0): _Reading(0.0, None)}
        self._size = 0
        """Bytes that are not decided."""

    def push(self, data: bytes, *, final: bool = False) -> bytes:
        """Append bytes; the wires, 0 or 1, of the bytes that are decided now, in their order."""
        decided = bytearray()
        for byte in data:
            self._readings = self._after(byte)
            self._size += 1
            state, best = max(self._readings.items(), key=lambda own: own[1].score)
            near = sum(own.score > best.score - _CLEAR for own in self._readings.values())
            is_clear = near == 1 and state[:2] == (0, 0)
            if is_clear or self._size >= _LONGEST_UNDECIDED:
                decided += self._decide(state, best)
        if final and self._size:
            decided += self._decide(*max(self._readings.items(), key=lambda own: own[1].score))
        return bytes(decided)

    def _decide(self, state: _State, best: _Reading) -> bytes:
        wires, path = bytearray(), best.path
        while path is not None:
            wires.append(path.wire)
            path = path.before
        self._readings, self._size = {state: _Reading(0.0, None)}, 0
        return bytes(wires[::-1])

    def _after(self, byte: int) -> dict[_State, _Reading]:
        """The readings with one more byte, the best of each state."""
        readings = dict[_State, _Reading]()
        for state, reading in self._readings.items():
            for after, gain in _steps(state, byte):
                score = reading.score + gain
                if after not in readings or readings[after].score < score:
                    readings[after] = _Reading(score, _Path(reading.path, after[2]))
        least = max(own.score for own in readings.values()) - _BEHIND
        kept = {state: own for state, own in readings.items() if own.score >= least}
        if len(kept) > _MOST_READINGS:
            best = sorted(kept.items(), key=lambda own: -own[1].score)[:_MOST_READINGS]
            kept = dict(best)
        return kept


def _steps(state: _State, byte: int) -> Iterator[tuple[_State, float]]:
    """What a state may be after a byte, and the gain of score."""
    *seen, last = state
    for wire in (0, 1):
        if byte in _legal(wire)[seen[wire]]:
            is_twice = wire == last and seen[0] > 0 and seen[1] > 0
            sizes = [*seen]
            sizes[wire] = (seen[wire] + 1) % FRAME_LENGTH
            gain = (_WHOLE if sizes[wire] == 0 else 0.0) + (_TWICE if is_twice else 0.0)
            yield (sizes[0], sizes[1], wire), gain
    yield state, _NOISE
    for wire in (0, 1):  # the frame that it was is none
        if seen[wire]:
            sizes = [*seen]
            sizes[wire] = 0
            yield (sizes[0], sizes[1], wire), _NOISE * (1 + seen[wire])


def unwoven(data: bytes) -> tuple[bytes, bytes]:
    """The bytes of each wire."""
    wires = Weave().push(data, final=True)
    pairs = [*zip(data, wires, strict=True)]
    control, feedback = (bytes(byte for byte, own in pairs if own == wire) for wire in (0, 1))
    return control, feedback
