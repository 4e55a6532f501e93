"""Streams of items, and their merge in the order of time.

A stream is an iterator of items: rows, and what happened between the rows before and after it, so a
gap has no index that slices, filters and merges would have to move.

    lane A   ───a1──────────a2─────────┤ reached
    lane B   ────────b1──────┤ reached
             taken: a1 b1     waits: a2

A lane has the items of one stream that wait. No item of it to come has a key before `reached`. The
keys are times; a row that is earlier than the one before it counts as of the time of that one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, cast

import numpy as np

from fte_sniff.protocol.items import PortEvent
from fte_sniff.protocol.rows import Bools, Ints, Item, Rows

NEVER: Final = -(2**63)
EVER: Final = 2**63 - 1


@dataclass(slots=True)
class Lane:
    """The items of one stream that wait."""

    reached: int = NEVER
    last: int = NEVER
    """The key of the last item that was put."""
    _items: deque[tuple[Item, Ints]] = field(default_factory=deque)
    """Each with the keys of its rows, or its own."""

    def put(self, item: Item, keys: Ints | None = None) -> None:
        """Append an item; an event has the key of its time, a gap that of the item before it.

        Other keys than times never fall.
        """
        if keys is not None:
            pass
        elif isinstance(item, Rows):
            keys = np.maximum.accumulate(np.maximum(item.t_ns, self.last))
        else:
            t_ns = item.t_ns if isinstance(item, PortEvent) else self.last
            keys = np.array([max(t_ns, self.last)])
        if len(keys):
            self.last = int(keys[-1])
            self._items.append((item, keys))

    @property
    def waiting(self) -> int:
        """Rows and other items that wait."""
        return sum(len(keys) for _, keys in self._items)

    @property
    def mark(self) -> int:
        """The key of the first other item than rows that waits: no row after it comes before it."""
        found = (int(keys[0]) for item, keys in self._items if not isinstance(item, Rows))
        return next(found, EVER)

    def rows_to(self, limit: int) -> Iterator[tuple[Rows, Ints]]:
        """Remove the rows whose keys are not after the limit, up to the first other item."""
        while self._items:
            rows, keys = self._items[0]
            stop = int(keys.searchsorted(limit, "right"))
            if not isinstance(rows, Rows) or not stop:
                return
            self._items.popleft()
            if stop < len(keys):
                self._items.appendleft((rows[stop:], keys[stop:]))
            yield rows[:stop], keys[:stop]

    def others_to(self, limit: int) -> Iterator[Item]:
        """Remove the other items at the start whose keys are not after the limit."""
        while self._items and self._items[0][1][0] <= limit:
            if isinstance(self._items[0][0], Rows):
                return
            yield self._items.popleft()[0]


class Merge:
    """The items of lanes in the order of their keys; those with equal keys by lane."""

    def __init__(self) -> None:
        self.lanes: list[Lane] = []

    @property
    def waiting(self) -> int:
        """Rows and other items that wait."""
        return sum(lane.waiting for lane in self.lanes)

    def take(self, *, least: int = NEVER, final: bool = False) -> Iterator[Item]:
        """Remove what no lane can precede any more, and all up to the key `least`."""
        reached = min((lane.reached for lane in self.lanes), default=EVER)
        settled = EVER if final or len(self.lanes) == 1 else max(least, reached)
        while True:
            limit = min([settled, *(lane.mark for lane in self.lanes)])
            parts = [part for lane in self.lanes for part in lane.rows_to(limit)]
            if parts:
                yield _joined(parts)
            others = [item for lane in self.lanes for item in lane.others_to(limit)]
            yield from others
            if not others:
                return


def _joined(parts: Sequence[tuple[Rows, Ints]]) -> Rows:
    rows = Rows.concat([own for own, _ in parts])
    keys = np.concatenate([keys for _, keys in parts])
    if len(parts) == 1 or (keys[1:] >= keys[:-1]).all():
        return rows
    return rows.select(keys.argsort(kind="stable"))


def uncertain(rows: Rows, uncertainty_ns: Mapping[str, int]) -> Bools:
    """Which rows, merged by time, may belong on the other side of a row of another port.

    The bytes of a port's row may have been on the wire by `uncertainty_ns` earlier than its time.
    """
    if not len(rows) or len(rows.used_ports) < 2:
        return np.zeros(len(rows), np.bool_)
    earlier = np.array([uncertainty_ns.get(port, 0) for port in rows.ports], np.int64)[rows.port]
    cuts = np.flatnonzero(rows.port[1:] != rows.port[:-1]) + 1  # where the port changes
    run = np.searchsorted(cuts, np.arange(len(rows)), "right")
    before, after = np.append(0, cuts)[run] - 1, np.append(cuts, len(rows))[run]
    near_before = (before >= 0) & (rows.t_ns - rows.t_ns[before] <= earlier)
    next_at = np.minimum(after, len(rows) - 1)
    near_after = (after < len(rows)) & (rows.t_ns[next_at] - rows.t_ns <= earlier[next_at])
    return cast("Bools", near_before | near_after)


@dataclass(frozen=True, slots=True)
class Timed:
    """A stream that can be opened."""

    first_ns: int | None
    """No row is earlier, except those that came late; None if its rows have no times."""
    open: Callable[[bool], Iterator[Item]]
    """Begins to read it; the argument is whether others are open."""


def merged(streams: Iterable[Timed]) -> Generator[Item]:
    """The items of streams that are sorted by their first times, those without at the end.

    A stream is opened when its first row is due, so few are open at a time.
    """
    merge, waiting = Merge(), deque(streams)
    if len(waiting) == 1:
        yield from waiting[0].open(False)
        return
    opened: list[tuple[Lane, Iterator[Item]]] = []
    while waiting or opened:
        first = min(opened, key=lambda one: one[0].reached, default=None)
        due_ns = waiting[0].first_ns if waiting else None
        if first is None or (due_ns is not None and due_ns < first[0].reached):
            one = waiting.popleft()
            lane = Lane(NEVER if one.first_ns is None else one.first_ns)
            opened.append((lane, one.open(bool(opened))))
            merge.lanes.append(lane)
            continue
        yield from merge.take()
        lane, stream = first
        if (item := next(stream, None)) is not None:
            lane.put(item)
            lane.reached = max(lane.reached, lane.last)
            continue
        opened.remove(first)
        lane.reached = EVER
        merge.lanes = [lane for lane in merge.lanes if lane.reached < EVER or lane.waiting]
    yield from merge.take(final=True)
