"""Owns which pieces can begin at a place of a window, where each ends, and how much it weighs.

It must not know which pieces make the best reading, nor what came before the window. A piece is a
whole frame, or a damaged one: truncated, overlong, or ten bytes of which some are wrong. (Noise is
no piece: it fills what lies between.)

A damaged frame is the *head* of a frame of one kind, as long as it still fits, and its *rest*, as
long as it fits again. Everything between them is lost, put in or changed; its weight is the sum
over all ways to divide it so.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import accumulate
from types import MappingProxyType
from typing import TypeAlias

from fte_sniff.protocol.likelihood import (
    BROKEN,
    CHANGED,
    FOREIGN_FRAME,
    HEADER_WEIGHT,
    KIND_SHARE,
    LOST,
    PAUSE_WITHIN,
    PLACE_WEIGHTS,
    PUT_IN,
    UNPAUSED,
    UNUSUAL,
    WHOLE,
    WIDEST_CHANGE,
)
from fte_sniff.protocol.structure import HEADER_BYTES, LONGEST_OVERLONG
from fte_sniff.protocol.table import FRAME_LENGTH, KINDS, NUM_PLACE, TAIL

Piece: TypeAlias = tuple[int, float, bool]
"""Where it stops, its weight, and whether it is a frame that fits its kind at every place."""

Weights: TypeAlias = Sequence[float]
"""Cumulative: entry x is the weight of the first (or last) x bytes fitting their places."""

_PLACES = tuple(PLACE_WEIGHTS[kind.name] for kind in KINDS)
_PLACES_BACKWARD = tuple(places[::-1] for places in _PLACES)
_NUMBER: Mapping[tuple[int, int], int] = MappingProxyType(
    {(kind.header, cmd): number for number, kind in enumerate(KINDS) for cmd in kind.cmds}
)
_SHARES = tuple(KIND_SHARE[kind.name] for kind in KINDS)
_WITH_HEADER: Mapping[int, tuple[int, ...]] = MappingProxyType(
    {
        header: tuple(number for number, kind in enumerate(KINDS) if kind.header == header)
        for header in HEADER_BYTES
    }
)
_LEAST_LEFT = FRAME_LENGTH - WIDEST_CHANGE
_CUT_FRONT = tuple(BROKEN + weight for weight in LOST)
_ONLY_HEADER = (1.0, HEADER_WEIGHT)


class _Tail:
    """A tail byte in a window: what a frame that ends with it can be, by its length.

    Computed once for each tail: the parts that do not depend on where the frame begins.
    """

    __slots__ = ("_only_header", "rests", "without_header")

    def __init__(self, ending: bytes) -> None:
        """`ending` are the bytes up to the tail, last one first."""
        self.rests = [_fitting(places, ending) for places in _PLACES_BACKWARD]
        """By kind, how far those bytes fit its last places."""
        self.without_header = self._headless()
        """By length: the weight of a frame whose first bytes are gone or wrong."""
        self._only_header: dict[int, list[float]] = {}

    def _headless(self) -> list[float]:
        weights = [0.0] * (LONGEST_OVERLONG + 1)
        longer = [0.0] * (LONGEST_OVERLONG + 1)
        for rest, share in zip(self.rests, _SHARES, strict=True):
            fit = min(len(rest), FRAME_LENGTH) - 1
            for length in range(1, fit + 1):
                weights[length] += share * _CUT_FRONT[length] * rest[length]
            longer[fit + 1] += share * BROKEN * rest[fit]
            for left in range(_LEAST_LEFT, fit + 1):
                weights[FRAME_LENGTH] += share * CHANGED[FRAME_LENGTH - left] * rest[left]
        return [own + more for own, more in zip(weights, accumulate(longer), strict=True)]

    def only_header(self, header: int) -> list[float]:
        """By length: the weight of a frame of which the header is left, and not the CMD."""
        weights = self._only_header.get(header)
        if weights is None:
            weights = self._only_header[header] = [0.0] * (LONGEST_OVERLONG + 1)
            for number in _WITH_HEADER[header]:
                self._add_only_header(weights, self.rests[number], _SHARES[number] * 256)
        return weights

    @staticmethod
    def _add_only_header(weights: list[float], rest: Weights, share: float) -> None:
        fit = min(len(rest), FRAME_LENGTH) - 1
        for left in range(1, min(fit, FRAME_LENGTH - 2) + 1):
            weights[left + 1] += share * LOST[left + 1] * rest[left]
            if left + 1 >= _LEAST_LEFT:
                weights[FRAME_LENGTH] += share * CHANGED[FRAME_LENGTH - 1 - left] * rest[left]
        if fit == FRAME_LENGTH - 1:
            for length in range(FRAME_LENGTH + 1, LONGEST_OVERLONG + 1):
                weights[length] += share * PUT_IN * rest[fit]


class Window:
    """A stretch of bytes, and the pieces that can stand in it."""

    def __init__(self, data: bytes, pauses: Sequence[int] = ()) -> None:
        """`pauses` are the places in `data` before which the line was silent for a while."""
        self.data = data
        self.pauses = pauses
        self.headers = [place for place, byte in enumerate(data) if byte in HEADER_BYTES]
        self._tails: list[tuple[int, _Tail]] = [
            (stop, _Tail(data[max(0, stop - FRAME_LENGTH) : stop][::-1]))
            for stop, byte in enumerate(data, start=1)
            if byte == TAIL
        ]
        self._pieces: dict[int, list[Piece]] = {}

    def pieces_at(self, start: int) -> list[Piece]:
        """Every piece that can begin at `start`."""
        pieces = self._pieces.get(start)
        if pieces is None:
            if self.data[start] in HEADER_BYTES:
                pieces = self._with_header(start)
            else:
                pieces = []
                for stop, tail in self._tails:
                    if start < stop:
                        if stop > start + LONGEST_OVERLONG:
                            break
                        pieces.append((stop, tail.without_header[stop - start], False))
            if self.pauses:
                pieces = [self._with_pauses(start, *piece) for piece in pieces]
            self._pieces[start] = pieces
        return pieces

    def head(self, start: int) -> Weights:
        """How far the bytes from a header on fit the kind that header and CMD name."""
        kind = self._kind_at(start)
        if kind is None:
            return _ONLY_HEADER
        given = _fitting(_PLACES[kind], self.data[start : start + FRAME_LENGTH])
        share = _SHARES[kind]
        return [1.0, HEADER_WEIGHT, *(share * weight for weight in given[2:])]

    def rests_from_first(self, longest: int) -> list[float]:
        """By length, from 1 to `longest`: the weight of the first bytes being a frame's last."""
        weights = [0.0] * min(longest, len(self.data))
        for stop, tail in self._tails:
            if stop <= longest:
                weights[stop - 1] = sum(
                    share * rest[stop]
                    for rest, share in zip(tail.rests, _SHARES, strict=True)
                    if len(rest) > stop
                )
        return weights

    def _kind_at(self, start: int) -> int | None:
        if start + 1 >= len(self.data):
            return None
        return _NUMBER.get((self.data[start], self.data[start + 1]))

    def _with_header(self, start: int) -> list[Piece]:
        kind, head = self._kind_at(start), self.head(start)
        fit = len(head) - 1
        pieces = [
            (start + length, LOST[length] * head[length], False)
            for length in range(1, min(fit, FRAME_LENGTH - 1) + 1)
        ]
        whole = start + FRAME_LENGTH if fit == FRAME_LENGTH else 0
        if whole:
            pieces.append((whole, WHOLE * head[FRAME_LENGTH], True))
        header = self.data[start]
        for stop, tail in self._tails:
            if stop <= start + 1 or stop == whole:
                continue
            length = stop - start
            if length > LONGEST_OVERLONG:
                break
            weight = tail.without_header[length] + tail.only_header(header)[length]
            if length == FRAME_LENGTH:
                weight += _unusual(head)
            if kind is not None:
                rest = tail.rests[kind]
                weight += _damaged(length, head, rest) + _broken(length, head, rest)
            pieces.append((stop, weight, False))
        if not whole and fit >= _LEAST_LEFT and start + FRAME_LENGTH <= len(self.data):
            weight = sum(
                CHANGED[FRAME_LENGTH - left] * head[left] for left in range(_LEAST_LEFT, fit + 1)
            )
            pieces.append((start + FRAME_LENGTH, weight, False))
        return pieces

    def _with_pauses(self, start: int, stop: int, weight: float, whole: bool) -> Piece:
        if start and start not in self.pauses:
            weight *= UNPAUSED
        within = sum(start < pause < stop for pause in self.pauses)
        return stop, weight * PAUSE_WITHIN**within, whole


def _fitting(places: Iterable[Weights], raw: bytes) -> Weights:
    weight, weights = 1.0, [1.0]
    for place, byte in zip(places, raw, strict=False):
        weight *= place[byte]
        if not weight:
            break
        weights.append(weight)
    return weights


def _damaged(length: int, head: Weights, rest: Weights) -> float:
    """One damage between header and CMD, or more of the head, and the rest: every way to divide."""
    if length == FRAME_LENGTH:
        return _changed(head, rest)
    left = min(length, FRAME_LENGTH)
    total = 0.0
    for x in range(max(2, left - len(rest) + 1), min(len(head), left)):
        total += head[x] * rest[left - x]
    return total * (LOST[length] if length < FRAME_LENGTH else PUT_IN)


def _changed(head: Weights, rest: Weights) -> float:
    """Adjacent bytes changed behind header and CMD."""
    total = 0.0
    for x in range(2, min(len(head), FRAME_LENGTH - 1)):
        for y in range(max(1, _LEAST_LEFT - x), min(len(rest), FRAME_LENGTH - x)):
            total += CHANGED[FRAME_LENGTH - x - y] * head[x] * rest[y]
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
