"""Owns what noise weighs, short or long, by its length and by what is behind it.

It must not know where noise stands. The shares that it is made of stand in `likelihood`.
"""

from __future__ import annotations

from typing import Final

from librt.vecs import vec
from mypy_extensions import i64

from fte_sniff.protocol.framer.likelihood import (
    JUNK,
    LONGEST_JUNK,
    NOISE_BEGINS,
    NOISE_ENDS,
    NOISE_STAYS,
)

_LONGEST: Final = 512
"""Bytes of the longest stretch that is weighed; the framer never asks for as many."""

# What is known of the line behind a stretch

OPEN: Final[i64] = 0
"""Bytes may follow at once."""
CLOSED: Final[i64] = 1
"""Silence, or the end of the stream."""
BOUNDARY: Final[i64] = 2
"""No frame goes on behind it."""

_GOES_ON: Final[vec[float]] = vec[float]([1.0, NOISE_ENDS, NOISE_ENDS])
_STAYING: Final[vec[float]] = vec[float]([NOISE_STAYS**length for length in range(_LONGEST + 1)])


def _to_header(length: int) -> float:
    if not length:
        return 0.0
    long = NOISE_BEGINS * NOISE_STAYS ** (length - 1) * NOISE_ENDS
    return long + (JUNK if length <= LONGEST_JUNK else 0.0)


def _run(length: int) -> float:
    if length <= LONGEST_JUNK:
        return JUNK
    return NOISE_BEGINS * NOISE_ENDS * NOISE_STAYS ** (length - 1)


def _to_end(ending: i64, length: int) -> float:
    if not length:
        return 1.0
    lengths = LONGEST_JUNK + 1 - length if ending == OPEN else 1
    junk = JUNK * lengths if length <= LONGEST_JUNK else 0.0
    return junk + NOISE_BEGINS * NOISE_STAYS ** (length - 1) * _GOES_ON[ending]


NOISE_TO_HEADER: Final[vec[float]] = vec[float](
    [_to_header(length) for length in range(_LONGEST + 1)]
)
"""By length: the weight of noise, short or long, up to a header."""

_RUNS: Final[vec[float]] = vec[float]([_run(length) for length in range(_LONGEST + 1)])
_TO_END: Final[vec[float]] = vec[float](
    [
        _to_end(ending, length)
        for ending in (OPEN, CLOSED, BOUNDARY)
        for length in range(_LONGEST + 1)
    ]
)


def staying(length: i64) -> float:
    """The weight of long noise going on for so many bytes."""
    return _STAYING[length]


def unending(ending: i64) -> float:
    """The weight of long noise at the end of a stretch."""
    return _GOES_ON[ending]


def noise_to_end(ending: i64, length: i64) -> float:
    """The weight of noise of so many bytes up to the end of a stretch; 1 for none."""
    return _TO_END[ending * (_LONGEST + 1) + length]


def noise_run(length: i64) -> float:
    """The weight of one run of noise of so many bytes, if it is the likelier of short and long."""
    return _RUNS[length]
