"""Merge the batches of several inputs by time, columns at a time.

Each input gives its rows in order, a batch at a time. The batch that ends first decides how far the
order is settled:

    input A   ──────a1──────a2───┤ next batch
    input B      ──b1─────b2────────────b3───┤
    input C                                      first row: not opened yet
              emitted: b1 a1 b2 a2  waits: b3

A row that is earlier than one before it in its input stays behind it. Rows of the same time come in
the order of the inputs. So memory holds one batch for each input that is open, and an input is open
from the time of its first row to its end. A batch that no other overlaps is passed on as it is.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import takewhile
from operator import attrgetter
from typing import TYPE_CHECKING

from fte_sniff.analysis.feed import StreamChange, rising_times
from fte_sniff.protocol import PortEvent
from fte_sniff.session.inputs import InputBatch

if TYPE_CHECKING:
    from fte_sniff.protocol.rows import Ints, Rows

_NEVER = -(2**63)


@dataclass(frozen=True, slots=True)
class TimedInput:
    """An input that can be opened."""

    first_ns: int | None
    """No row is earlier, except those that came late; None if its rows have no times."""
    open: Callable[[int], Iterator[InputBatch]]
    """Reads its batches; the argument is the number of other open inputs."""


def merged_by_time(inputs: Sequence[TimedInput]) -> Iterator[InputBatch]:
    """The batches of inputs that are sorted by their first times, those without at the end.

    Raises what reading an input raises, after the rows up to there.
    """
    waiting, lanes = deque(inputs), list[_Lane]()
    while waiting or lanes:
        first = min(lanes, key=attrgetter("end_ns"), default=None)
        if first is None or (waiting and _starts_before(waiting[0], first.end_ns)):
            lane = _Lane(waiting.popleft(), len(lanes))
            if lane.advance():
                lanes.append(lane)
            continue
        place = lanes.index(first)
        yield _joined(
            [lane.take(first.end_ns, inclusive=True) for lane in lanes[:place]]
            + [first.take_all()]
            + [lane.take(first.end_ns, inclusive=False) for lane in lanes[place + 1 :]]
        )
        if not first.advance():
            lanes.remove(first)


def _starts_before(one: TimedInput, t_ns: int) -> bool:
    return one.first_ns is not None and one.first_ns < t_ns


class _Lane:
    """An open input: its current batch, and how far it is read."""

    def __init__(self, source: TimedInput, others: int) -> None:
        self._batches = source.open(others)
        self.end_ns = _NEVER if source.first_ns is None else source.first_ns
        """The latest time in its current batch, and before."""

    def advance(self) -> bool:
        """Read the next batch; returns whether there is one."""
        found = next(self._batches, None)
        if found is None:
            return False
        self._batch, self._start, self._floor_ns = found, 0, self.end_ns
        self._times: Ints | None = None
        self._events, self._changes = deque(found.events), deque(found.changes)
        self.end_ns = max(self.end_ns, found.latest_ns or _NEVER)
        return True

    def take_all(self) -> _Passage:
        """What is left of the batch."""
        return self._take(len(self._batch.rows), len(self._events), len(self._changes))

    def take(self, t_ns: int, *, inclusive: bool) -> _Passage:
        """What comes before a time within the batch; with `inclusive`, up to it."""
        if self._times is None:
            self._times = rising_times(self._batch.rows, self._floor_ns)
        stop = int(self._times.searchsorted(t_ns, "right" if inclusive else "left"))
        before_ns = t_ns + inclusive
        events = sum(1 for _ in takewhile(lambda event: event.t_ns < before_ns, self._events))
        changes = sum(1 for _ in takewhile(lambda change: change.index < stop, self._changes))
        return self._take(stop, events, changes)

    def _take(self, stop: int, events: int, changes: int) -> _Passage:
        start, self._start = self._start, stop
        return _Passage(
            self._batch,
            RowSlice(self._batch.reload, start, stop, self._floor_ns),
            [self._events.popleft() for _ in range(events)],
            [self._changes.popleft() for _ in range(changes)],
        )


@dataclass(frozen=True, slots=True)
class RowSlice:
    """Consecutive rows of a batch."""

    reload: Callable[[], Rows] | None
    """Reads the batch again; None if that is impossible."""
    start: int
    stop: int
    floor_ns: int
    """Earlier rows of the batch count as of this time."""

    def times(self, rows: Rows) -> Ints:
        """The rising times by which its rows are merged; `rows` are those of the batch."""
        return rising_times(rows, self.floor_ns)[self.start : self.stop]


@dataclass(frozen=True, slots=True)
class _Passage:
    """The next rows of a batch, and what is between them."""

    batch: InputBatch
    rows: RowSlice
    events: Sequence[PortEvent]
    changes: Sequence[StreamChange]

    def __bool__(self) -> bool:
        return self.rows.start < self.rows.stop or bool(self.events or self.changes)

    @property
    def is_whole(self) -> bool:
        """Whether it is all of the batch."""
        return (self.rows.stop - self.rows.start, len(self.events), len(self.changes)) == (
            len(self.batch.rows),
            len(self.batch.events),
            len(self.batch.changes),
        )


def _joined(passages: Sequence[_Passage]) -> InputBatch:
    passages = [one for one in passages if one]
    if len(passages) == 1 and passages[0].is_whole:
        return passages[0].batch
    if not passages:
        return InputBatch()
    import numpy as np

    slices = [one.rows for one in passages]
    rows, order = _merged_rows([one.batch.rows for one in passages], slices)
    place = order.argsort()
    lengths = [one.stop - one.start for one in slices]
    changes, base = list[StreamChange](), 0
    for one in passages:
        for change in one.changes:
            index = base + change.index - one.rows.start
            at = len(rows) if change.index == one.rows.stop else int(place[index])
            changes.append(replace(change, index=at))
        base += one.rows.stop - one.rows.start
    origins = [np.asarray(one.batch.origin) for one in passages]
    return InputBatch(
        rows,
        sorted((event for one in passages for event in one.events), key=attrgetter("t_ns")),
        reload=None if any(one.reload is None for one in slices) else partial(_reread, slices),
        changes=sorted(changes, key=attrgetter("index")),
        losses=[loss for one in passages for loss in one.batch.losses if one.is_whole],
        origin=np.repeat(origins, lengths)[order],
    )


def _merged_rows(batches: Sequence[Rows], slices: Sequence[RowSlice]) -> tuple[Rows, Ints]:
    """The rows of slices of batches, merged, and their places in all slices one after the other."""
    import numpy as np

    from fte_sniff.protocol.rows import Rows

    parts = zip(batches, slices, strict=True)
    times = np.concatenate([one.times(rows) for rows, one in parts])
    order = times.argsort(kind="stable")
    parts = zip(batches, slices, strict=True)
    rows = Rows.concat([rows[one.start : one.stop] for rows, one in parts])
    return rows.select(order), order


def _reread(slices: Sequence[RowSlice]) -> Rows:
    """Read merged rows again."""
    return _merged_rows([one.reload() for one in slices if one.reload is not None], slices)[0]
