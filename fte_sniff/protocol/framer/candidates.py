"""Candidate frames and damaged frames in a span, prefix and suffix scores.

Weights of heads and rests are cumulative: entry x is that of the first (or last) x bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, final

from librt.vecs import append, vec
from mypy_extensions import i64, mypyc_attr

from fte_sniff.protocol.codec import LONGEST_OVERLONG
from fte_sniff.protocol.framer.likelihood import (
    BROKEN,
    CHANGED,
    FOREIGN_FRAME,
    HEADER_WEIGHT,
    LOST,
    PAUSE_WITHIN,
    PUT_IN,
    UNPAUSED,
    UNUSUAL,
    WHOLE,
    WIDEST_CHANGE,
)
from fte_sniff.protocol.framer.predicates import kind_named
from fte_sniff.protocol.framer.tables import (
    COUNT,
    HEADER,
    HEADERS,
    LENGTH,
    MARKS,
    NO_KIND,
    SHARES,
    WEIGHTS,
)
from fte_sniff.protocol.spec import FRAME_LENGTH, NUM_OFFSET

LONGEST: Final[i64] = LONGEST_OVERLONG
"""Bytes that a damaged frame has at most."""

_LEAST_LEFT: Final[i64] = FRAME_LENGTH - WIDEST_CHANGE
_LOST: Final[vec[float]] = vec[float](LOST)
_CUT: Final[vec[float]] = vec[float](
    [BROKEN + weight for weight in LOST] + [0.0] * (LONGEST_OVERLONG + 1 - FRAME_LENGTH)
)
"""By length left, up to `LONGEST`: the weight of a frame having lost its first bytes; 0 where none
is lost."""
_CHANGED: Final[vec[float]] = vec[float](CHANGED)
_NAMED: Final[i64] = NUM_OFFSET + 1
_ROW: Final[i64] = LENGTH + 1
"""Entries of a head or a rest."""


@final
@mypyc_attr(acyclic=True)
class PrefixScore:
    """Up to ten bytes from a header on: what a frame that begins so weighs."""

    def __init__(self, data: bytes, at: i64, end: i64) -> None:
        """`at` is the place of the header, `end` that behind the last byte."""
        head = vec[float]([0.0] * _ROW)
        head[0], head[1] = 1.0, HEADER_WEIGHT
        kind, fit = NO_KIND, i64(1)
        if end - at > 1:
            kind = kind_named(data, at)
        if kind != NO_KIND:
            fit = _weigh_head(data, at, end - at, kind, head)
        self.place = at
        self.header = i64(data[at])
        self.kind = kind
        """Number of the kind that header and CMD name; `NO_KIND` where they name none."""
        self.head = head
        """The weights of the first bytes fitting that kind; without one, of the header alone."""
        self.fit = fit
        """How many bytes fit, at most ten."""
        self.whole = WHOLE * head[LENGTH] if fit == LENGTH else 0.0
        """The weight of a whole frame that fits its kind at every place; 0 if it is none."""
        self.bad_tail = 0.0
        """The weight of ten bytes of which the last are wrong; 0 if they are not that."""
        if fit < LENGTH and end - at >= LENGTH:
            self.bad_tail = _weigh_bad_tail(head, fit)
        self.cut_to = min(fit, LENGTH - 1)
        """The longest length of a frame cut off, all of it fitting."""

    def truncated(self, length: i64) -> float:
        """The weight of the frame cut off at that length, from 1 to `cut_to`."""
        return _LOST[length] * self.head[length]


def _weigh_head(data: bytes, at: i64, length: i64, kind: i64, head: vec[float]) -> i64:
    """Fill in what the first bytes weigh; returns how many of them fit."""
    weight = SHARES[kind]
    row = kind * LENGTH * 256
    for place in range(length):
        own = WEIGHTS[row + place * 256 + i64(data[at + place])]
        if own == 0.0:
            return place
        weight *= own
        if place > 0:
            head[place + 1] = weight
    return length


def _weigh_bad_tail(head: vec[float], fit: i64) -> float:
    weight = 0.0
    for left in range(_LEAST_LEFT, fit + 1):
        weight += _CHANGED[LENGTH - left] * head[left]
    return weight


@final
@mypyc_attr(acyclic=True)
class SuffixScore:
    """Up to ten bytes that end with a tail: what a frame that ends so weighs."""

    def __init__(self, data: bytes, start: i64, end: i64) -> None:
        """The bytes from `start` to `end`; the last of them is the tail."""
        self.rests = vec[float]([0.0] * (_ROW * COUNT))
        """By kind * 11 + length: the weight of the last bytes fitting its last places."""
        self.fits = vec[i64]([i64(0)] * COUNT)
        """By kind: how many of them fit, at most ten."""
        self.headless = vec[float]([0.0] * (LONGEST + 1))
        """By length, up to `LONGEST`: the weight of a frame whose first bytes are gone or wrong."""
        left = vec[float]([0.0] * (LONGEST + 1))
        broken = vec[float]([0.0] * (LONGEST + 1))
        for kind in range(COUNT):
            fit = self._weigh_kind(data, end, min(end - start, LENGTH), kind, left)
            self.fits[kind] = fit
            most = min(fit, LENGTH - 1)
            broken[most + 1] += SHARES[kind] * self.rests[kind * _ROW + most]
        self._weigh_headless(left, broken)

    def _weigh_kind(self, data: bytes, end: i64, length: i64, kind: i64, left: vec[float]) -> i64:
        """Fill in what the last bytes weigh as those of a kind, and add it to what all kinds weigh
        by length; returns how many bytes fit."""
        rests, row, share = self.rests, kind * _ROW, SHARES[kind]
        last = ((kind + 1) * LENGTH - 1) * 256
        weight = rests[row] = 1.0
        for number in range(length):
            weight *= WEIGHTS[last - number * 256 + i64(data[end - 1 - number])]
            if weight == 0.0:
                return number
            rests[row + number + 1] = weight
            left[number + 1] += share * weight
        return length

    def _weigh_headless(self, left: vec[float], broken: vec[float]) -> None:
        """Fill in what frames without their front weigh, from what is left of them, by length, and
        what fits no longer than that."""
        headless, longer = self.headless, 0.0
        for length in range(i64(1), LONGEST + 1):
            longer += broken[length]
            headless[length] = longer * BROKEN + _CUT[length] * left[length]
        for length in range(_LEAST_LEFT, LENGTH):
            headless[LENGTH] += _CHANGED[LENGTH - length] * left[length]

    def rest(self, length: i64) -> float:
        """The weight of the last `length` bytes being the rest of a frame of any kind."""
        weight = 0.0
        for kind in range(COUNT):
            if self.fits[kind] >= length:
                weight += SHARES[kind] * self.rests[kind * _ROW + length]
        return weight


def between(front: PrefixScore, back: SuffixScore, length: i64) -> float:
    """The weight of a damaged frame of `length` bytes (1-14) with this front and this back; it is 0
    where the front is the back."""
    if length < 2:
        return 0.0
    weight = back.headless[length] + _only_header(length, front.header, back)
    if length == LENGTH:
        weight += _unusual(front)
    if front.kind != NO_KIND:
        weight += _damaged(length, front, back) + _broken(length, front, back)
    return weight


def _only_header(length: i64, header: i64, back: SuffixScore) -> float:
    """The weight of a frame of that length of which the header is left, and not the CMD."""
    weight = 0.0
    rests, fits = back.rests, back.fits
    behind = min(length, LENGTH) - 1
    for kind in range(COUNT):
        if i64(HEADERS[kind]) != header:
            continue
        row, share = kind * _ROW, SHARES[kind] * 256
        if length == LENGTH:
            for left in range(_LEAST_LEFT - 1, min(fits[kind] + 1, LENGTH - 1)):
                weight += share * _CHANGED[LENGTH - 1 - left] * rests[row + left]
        elif fits[kind] >= behind:
            weight += share * rests[row + behind]
    return weight if length == LENGTH else weight * _one_damage(length)


def _one_damage(length: i64) -> float:
    """The weight of bytes lost, or put in, at one certain place, for a frame of that length."""
    return _LOST[length] if length < LENGTH else PUT_IN


def _damaged(length: i64, front: PrefixScore, back: SuffixScore) -> float:
    """One damage between header and CMD, or more of the head, and the rest: every way to divide."""
    head, rests = front.head, back.rests
    row, fit = front.kind * _ROW, back.fits[front.kind]
    if length == LENGTH:
        return _changed(head, front.fit, rests, row, fit)
    left = min(length, LENGTH)
    total = 0.0
    for own in range(max(i64(2), left - fit), min(front.fit + 1, left)):
        total += head[own] * rests[row + left - own]
    return total * _one_damage(length)


def _changed(head: vec[float], fit: i64, rests: vec[float], row: i64, rest_fit: i64) -> float:
    """Adjacent bytes changed behind header and CMD."""
    total = 0.0
    for own in range(i64(2), min(fit + 1, LENGTH - 1)):
        weight = 0.0
        most = min(rest_fit, LENGTH - 1 - own)
        for left in range(max(i64(1), _LEAST_LEFT - own), most + 1):
            weight += _CHANGED[LENGTH - own - left] * rests[row + left]
        total += head[own] * weight
    return total


def _unusual(front: PrefixScore) -> float:
    """Ten bytes framed, whatever they hold."""
    named = front.fit >= _NAMED
    return FOREIGN_FRAME + (UNUSUAL * front.head[_NAMED] * 256 if named else 0.0)


def _broken(length: i64, front: PrefixScore, back: SuffixScore) -> float:
    """Something else happened to the bytes between the head and the rest."""
    left = min(front.fit, min(length - 1, LENGTH - 2))
    fit = back.fits[front.kind]
    ending = min(fit, min(length - left, LENGTH - 1 - left))
    return BROKEN * front.head[left] * back.rests[front.kind * _ROW + ending]


@final
@mypyc_attr(acyclic=True)
class CandidateEnd:
    """A tail in a window, and the pieces that reach it."""

    def __init__(self, place: i64, back: SuffixScore) -> None:
        self.place = place
        """Behind the tail."""
        self.back = back
        self.first = max(i64(0), place - LONGEST)
        """The first place from which one can reach it."""
        self.weights = vec[float]([0.0] * LONGEST)
        """By place from `first` to the tail: the weight of the piece that is no whole frame."""


AT_TAIL: Final[i64] = 1
"""In a mark: it is a tail, not a header."""


@final
@mypyc_attr(acyclic=True, free_list_len=1)
class CandidateSet:
    """A stretch of bytes, and the pieces that can stand in it."""

    def __init__(self, data: bytes, pauses: Sequence[i64] = ()) -> None:
        """`pauses` are the places in `data` before which the line was silent for a while."""
        self.data = data
        self.pauses = pauses
        self.paused = len(pauses) > 0
        self.size: i64 = len(data)
        self.starts: list[PrefixScore] = []
        """Every header, from left to right."""
        self.stops: list[CandidateEnd] = []
        """Every tail, from left to right."""
        self.marks = vec[i64]()
        """Both, in the order of their places; where a tail ends and a header stands, the tail. Each
        is twice its number among its like, and `AT_TAIL`."""
        for place in range(self.size):
            mark = MARKS[data[place]]
            if mark == HEADER:
                self.marks = append(self.marks, 2 * i64(len(self.starts)))
                self.starts.append(PrefixScore(data, place, min(self.size, place + LENGTH)))
            elif mark != 0:
                self.marks = append(self.marks, 2 * i64(len(self.stops)) + AT_TAIL)
                self.stops.append(self._stop(place + 1))

    def _stop(self, place: i64) -> CandidateEnd:
        """A tail, with all that reaches the place behind it."""
        back = SuffixScore(self.data, max(i64(0), place - LENGTH), place)
        stop = CandidateEnd(place, back)
        weights, first, headless = stop.weights, stop.first, back.headless
        for at in range(first, place):
            weights[at - first] = headless[place - at]
        number: i64 = len(self.starts) - 1
        while number >= 0 and self.starts[number].place >= first:
            front = self.starts[number]
            length = place - front.place
            whole = length == LENGTH and front.whole > 0.0
            weights[front.place - first] = 0.0 if whole else between(front, back, length)
            number -= 1
        if self.paused:
            for at in range(first, place):
                weights[at - first] *= self.unpaused(at, place)
                if MARKS[self.data[at]] != HEADER:
                    weights[at - first] *= self.meeting(at)
        return stop

    def truncated(self, front: PrefixScore, length: i64) -> float:
        """The weight of a frame cut off at that length."""
        weight = front.truncated(length)
        return weight * self.unpaused(front.place, front.place + length) if self.paused else weight

    def whole(self, front: PrefixScore) -> float:
        """The weight of a whole frame; 0 where none stands."""
        return self._ten(front, front.whole)

    def bad_tail(self, front: PrefixScore) -> float:
        """The weight of ten bytes of which the last are wrong; 0 where none stand."""
        return self._ten(front, front.bad_tail)

    def _ten(self, front: PrefixScore, weight: float) -> float:
        if self.paused and weight > 0.0:
            return weight * self.unpaused(front.place, front.place + LENGTH)
        return weight

    def unpaused(self, start: i64, stop: i64) -> float:
        """What a piece weighs the less, seeing where the line paused within."""
        weight = 1.0
        for pause in self.pauses:
            if start < pause < stop:
                weight *= PAUSE_WITHIN
        return weight

    def meeting(self, place: i64) -> float:
        """The weight of two pieces meeting there, of which the second begins with a header.

        (It is within the weight of one that begins with none. Noise meets a frame for nothing: junk
        stands right before it.)
        """
        if not self.paused or place == 0 or place in self.pauses:
            return 1.0
        return UNPAUSED

    def rests_from_first(self, longest: i64) -> vec[float]:
        """By length, up to `longest`: the weight of the first bytes being a frame's last."""
        weights = vec[float]([0.0] * (longest + 1))
        for stop in self.stops:
            if stop.place <= longest:
                weights[stop.place] = stop.back.rest(stop.place) * self.unpaused(0, stop.place)
        return weights
