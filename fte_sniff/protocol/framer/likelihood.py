"""Log-likelihood of frame, damaged frame and noise bytes.

What was chosen, and why:

- One frame in ten is damaged. Readings hardly depend on it: it is small against what structure
  tells, and large enough that damage is considered at once.
- Five kinds of damage are equally likely: 1-9 adjacent bytes lost, 1-4 put in, one bit flipped,
  2-6 adjacent bytes replaced, 1-30 bytes of junk before a frame. Each place is equally likely.
- Payload bytes are not uniform: 00 and FF are common, 01-03 too, and AA, 55 and EE get a surplus.
  Without it, three payload bytes that happen to imitate a frame's first bytes would
  weigh as much as real evidence.
- Long noise (a wrong baud rate, a plugged-in cable) is rare to begin, and lasts once it began; a
  lone legal-looking frame in the midst of it has to outweigh leaving noise and beginning it anew.
- A pause on the line between two bytes is 64 times as likely between frames as within one.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from librt.vecs import vec
from mypy_extensions import i64

from fte_sniff.protocol.codec import HEADER_BYTES, LONGEST_OVERLONG, legal_bytes
from fte_sniff.protocol.spec import FRAME_LENGTH, KINDS, NUM_OFFSET, TAIL, FrameKind

DAMAGED: Final = 0.1
"""Share of frames that are damaged."""

WHOLE: Final = 1 - DAMAGED
"""Share of frames that arrive as they were sent."""

_EACH_HARM: Final = DAMAGED / 5

LONGEST_JUNK: Final = 30
"""Bytes that junk before a frame has at most; more is long noise."""

JUNK: Final = _EACH_HARM / LONGEST_JUNK
"""Weight of junk of one certain length."""

NOISE_BEGINS: Final = 1e-5
"""Weight of long noise beginning at a boundary."""

NOISE_ENDS: Final = 1 / 500
"""Weight of long noise ending at a header."""

NOISE_STAYS: Final = 1 - NOISE_ENDS

FOREIGN: Final = 0.002
"""Share of frames with a header, a tail and content that this protocol does not have."""

PAUSE_WITHIN: Final = 1 / 64
"""Weight of a pause within a frame, against one between frames."""

UNPAUSED: Final = 1 / 64
"""Weight of two pieces meeting without a pause, where other pauses show that the line has them."""

CERTAIN: Final = 0.9995
"""A frame that is at least so probable is believed; a less probable one is `ambiguous`."""

SHOWN: Final = 0.03
"""A frame that is at least so probable is shown as a frame, if no other claims its bytes."""


def _uneven(shares: Mapping[int, float]) -> tuple[float, ...]:
    """Weights of a byte's values, where some have a share of their own and the rest is even."""
    even = (1.0 - sum(shares.values(), 0.0)) / (256 - len(shares))
    return tuple(256 * shares.get(byte, even) for byte in range(256))


_IMITATING: Final = dict.fromkeys([*HEADER_BYTES, TAIL], 0.03)
_PAYLOAD: Final = _uneven({0x00: 0.25, 0xFF: 0.08, **dict.fromkeys((1, 2, 3), 0.03), **_IMITATING})
_UNUSED_NUM: Final = _uneven({0x00: 0.5})
_USUAL_FLAGS: Final = 0.9
"""Share of flag bytes that have the value of the protocol's examples."""


def _place_weights(kind: FrameKind, place: int) -> tuple[float, ...]:
    """For one place of a kind the weight of each byte value; 0 where it does not fit."""
    legal = legal_bytes(kind)[place]
    if legal is None:
        return _UNUSED_NUM if place == NUM_OFFSET else _PAYLOAD
    weights = [0.0] * 256
    usual = next((f.default for f in kind.fields if f.start == place and f.size == 1), None)
    for byte in legal:
        weights[byte] = 256 / len(legal)
        if usual is not None:
            rest = (1 - _USUAL_FLAGS) / (len(legal) - 1)
            weights[byte] = 256 * (_USUAL_FLAGS if byte == usual else rest)
    return tuple(weights)


def _choices(header: int) -> int:
    """How many CMDs a header has."""
    return sum(len(kind.cmds) for kind in KINDS if kind.header == header)


PLACE_WEIGHTS: Mapping[str, tuple[tuple[float, ...], ...]] = MappingProxyType(
    {
        kind.name: tuple(_place_weights(kind, place) for place in range(FRAME_LENGTH))
        for kind in KINDS
    }
)
"""By kind, place and byte value: the weight if that kind was sent, 0 where the byte cannot be."""

KIND_SHARE: Mapping[str, float] = MappingProxyType(
    {kind.name: len(kind.cmds) / _choices(kind.header) / len(HEADER_BYTES) for kind in KINDS}
)
"""The share of a kind among all frames: every header is equally likely, and every CMD under it."""

HEADER_WEIGHT: Final = 256 / len(HEADER_BYTES)
"""Weight of a header byte at the first place of a frame."""

BROKEN: Final = 1e-5
"""Weight of a frame damaged twice or in some other way, its tail left, of one certain length."""

UNUSUAL: Final = 0.003
"""Share of frames with reserve bytes or flags that the document does not show."""

LIKELY: Final = 0.5
"""A frame that does not fit its kind at every place is `ambiguous` if it is less probable."""

FOREIGN_FRAME: Final = FOREIGN * HEADER_WEIGHT * 256
"""Weight of ten bytes between a header and a tail, whatever they are."""


def _lost(length: int) -> float:
    """Weight of a truncated frame of `length` bytes, for one place of the loss."""
    return _EACH_HARM / (FRAME_LENGTH - 1) / (length + 1)


LOST: tuple[float, ...] = (0.0, *(_lost(length) for length in range(1, FRAME_LENGTH)))
"""By length left: weight of one certain run of bytes having been lost."""

PUT_IN: Final = _EACH_HARM / (LONGEST_OVERLONG - FRAME_LENGTH) / (FRAME_LENGTH - 1)
"""Weight of one certain number of bytes having been put in at one certain place."""


def _changed(width: int) -> float:
    if width == 1:
        return _EACH_HARM / FRAME_LENGTH / 8
    return _EACH_HARM / 5 / (FRAME_LENGTH + 1 - width)


WIDEST_CHANGE: Final = 6
"""Bytes that one replacement changes at most."""

CHANGED: tuple[float, ...] = (0.0, *(_changed(width) for width in range(1, WIDEST_CHANGE + 1)))
"""By width: weight of that many adjacent bytes having been changed at one certain place."""


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
