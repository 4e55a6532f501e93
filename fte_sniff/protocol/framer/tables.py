"""Precomputed lookup tables (header/command, fault sets)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

from librt.vecs import vec
from mypy_extensions import i64

from fte_sniff.protocol.codec import HEADER_BYTES, frame_faults, legal_bytes
from fte_sniff.protocol.framer.likelihood import KIND_SHARE, PLACE_WEIGHTS
from fte_sniff.protocol.spec import (
    FRAME_LENGTH,
    KIND_BY_HEADER_AND_CMD,
    KINDS,
    MOTORS,
    NUM_OFFSET,
    TAIL,
    Fault,
    FrameKind,
)

_ORDER: Final = (
    Fault.UNKNOWN_CMD,
    Fault.BAD_MOTOR,
    Fault.BAD_HEADER,
    Fault.BAD_TAIL,
    Fault.TRUNCATED,
    Fault.OVERLONG,
    Fault.NOISE,
    Fault.UNDEFINED_FLAGS,
    Fault.RESERVED_NONZERO,
    Fault.AMBIGUOUS,
)
"""As a row names them; what the framer does not give is missing."""

_BITS: Final = {fault: 1 << number for number, fault in enumerate(_ORDER)}


def set_of(faults: Iterable[Fault]) -> int:
    """The number of these faults."""
    return sum(_BITS[fault] for fault in faults)


UNKNOWN_CMD: Final[i64] = _BITS[Fault.UNKNOWN_CMD]
BAD_HEADER: Final[i64] = _BITS[Fault.BAD_HEADER]
BAD_TAIL: Final[i64] = _BITS[Fault.BAD_TAIL]
TRUNCATED: Final[i64] = _BITS[Fault.TRUNCATED]
OVERLONG: Final[i64] = _BITS[Fault.OVERLONG]
NOISE: Final[i64] = _BITS[Fault.NOISE]
AMBIGUOUS: Final[i64] = _BITS[Fault.AMBIGUOUS]

FAULT_SETS: Final[list[tuple[Fault, ...]]] = [
    tuple([fault for fault in _ORDER if number & _BITS[fault]])
    for number in range(1 << len(_ORDER))
]
"""By number: the faults, in the order in which a row names them."""


LENGTH: Final[i64] = FRAME_LENGTH
"""Bytes in every frame."""

COUNT: Final[i64] = len(KINDS)
"""How many kinds there are."""

NO_KIND: Final[i64] = 255
"""Stands in `KIND_OF` where header and CMD name no kind."""

# What a byte can be in a stream

HEADER: Final[i64] = 1
ENDING: Final[i64] = 2

MARKS: Final = bytes(
    HEADER if value in HEADER_BYTES else ENDING if value == TAIL else 0 for value in range(256)
)
"""By byte: whether it is a header, the tail (`ENDING`), or neither (0)."""


def _kind_of() -> bytes:
    numbers = {kind.name: number for number, kind in enumerate(KINDS)}
    found = bytearray([NO_KIND]) * (1 << 16)
    for (header, cmd), kind in KIND_BY_HEADER_AND_CMD.items():
        found[header << 8 | cmd] = numbers[kind.name]
    return bytes(found)


KIND_OF: Final = _kind_of()
"""By header * 256 + CMD: the kind that they name."""


def _cmds(kinds: Iterator[FrameKind]) -> bytes:
    cmds = {cmd for kind in kinds for cmd in kind.cmds}
    return bytes(value in cmds for value in range(256))


NAMES_CMD: Final = _cmds(kind for kind in KINDS)
"""By byte: 1 where it is the CMD of a frame."""

BRINGS_VALUES: Final = _cmds(kind for kind in KINDS if kind.fields)
"""By byte: 1 where it is the CMD of a frame that brings values."""

NAMES_MOTOR: Final = bytes(value == 0 or value in MOTORS for value in range(256))
"""By byte: 1 where it can be the NUM behind a CMD: a motor, or 00."""

# What fits where


LEGAL: Final = b"".join(
    bytes(legal is None or value in legal for value in range(256))
    for kind in KINDS
    for legal in legal_bytes(kind)
)
"""By (kind * 10 + place) * 256 + byte: 1 where the byte fits."""

WEIGHTS: Final[vec[float]] = vec[float](
    [weight for kind in KINDS for place in PLACE_WEIGHTS[kind.name] for weight in place]
)
"""By (kind * 10 + place) * 256 + byte: the weight of it if that kind was sent; 0 where it cannot
be."""

SHARES: Final[vec[float]] = vec[float]([KIND_SHARE[kind.name] for kind in KINDS])
"""By kind: its share among all frames."""

HEADERS: Final = bytes(kind.header for kind in KINDS)
"""By kind: its header."""


def _free(kind: FrameKind) -> list[int]:
    """The places of the payload that may be anything."""
    legal = legal_bytes(kind)
    return [place for place in range(NUM_OFFSET + 1, FRAME_LENGTH) if legal[place] is None]


def _rows(lists: Iterator[list[int]]) -> bytes:
    """Lists of places, each on a row of ten; 0 is behind the last."""
    return b"".join(bytes(places).ljust(FRAME_LENGTH, b"\0") for places in lists)


CHECKED: Final = _rows(
    [place for place in range(NUM_OFFSET, FRAME_LENGTH - 1) if legal_bytes(kind)[place]]
    for kind in KINDS
)
"""By kind * 10: the places behind header and CMD, and before the tail, that must be something."""

FREE: Final = _rows(_free(kind) for kind in KINDS)
"""By kind * 10: the places of the payload that may be anything."""

FREE_NUM: Final = bytes(legal_bytes(kind)[NUM_OFFSET] is None for kind in KINDS)
"""By kind: 1 where NUM means nothing."""

# The eight bytes from NUM to the tail as one number, the first byte the lowest


def _bits_of(legal: bytes | None) -> tuple[int, int] | None:
    """What to take from a byte, and which bits must not be set then, so that just these are left;
    None where bits do not tell. (What is less borrows from the bytes behind, and is none of them.)
    """
    if legal is None:
        return 0, 0
    first, used = min(legal), 0
    for value in legal:
        used |= value - first
    mask = 0xFF ^ used
    fitting = bytes(value for value in range(256) if (value - first) & 0xFF & mask == 0)
    return (first, mask) if fitting == bytes(sorted(legal)) else None


def _word_of(kind: FrameKind) -> tuple[int, int, int]:
    """The same for all places from NUM to before the tail; and whether bits tell all of them."""
    first = mask = 0
    tells = 1
    for number, legal in enumerate(legal_bytes(kind)[NUM_OFFSET:-1]):
        bits = _bits_of(legal)
        if bits is None:
            tells = 0
            continue
        first |= bits[0] << 8 * number
        mask |= bits[1] << 8 * number
    return first, mask, tells


_WORDS: Final = [_word_of(kind) for kind in KINDS]
WORD_FIRST: Final[vec[i64]] = vec[i64]([first for first, _, _ in _WORDS])
"""By kind: what to take from that number,"""
WORD_FORBIDDEN: Final[vec[i64]] = vec[i64]([mask for _, mask, _ in _WORDS])
"""and which bits must not be set in what is left, if the frame fits;"""
WORD_TELLS: Final = bytes(tells for _, _, tells in _WORDS)
"""1 where it fits if none of them is."""


def _repeated(value: int) -> int:
    """A byte in each place from NUM to before the tail."""
    return int.from_bytes(bytes([value]) * (FRAME_LENGTH - 1 - NUM_OFFSET), "little")


EVERY_LOW_BIT: Final[i64] = _repeated(0x01)
EVERY_HIGH_BIT: Final[i64] = _repeated(0x80)
HEADER_WORDS: Final[vec[i64]] = vec[i64]([_repeated(header) for header in HEADER_BYTES])
"""Each header, in all of these places."""

# How frames end


def _usual_flags(kind: FrameKind) -> bytes:
    """The flags that nearly every frame of a kind has, with which it ends; empty if it has none."""
    return bytes(field.default for field in kind.fields if field.default is not None)


USUAL_FLAGS: Final = tuple({flags: None for kind in KINDS if (flags := _usual_flags(kind))})
"""What nearly every frame with flags ends with, before its tail."""

MAY_END_SO: Final = bytes(
    0 if legal_bytes(kind)[-2] is not None else 1 if kind.names_motor else 2 for kind in KINDS
)
"""By kind: whether its payload can end with what are another one's flags: not at all (0), or it can
and tells nothing (1), or it can and a NUM that is 00, as usual, speaks for the frame (2)."""

# What is wrong with ten framed bytes


def _fault_at(number: int, place: int) -> int:
    """The fault that a frame has if what stands at that place does not fit."""
    kind = KINDS[number]
    sound = [0 if legal is None else legal[0] for legal in legal_bytes(kind)]
    legal = legal_bytes(kind)[place]
    if legal is None or len(legal) == 256:
        return 0
    sound[place] = next(value for value in reversed(range(256)) if value not in legal)
    return set_of(frame_faults(bytes(sound)))


PLACE_FAULTS: Final[vec[i64]] = vec[i64](
    [
        _fault_at(number, place) if NUM_OFFSET <= place < FRAME_LENGTH - 1 else 0
        for number in range(len(KINDS))
        for place in range(FRAME_LENGTH)
    ]
)
"""By kind * 10 + place: the faults of a frame in which that place does not fit."""
