"""Hits are counted as one would count them by hand, whatever comes, leaves, or is dropped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import pytest

from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.search import HitCounter, HitPosition
from fte_sniff.protocol import KIND_BY_NAME, Frame, Row, encode
from fte_sniff.row_batch import Codebook, Packed, pack


def rows(start: int, stop: int) -> Sequence[Row]:
    kind = KIND_BY_NAME["speed"]
    raws = (encode(kind, {"motor": 1 + at % 4, "rpm": at}) for at in range(start, stop))
    return [Frame("p", 10 * at, raw, at) for at, raw in enumerate(raws, start)]


def third(packed: Packed, _: Mapping[int, bytes], __: Codebook) -> npt.NDArray[np.bool_]:
    return np.asarray(packed["offset"] % 30 == 0)


def counted(store: RowStore) -> HitCounter:
    hits = HitCounter(store, third)
    while hits.step():
        pass
    return hits


def by_hand(store: RowStore, index: int) -> HitPosition:
    places = [store.shown.index(at) for at in range(store.shown.count)]
    passing = [at for at in places if at % 3 == 0]
    number = passing.index(index) + 1 if index in passing else None
    return HitPosition(number, len(passing), left_out=False, behind=False)


@pytest.mark.parametrize("row_filter", [None, "motor = 1", "rpm > 10", "motor = 9"])
@pytest.mark.parametrize("bound", [1000, 50])
def test_each_row_stands_where_it_does_by_hand(row_filter: str | None, bound: int) -> None:
    store = RowStore(bound, block_rows=16)
    store.shown.set_filter(RowFilter.parse(row_filter) if row_filter else None)
    hits = HitCounter(store, third)
    for start in range(0, 120, 7):
        store.append(rows(start, start + 7))
        while hits.step():
            pass
        for index in range(store.first, store.next):
            assert hits.standing(index) == by_hand(store, index)


def test_what_is_not_counted_yet_is_behind() -> None:
    store = RowStore(1000, block_rows=16)
    store.append(rows(0, 40))
    hits = HitCounter(store, third)
    assert hits.standing(3) == HitPosition(None, 0, left_out=False, behind=True)
    assert hits.step()
    assert hits.standing(3) == HitPosition(2, 6, left_out=False, behind=True)
    while hits.step():
        pass
    store.append(rows(40, 45))
    assert hits.standing(3) == HitPosition(2, 14, left_out=False, behind=True)


class Again:
    def load(
        self, start: int, count: int, codebook: Codebook
    ) -> tuple[Packed, Mapping[int, bytes]]:
        return pack(rows(start, start + count), codebook)


def test_rows_that_left_memory_before_they_were_counted_are_left_out_and_said_to_be() -> None:
    store = RowStore(1000, block_rows=16, source=Again(), most_blocks=2)
    store.append(rows(0, 64))
    late = counted(store)
    assert (
        late.standing(63) == HitPosition(6, 6 + 5, left_out=True, behind=False)
        or late.standing(63).left_out
    )
    early = RowStore(1000, block_rows=16, source=Again(), most_blocks=2)
    hits = HitCounter(early, third)
    for start in range(0, 64, 16):
        early.append(rows(start, start + 16))
        while hits.step():
            pass
    assert hits.standing(63) == HitPosition(22, 22, left_out=False, behind=False)
