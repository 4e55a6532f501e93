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

from librt.vecs import vec
from mypy_extensions import i64

from fte_sniff.protocol.framer.fault_sets import AMBIGUOUS
from fte_sniff.protocol.framer.gap import Gap
from fte_sniff.protocol.framer.likelihood import CERTAIN, LIKELY, SHOWN
from fte_sniff.protocol.framer.places import LENGTH
from fte_sniff.protocol.framer.reading import Stretch
from fte_sniff.protocol.framer.shapes import plain, strict, undivided
from fte_sniff.protocol.framer.weighing import Weighing


def chosen(weighing: Weighing, following: Stretch | None = None) -> list[Stretch]:
    """The chosen reading of a window, which begins where the rows so far end.

    `following` is known to stand behind it.
    """
    window = weighing.window
    probable = weighing.whole_frames()
    behind_rows = weighing.whole_frames_behind_rows() if weighing.behind_rows else probable
    reading: list[Stretch] = []
    at: i64 = 0
    for number in _shown_frames(weighing, behind_rows):
        place = window.starts[number].place
        if at < place:
            _divide(weighing, Gap(window, at, place), reading)
        reading.append(_frame(place, probable[number]))
        at = place + LENGTH
    if at < weighing.size:
        gap = Gap(window, at, weighing.size)
        for start in window.starts:
            if start.place > weighing.size - LENGTH:
                gap.end_with_cut_off(start, weighing.cut_off(start))
        _divide(weighing, gap, reading)
    _believe_neighbours(window.data, reading, following)
    return reading


def _divide(weighing: Weighing, gap: Gap, reading: list[Stretch]) -> None:
    """Add the parts of a gap; ten framed bytes among them are `ambiguous` where unlikely."""
    for part in gap.parts():
        faults = part.faults
        if part.framed and weighing.probability(part.start, part.stop, part.probability) < LIKELY:
            faults |= AMBIGUOUS
        reading.append(Stretch(part.start, part.stop, part.framed, faults, 0.0))


def _shown_frames(weighing: Weighing, probable: vec[float]) -> list[i64]:
    """Of which headers the most probable whole frames begin, none overlapping another."""
    starts = weighing.window.starts
    likely = vec[i64]([i64(0)] * len(probable))
    count: i64 = 0
    for number in range(i64(len(probable))):
        if probable[number] > SHOWN:
            likely[count] = number
            count += 1
    best = vec[float]([0.0] * (count + 1))
    """By how many frames are considered: the best sum, and how many were before its last frame."""
    left = vec[i64]([i64(-1)] * (count + 1))
    for number in range(count):
        place, gain = starts[likely[number]].place, probable[likely[number]] - SHOWN
        before = number
        while before > 0 and starts[likely[before - 1]].place + LENGTH > place:
            before -= 1
        best[number + 1] = best[number]
        if best[before] + gain > best[number]:
            best[number + 1], left[number + 1] = best[before] + gain, before
    shown: list[i64] = []
    while count > 0:
        if left[count] < 0:
            count -= 1
            continue
        shown.append(likely[count - 1])
        count = left[count]
    shown.reverse()
    return shown


def _frame(start: i64, probability: float) -> Stretch:
    """A whole frame: it fits its kind at every place, so its only fault can be doubt."""
    faults = i64(0) if probability >= CERTAIN else AMBIGUOUS
    return Stretch(start, start + LENGTH, True, faults, probability)


def _believe_neighbours(data: bytes, reading: list[Stretch], following: Stretch | None) -> None:
    """Believe those frames that stand in step between others.

    Where a frame follows a certain one, and another one follows it, it takes two faults that
    cancel each other out to make a better reading; that is rarer than the weights say, unless
    the frame could be divided into two truncated ones.
    """
    for number in range(i64(1), i64(len(reading))):
        frame = reading[number]
        if frame.faults != AMBIGUOUS or frame.probability < LIKELY:
            continue
        behind = reading[number + 1] if number + 1 < len(reading) else following
        if behind is None or behind.probability == 0.0 or not reading[number - 1].certain:
            continue
        if plain(data, frame.start):
            reading[number] = frame.called(0)


def calmly(weighing: Weighing, reading: list[Stretch]) -> list[Stretch]:
    """The reading of a line that was calm, with its frames believed up to the first damage.

    If it is only weighed, a frame is taken for two truncated ones whenever a target ends as another
    kind's flags do: those who hold a motor at 15 pulses would see nothing else. Where they even
    weigh more, as where a payload imitates a tail and a header, the frame is shown, and doubted.
    """
    believed: list[Stretch] = []
    number: i64 = 0
    while number < len(reading):
        part = reading[number]
        if not part.framed:
            second = reading[number + 1] if number + 1 < len(reading) else None
            whole = _whole_of_two(weighing, part, second)
            if whole is None:
                break
            part = whole
            number += 1
        believed.append(_believed(weighing, part))
        number += 1
    return believed + reading[number:]


def _whole_of_two(weighing: Weighing, first: Stretch, second: Stretch | None) -> Stretch | None:
    """The one frame that two damaged ones in a row are together; None where they are none."""
    if second is None or second.framed or second.stop - first.start != LENGTH:
        return None
    if not strict(weighing.window.data, first.start):
        return None
    return Stretch(first.start, second.stop, True, AMBIGUOUS, 0.0)


def _believed(weighing: Weighing, frame: Stretch) -> Stretch:
    """The frame without its doubt, if only two truncated ones could stand there instead."""
    if frame.faults != AMBIGUOUS or frame.probability < LIKELY:
        return frame
    if not undivided(weighing.window.data, frame.start):
        return frame
    before, behind = weighing.boundary(frame.start), weighing.boundary(frame.stop)
    return frame.called(0) if min(before, behind) >= CERTAIN else frame
