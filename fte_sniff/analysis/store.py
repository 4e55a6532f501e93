"""The rows of a screen: all of them, by index, and those that a filter shows.

    index     of a row since the store began; it never changes
    position  of a row among those that are shown: `shown.indices[position] == index`

A screen appends what comes, and paints a slice:

    store = RowStore()
    store.append(rows); store.append(gap); store.end()     # `Rows`, `Gap`, `PortEvent`, ...
    shown = Matches(store, row_filter)
    while shown.extend(): ...                              # 128k rows at a time
    store.rows_at(shown.indices[top : top + height])       # the rows to paint
    store.batch(start, end); store.runs(start, end)        # a span, as for `motors_at`

The rows are columns in blocks; those above ten million are in a memory-mapped temporary file.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import takewhile
from tempfile import TemporaryFile
from typing import Any, Final

import numpy as np

from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.relations import DEADLINE_NS, RUN, Runs, runs_of
from fte_sniff.analysis.segments import Segments
from fte_sniff.analysis.table import Table
from fte_sniff.protocol.items import Change
from fte_sniff.protocol.rows import ARRAYS, FACTS, Array, Ints, Item, Rows

BLOCK_ROWS: Final = 1 << 20
MEMORY_ROWS: Final = 10_000_000
"""Rows that are in memory; later blocks are in a file."""
STEP_ROWS: Final = 1 << 17
"""Rows that `Matches.extend` tests at once: a few hundredths of a second."""


class RowStore:
    """All rows so far, with their facts."""

    def __init__(self, block_rows: int = BLOCK_ROWS, memory_rows: int = MEMORY_ROWS) -> None:
        self._block_rows, self._memory_blocks = block_rows, memory_rows // block_rows
        self._blocks = list[dict[str, Array]]()
        # Each table has the rows of the two seconds around its own.
        self._segments = Segments(most=1, every_ns=DEADLINE_NS)
        self.ports: tuple[str, ...] = ()
        """The ports so far."""
        self.marks = list[Change]()
        """Gaps, port events and baud changes, in their order."""
        self._starts, self._runs = np.zeros(1, np.int64), np.zeros(1, RUN)
        """The first index of each run, and the run."""
        self.next = 0
        """Index of the next row: the number of all rows so far."""
        self.known = 0
        """Index after the last row whose facts are known: a second or two behind."""

    def append(self, item: Item) -> None:
        """Append rows, or what happened before the next ones."""
        if isinstance(item, Rows):
            self._add(item)
        else:
            self.marks.append(Change(self.next, item))
        for table in self._segments.push(item):
            self._complete(table)

    def end(self) -> None:
        """Decide the facts of the last second: no more rows of this stream come."""
        self._complete(self._segments.rest())

    def _add(self, rows: Rows) -> None:
        start, self.next = self.next, self.next + len(rows)
        self.ports = tuple(dict.fromkeys((*self.ports, *rows.ports)))
        since = takewhile(lambda one: one.index == start, reversed(self.marks))
        gaps = [Change(0, one.what) for one in since]
        runs = runs_of(rows, gaps[::-1], self._runs[-1:])
        at = np.flatnonzero(runs != np.append(self._runs[-1:], runs[:-1])[: len(runs)])
        self._starts = np.append(self._starts, start + at)
        self._runs = np.append(self._runs, runs[at])
        columns = rows.with_ports(self.ports).columns
        for block, own, part in self._parts(start, self.next):
            for name, values in columns.items():
                block[name][own] = values[part]

    def _complete(self, table: Table) -> None:
        """Store the facts of a table's own rows."""
        facts = table.with_facts.select(slice(table.start, table.stop))
        start, self.known = self.known, self.known + len(facts)
        for block, own, part in self._parts(start, self.known):
            for name in FACTS:
                block[name][own] = facts.columns[name][part]

    def _parts(self, start: int, end: int) -> Iterator[tuple[dict[str, Array], slice, slice]]:
        """The blocks of a span, the rows of it in each, and their slice of the span."""
        size, at = self._block_rows, start
        while at < end:
            number, first = divmod(at, size)
            if number == len(self._blocks):
                in_file = number >= self._memory_blocks
                columns = {
                    name: _space(kind, size, in_file=in_file) for name, (kind, _) in ARRAYS.items()
                }
                self._blocks.append(columns)
            count = min(end - at, size - first)
            part = slice(at - start, at - start + count)
            yield self._blocks[number], slice(first, first + count), part
            at += count

    def batch(self, start: int, end: int) -> Rows:
        """The rows with indices from `start` up to `end` that exist; a view within a block."""
        start, end = max(0, start), min(end, self.next)
        parts = [Rows(block, self.ports).select(own) for block, own, _ in self._parts(start, end)]
        return Rows.concat(parts) if parts else Rows.blank(0, self.ports)

    def rows_at(self, indices: Ints) -> Rows:
        """The rows with these indices, which rise."""
        numbers, at = np.divmod(indices, self._block_rows)
        parts = [
            Rows(self._blocks[one], self.ports).select(at[numbers == one])
            for one in np.unique(numbers).tolist()
        ]
        return Rows.concat(parts) if parts else Rows.blank(0, self.ports)

    def runs(self, start: int, end: int) -> Runs:
        """The runs of the rows of a span."""
        start, end = max(0, start), min(end, self.next)
        return self._runs[np.searchsorted(self._starts, np.arange(start, end), "right") - 1]

    def index_at(self, t_ns: int) -> int:
        """The index of the first row that is not before a time, or after the last row."""
        for block, own, part in self._parts(0, self.next):
            is_after = block["t_ns"][own] >= t_ns
            if is_after.any():
                return int(part.start + is_after.argmax())
        return self.next


def _space(dtype: np.dtype[Any], size: int, *, in_file: bool) -> Array:
    """A column with space for rows, in memory or in a temporary file."""
    if not in_file:
        return np.empty(size, dtype)
    with TemporaryFile() as file:
        return np.memmap(file, dtype.base, "w+", shape=(size, *dtype.shape))


class Matches:
    """The indices of the rows that pass a filter: an array that grows with the store."""

    def __init__(self, store: RowStore, row_filter: RowFilter) -> None:
        """No row is tested yet; where the filter reads facts, rows wait until these are known."""
        self._store, self._filter = store, row_filter
        self._space: Ints = np.empty(1 << 12, np.int64)
        self.count = 0
        self.tested = 0
        """Index after the last row that was tested."""

    @property
    def indices(self) -> Ints:
        """The indices, rising; a view."""
        return self._space[: self.count]

    def extend(self, most: int = STEP_ROWS) -> bool:
        """Test at most this number of rows; returns whether more can be tested."""
        end = self._store.known if self._filter.needs_facts else self._store.next
        stop = min(end, self.tested + most)
        if stop > self.tested:
            passing = self._filter.matches(self._store.batch(self.tested, stop))
            found = np.flatnonzero(passing) + self.tested
            while self.count + len(found) > len(self._space):
                self._space = np.concatenate((self._space, np.empty_like(self._space)))
            self._space[self.count : self.count + len(found)] = found
            self.count, self.tested = self.count + len(found), stop
        return stop < end

    def position_of(self, index: int) -> int:
        """The number of rows before an index: the position of a row that passes."""
        return int(np.searchsorted(self.indices, index))
