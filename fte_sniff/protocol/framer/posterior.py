"""Forward–backward pass; state carried over a boundary.

The passes go from header to header and from tail to tail, since nothing begins a frame or ends one
anywhere else; what lies between is reckoned as a whole. They take time and memory in proportion to
the stretch, which the framer bounds.
"""

from __future__ import annotations

from typing import Final, final

from librt.vecs import vec
from mypy_extensions import i64, mypyc_attr

from fte_sniff.protocol.framer.candidates import AT_TAIL, CandidateEnd, CandidateSet, PrefixScore
from fte_sniff.protocol.framer.likelihood import (
    BOUNDARY,
    JUNK,
    LONGEST_JUNK,
    NOISE_BEGINS,
    NOISE_ENDS,
    NOISE_STAYS,
    NOISE_TO_HEADER,
    OPEN,
    WHOLE,
    noise_to_end,
    staying,
    unending,
)
from fte_sniff.protocol.framer.tables import HEADER, LENGTH, MARKS


@final
@mypyc_attr(acyclic=True, free_list_len=1)
class BoundaryState:
    """The weights of the readings so far, by where they end."""

    def __init__(
        self,
        after_piece: vec[float],
        after_noise: vec[float],
        in_noise: float,
        ends_frame: bool = False,
        within: float = 0.0,
    ) -> None:
        self.after_piece = after_piece
        """By place: the weight of all readings of the bytes before it whose last piece ends
        there."""
        self.after_noise = after_noise
        """The same for readings that end there with noise."""
        self.in_noise = in_noise
        """The weight of readings with long noise going on at the first place."""
        self.ends_frame = ends_frame
        """Whether the rows so far end here with a frame, or with something else of known length."""
        self.within = within
        """The weight of the first place being anywhere within a frame; only where a stream
        begins."""

    def joining(self, window: CandidateSet) -> BoundaryState:
        """The same for a window whose first piece may be the rest of a frame begun before."""
        rests = window.rests_from_first(LENGTH - 1)
        weights = vec[float]([0.0] * (max(len(rests), len(self.after_piece))))
        for place in range(i64(len(self.after_piece))):
            weights[place] = self.after_piece[place]
        for place in range(i64(1), i64(len(rests))):
            weights[place] += self.within / float(LENGTH - 1) * rests[place]
        return BoundaryState(weights, self.after_noise, self.in_noise, self.ends_frame, self.within)


def trusted() -> BoundaryState:
    """A frame ends here beyond doubt."""
    return BoundaryState(vec[float]([1.0]), vec[float](), 0.0)


def joined() -> BoundaryState:
    """The stream begins here: between two frames, or anywhere within one, or in noise."""
    return BoundaryState(vec[float]([0.5]), vec[float](), 0.01, within=0.5)


def settled() -> BoundaryState:
    """The line was silent here: something ended, or long noise goes on."""
    return BoundaryState(vec[float]([1.0]), vec[float](), 0.05)


def lost() -> BoundaryState:
    """Long noise is going on."""
    return BoundaryState(vec[float](), vec[float](), 1.0)


_JUNK_REACH: Final[i64] = LONGEST_JUNK
_TRUSTED: Final = trusted()


@final
@mypyc_attr(acyclic=True, free_list_len=1)
class ForwardPass:
    """What the pieces and the noise before some end lay on every place of a window."""

    def __init__(self, size: i64) -> None:
        self.after_piece = vec[float]([0.0] * (size + 1))
        """By place: the weight of all readings of the bytes before it whose last piece ends
        there."""
        self.after_noise = vec[float]([0.0] * (size + 1))
        """The same for readings that end there with noise."""
        self.in_noise = 0.0
        """The weight of those that are in long noise at the end."""


