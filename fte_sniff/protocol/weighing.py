"""Owns the choice between the readings of one disputed stretch, and the doubt that remains.

It must not know of chunks, times or rows. Every way to divide the stretch into whole frames,
damaged ones and noise is a reading; its weight is the product of its pieces' weights. Two passes,
one from each side, add up the weights of all readings at once, so that each frame's probability is
that of the readings that contain it. Then:

- Shown are those frames that together are the most probable, none overlapping another.
- What lies between them is divided into the pieces that weigh most.
- A frame whose probability is below `CERTAIN` is `ambiguous`, unless it stands in step between a
  certain frame and another.

The passes take time and memory in proportion to the stretch, which the framer bounds.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum

from fte_sniff.protocol.codec import frame_faults
from fte_sniff.protocol.likelihood import (
    CERTAIN,
    JUNK,
    LIKELY,
    LONGEST_JUNK,
    NOISE_BEGINS,
    NOISE_ENDS,
    NOISE_STAYS,
    SHOWN,
    WHOLE,
)
from fte_sniff.protocol.patterns import DIVIDING
from fte_sniff.protocol.pieces import Piece, Window
from fte_sniff.protocol.reading import Stretch
from fte_sniff.protocol.rows import Fault
from fte_sniff.protocol.structure import HEADER_BYTES
from fte_sniff.protocol.table import FRAME_LENGTH, TAIL


class Ending(Enum):
    """What is known of the line behind a stretch."""

    OPEN = "bytes may follow at once"
    CLOSED = "silence, or the end of the stream"


@dataclass(slots=True)
class Carry:
    """What the bytes before a place say about the places from there on."""

    after_piece: list[float] = field(default_factory=lambda: [1.0])
    """By place: the weight of all readings of the bytes before it whose last piece ends there."""
    after_noise: list[float] = field(default_factory=list)
    """The same for readings that end there with noise."""
    in_noise: float = 0.0
    """The weight of readings with long noise going on at the first place."""
    ends_frame: bool = False
    """Whether the rows so far end here with a frame, or with something else of known length."""
    within: float = 0.0
    """The weight of the first place being anywhere within a frame; only where a stream begins."""


def trusted() -> Carry:
    """A frame ends here beyond doubt."""
    return Carry()


def joined() -> Carry:
    """The stream begins here: between two frames, or anywhere within one, or in noise."""
    return Carry([0.5], [], 0.01, within=0.5)


def lost() -> Carry:
    """Long noise is going on."""
    return Carry([], [], 1.0)


class Weighing:
    """The readings of a window, weighed; places are counted from the window's first byte."""

    def __init__(self, window: Window, carry: Carry, ending: Ending) -> None:
        self._window = window
        self._size = len(window.data)
        self._ending = ending
        self._headers = set(window.headers)
        self._carry = replace(carry, after_piece=_joining(window, carry))
        self._after_piece, self._after_noise, _ = self._passed(self._carry, self._size)
        self._backward(self._carry)

    # The two passes

    def _passed(self, carry: Carry, end: int) -> tuple[list[float], list[float], float]:
        """The forward pass over the places before `end`: what they lay on every place."""
        headers, pieces_at = self._headers, self._window.pieces_at
        after_piece = _padded(carry.after_piece, self._size)
        after_noise = _padded(carry.after_noise, self._size)
        in_noise = carry.in_noise
        for place in range(end):
            weight = here = after_piece[place]
            if place in headers:
                junk = sum(after_piece[max(0, place - LONGEST_JUNK) : place])
                after_noise[place] += junk * JUNK + in_noise * NOISE_ENDS
                weight += after_noise[place]
            if weight:
                for stop, own, _ in pieces_at(place):
                    after_piece[stop] += weight * own
            in_noise = in_noise * NOISE_STAYS + here * NOISE_BEGINS
        for place in self._window.headers:
            if place >= end:
                junk = sum(after_piece[max(0, place - LONGEST_JUNK) : end])
                after_noise[place] += junk * JUNK
        return after_piece, after_noise, in_noise

    def _backward(self, carry: Carry) -> None:
        size, headers, pieces_at = self._size, self._headers, self._window.pieces_at
        after_piece, after_noise = self._after_piece, self._after_noise
        to_end = self._to_end = [0.0] * size + [1.0]
        at_header = [0.0] * size + [0.0]
        noise = 1.0 if self._ending is Ending.OPEN else NOISE_ENDS
        for place in range(size - 1, -1, -1):
            weight = 0.0
            if after_piece[place] or after_noise[place]:
                for stop, own, _ in pieces_at(place):
                    weight += own * to_end[stop]
                junk = sum(at_header[place + 1 : place + 1 + LONGEST_JUNK])
                if place > size - FRAME_LENGTH:
                    weight += self._cut_off(place)
                if place >= size - LONGEST_JUNK:
                    junk += self._junk_at_end(place)
                to_end[place] = weight + JUNK * junk + NOISE_BEGINS * noise
            noise *= NOISE_STAYS
            if place in headers:
                at_header[place] = weight
                noise += NOISE_ENDS * weight
        total = carry.in_noise * noise
        total += sum(a * b for a, b in zip(carry.after_piece, to_end, strict=False))
        total += sum(a * b for a, b in zip(carry.after_noise, at_header, strict=False))
        self._total = total

    def _cut_off(self, place: int) -> float:
        """The weight of a frame that begins here and goes on behind the window's end."""
        length = self._size - place
        if self._window.data[place] not in HEADER_BYTES:
            return 0.0
        head = self._window.head(place)
        if len(head) <= length:
            return 0.0
        return head[length] * (WHOLE if self._ending is Ending.OPEN else WHOLE / FRAME_LENGTH)

    def _junk_at_end(self, place: int) -> float:
        """In how many lengths junk that begins here can reach the window's end."""
        length = self._size - place
        return LONGEST_JUNK + 1 - length if self._ending is Ending.OPEN else 1.0

    # The chosen reading

    def reading(self) -> list[Stretch]:
        """The chosen reading of the window, which begins where the rows so far end."""
        chooser = self
        if self._carry.ends_frame:
            chooser = Weighing(self._window, trusted(), self._ending)
        stretches: list[Stretch] = []
        at = 0
        for place in chooser.shown_frames():
            stretches += self._between(at, place)
            stretches.append(self._frame(place))
            at = place + FRAME_LENGTH
        return self._believing_neighbours(stretches + self._between(at, None))

    def _believing_neighbours(self, reading: list[Stretch]) -> list[Stretch]:
        """The reading with those frames believed that stand in step between others.

        Where a frame follows a certain one, and another one follows it, it takes two faults that
        cancel each other out to make a better reading; that is rarer than the weights say, unless
        the frame could be divided into two truncated ones.
        """
        believed = list(reading)
        for number in range(1, len(reading) - 1):
            before, frame, behind = believed[number - 1], reading[number], reading[number + 1]
            in_step = before.certain and behind.probability and frame.probability >= LIKELY
            if in_step and not self._divisible(frame):
                believed[number] = frame._replace(faults=())
        return believed

    def _divisible(self, frame: Stretch) -> bool:
        return bool(DIVIDING.search(self._window.data, frame.start + 1, frame.stop - 1))

    def _probability(self, start: int, stop: int, weight: float) -> float:
        before = self._after_piece[start] + self._after_noise[start]
        return before * weight * self._to_end[stop] / self._total

    def whole_frame(self, start: int) -> float:
        """The probability (0-1) of a whole frame at `start`; 0 where none can stand there."""
        for stop, weight, whole in self._window.pieces_at(start):
            if whole:
                return self._probability(start, stop, weight)
        return 0.0

    def shown_frames(self) -> list[int]:
        """Where the most probable whole frames begin, none overlapping another."""
        ending = {
            start + FRAME_LENGTH: (start, probability)
            for start in self._window.headers
            if (probability := self.whole_frame(start)) > SHOWN
        }
        best: dict[int, tuple[float, tuple[int, float] | None]] = {}
        for place in range(self._size + 1):
            value, frame = best.get(place - 1, (0.0, None))[0], None
            if place in ending:
                begin, probability = ending[place]
                with_it = best[begin][0] + probability - SHOWN
                if with_it > value:
                    value, frame = with_it, (begin, probability)
            best[place] = value, frame
        chosen: list[int] = []
        place = self._size
        while place > 0:
            frame = best[place][1]
            place = frame[0] if frame else place - 1
            if frame:
                chosen.append(place)
        return chosen[::-1]

    def _frame(self, start: int) -> Stretch:
        faults = frame_faults(self._window.data[start : start + FRAME_LENGTH])
        probability = self.whole_frame(start)
        if probability < CERTAIN:
            faults += (Fault.AMBIGUOUS,)
        return Stretch(start, start + FRAME_LENGTH, True, faults, probability)

    def _between(self, start: int, stop: int | None) -> list[Stretch]:
        """The pieces and noise that weigh most from `start` to `stop`, or to the end (None)."""
        last = self._size if stop is None else stop
        if start == last:
            return []
        best: dict[int, tuple[float, int, Piece | None]] = {start: (1.0, start, None)}
        for place in range(start, last):
            if place in best:
                self._extend(best, place, last)
        if stop is None:
            self._extend_cut_off(best, start)
        stretches: list[Stretch] = []
        place = last
        while place > start:
            _, begin, piece = best[place]
            stretches.append(self._stretch(begin, place, piece))
            place = begin
        return stretches[::-1]

    def _extend(
        self, best: dict[int, tuple[float, int, Piece | None]], place: int, last: int
    ) -> None:
        weight, begin, piece = best[place]
        for following in self._window.pieces_at(place):
            stop, own, whole = following
            if stop <= last and not whole:
                _improve(best, stop, weight * own, place, following)
        if piece is None and begin != place:
            return
        for header in self._window.headers:
            if place < header < last:
                _improve(best, header, weight * _noise_weight(header - place), place, None)
        _improve(best, last, weight * _noise_weight(last - place), place, None)

    def _extend_cut_off(self, best: dict[int, tuple[float, int, Piece | None]], start: int) -> None:
        """Let the reading end with a frame that goes on behind the end, where that is best."""
        for place in range(max(start, self._size - FRAME_LENGTH + 1), self._size):
            weight = self._cut_off(place)
            if place in best and weight:
                cut_off = (self._size, weight, False)
                _improve(best, self._size, best[place][0] * weight, place, cut_off)

    def _stretch(self, start: int, stop: int, piece: Piece | None) -> Stretch:
        raw = self._window.data[start:stop]
        if piece is None or (raw[0] not in HEADER_BYTES and len(raw) != FRAME_LENGTH):
            return Stretch(start, stop, False, (Fault.NOISE,), 0.0)
        if len(raw) < FRAME_LENGTH:
            return Stretch(start, stop, False, (Fault.TRUNCATED,), 0.0)
        if len(raw) > FRAME_LENGTH:
            return Stretch(start, stop, False, (Fault.OVERLONG,), 0.0)
        if raw[0] not in HEADER_BYTES:
            return Stretch(start, stop, False, (Fault.BAD_HEADER,), 0.0)
        if raw[-1] != TAIL:
            return Stretch(start, stop, False, (Fault.BAD_TAIL,), 0.0)
        faults = frame_faults(raw)
        if self._probability(start, *piece[:2]) < LIKELY:
            faults += (Fault.AMBIGUOUS,)
        return Stretch(start, stop, True, faults, 0.0)

    def carry(self, last: Stretch) -> Carry:
        """What the bytes up to the end of `last`, a part of the reading, say of those behind it."""
        place, noise = last.stop, last.faults == (Fault.NOISE,)
        after_piece, after_noise, in_noise = self._passed(self._carry, place)
        after_piece, after_noise = after_piece[place:], after_noise[place:]
        total = sum(after_piece) + sum(after_noise) + in_noise
        return Carry(
            [weight / total for weight in after_piece],
            [weight / total for weight in after_noise],
            in_noise / total,
            ends_frame=not noise,
        )


def _joining(window: Window, carry: Carry) -> list[float]:
    """The weights after the first piece, where that may be the rest of a frame begun before."""
    weights = _padded(carry.after_piece, 0)
    if carry.within:
        rests = window.rests_from_first(FRAME_LENGTH - 1)
        weights = _padded(weights, len(rests))
        for place, rest in enumerate(rests, start=1):
            weights[place] += carry.within / (FRAME_LENGTH - 1) * rest
    return weights


def _padded(weights: list[float], size: int) -> list[float]:
    return (weights + [0.0] * (size + 1))[: max(size + 1, len(weights))]


def _noise_weight(length: int) -> float:
    if length <= LONGEST_JUNK:
        return JUNK
    return NOISE_BEGINS * NOISE_ENDS * NOISE_STAYS ** (length - 1)


def _improve(
    best: dict[int, tuple[float, int, Piece | None]],
    place: int,
    weight: float,
    begin: int,
    piece: Piece | None,
) -> None:
    if weight > best.get(place, (0.0, 0, None))[0]:
        best[place] = weight, begin, piece
