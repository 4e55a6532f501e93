"""Score of the rows of a damaged stream against the frames that were sent."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import FRAME_LENGTH, Status
from tests.support.faults import Harm, Sent


@dataclass(slots=True)
class Score:
    """Counts of one damaged stream; the shares are those of the quality table."""

    rows: int = 0
    undamaged: int = 0
    found: int = 0
    doubted: int = 0
    """Undamaged frames that were found as suspect."""
    invented: int = 0
    invented_ok: int = 0
    cases: list[tuple[int, Row]] = field(default_factory=list)
    """Invented rows with status ok: the number of the frame that was sent there, and the row."""
    missed: list[int] = field(default_factory=list)
    """Numbers of the undamaged frames that were not found."""

    @property
    def found_share(self) -> float:
        """Share of the undamaged frames that were found, with any status, 0-1."""
        return self.found / self.undamaged

    @property
    def invented_ok_share(self) -> float:
        """Share of all rows that are invented and have status ok, 0-1."""
        return self.invented_ok / self.rows

    @property
    def doubted_share(self) -> float:
        """Share of the undamaged frames that are suspect, 0-1."""
        return self.doubted / self.undamaged


def score(sent: Sequence[Sent], rows: Iterable[Row]) -> Score:
    """Score rows against the frames that were sent.

    A row is invented where no frame starts at its offset, or one with other bytes does; except
    where as many bytes were inserted as were lost, which cannot be detected.
    """
    began = {frame.start: number for number, frame in enumerate(sent)}
    began_with_junk = {frame.start - frame.before: number for number, frame in enumerate(sent)}
    total = Score(undamaged=sum(frame.whole for frame in sent))
    found: set[int] = set()
    for row in rows:
        total.rows += 1
        if not row.framed:
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


def harm_detail(frame: Sent) -> str:
    """The damage of a frame, in the detail that its own bytes can show."""
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
    """Labels of single damaged frames between intact ones.

    Keys are the kind of harm, its detail, and the label.

    The label is the first fault of the row that covers exactly the damaged bytes, `ok` without a
    fault, and `split` where no row begins or ends with them, or their rows have other labels.
    """
    by_start = {row.offset: row for row in rows}
    seen: Counter[tuple[Harm, str, str]] = Counter()
    for before, frame, after in zip(sent, sent[1:], sent[2:], strict=False):
        if frame.harm is None or before.harm is not None or after.harm is not None:
            continue
        span = (
            (frame.start - frame.before, frame.before)
            if frame.harm is Harm.JUNK
            else (frame.start, len(frame.arrived))
        )
        found, at = set(), span[0]
        while at < sum(span) and (row := by_start.get(at)) is not None:
            found.add(row.faults[0].value if row.faults else "ok")
            at += len(row.raw)
        name = found.pop() if at == sum(span) and len(found) == 1 else "split"
        seen[frame.harm, harm_detail(frame), name] += 1
    return seen
