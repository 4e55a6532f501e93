"""Owns how many of each sort came when, over any length of time, in bounded memory.

It must not know what is counted. Time is cut into slots of equal length; where a time lies outside
of them, two slots become one until it fits, so that the slots always cover all there was.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from fte_sniff.analysis.columns.fields import Ints

SLOTS: Final = 512
"""Slots at most; they cover at least half of what they could."""

SHORTEST_NS: Final = 1 << 24
"""Length of a slot at first, nanoseconds: about 17 ms."""


@dataclass(frozen=True, slots=True)
class OverTime:
    """A number in each of equally long slots of time."""

    start_ns: int
    """When the first slot begins, nanoseconds since 1970 UTC."""
    slot_ns: int
    values: tuple[float, ...]


class CountsOverTime:
    """Numbers by sort (0, 1, ...) and by slot."""

    def __init__(self, shortest_ns: int = SHORTEST_NS) -> None:
        """Nothing came yet; a slot is `shortest_ns` long as long as that is long enough."""
        self.slot_ns = shortest_ns
        """Length of a slot, nanoseconds."""
        self._first = 0
        self._table: Ints = np.zeros((0, 0), np.int64)

    @property
    def start_ns(self) -> int:
        """When the first slot begins, nanoseconds since 1970 UTC."""
        return self._first * self.slot_ns

    def add(self, sorts: npt.NDArray[np.integer], t_ns: Ints, counts: Ints | None = None) -> None:
        """So many (1 where nothing is said) of each sort came at these times."""
        if not len(t_ns):
            return
        self._make_room(int(sorts.max()), int(t_ns.min()), int(t_ns.max()))
        places = sorts * self._table.shape[1] + (t_ns // self.slot_ns - self._first)
        added = np.bincount(places, counts, self._table.size)
        self._table += added.astype(np.int64).reshape(self._table.shape)

    def _make_room(self, sort: int, low_ns: int, high_ns: int) -> None:
        if not self._table.shape[1]:
            self._first = low_ns // self.slot_ns
        slots = self._table.shape[1]
        while True:
            first = min(self._first, low_ns // self.slot_ns)
            last = max(self._first + slots - 1, high_ns // self.slot_ns)
            if last - first < SLOTS:
                break
            self._halve()
            slots = self._table.shape[1]
        before, behind = self._first - first, last + 1 - self._first - slots
        below = max(0, sort + 1 - len(self._table))
        self._table = np.pad(self._table, ((0, below), (before, behind)))
        self._first = first

    def _halve(self) -> None:
        """Make two slots one."""
        table, slots = self._table, self._table.shape[1]
        odd = self._first % 2
        table = np.pad(table, ((0, 0), (odd, (slots + odd) % 2)))
        self._table = table[:, ::2] + table[:, 1::2]
        self._first //= 2
        self.slot_ns *= 2

    def of(self, sort: int) -> Ints:
        """The numbers of one sort, slot by slot; as many as for every other."""
        if sort >= len(self._table):
            return np.zeros(self._table.shape[1], np.int64)
        row: Ints = self._table[sort]
        return row
