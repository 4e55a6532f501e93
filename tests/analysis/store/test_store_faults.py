"""The way from a row to the nearest one with a fault, with and without a filter and a bound."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.store.finding import find_fault
from fte_sniff.analysis.store.row_store import RowStore
from fte_sniff.protocol import Damage, Fault, Frame, Row

TEN_BYTES = RowFilter.parse("length = 10")


def rows_of(faulty: list[bool]) -> list[Row]:
    """Odd rows are three bytes long, so that the filter hides them."""
    found: list[Row] = []
    for number, wrong in enumerate(faulty):
        raw = bytes.fromhex("AA0101000100000000EE") if number % 2 == 0 else b"\x01\x02\x03"
        sort = Frame if number % 2 == 0 else Damage
        found.append(sort("p", number, raw, number, (Fault.LINE_ERROR,) if wrong else ()))
    return found


@given(
    st.lists(st.booleans(), max_size=60),
    st.integers(-5, 65),
    st.sampled_from((1, -1)),
    st.booleans(),
    st.integers(1, 70),
)
def test_the_nearest_fault_is_found(
    faulty: list[bool], start: int, by: int, filtered: bool, bound: int
) -> None:
    store = RowStore(bound, block_rows=8)
    store.append(rows_of(faulty))
    if filtered:
        store.shown.set_filter(TEN_BYTES)
        store.shown.filter_step()
    shown = [
        at
        for at in range(store.first, store.next)
        if faulty[at] and not (filtered and at % 2) and (at - start) * by > 0
    ]
    nearest = min(shown, key=lambda at: abs(at - start), default=None)
    assert find_fault(store, start, by) == nearest