@final
@mypyc_attr(acyclic=True, free_list_len=1)
class ForwardBackward:
    """The readings of a window, weighed; places are counted from the window's first byte."""

    def __init__(self, window: CandidateSet, carry: BoundaryState, ending: i64) -> None:
        """`ending` is one of those that `noise` names."""
        self.window = window
        self.size = window.size
        self.ending = ending
        self._carried = carry.joining(window) if carry.within else carry
        self._passed = self._forward(self._carried, self.size)
        self._to_end = vec[float]([0.0] * (self.size + 1))
        """By place: the weight of all readings from there on."""
        self._at_header = vec[float]([0.0] * len(window.starts))
        """By header: that of those that begin with a frame there."""
        self._backward()
        self._total = self._in_all(self._carried)

    # The two passes

    def _forward(self, carry: BoundaryState, end: i64) -> ForwardPass:
        """The weights that the pieces and the noise before `end` lay on every place."""
        passed, window = ForwardPass(self.size), self.window
        after_piece, after_noise = passed.after_piece, passed.after_noise
        _fill(after_piece, carry.after_piece)
        _fill(after_noise, carry.after_noise)
        noise, noisy_to = carry.in_noise, i64(0)
        for mark in window.marks:
            if mark & AT_TAIL:
                self._reach(window.stops[mark >> 1], passed, end)
                continue
            front = window.starts[mark >> 1]
            place = front.place
            junk = _junk_up_to(place, min(place, end), after_piece)
            if place >= end:
                after_noise[place] += junk
                continue
            noise = _gone_on(noise, after_piece, noisy_to, place)
            noisy_to = place
            after_noise[place] += junk + noise * NOISE_ENDS
            self._lay(front, self._before(passed, place), after_piece)
        passed.in_noise = _gone_on(noise, after_piece, noisy_to, end)
        return passed

    def _reach(self, stop: CandidateEnd, passed: ForwardPass, end: i64) -> None:
        """Lay what the readings before `end` weigh on the place behind a tail that they reach."""
        after_piece, after_noise = passed.after_piece, passed.after_noise
        weights, first, paused = stop.weights, stop.first, self.window.paused
        reached = 0.0
        for at in range(first, min(stop.place, end)):
            before = after_piece[at] + after_noise[at]
            if paused and MARKS[self.window.data[at]] == HEADER:
                before = self._before(passed, at)
            reached += before * weights[at - first]
        after_piece[stop.place] += reached

    def _lay(self, front: PrefixScore, weight: float, after_piece: vec[float]) -> None:
        """Lay what all readings up to a header weigh on where its own pieces end."""
        window, place = self.window, front.place
        for length in range(i64(1), front.cut_to + 1):
            after_piece[place + length] += weight * window.truncated(front, length)
        ten = window.whole(front) + window.bad_tail(front)
        if ten > 0.0:
            after_piece[place + LENGTH] += weight * ten

    def _backward(self) -> None:
        """The weights of all readings from each place on."""
        to_end, size, window = self._to_end, self.size, self.window
        for place in range(size + 1):
            to_end[place] = noise_to_end(self.ending, size - place)
        header: i64 = len(window.starts) - 1
        number: i64 = len(window.marks) - 1
        while number >= 0:
            mark = window.marks[number]
            number -= 1
            if mark & AT_TAIL:
                self._leave(window.stops[mark >> 1], header)
                continue
            front = window.starts[mark >> 1]
            header = (mark >> 1) - 1
            weight = self._at_header[mark >> 1] + self._from_header(front)
            self._at_header[mark >> 1] = weight
            place = front.place
            to_end[place] += weight * window.meeting(place)
            for at in range(place):
                to_end[at] += weight * NOISE_TO_HEADER[place - at]

    def _leave(self, stop: CandidateEnd, header: i64) -> None:
        """Lay what the readings from behind a tail weigh on all places from which it is reached;
        `header` is the number of the last header before it."""
        window, to_end, first = self.window, self._to_end, stop.first
        data, weights, weight = window.data, stop.weights, to_end[stop.place]
        for at in range(first, stop.place):
            if MARKS[data[at]] != HEADER:
                to_end[at] += weight * weights[at - first]
        while header >= 0 and window.starts[header].place >= first:
            at = window.starts[header].place
            self._at_header[header] += weight * weights[at - first]
            header -= 1

    def _from_header(self, front: PrefixScore) -> float:
        """The weight of all readings that begin with a piece of the header's own."""
        to_end, place, weight, window = self._to_end, front.place, 0.0, self.window
        for length in range(i64(1), front.cut_to + 1):
            weight += window.truncated(front, length) * to_end[place + length]
        ten = window.whole(front) + window.bad_tail(front)
        if ten > 0.0:
            weight += ten * to_end[place + LENGTH]
        return weight + self.cut_off(front)

    def _in_all(self, carry: BoundaryState) -> float:
        """The weight of all readings, if this was before them."""
        total, noise = 0.0, staying(self.size) * unending(self.ending)
        known, to_end = carry.after_piece, self._to_end
        for place in range(min(i64(len(known)), self.size + 1)):
            total += known[place] * to_end[place]
        for number, front in enumerate(self.window.starts):
            weight = self._at_header[number]
            noise += staying(front.place) * NOISE_ENDS * weight
            if front.place < len(carry.after_noise):
                total += carry.after_noise[front.place] * weight
        return total + carry.in_noise * noise

    def cut_off(self, front: PrefixScore) -> float:
        """The weight of a frame that begins there and goes on behind the window's end."""
        length = self.size - front.place
        if length >= LENGTH or front.fit < length or self.ending == BOUNDARY:
            return 0.0
        left = front.head[length] * WHOLE
        return left if self.ending == OPEN else left / float(LENGTH)

    # What they tell

    def probability(self, start: i64, stop: i64, weight: float) -> float:
        """The probability (0-1) of a piece of that weight at `start`."""
        return self._before(self._passed, start) * weight * self._to_end[stop] / self._total

    def _before(self, passed: ForwardPass, place: i64) -> float:
        """The weight of all readings of what is before a place at which a piece begins."""
        meeting = self.window.meeting(place)
        return passed.after_piece[place] * meeting + passed.after_noise[place]

    def boundary(self, place: i64) -> float:
        """The probability (0-1) that no frame, whole or damaged, goes on over that place."""
        before = self._passed.after_piece[place] + self._passed.after_noise[place]
        return before * self._to_end[place] / self._total

    def whole_frames(self) -> vec[float]:
        """By header: how probable a whole frame there is (0-1); 0 where none can stand."""
        return self._whole_frames(self._passed, self._total)

    @property
    def behind_rows(self) -> bool:
        """Whether it matters that rows so far are not taken for granted."""
        return self._carried.ends_frame

    def whole_frames_behind_rows(self) -> vec[float]:
        """As `whole_frames`, if all rows so far are taken for granted."""
        return self._whole_frames(self._forward(_TRUSTED, self.size), self._in_all(_TRUSTED))

    def _whole_frames(self, passed: ForwardPass, total: float) -> vec[float]:
        window = self.window
        probable = vec[float]([0.0] * len(window.starts))
        for number, front in enumerate(window.starts):
            if front.whole > 0.0:
                weight = self._before(passed, front.place) * window.whole(front)
                probable[number] = weight * self._to_end[front.place + LENGTH] / total
        return probable

    def carry(self, place: i64, *, ends_frame: bool) -> BoundaryState:
        """What the bytes before `place`, where a row ends, say of those behind it."""
        passed = self._forward(self._carried, place)
        total = passed.in_noise
        for at in range(place, self.size + 1):
            total += passed.after_piece[at] + passed.after_noise[at]
        return BoundaryState(
            _share(passed.after_piece, place, total),
            _share(passed.after_noise, place, total),
            passed.in_noise / total,
            ends_frame,
        )


def _fill(places: vec[float], known: vec[float]) -> None:
    for place in range(min(i64(len(known)), i64(len(places)))):
        places[place] = known[place]


def _gone_on(noise: float, after_piece: vec[float], start: i64, end: i64) -> float:
    """The weight of long noise at `end`, where it may have begun at each place from `start` on."""
    for at in range(start, end):
        noise = noise * NOISE_STAYS + NOISE_BEGINS * after_piece[at]
    return noise


def _junk_up_to(header: i64, end: i64, after_piece: vec[float]) -> float:
    """What junk that begins before `end` lays on the place of a header."""
    weight = 0.0
    for at in range(max(i64(0), header - _JUNK_REACH), end):
        weight += after_piece[at]
    return weight * JUNK


def _share(weights: vec[float], start: i64, total: float) -> vec[float]:
    """The weights from `start` on, as shares of the total."""
    shares = vec[float]([0.0] * (len(weights) - start))
    for place in range(start, i64(len(weights))):
        shares[place - start] = weights[place] / total
    return shares
