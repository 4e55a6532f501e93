"""Search in a store: the next matching row, and a counter of all of them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from fte_sniff.analysis.row_store import Block, Offsets, RowStore
from fte_sniff.errors import InputTextError, printable
from fte_sniff.protocol import COLUMN_BY_NAME, ColumnType
from fte_sniff.protocol.rows import MOST_BYTES, NO_ROWS, Bools, Codes, Rows, faults_in

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter


SELECT_ROWS: Final = 4096
"""Most rows that one `select_rows` returns, in a few hundredths of a second."""

RowTest: TypeAlias = Callable[[Rows], Bools]
"""Whether each row of a batch matches."""


@dataclass(frozen=True, slots=True)
class SearchStep:
    """Result of a search in one block."""

    found: int | None
    next_index: int | None
    """Index for the next step; None if a row was found, or there are no more."""


def find_step(store: RowStore, test: RowTest, index: int, by: int) -> SearchStep:
    """Search one block for the nearest shown row that matches.

    It starts at `index`, or at the nearest row in the store, and goes to later (`by` 1) or earlier
    (-1) rows.
    """
    index = max(index, store.first) if by > 0 else min(index, store.next - 1)
    if not store.first <= index < store.next:
        return SearchStep(None, None)
    block = store.block_at(index)
    offsets = store.view.offsets(block)
    at = index - block.start
    offsets = offsets[offsets >= at] if by > 0 else offsets[offsets <= at]
    if len(offsets):
        offsets = offsets[test(store.in_memory(block).rows.select(offsets))]
    if len(offsets):
        return SearchStep(block.start + int(offsets[0 if by > 0 else -1]), None)
    next_index = block.end if by > 0 else block.start - 1
    return SearchStep(None, next_index if store.first <= next_index < store.next else None)


def find_fault(store: RowStore, index: int, by: int) -> int | None:
    """Index of the next shown row with a fault after `index`, or before it (`by` -1).

    None if there is none; rows that the filter was not applied to do not count.
    """
    return _find(store, attrgetter("faults"), attrgetter("faulty"), index + by, by)


def find_raised(store: RowStore, index: int, by: int) -> int | None:
    """Index of the next shown row with a raised flag byte after `index`, or before it (`by` -1)."""
    return _find(store, Rows.raised, attrgetter("raised"), index + by, by)


def find_unanswered(store: RowStore, index: int, by: int) -> int | None:
    """Index of the next shown command known to have no answer after `index`, or before it."""
    missed = attrgetter("unanswered")
    return _find(store, lambda rows: missed(rows) > 0, missed, index + by, by)


def find_byte(store: RowStore, port: str, offset: int) -> int | None:
    """Index of the first shown row that contains a byte of a port's stream, or None."""
    code = store.code_of(port)

    def contains(rows: Rows) -> Bools:
        at = offset - rows.offset
        return np.asarray((rows.port == code) & (at >= 0) & (at < rows.length))

    return _find(store, contains, lambda _block: True, store.first, 1)


def _find(
    store: RowStore, test: RowTest, may_match: Callable[[Block], bool], index: int, by: int
) -> int | None:
    """The nearest shown row that matches, from `index` on; blocks that cannot match are skipped."""
    step = SearchStep(None, index)
    while step.found is None and step.next_index is not None:
        index = step.next_index
        while store.first <= index < store.next and not may_match(block := store.block_at(index)):
            index = block.end if by > 0 else block.start - 1
        step = find_step(store, test, index, by)
    return step.found


def select_rows(
    store: RowStore, start: int, end: int, row_filter: RowFilter | None
) -> tuple[Rows, int]:
    """Rows of one block with indices from `start` up to `end` that pass a filter, not the view's.

    Returns them and the index to continue at: `end` or less.
    """
    start, end = max(start, store.first), min(end, store.next)
    if start >= end:
        return NO_ROWS, end
    block = store.in_memory(store.block_at(start))
    end = min(end, block.end, start + SELECT_ROWS)
    rows = block.rows[start - block.start : end - block.start]
    return (rows if row_filter is None else row_filter.select(rows)), end


