"""Owns what the two ends of a damaged frame weigh: its front, from a header on, and its back.

It must not know of windows, nor where in them an end stands. A damaged frame is the *head* of a
frame of one kind, as long as it still fits, and its *rest*, as long as it fits again. Everything
between them is lost, put in or changed; its weight is the sum over all ways to divide it so.

All bytes that no table of `likelihood` tells apart weigh the same. So ends are looked up by their
bytes made `CANONICAL`, and each is reckoned once only, as long as it is remembered.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from itertools import accumulate
from operator import add, getitem, mul
from types import MappingProxyType
from typing import Final, NamedTuple, TypeAlias

from fte_sniff.protocol.framer.likelihood import (
    BROKEN,
    CHANGED,
    FOREIGN_FRAME,
    HEADER_WEIGHT,
    KIND_SHARE,
    LOST,
    PLACE_WEIGHTS,
    PUT_IN,
    UNUSUAL,
    WHOLE,
    WIDEST_CHANGE,
)
from fte_sniff.protocol.structure import HEADER_BYTES, LONGEST_OVERLONG
from fte_sniff.protocol.table import FRAME_LENGTH, KINDS, NUM_PLACE, TAIL

Weights: TypeAlias = Sequence[float]
"""Cumulative: entry x is the weight of the first (or last) x bytes fitting their places."""

_PLACES = tuple(PLACE_WEIGHTS[kind.name] for kind in KINDS)
_NUMBER: Mapping[tuple[int, int], int] = MappingProxyType(
    {(kind.header, cmd): number for number, kind in enumerate(KINDS) for cmd in kind.cmds}
)
_PLACES_BACKWARDS = tuple(places[::-1] for places in _PLACES)
_SHARES = tuple(KIND_SHARE[kind.name] for kind in KINDS)
_WITH_HEADER: Mapping[int, tuple[int, ...]] = MappingProxyType(
    {
        header: tuple(number for number, kind in enumerate(KINDS) if kind.header == header)
        for header in HEADER_BYTES
    }
)
_LEAST_LEFT = FRAME_LENGTH - WIDEST_CHANGE
_TAIL_ALONE: Weights = (1.0, _PLACES[0][-1][TAIL])
"""How far bytes fit of which the tail does, and nothing before it."""
_CUT_FRONT = (0.0, *(BROKEN + weight for weight in LOST[1:]))
"""By length left: the weight of a frame having lost its first bytes."""
_CHANGED_FRONT = CHANGED[:0:-1]
"""By length left, from `_LEAST_LEFT` on: that of its first bytes being wrong, or its last."""
_NONE_CUT = (0.0,) * (LONGEST_OVERLONG - FRAME_LENGTH)
_CHANGED_CMD = tuple(
    CHANGED[FRAME_LENGTH - 1 - left] for left in range(_LEAST_LEFT - 1, FRAME_LENGTH - 1)
)
"""By length left, from `_LEAST_LEFT - 1` on: the weight of all between it and the header wrong."""
_NO_CMD = tuple(share * 256 for share in _SHARES)
"""By kind: the weight of its header alone."""
_REMEMBERED: Final = 1 << 14
"""Ends of each sort that are remembered; a few megabytes at most."""


def _canonical() -> bytes:
    """By byte value: the least value that weighs the same at every place of every kind."""
    least: dict[tuple[float, ...], int] = {}
    alike = (tuple(place[value] for places in _PLACES for place in places) for value in range(256))
    return bytes(least.setdefault(weights, value) for value, weights in enumerate(alike))


CANONICAL: Final = _canonical()
"""For `bytes.translate`: makes alike what weighs alike."""


class Front(NamedTuple):
    """Up to ten bytes from a header on: what a frame that begins so weighs."""

    header: int
    kind: int | None
    """Number of the kind that header and CMD name."""
    head: Weights
    """How far the bytes fit that kind; where there is none, the header alone."""
    truncated: tuple[float, ...]
    """By length from 1: the weight of a frame cut off there, all of it fitting."""
    whole: float
    """The weight of a whole frame that fits its kind at every place; 0 if it is none."""
    bad_tail: float
    """The weight of ten bytes of which the last are wrong; 0 if they are not that."""

    @property
    def length(self) -> int:
        """How many bytes fit, at most ten."""
        return len(self.head) - 1


class Back:
    """Up to ten bytes that end with a tail: what a frame that ends so weighs."""

    __slots__ = ("headless", "rests")

    def __init__(self, ending: bytes) -> None:
        """`ending` are the bytes, the tail the last of them."""
        backwards = ending[::-1]
        last = backwards[1] if len(backwards) > 1 else TAIL
        self.rests: tuple[Weights, ...] = tuple(
            [
                _fitting(places, backwards) if places[1][last] else _TAIL_ALONE
                for places in _PLACES_BACKWARDS
            ]
        )
        """By kind, how far the bytes fit its last places."""
        self.headless = _headless(self.rests)[:0:-1]
        """From the longest length down to 1: the weight of a frame whose first bytes are gone or
        wrong. Entry -n is that of length n."""

    def rest(self, length: int) -> float:
        """The weight of the last `length` bytes being the rest of a frame of any kind."""
        return sum(
            share * rest[length]
            for rest, share in zip(self.rests, _SHARES, strict=True)
            if len(rest) > length
        )


@lru_cache(_REMEMBERED)
def front_of(own: bytes) -> Front:
    """The front that these bytes are: ten of them, or as many as there are; a header first."""
    header = own[0]
    kind = _NUMBER.get((header, own[1])) if len(own) > 1 else None
    head: Weights = (1.0, HEADER_WEIGHT)
    if kind is not None:
        share = _SHARES[kind]
        head = (*head, *_fitting(_PLACES[kind], own, share)[2:])
    fit = len(head) - 1
    truncated = tuple(map(mul, LOST[1:], head[1:FRAME_LENGTH]))
    whole = WHOLE * head[FRAME_LENGTH] if fit == FRAME_LENGTH else 0.0
    bad_tail = 0.0
    if not whole and len(own) == FRAME_LENGTH:
        bad_tail = sum(map(mul, _CHANGED_FRONT, head[_LEAST_LEFT:]))
    return Front(header, kind, head, truncated, whole, bad_tail)


@lru_cache(_REMEMBERED)
def back_of(ending: bytes) -> Back:
    """The back that these bytes are: ten of them, or as many as there are; a tail last."""
    return Back(ending)


def between(front: Front, back: Back, length: int) -> float:
    """The weight of a damaged frame of `length` bytes (2-14) with this front and this back."""
    weight = back.headless[-length] + _only_header(length, front.header, back.rests)
    if length == FRAME_LENGTH:
        weight += _unusual(front.head)
    if front.kind is not None:
        rest = back.rests[front.kind]
        weight += _damaged(length, front.head, rest) + _broken(length, front.head, rest)
    return weight


def _fitting(places: Iterable[Weights], raw: bytes, before: float = 1.0) -> Weights:
    """How far the bytes fit the places, on top of a weight that was there before."""
    weights = list(accumulate(map(getitem, places, raw), mul, initial=before))
    return weights if weights[-1] else weights[: weights.index(0.0)]


def _headless(rests: tuple[Weights, ...]) -> list[float]:
    """By length: the weight of a frame whose first bytes are gone or wrong."""
    left = [0.0] * FRAME_LENGTH
    longer = [0.0] * (LONGEST_OVERLONG + 1)
    for rest, share in zip(rests, _SHARES, strict=True):
        fit = len(rest) - 1 if len(rest) < FRAME_LENGTH else FRAME_LENGTH - 1
        longer[fit + 1] += share * rest[fit] * BROKEN
        if fit > 1:
            left[: fit + 1] = map(add, left, map(share.__mul__, rest))
        else:
            left[1] += share * rest[1]
    changed = sum(map(mul, _CHANGED_FRONT, left[_LEAST_LEFT:]))
    return list(map(add, (*map(mul, _CUT_FRONT, left), changed, *_NONE_CUT), accumulate(longer)))


def _only_header(length: int, header: int, rests: tuple[Weights, ...]) -> float:
    """The weight of a frame of that length of which the header is left, and not the CMD."""
    weight = 0.0
    if length == FRAME_LENGTH:
        for number in _WITH_HEADER[header]:
            left = rests[number][_LEAST_LEFT - 1 : FRAME_LENGTH - 1]
            weight += _NO_CMD[number] * sum(map(mul, _CHANGED_CMD, left))
        return weight
    behind = min(length, FRAME_LENGTH) - 1
    for number in _WITH_HEADER[header]:
        rest = rests[number]
        if len(rest) > behind:
            weight += _NO_CMD[number] * rest[behind]
    return weight * _one_damage(length)


def _one_damage(length: int) -> float:
    """The weight of bytes lost, or put in, at one certain place, for a frame of that length."""
    return LOST[length] if length < FRAME_LENGTH else PUT_IN


def _damaged(length: int, head: Weights, rest: Weights) -> float:
    """One damage between header and CMD, or more of the head, and the rest: every way to divide."""
    if length == FRAME_LENGTH:
        return _changed(head, rest)
    left = min(length, FRAME_LENGTH)
    first, behind = max(2, left - len(rest) + 1), min(len(head), left)
    if first >= behind:
        return 0.0
    total: float = sum(map(mul, head[first:behind], rest[left - first : left - behind : -1]))
    return total * _one_damage(length)


def _changed(head: Weights, rest: Weights) -> float:
    """Adjacent bytes changed behind header and CMD."""
    total = 0.0
    for x in range(2, min(len(head), FRAME_LENGTH - 1)):
        y = max(1, _LEAST_LEFT - x)
        widths = _CHANGED_FRONT[x + y - _LEAST_LEFT :]
        total += head[x] * sum(map(mul, widths, rest[y : FRAME_LENGTH - x]))
    return total


def _unusual(head: Weights) -> float:
    """Ten bytes framed, whatever they hold."""
    named = len(head) - 1 > NUM_PLACE
    return FOREIGN_FRAME + (UNUSUAL * head[NUM_PLACE + 1] * 256 if named else 0.0)


def _broken(length: int, head: Weights, rest: Weights) -> float:
    """Something else happened to the bytes between the head and the rest."""
    left = min(len(head) - 1, length - 1, FRAME_LENGTH - 2)
    ending = min(len(rest) - 1, length - left, FRAME_LENGTH - 1 - left)
    return BROKEN * head[left] * rest[ending]
