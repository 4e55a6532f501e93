"""Owns looking through a store's rows a block at a time, so that no look takes long.

It must not know what is looked for beyond a test that it is given, nor who waits for it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from fte_sniff.analysis.columns.fields import raised
from fte_sniff.analysis.columns.packing import Codebook, Packed, unpack
from fte_sniff.analysis.store.block import Block, Places
from fte_sniff.analysis.store.row_store import RowStore
from fte_sniff.protocol import Row

if TYPE_CHECKING:
    from fte_sniff.analysis.filter.row_filter import RowFilter

SELECT_ROWS: Final = 4096
"""Rows that one `select_rows` looks at, at most: unpacking takes a few hundredths of a second."""

Bools: TypeAlias = npt.NDArray[np.bool_]

RowTest: TypeAlias = Callable[[Packed, Mapping[int, bytes], Codebook], Bools]
"""Says of packed rows which of them pass; the mapping holds the bytes of long ones by place."""


@dataclass(frozen=True, slots=True)
class Step:
    """What looking in one block brought."""

    found: int | None
    """Index of a row that passes."""
    onward: int | None
    """Index to look at next; None where a row was found, or there are no more."""


def find_step(store: RowStore, test: RowTest, index: int, by: int) -> Step:
    """Look in one block for the nearest shown row that passes a test.

    Args:
        store: the rows.
        test: says of packed rows which of them pass; it may be asked of any of the block's.
        index: the first row to look at; where it is not kept, the nearest that is.
        by: 1 to look at later rows after it, -1 at earlier ones.
    """
    index = max(index, store.first) if by > 0 else min(index, store.next - 1)
    if not store.first <= index < store.next:
        return Step(None, None)
    block = store.blocks[store.block_number(index)]
    places = store.shown.places(block)
    here = index - block.start
    places = places[places >= here] if by > 0 else places[places <= here]
    passing = places
    if len(places):
        part = store.in_memory(block).part(places)
        passing = places[test(*part, store.codebook)]
    if len(passing):
        return Step(block.start + int(passing[0 if by > 0 else -1]), None)
    onward = block.end if by > 0 else block.start - 1
    return Step(None, onward if store.first <= onward < store.next else None)


def find_fault(store: RowStore, index: int, by: int) -> int | None:
    """Index of the nearest shown row with a fault behind `index`, or before it (`by` below 0).

    None where there is none; rows that the filter has still to see do not count.
    """
    clean = store.codebook.fault_code(())

    def faulty(packed: Packed, _: Mapping[int, bytes], __: Codebook) -> Bools:
        return np.asarray(packed["faults"] != clean)

    return _find_in(store, faulty, lambda block: block.faulty, index, by)


def find_raised(store: RowStore, index: int, by: int) -> int | None:
    """The same of the nearest shown row with a flag byte that is not in order."""

    def flagged(packed: Packed, _: Mapping[int, bytes], __: Codebook) -> Bools:
        return raised(packed)

    return _find_in(store, flagged, lambda block: block.raised, index, by)


def _find_in(
    store: RowStore, test: RowTest, has: Callable[[Block], bool], index: int, by: int
) -> int | None:
    """The nearest shown row behind `index` that passes; only some blocks have such rows."""
    step = Step(None, index + by)
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

    def holds(packed: Packed, _: Mapping[int, bytes], __: Codebook) -> Bools:
        behind = offset - packed["offset"]
        return np.asarray((packed["port"] == code) & (behind >= 0) & (behind < packed["length"]))

    step = Step(None, store.first)
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
        places = places[row_filter.of_packed(*block.part(places), store.codebook)]
    return unpack(*block.part(places), store.codebook), end
