"""Find next/previous and count hits."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from fte_sniff.analysis.fields import raised
from fte_sniff.analysis.row_store import Block, Places, RowStore
from fte_sniff.errors import InputTextError, printable
from fte_sniff.protocol import COLUMN_BY_NAME, FRAME_LENGTH, Row
from fte_sniff.row_batch import RowBatch

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter


SELECT_ROWS: Final = 4096
"""Rows that one `select_rows` looks at, at most: unpacking takes a few hundredths of a second."""

Bools: TypeAlias = npt.NDArray[np.bool_]

RowTest: TypeAlias = Callable[[RowBatch], Bools]
"""Whether each row of a batch passes."""


@dataclass(frozen=True, slots=True)
class SearchStep:
    """What looking in one block brought."""

    found: int | None
    """Index of a row that passes."""
    onward: int | None
    """Index to look at next; None where a row was found, or there are no more."""


def find_step(store: RowStore, test: RowTest, index: int, by: int) -> SearchStep:
    """Look in one block for the nearest shown row that passes a test.

    Args:
        store: the rows.
        test: says which rows of a batch pass; it may be asked of any of the block's.
        index: the first row to look at; where it is not kept, the nearest that is.
        by: 1 to look at later rows after it, -1 at earlier ones.
    """
    index = max(index, store.first) if by > 0 else min(index, store.next - 1)
    if not store.first <= index < store.next:
        return SearchStep(None, None)
    block = store.blocks[store.block_number(index)]
    places = store.shown.places(block)
    here = index - block.start
    places = places[places >= here] if by > 0 else places[places <= here]
    passing = places
    if len(places):
        passing = places[test(store.in_memory(block).rows.select(places))]
    if len(passing):
        return SearchStep(block.start + int(passing[0 if by > 0 else -1]), None)
    onward = block.end if by > 0 else block.start - 1
    return SearchStep(None, onward if store.first <= onward < store.next else None)


def find_fault(store: RowStore, index: int, by: int) -> int | None:
    """Index of the nearest shown row with a fault behind `index`, or before it (`by` below 0).

    None where there is none; rows that the filter has still to see do not count.
    """
    clean = store.codebook.fault_code(())

    def faulty(rows: RowBatch) -> Bools:
        return np.asarray(rows.faults != clean)

    return _find_in(store, faulty, lambda block: block.faulty, index, by)


def find_raised(store: RowStore, index: int, by: int) -> int | None:
    """The same of the nearest shown row with a flag byte that is not in order."""

    def flagged(rows: RowBatch) -> Bools:
        return raised(rows)

    return _find_in(store, flagged, lambda block: block.raised, index, by)


def _find_in(
    store: RowStore, test: RowTest, has: Callable[[Block], bool], index: int, by: int
) -> int | None:
    """The nearest shown row behind `index` that passes; only some blocks have such rows."""
    step = SearchStep(None, index + by)
    while step.found is None and step.onward is not None:
        step = find_step(store, test, _past(store, has, step.onward, by), by)
    return step.found


def _past(store: RowStore, has: Callable[[Block], bool], index: int, by: int) -> int:
    """The index at which a look goes on, without blocks that have no such row."""
    while store.first <= index < store.next:
        block = store.blocks[store.block_number(index)]
        if has(block):
            break
        index = block.end if by > 0 else block.start - 1
    return index


def find_byte(store: RowStore, port: str, offset: int) -> int | None:
    """Index of the first shown row that holds that byte of a port's stream, or None."""
    code = store.codebook.port_code(port)

    def holds(rows: RowBatch) -> Bools:
        behind = offset - rows.offset
        return np.asarray((rows.port == code) & (behind >= 0) & (behind < rows.length))

    step = SearchStep(None, store.first)
    while step.found is None and step.onward is not None:
        step = find_step(store, holds, step.onward, 1)
    return step.found


def select_rows(
    store: RowStore, start: int, end: int, row_filter: RowFilter | None
) -> tuple[list[Row], int]:
    """The rows of one block from index `start` on, before `end`, that a filter wants.

    The filter need not be the one in force. Also tells the index to go on from: `end`, or less.
    """
    start, end = max(start, store.first), min(end, store.next)
    if start >= end:
        return [], end
    block = store.in_memory(store.blocks[store.block_number(start)])
    end = min(end, block.end, start + SELECT_ROWS)
    places: Places = np.arange(start - block.start, end - block.start)
    if row_filter is not None:
        places = places[row_filter.matches(block.rows.select(places))]
    return list(block.rows.select(places)), end


HEX: Final = "hex:"
"""What stands before bytes that are not to be taken for a text."""

_BYTES: Final = re.compile(r"(?:[0-9a-f]{2} ?)+")
_NIBBLES: Final = re.compile(r"(?:[0-9a-f?]{2} ?)+")


