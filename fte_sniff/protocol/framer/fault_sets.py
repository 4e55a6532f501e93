"""Owns the faults of a row as a number: one bit each, so that sets of them are quickly compared.

It must not know when a fault is given. Zero is none.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from mypy_extensions import i64

from fte_sniff.protocol.rows import Fault

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
