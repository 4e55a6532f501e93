"""Owns how rows are judged against what was sent: found, invented, doubted, labelled.

It must not know how streams are made or framed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from benchmarks.faults import Harm, Sent
from fte_sniff.protocol import FRAME_LENGTH, Frame, Row, Status


@dataclass(slots=True)
class Score:
    """What rows made of a damaged stream; the shares are those of the quality table."""

    rows: int = 0
    undamaged: int = 0
    found: int = 0
    doubted: int = 0
    """Undamaged frames that were found and called suspect."""
    invented: int = 0
    invented_ok: int = 0
    cases: list[tuple[int, Frame]] = field(default_factory=list)
    """Invented rows called ok: the number of the sent frame that stands there, and the row."""
    missed: list[int] = field(default_factory=list)
    """Numbers of the undamaged frames that were not found."""

    @property
    def found_share(self) -> float:
        """Undamaged frames found, with any status, 0-1."""
        return self.found / self.undamaged

    @property
    def invented_ok_share(self) -> float:
        """Rows that are invented and called ok, of all rows, 0-1."""
        return self.invented_ok / self.rows

    @property
    def doubted_share(self) -> float:
        """Undamaged frames called suspect, of all undamaged frames, 0-1."""
        return self.doubted / self.undamaged


def score(sent: Sequence[Sent], rows: Iterable[Row]) -> Score:
    """Judge rows by what was sent.

    A frame is invented where it starts where none began, or carries other bytes than the one that
    began there; except where equally many bytes came in as went out, which nobody can see.
    """
    began = {frame.start: number for number, frame in enumerate(sent)}
    began_with_junk = {frame.start - frame.before: number for number, frame in enumerate(sent)}
    total = Score(undamaged=sum(frame.whole for frame in sent))
    found: set[int] = set()
    for row in rows:
        total.rows += 1
        if not isinstance(row, Frame):
            continue
        number = began.get(row.offset)
        if number is not None and row.raw == sent[number].raw:
            if sent[number].whole:
                found.add(number)
                total.doubted += row.status is Status.SUSPECT
            continue
        if number is not None and began_with_junk.get(row.offset + FRAME_LENGTH) == number + 1:
            continue
        total.invented += 1
        if row.status is Status.OK:
            total.invented_ok += 1
            total.cases.append((number if number is not None else -1, row))
    total.found = len(found)
    total.missed = [n for n, frame in enumerate(sent) if frame.whole and n not in found]
    return total


def told_apart(frame: Sent) -> str:
    """What was done to a frame, as finely as its own bytes can tell a label."""
    if frame.harm is Harm.LOST:
        return "lost, header left" if frame.arrived[:1] == frame.raw[:1] else "lost, header too"
    if len(frame.arrived) == len(frame.raw) and frame.harm is not Harm.JUNK:
        changed = [a != b for a, b in zip(frame.arrived, frame.raw, strict=True)]
        if changed == [True] + [False] * 9:
            return "only the header changed"
        if changed == [False] * 9 + [True]:
            return "only the tail changed"
    return str(frame.harm)


def labels(sent: Sequence[Sent], rows: Iterable[Row]) -> Counter[tuple[Harm, str, str]]:
    """What single faults between intact neighbours were called, by what was done.

    Keys are the kind of harm, what was done as finely as can be told, and the label.

    The label is the row's first fault where one row covers exactly the damaged bytes, `ok` where
    it shows none, and `split` where no single row covers them.
    """
    by_place = {(row.offset, len(row.raw)): row for row in rows}
    seen: Counter[tuple[Harm, str, str]] = Counter()
    for before, frame, after in zip(sent, sent[1:], sent[2:], strict=False):
        if frame.harm is None or before.harm is not None or after.harm is not None:
            continue
        place = (
            (frame.start - frame.before, frame.before)
            if frame.harm is Harm.JUNK
            else (frame.start, len(frame.arrived))
        )
        row = by_place.get(place)
        name = "split" if row is None else row.faults[0].value if row.faults else "ok"
        seen[frame.harm, told_apart(frame), name] += 1
    return seen