@dataclass(frozen=True, slots=True)
class Search:
    """What is looked for; made by `parse`."""

    typed: str
    """As typed."""
    text: str
    """In small letters; empty where only bytes are meant."""
    nibbles: str
    """The bytes as hex digits, two a byte, `?` where any will do; empty where none are meant."""
    pattern: re.Pattern[str]
    """Finds either in a shown text."""

    @classmethod
    def parse(cls, typed: str) -> Search:
        """What a line says that is not empty.

        Raises:
            InputTextError: it begins like bytes and is none.
        """
        line = " ".join(typed.split()).lower()
        if line.startswith(HEX):
            digits = line.removeprefix(HEX).strip()
            if not _NIBBLES.fullmatch(digits):
                raise InputTextError(
                    f"'{printable(digits)}' is not hex: two digits a byte, as in hex:AA 02 ??03"
                )
            return cls._made(typed, "", digits)
        return cls._made(typed, line, line if _BYTES.fullmatch(line) else "")

    @classmethod
    def _made(cls, typed: str, text: str, digits: str) -> Search:
        nibbles = digits.replace(" ", "")
        pairs = [nibbles[at : at + 2] for at in range(0, len(nibbles), 2)]
        spaced = " ".join(pair.replace("?", "[0-9a-f]") for pair in pairs)
        ways = [re.escape(text)] if text else []
        ways += [rf"\b{spaced}\b"] if spaced else []
        return cls(typed, text, nibbles, re.compile("|".join(ways), re.IGNORECASE))

    def places(self, text: str) -> list[tuple[int, int]]:
        """Where in a shown text it stands: starts and ends, rising, none of them empty."""
        return [match.span() for match in self.pattern.finditer(text) if match.group()]

    def mask(
        self,
        rows: RowBatch,
        columns: Collection[str] = COLUMN_BY_NAME,
    ) -> Bools:
        """Whether each row has what is looked for.

        Args:
            rows: the rows.
            columns: those that a table has; a port, time or offset that no column tells is not
                looked at. Kind, values, faults and bytes are told in any.
        """
        found: Bools = np.zeros(len(rows), np.bool_)
        if self.nibbles:
            found |= self._has_bytes(rows)
        if self.text:
            if "port" in columns:
                found |= self._told(rows.codebook.ports)[rows.port]
            found |= self._told([",".join(faults) for faults in rows.codebook.faults])[rows.faults]
            # It needs polars, which takes long to load; a screen begins without a search.
            from fte_sniff.analysis.search_frame import tell

            found |= tell(self.text, columns, rows)
        return found

    def _told(self, texts: Sequence[str]) -> Bools:
        return np.array([self.text in printable(text).lower() for text in texts], np.bool_)

    def _has_bytes(self, rows: RowBatch) -> Bools:
        wanted, care = _byte_pattern(self.nibbles)
        raw, found = rows.raw, np.zeros(len(rows), np.bool_)
        size = len(wanted)
        for start in range(FRAME_LENGTH - size + 1):
            same = ((raw[:, start : start + size] ^ wanted) & care == 0).all(axis=1)
            found |= same & (rows.length >= start + size)
        expression = re.compile(_bytes_expression(self.nibbles), re.DOTALL)
        for place, whole in rows.long.items():
            found[place] = expression.search(whole) is not None
        return found


def _byte_pattern(nibbles: str) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """The bytes, and which of their bits count."""
    wanted = bytes.fromhex(nibbles.replace("?", "0"))
    care = bytes.fromhex("".join("0" if digit == "?" else "f" for digit in nibbles))
    return np.frombuffer(wanted, np.uint8), np.frombuffer(care, np.uint8)


def _bytes_expression(nibbles: str) -> bytes:
    wanted, care = _byte_pattern(nibbles)
    return b"".join(
        b"[" + b"".join(re.escape(bytes((b,))) for b in range(256) if (b ^ w) & c == 0) + b"]"
        for w, c in zip(wanted.tolist(), care.tolist(), strict=True)
    )


STEP_ROWS: Final = 4096
"""Rows that one step looks at, at most: a text is looked for in them in about a hundredth of a
second."""


@dataclass(slots=True)
class _Counted:
    """What is known of a block."""

    seen: int = 0
    """Rows that were looked at, from the start."""
    places: Places = field(default_factory=lambda: np.empty(0, np.int64))
    """Of those that pass, rising."""


@dataclass(frozen=True, slots=True)
class HitPosition:
    """Where a row stands among those that pass."""

    number: int | None
    """From 1; None where the row does not pass, or is not counted yet."""
    all: int
    """How many pass of those that were counted and are kept."""
    left_out: bool
    """Whether there are rows that are not in memory and were not counted."""
    behind: bool
    """Whether there are others that are not counted yet."""


class HitCounter:
    """The rows that pass, counted under the filter that is in force when it is made."""

    def __init__(self, store: RowStore, test: RowTest) -> None:
        """Nothing is counted.

        Args:
            store: the rows.
            test: says which rows of a batch pass.
        """
        self._store, self._test = store, test
        self._counted: dict[int, _Counted] = {}

    def step(self) -> bool:
        """Count some rows more, the oldest first; whether there were any."""
        for block in self._store.blocks:
            counted = self._counted.setdefault(block.start, _Counted())
            if counted.seen < self._judged(block) and not block.dropped:
                self._look(block, counted)
                return True
        return False

    def _look(self, block: Block, counted: _Counted) -> None:
        stop = min(self._judged(block), counted.seen + STEP_ROWS)
        places = self._store.shown.places(block)
        places = places[(places >= counted.seen) & (places < stop)]
        if len(places):
            passing = places[self._test(block.rows.select(places))]
            counted.places = np.concatenate((counted.places, passing))
        counted.seen = stop

    def _judged(self, block: Block) -> int:
        """Rows of the block of which it is known whether they are shown."""
        return block.count if self._store.shown.filter is None else block.judged

    def standing(self, index: int) -> HitPosition:
        """Where the row of an index stands."""
        store, number, count = self._store, None, 0
        left_out = behind = False
        kept = {block.start: self._counted.get(block.start, _Counted()) for block in store.blocks}
        self._counted = kept
        for block in store.blocks:
            counted = kept[block.start]
            missing = counted.seen < self._judged(block)
            left_out = left_out or (missing and block.dropped)
            behind = behind or (missing and not block.dropped)
            places = counted.places[np.searchsorted(counted.places, store.first - block.start) :]
            at = int(np.searchsorted(places, index - block.start))
            if at < len(places) and places[at] == index - block.start:
                number = count + at + 1
            count += len(places)
        return HitPosition(number, count, left_out, behind)
