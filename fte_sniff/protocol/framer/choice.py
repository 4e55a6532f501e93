"""Owns the choice between the readings of one disputed stretch, and the doubt that remains.

It must not know of chunks, times or rows, nor reckon weights: `weighing` does.

- Shown are those frames that together are the most probable, none overlapping another.
- What lies between them is divided into the pieces that weigh most.
- A frame whose probability is below `CERTAIN` is `ambiguous`, unless it stands in step between a
  certain frame and another, and could not also be two truncated ones.
- Where the line has shown no damage for long, two truncated frames that together have ten bytes
  are no other reading.
"""

from __future__ import annotations

from fte_sniff.protocol.framer.gap import Gap
from fte_sniff.protocol.framer.likelihood import CERTAIN, LIKELY, SHOWN
from fte_sniff.protocol.framer.patterns import PLAIN_FRAME, STRICT, UNDIVIDED_FRAME
from fte_sniff.protocol.framer.reading import Stretch
from fte_sniff.protocol.framer.weighing import Weighing
from fte_sniff.protocol.rows import Fault
from fte_sniff.protocol.table import FRAME_LENGTH

DOUBT = (Fault.AMBIGUOUS,)
"""The faults of a frame that is whole, but for another reading."""


def chosen(weighing: Weighing, *following: Stretch) -> list[Stretch]:
    """The chosen reading of a window, which begins where the rows so far end.

    `following` is known to stand behind it.
    """
    probable, behind_rows = weighing.whole_frames(), weighing.whole_frames_behind_rows()
    reading: list[Stretch] = []
    at = 0
    for place in _shown_frames(probable if behind_rows is None else behind_rows):
        if at < place:
            reading += _between(weighing, Gap(weighing.window, at, place))
        reading.append(_frame(place, probable[place]))
        at = place + FRAME_LENGTH
    if at < weighing.size:
        gap = Gap(weighing.window, at, weighing.size)
        gap.end_with_cut_off(weighing.cut_off)
        reading += _between(weighing, gap)
    believed = _believing_neighbours(weighing.window.data, [*reading, *following])
    return believed[: len(reading)]


def _between(weighing: Weighing, gap: Gap) -> list[Stretch]:
    """The parts of a gap; ten framed bytes among them are `ambiguous` where that is unlikely."""
    return [
        part._replace(faults=part.faults + DOUBT)
        if part.framed and weighing.probability(part.start, part.stop, weight) < LIKELY
        else part
        for part, weight in gap.parts()
    ]


def _shown_frames(probable: dict[int, float]) -> list[int]:
    """Where the most probable whole frames begin, none overlapping another."""
    likely = [(place, own - SHOWN) for place, own in probable.items() if own > SHOWN]
    best: list[tuple[float, int | None]] = [(0.0, None)]
    """By how many frames are considered: the best sum, and how many were before its last frame."""
    for number, (place, gain) in enumerate(likely):
        before = number
        while before and likely[before - 1][0] + FRAME_LENGTH > place:
            before -= 1
        value = best[before][0] + gain
        without = best[number][0]
        best.append((value, before) if value > without else (without, None))
    shown: list[int] = []
    number = len(likely)
    while number:
        last = best[number][1]
        if last is not None:
            shown.append(likely[number - 1][0])
        number = number - 1 if last is None else last
    return shown[::-1]


def _frame(start: int, probability: float) -> Stretch:
    """A whole frame: it fits its kind at every place, so its only fault can be doubt."""
    faults = () if probability >= CERTAIN else DOUBT
    return Stretch(start, start + FRAME_LENGTH, True, faults, probability)


def _believing_neighbours(data: bytes, reading: list[Stretch]) -> list[Stretch]:
    """The reading with those frames believed that stand in step between others.

    Where a frame follows a certain one, and another one follows it, it takes two faults that
    cancel each other out to make a better reading; that is rarer than the weights say, unless
    the frame could be divided into two truncated ones.
    """
    for number in range(1, len(reading) - 1):
        frame = reading[number]
        if frame.faults != DOUBT or frame.probability < LIKELY:
            continue
        in_step = reading[number - 1].certain and reading[number + 1].probability
        if in_step and PLAIN_FRAME.match(data, frame.start):
            reading[number] = frame._replace(faults=())
    return reading


def calmly(weighing: Weighing, reading: list[Stretch]) -> list[Stretch]:
    """The reading of a line that was calm, with its frames believed up to the first damage.

    If it is only weighed, a frame is taken for two truncated ones whenever a target ends as another
    kind's flags do: those who hold a motor at 15 pulses would see nothing else. Where they even
    weigh more, as where a payload imitates a tail and a header, the frame is shown, and doubted.
    """
    believed: list[Stretch] = []
    rest = iter(reading)
    for part in rest:
        if not part.framed:
            whole = _whole_of_two(weighing, part, next(rest, None))
            if whole is None:
                break
            part = whole
        believed.append(_believed(weighing, part))
    covered = believed[-1].stop if believed else 0
    return believed + [part for part in reading if part.start >= covered]


def _whole_of_two(weighing: Weighing, first: Stretch, second: Stretch | None) -> Stretch | None:
    """The one frame that two damaged ones in a row are together; None where they are none."""
    if second is None or second.framed or second.stop - first.start != FRAME_LENGTH:
        return None
    if not STRICT.match(weighing.window.data, first.start):
        return None
    return Stretch(first.start, second.stop, True, DOUBT, 0.0)


def _believed(weighing: Weighing, frame: Stretch) -> Stretch:
    """The frame without its doubt, if only two truncated ones could stand there instead."""
    if frame.faults != DOUBT or frame.probability < LIKELY:
        return frame
    if not UNDIVIDED_FRAME.match(weighing.window.data, frame.start):
        return frame
    certain = min(map(weighing.boundary, (frame.start, frame.stop))) >= CERTAIN
    return frame._replace(faults=()) if certain else frame