HEX: Final = "hex:"
"""Prefix of a search for bytes only."""

_BYTES: Final = re.compile(r"(?:[0-9a-f]{2} ?)+")
_NIBBLES: Final = re.compile(r"(?:[0-9a-f?]{2} ?)+")


@dataclass(frozen=True, slots=True)
class Search:
    """A search for a text or bytes; made by `parse`."""

    typed: str
    text: str
    """In lower case; empty for bytes only."""
    nibbles: str
    """Hex digits, two a byte, `?` for any digit; empty for a text only."""
    pattern: re.Pattern[str]
    """Finds either in a displayed text."""

    @classmethod
    def parse(cls, typed: str) -> Search:
        """Parse a line that is not empty; InputTextError if invalid hex follows `HEX`."""
        line = " ".join(typed.split()).lower()
        if line.startswith(HEX):
            digits = line.removeprefix(HEX).strip()
            if not _NIBBLES.fullmatch(digits):
                raise InputTextError(
                    "'{digits}' is not hex: two digits a byte, as in hex:AA ?? 03",
                    digits=printable(digits),
                )
            return cls._build(typed, "", digits)
        return cls._build(typed, line, line if _BYTES.fullmatch(line) else "")

    @classmethod
    def _build(cls, typed: str, text: str, digits: str) -> Search:
        nibbles = digits.replace(" ", "")
        pairs = [nibbles[at : at + 2] for at in range(0, len(nibbles), 2)]
        spaced = " ".join(pair.replace("?", "[0-9a-f]") for pair in pairs)
        alternatives = [re.escape(text)] if text else []
        alternatives += [rf"\b{spaced}\b"] if spaced else []
        return cls(typed, text, nibbles, re.compile("|".join(alternatives), re.IGNORECASE))

    def spans(self, text: str) -> list[tuple[int, int]]:
        """Start and end of each match in a displayed text, rising, none of them empty."""
        return [match.span() for match in self.pattern.finditer(text) if match.group()]

    def matches(self, rows: Rows, columns: Collection[str] = COLUMN_BY_NAME) -> Bools:
        """Whether each row matches.

        Port, time and offset are searched only if they are among the displayed `columns`; kind,
        values, faults and bytes always.
        """
        found: Bools = np.zeros(len(rows), np.bool_)
        if self.nibbles:
            found |= self._has_bytes(rows)
        if self.text:
            if "port" in columns:
                found |= self._in_texts(rows.ports)[rows.port]
            bits, sets = np.unique(rows.faults, return_inverse=True)
            found |= self._in_texts([",".join(faults_in(one)) for one in bits.tolist()])[sets]
            # The import loads polars, which is slow; the screen starts without a search.
            from fte_sniff.analysis.dataframe import contains_text

            found |= contains_text(self.text, columns, rows)
        return found

    def _in_texts(self, texts: Sequence[str]) -> Bools:
        return np.array([self.text in printable(text).lower() for text in texts], np.bool_)

    def _has_bytes(self, rows: Rows) -> Bools:
        pattern, mask = _byte_pattern(self.nibbles)
        ends = np.arange(len(pattern), MOST_BYTES + 1)
        inside = ends <= rows.length[:, None]
        return np.asarray((_matches(rows.raw, pattern, mask) & inside).any(axis=1))


def _byte_pattern(nibbles: str) -> tuple[Codes, Codes]:
    """The bytes, and a mask of the bits that are compared."""
    pattern = bytes.fromhex(nibbles.replace("?", "0"))
    mask = bytes.fromhex("".join("0" if digit == "?" else "f" for digit in nibbles))
    return np.frombuffer(pattern, np.uint8), np.frombuffer(mask, np.uint8)


def _matches(raw: Codes, pattern: Codes, mask: Codes) -> Bools:
    """Whether the bytes match at each offset; `raw` is one row, or several of equal length."""
    if raw.shape[-1] < len(pattern):
        return np.zeros((*raw.shape[:-1], 0), np.bool_)
    windows = sliding_window_view(raw, len(pattern), axis=-1)
    return np.asarray(((windows ^ pattern) & mask == 0).all(axis=-1))


