"""Owns when a disputed stretch is weighed next, and how much of its reading is decided then.

It must not weigh anything, nor keep any state. What it says depends on the bytes alone, up to the
place that it names; never on how many more have come.
"""

from __future__ import annotations

from fte_sniff.protocol.framer.enclosed import BEHIND
from fte_sniff.protocol.framer.patterns import FRAMED, FRAMED_THREE, STRICT, STRICT_PAIR
from fte_sniff.protocol.framer.reading import Stretch
from fte_sniff.protocol.framer.tiling import NOISE
from fte_sniff.protocol.table import FRAME_LENGTH

WIDEST = 44
"""Bytes that are weighed at once, at most, while bytes keep coming."""

AHEAD = 2 * FRAME_LENGTH
"""Bytes behind ten framed ones with which it is decided at the latest what these are; and bytes
that stay undecided when `WIDEST` is reached."""

PROMISED = FRAME_LENGTH + AHEAD
"""Bytes from the beginning of ten framed ones to where that falls due."""

LEAD = 32
"""Bytes before an anchor that are weighed, after long noise."""

_ENOUGH = 3
"""Frames that fit, in step or not, that make it worth while to weigh."""


def next_due(data: bytes, start: int, not_before: int, weighed_to: int) -> tuple[int, int] | None:
    """The place up to which `data` is to be weighed next, from `start`; None if not there yet.

    Before it stands the place up to which the bytes must be known for that. Nothing new is learnt
    before `not_before`, except that promises behind `weighed_to` fall due.
    """
    limit = min(len(data), start + WIDEST)
    known = limit - BEHIND
    if known < start + 2 * FRAME_LENGTH:
        return None
    ends = []
    pair = STRICT_PAIR.search(data, max(start, not_before - 2 * FRAME_LENGTH), known)
    if pair:
        ends.append(pair.end())
    three = FRAMED_THREE.match(data, start, known)
    if three:
        ends.append(three.end())
    found, count = STRICT.search(data, start, known), 1
    while found and count < _ENOUGH:
        found, count = STRICT.search(data, found.end(), known), count + 1
    if found:
        ends.append(found.end())
    due = [(end + BEHIND, end) for end in ends if end >= not_before]
    if limit == start + WIDEST:
        due.append((limit, limit))
    promised = next_promised(data, start, weighed_to, limit)
    if promised is not None:
        due.append((promised, promised))
    return min(due, default=None)


def next_promised(data: bytes, start: int, weighed_to: int, limit: int) -> int | None:
    """The place by which the next ten framed bytes must be decided; None if behind `limit`."""
    first = max(start, weighed_to + 1 - PROMISED)
    framed = FRAMED.search(data, first, limit - AHEAD) if limit > AHEAD else None
    return framed.end() + AHEAD if framed else None


def settled_part(reading: list[Stretch], data: bytes, start: int, end: int) -> list[Stretch]:
    """What of a reading of `data` from `start` to `end`, where bytes may follow, is decided."""
    size = end - start
    if size >= WIDEST or (size >= PROMISED and FRAMED.match(data, end - PROMISED)):
        return _up_to(reading, size - AHEAD)
    frames = [n for n, part in enumerate(reading) if part.framed and part.stop <= size - AHEAD]
    return reading[: frames[-1] + 1] if frames else []


def _up_to(reading: list[Stretch], limit: int) -> list[Stretch]:
    """The parts up to `limit`: noise is cut there, an overlong frame is taken as a whole."""
    settled = [part for part in reading if part.stop <= limit]
    following = reading[len(settled)]
    if following.faults == NOISE and following.start < limit:
        settled.append(following._replace(stop=limit))
    elif following.start <= limit - FRAME_LENGTH:
        settled.append(following)
    return settled


def lead(data: bytes, start: int, known: int) -> int:
    """Where weighing begins after long noise, for an anchor at `known`, but not before `start`.

    What is due already has been decided: it is noise.
    """
    begin = max(start, known - LEAD)
    while late := FRAMED.search(data, begin, max(begin, known - 1)):
        begin = late.start() + 1
    return begin
