"""Owns the one way from the tests to what the framer weighs and decides inside.

It must not know what is right. Everything is asked of bytes and answered in plain numbers and fault
words, so that the insides of the framer can change, and only this file with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from fte_sniff.protocol import Fault
from fte_sniff.protocol.framer import decoder as enclosed
from fte_sniff.protocol.framer import predicates as shapes
from fte_sniff.protocol.framer.candidates import CandidateSet
from fte_sniff.protocol.framer.decoder import DamagedSpan, calmly, chosen, undisputed
from fte_sniff.protocol.framer.likelihood import BOUNDARY, CLOSED, OPEN
from fte_sniff.protocol.framer.posterior import (
    BoundaryState,
    ForwardBackward,
    joined,
    lost,
    settled,
    trusted,
)
from fte_sniff.protocol.framer.segments import Segment
from fte_sniff.protocol.framer.tables import FAULT_SETS

__all__ = [
    "BOUNDARY",
    "CLOSED",
    "OPEN",
    "Part",
    "doubtless_from",
    "gap_of",
    "joined",
    "lost",
    "piece_weights",
    "read_alone",
    "reading_of",
    "settled",
    "trusted",
    "undisputed_at",
    "whole_frames",
]


class Part(NamedTuple):
    """A part of a reading."""

    start: int
    stop: int
    framed: bool
    faults: tuple[Fault, ...]

    @property
    def certain(self) -> bool:
        """Whether it is a frame that is to be believed."""
        return self.framed and not self.faults


def _part(stretch: Segment) -> Part:
    return Part(stretch.start, stretch.stop, stretch.framed, FAULT_SETS[stretch.faults])


def _parts(reading: Sequence[Segment]) -> list[Part]:
    return [_part(stretch) for stretch in reading]


def whole_frames(data: bytes, carry: BoundaryState, ending: int) -> dict[int, float]:
    """Where a whole frame can stand in a stretch, and how probable it is (0-1)."""
    weighing = ForwardBackward(CandidateSet(data), carry, ending)
    probable = weighing.whole_frames()
    return {
        front.place: probable[number]
        for number, front in enumerate(weighing.window.starts)
        if front.whole > 0
    }


def reading_of(
    data: bytes,
    carry: BoundaryState,
    ending: int,
    *,
    before_frame: bool = False,
    calm: bool = False,
) -> list[Part]:
    """The chosen reading of a stretch; `before_frame` if one is known to stand behind it."""
    weighing = ForwardBackward(CandidateSet(data), carry, ending)
    following = Segment(0, 10, True, 0, 1.0) if before_frame else None
    reading = chosen(weighing, following)
    return _parts(calmly(weighing, reading) if calm else reading)


def piece_weights(data: bytes) -> dict[tuple[int, int], float]:
    """Where each frame, whole or damaged, can begin and end in a stretch, and what it weighs."""
    window = CandidateSet(data)
    weights: dict[tuple[int, int], float] = {}

    def add(start: int, stop: int, weight: float) -> None:
        if weight > 0:
            weights[start, stop] = weights.get((start, stop), 0.0) + weight

    for front in window.starts:
        for length in range(1, front.cut_to + 1):
            add(front.place, front.place + length, window.truncated(front, length))
        add(front.place, front.place + 10, window.whole(front) or window.bad_tail(front))
    for stop in window.stops:
        for place in range(stop.first, stop.place):
            add(place, stop.place, stop.weights[place - stop.first])
    return weights


def gap_of(data: bytes) -> list[Part]:
    """How a stretch is divided in which no whole frame is shown."""
    return _parts(DamagedSpan(CandidateSet(data), 0, len(data)).parts())


def read_alone(data: bytes, firm: int, *, calm: bool) -> list[Part] | None:
    """The parts of what stands before a frame beyond doubt; None where weighing has to tell."""
    reading = enclosed.read_by_itself(data, 0, firm, calm=calm)
    return None if reading is None else _parts(reading)


def undisputed_at(data: bytes, at: int) -> Part | None:
    """The damage there that has one reading only, counted from there; None if it needs weighing."""
    stretch = undisputed(data, at)
    return None if stretch is None else _part(stretch)


def doubtless_from(data: bytes, start: int, end: int) -> int:
    """Where the next frame beyond doubt stands; -1 if there is none."""
    return shapes.doubtless_frame(data, start, end)
