"""Likelihood model: scores of frames, damaged frames and noise.

A score is a prior probability times a likelihood ratio: the probability of the bytes if they were
sent as described, divided by their probability as random bytes (1/256 each). So a random byte
scores 1. Scores are multiplied, not added as logarithms: a span is short enough for floats.

The assumptions:

- One frame in ten is damaged. The result hardly depends on this number.
- Five kinds of damage are equally likely, and so is each position of it: 1 to n-1 adjacent bytes of
  a frame of n bytes lost, 1-4 inserted, one bit flipped, 2-6 adjacent bytes replaced, 1-30 bytes of
  junk before a frame.
- Payload bytes are not uniform: 00, FF and 01-03 are common, and headers and tails get a surplus,
  so that a payload that imitates the first bytes of a frame is weak evidence.
- Reserve bytes are a property of the line. Where it has a constant, nearly every frame has it;
  elsewhere they are payload bytes (see `reserve`).
- Long noise (a wrong baud rate, a plugged-in cable) rarely begins, but lasts.
- A pause on the line is 64 times as likely between two frames as within one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from librt.vecs import vec
from mypy_extensions import i64

from fte_sniff.protocol.spec import NUM_OFFSET, FrameFormat, FrameKind

# Priors

DAMAGED: Final = 0.1
"""Share of frames that are damaged."""

INTACT: Final = 1 - DAMAGED
"""Share of frames that arrive as they were sent."""

_EACH_DAMAGE: Final = DAMAGED / 5

MOST_INSERTED: Final = 4
"""Largest number of bytes inserted into a frame."""

WIDEST_CHANGE: Final = 6
"""Largest number of adjacent bytes that one replacement changes."""

LONGEST_JUNK: Final = 30
"""Largest number of junk bytes before a frame; more is long noise."""

JUNK: Final = _EACH_DAMAGE / LONGEST_JUNK
"""Score of junk of one given length."""

NOISE_BEGINS: Final = 1e-5
"""Score of long noise that begins at a boundary between segments."""

NOISE_ENDS: Final = 1 / 500
"""Score of long noise that ends at a header."""

NOISE_CONTINUES: Final = 1 - NOISE_ENDS
"""Score of one more byte of long noise."""

FOREIGN: Final = 0.002
"""Share of frames with a header, a tail, and a CMD that is not in the frame table."""

UNUSUAL: Final = 0.003
"""Share of frames with undefined flags, or with a reserve that the line does not have elsewhere."""

BROKEN: Final = 1e-5
"""Score of a frame of one given length, damaged twice or in another way, that keeps its tail."""

PAUSE_WITHIN: Final = 1 / 64
"""Score of a pause within a frame, relative to one between frames."""

NO_PAUSE_BETWEEN: Final = 1 / 64
"""Score of two segments that meet without a pause, on a line whose bytes show other pauses."""

# Decision thresholds (posterior probabilities)

CERTAIN: Final = 0.9995
"""A whole frame below this probability is `ambiguous`."""

LIKELY: Final = 0.5
"""A frame with other faults is also `ambiguous` below this probability."""

SHOWN: Final = 0.03
"""A whole frame below this probability is not shown as a frame."""


# Scores that depend on the frame table


def _distribution(shares: Mapping[int, float]) -> tuple[float, ...]:
    """The score of each byte value: `shares` for the values in it, the rest is uniform."""
    rest = (1.0 - sum(shares.values(), 0.0)) / (256 - len(shares))
    return tuple(256 * shares.get(byte, rest) for byte in range(256))


_UNUSED_NUM: Final = _distribution({0x00: 0.5})
_USUAL_FLAGS: Final = 0.9
"""Share of flag bytes that have their default value."""


def payload_scores(frame_format: FrameFormat) -> tuple[float, ...]:
    """The score of each byte value in a payload where every byte is legal."""
    common = dict.fromkeys((1, 2, 3, *frame_format.headers.values(), frame_format.tail), 0.03)
    return _distribution({0x00: 0.25, 0xFF: 0.08, **common})


def byte_scores(
    frame_format: FrameFormat, kind: FrameKind, legal: Sequence[bytes | None]
) -> list[tuple[float, ...]]:
    """For each offset in a frame of a kind the score of each byte value; 0 for illegal values.

    `legal` are the kind's legal bytes; see `FrameFormat.legal_bytes`.
    """
    payload = payload_scores(frame_format)
    defaults = {f.start: f.default for f in kind.fields if f.default is not None}
    scores: list[tuple[float, ...]] = []
    for offset, own in enumerate(legal):
        if own is not None or offset in defaults:
            scores.append(_legal_scores(own or bytes(range(256)), defaults.get(offset)))
        elif offset == NUM_OFFSET and not kind.names_motor:
            scores.append(_UNUSED_NUM)
        else:
            scores.append(payload)
    return scores


def _legal_scores(legal: bytes, default: int | None) -> tuple[float, ...]:
    scores = [0.0] * 256
    for byte in legal:
        scores[byte] = 256 / len(legal)
        if default is not None:
            rest = (1 - _USUAL_FLAGS) / (len(legal) - 1)
            scores[byte] = 256 * (_USUAL_FLAGS if byte == default else rest)
    return tuple(scores)


def kind_share(frame_format: FrameFormat, kind: FrameKind) -> float:
    """The share of a kind among all frames: headers are equally likely, and CMDs of a header."""
    same_header = [k for k in frame_format.kinds if k.direction == kind.direction]
    cmds = sum(len(k.cmds) for k in same_header)
    return len(kind.cmds) / cmds / len(frame_format.headers)


def truncation_scores(length: int) -> tuple[float, ...]:
    """By number of bytes left: the score of one given run of bytes lost from `length` bytes."""
    return (0.0, *(_EACH_DAMAGE / (length - 1) / (left + 1) for left in range(1, length)))


def insertion_score(length: int) -> float:
    """The score of a given number of bytes inserted at a given offset of `length` bytes."""
    return _EACH_DAMAGE / MOST_INSERTED / (length - 1)


def change_scores(length: int) -> tuple[float, ...]:
    """By width: the score of that many bytes changed at a given offset of `length` bytes."""
    flipped = _EACH_DAMAGE / length / 8
    widths = range(2, WIDEST_CHANGE + 1)
    return (0.0, flipped, *(_EACH_DAMAGE / 5 / (length + 1 - width) for width in widths))


# Noise

OPEN: Final[i64] = 0
"""More bytes may follow the span at once."""
CLOSED: Final[i64] = 1
"""Silence or the end of the stream follows the span."""
BOUNDARY: Final[i64] = 2
"""No frame continues after the span."""

_LONGEST_SPAN: Final = 512
"""Length of the noise tables; the framer decodes shorter spans only."""

NOISE_AT_END: Final[vec[float]] = vec[float]([1.0, NOISE_ENDS, NOISE_ENDS])
"""By ending: the score of long noise at the end of a span."""

_LENGTHS: Final = range(_LONGEST_SPAN + 1)


def _to_header(length: int) -> float:
    if not length:
        return 0.0
    long = NOISE_BEGINS * NOISE_CONTINUES ** (length - 1) * NOISE_ENDS
    return long + (JUNK if length <= LONGEST_JUNK else 0.0)


def _best_run(length: int) -> float:
    if length <= LONGEST_JUNK:
        return JUNK
    return NOISE_BEGINS * NOISE_ENDS * NOISE_CONTINUES ** (length - 1)


def _to_end(ending: i64, length: int) -> float:
    if not length:
        return 1.0
    lengths = LONGEST_JUNK + 1 - length if ending == OPEN else 1
    junk = JUNK * lengths if length <= LONGEST_JUNK else 0.0
    return junk + NOISE_BEGINS * NOISE_CONTINUES ** (length - 1) * NOISE_AT_END[ending]


# By length in bytes:
NOISE_RUN: Final[vec[float]] = vec[float]([_best_run(length) for length in _LENGTHS])
"""The score of noise, as the likelier of junk and long noise."""

LONG_NOISE: Final[vec[float]] = vec[float]([NOISE_CONTINUES**length for length in _LENGTHS])
"""The score of long noise that continues."""

NOISE_TO_HEADER: Final[vec[float]] = vec[float]([_to_header(length) for length in _LENGTHS])
"""The score of noise, short or long, before a header."""

_TO_END: Final[vec[float]] = vec[float](
    [_to_end(ending, length) for ending in (OPEN, CLOSED, BOUNDARY) for length in _LENGTHS]
)


def noise_to_end(ending: i64, length: i64) -> float:
    """The score of `length` bytes of noise up to the end of a span; 1 for none."""
    return _TO_END[ending * (_LONGEST_SPAN + 1) + length]