STEP_ROWS: Final = 4096
"""Most rows of one step: a text search takes about a hundredth of a second."""


@dataclass(slots=True)
class _BlockHits:
    counted: int = 0
    """Rows that were searched, from the start."""
    offsets: Offsets = field(default_factory=lambda: np.empty(0, np.int64))
    """Of the hits, rising."""


@dataclass(frozen=True, slots=True)
class HitPosition:
    """Number of a row among the hits."""

    number: int | None
    """From 1; None if the row is not a hit, or not counted yet."""
    total: int
    """Number of hits so far that are in the store."""


class HitCounter:
    """Counts the matching rows under the current filter, without rows that are not in memory."""

    def __init__(self, store: RowStore, test: RowTest, step_rows: int = STEP_ROWS) -> None:
        self._store, self._test, self._step_rows = store, test, step_rows
        self._hits: dict[int, _BlockHits] = {}

    def step(self) -> bool:
        """Count more rows, the oldest first; False if there were none."""
        for block in self._store.blocks:
            hits = self._hits.setdefault(block.start, _BlockHits())
            if hits.counted < self._countable(block) and not block.dropped:
                self._count(block, hits)
                return True
        return False

    def _count(self, block: Block, hits: _BlockHits) -> None:
        stop = min(self._countable(block), hits.counted + self._step_rows)
        offsets = self._offsets(block)
        offsets = offsets[(offsets >= hits.counted) & (offsets < stop)]
        if len(offsets):
            found = offsets[self._test(block.rows.select(offsets))]
            hits.offsets = np.concatenate((hits.offsets, found))
        hits.counted = stop

    def _offsets(self, block: Block) -> Offsets:
        return self._store.view.offsets(block)

    def _countable(self, block: Block) -> int:
        """Rows of the block that the filter was applied to."""
        reached = block.count if self._store.view.filter is None else block.filtered
        return min(reached, max(0, self._store.next - block.start))

    def position(self, index: int) -> HitPosition:
        """The position of the row with that index."""
        store, number, total = self._store, None, 0
        self._hits = {
            block.start: self._hits.get(block.start, _BlockHits()) for block in store.blocks
        }
        for block in store.blocks:
            hits = self._hits[block.start]
            shown = (store.first - block.start, self._countable(block))
            first, end = np.searchsorted(hits.offsets, shown)
            offsets = hits.offsets[first:end]
            at = int(np.searchsorted(offsets, index - block.start))
            if at < len(offsets) and offsets[at] == index - block.start:
                number = total + at + 1
            total += len(offsets)
        return HitPosition(number, total)


class MatchCounter(HitCounter):
    """Counts the rows in memory that match, also those that the current filter hides."""

    def _offsets(self, block: Block) -> Offsets:
        return np.arange(max(0, self._store.first - block.start), self._countable(block))

    def _countable(self, block: Block) -> int:
        return min(block.count, max(0, self._store.next - block.start))


MOST_VALUES: Final = 10_000
"""Different values of a column after which the others are not counted."""


class ValueCounter:
    """Counts the values of one column of the rows in memory, for suggestions."""

    def __init__(self, store: RowStore, column: str) -> None:
        self._store, self._column = store, column
        self._counted: dict[int, int] = {}
        self.counts: Counter[str] = Counter()
        """Number of rows by value, as text."""

    def step(self) -> bool:
        """Count the rows of one more block, the newest first; False if there were none."""
        if len(self.counts) >= MOST_VALUES:
            return False
        for block in reversed(self._store.blocks):
            start = self._counted.get(block.start, 0)
            if start < block.count and not block.dropped:
                self._counted[block.start] = block.count
                self._count(block.rows[start : block.count])
                return True
        return False

    def _count(self, rows: Rows) -> None:
        # The import loads polars, which is slow; the screen starts without a filter.
        from fte_sniff.analysis.dataframe import row_frame

        values = row_frame(rows, (self._column,))[self._column].drop_nulls()
        if COLUMN_BY_NAME[self._column].type is ColumnType.WORDS:
            values = values.explode().drop_nulls()
        for value, count in values.value_counts().iter_rows():
            self.counts[str(value)] += count
