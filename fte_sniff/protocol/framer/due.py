"""Owns when a disputed stretch is weighed next, and how much of its reading is decided then.

It must not weigh anything, nor keep any state. What it says depends on the bytes alone, up to the
place that it names; never on how many more have come.
"""

from __future__ import annotations

from typing import Final

from mypy_extensions import i64

from fte_sniff.protocol.framer.fault_sets import NOISE
from fte_sniff.protocol.framer.places import LENGTH
from fte_sniff.protocol.framer.reading import Stretch
from fte_sniff.protocol.framer.shapes import BEHIND, framed, framed_from, strict, strict_from

WIDEST: Final[i64] = 44
"""Bytes that are weighed at once, at most, while bytes keep coming."""

AHEAD: Final[i64] = 2 * LENGTH
"""Bytes behind ten framed ones with which it is decided at the latest what these are; and bytes
that stay undecided when `WIDEST` is reached."""

PROMISED: Final[i64] = LENGTH + AHEAD
"""Bytes from the beginning of ten framed ones to where that falls due."""

LEAD: Final[i64] = 32
"""Bytes before an anchor that are weighed, after long noise."""

_ENOUGH: Final[i64] = 3
"""Frames that fit, in step or not, that make it worth while to weigh."""

_NEVER: Final[i64] = -1


def next_due(data: bytes, start: i64, not_before: i64, weighed_to: i64) -> tuple[i64, i64]:
    """The place up to which `data` is to be weighed next, from `start`; -1 if not there yet.

    Before it stands the place up to which the bytes must be known for that. Nothing new is learnt
    before `not_before`, except that promises behind `weighed_to` fall due.
    """
    limit = min(i64(len(data)), start + WIDEST)
    known = limit - BEHIND
    if known < start + 2 * LENGTH:
        return _NEVER, _NEVER
    end = _earliest(
        _pair_end(data, max(start, not_before - 2 * LENGTH), known),
        _three_end(data, start, known),
        _third_end(data, start, known),
        not_before,
    )
    due, to = (end + BEHIND, end) if end >= 0 else (_NEVER, _NEVER)
    if limit == start + WIDEST and (due < 0 or limit < due):
        due = to = limit
    promised = next_promised(data, start, weighed_to, limit)
    if promised >= 0 and (due < 0 or promised < due or (promised == due and promised < to)):
        due = to = promised
    return due, to


def _earliest(pair: i64, three: i64, third: i64, not_before: i64) -> i64:
    """The earliest of these places that is not before that one; -1 if none is."""
    end = pair if pair >= not_before else _NEVER
    if three >= not_before and (end < 0 or three < end):
        end = three
    if third >= not_before and (end < 0 or third < end):
        end = third
    return end


def _pair_end(data: bytes, start: i64, known: i64) -> i64:
    """Where the first two strict frames in step end."""
    at = strict_from(data, start, known - LENGTH)
    while at >= 0 and not strict(data, at + LENGTH):
        at = strict_from(data, at + 1, known - LENGTH)
    return _NEVER if at < 0 else at + 2 * LENGTH


def _three_end(data: bytes, start: i64, known: i64) -> i64:
    """Where three times ten framed bytes in step end, that begin at the start."""
    end = start + 3 * LENGTH
    if end > known or not framed(data, start):
        return _NEVER
    return end if framed(data, start + LENGTH) and framed(data, start + 2 * LENGTH) else _NEVER


def _third_end(data: bytes, start: i64, known: i64) -> i64:
    """Where the third strict frame ends, in step or not."""
    end = start
    for _ in range(_ENOUGH):
        at = strict_from(data, end, known)
        if at < 0:
            return _NEVER
        end = at + LENGTH
    return end


def next_promised(data: bytes, start: i64, weighed_to: i64, limit: i64) -> i64:
    """The place by which the next ten framed bytes must be decided; -1 if behind `limit`."""
    at = framed_from(data, max(start, weighed_to + 1 - PROMISED), limit - AHEAD)
    return _NEVER if at < 0 else at + PROMISED


def settled_part(reading: list[Stretch], data: bytes, start: i64, end: i64) -> list[Stretch]:
    """What of a reading of `data` from `start` to `end`, where bytes may follow, is decided."""
    size = end - start
    if size >= WIDEST or (size >= PROMISED and framed(data, end - PROMISED)):
        return _up_to(reading, size - AHEAD)
    number: i64 = len(reading)
    while number > 0:
        part = reading[number - 1]
        if part.framed and part.stop <= size - AHEAD:
            break
        number -= 1
    return reading[:number]


def _up_to(reading: list[Stretch], limit: i64) -> list[Stretch]:
    """The parts up to `limit`: noise is cut there, an overlong frame is taken as a whole."""
    settled = [part for part in reading if part.stop <= limit]
    following = reading[len(settled)]
    if following.faults == NOISE and following.start < limit:
        settled.append(Stretch(following.start, limit, False, NOISE, 0.0))
    elif following.start <= limit - LENGTH:
        settled.append(following)
    return settled


def lead(data: bytes, start: i64, known: i64) -> i64:
    """Where weighing begins after long noise, for an anchor at `known`, but not before `start`.

    What is due already has been decided: it is noise.
    """
    begin = max(start, known - LEAD)
    while True:
        late = framed_from(data, begin, max(begin, known - 1))
        if late < 0:
            return begin
        begin = late + 1
