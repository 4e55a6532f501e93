"""The way from a row to the nearest one with a fault or a raised flag, filtered and bounded."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.search import find_fault, find_raised
from fte_sniff.protocol import Damage, Fault, Frame, Row

TEN_BYTES = RowFilter.parse("length = 10")


BYTES = {
    False: bytes.fromhex("55010100010000000FEE"),
    True: bytes.fromhex("55010100010000080FEE"),
}
"""Feedback that all is in order, and that it is not."""


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


@given(
    st.lists(st.tuples(st.booleans(), st.booleans()), max_size=60),
    st.integers(-5, 65),
    st.sampled_from((1, -1)),
    st.booleans(),
    st.integers(1, 70),
)
def test_the_nearest_raised_flag_is_found_and_bytes_of_no_frame_raise_none(
    flags: list[tuple[bool, bool]], start: int, by: int, filtered: bool, bound: int
) -> None:
    rows: list[Row] = [
        Frame("p", number, BYTES[raised], number)
        if framed
        else Damage("p", number, BYTES[raised], number, (Fault.NOISE,))
        for number, (framed, raised) in enumerate(flags)
    ]
    store = RowStore(bound, block_rows=8)
    store.append(rows)
    if filtered:
        store.shown.set_filter(RowFilter.parse("kind = 'speed_feedback'"))
        store.shown.filter_step()
    shown = [
        at
        for at in range(store.first, store.next)
        if flags[at] == (True, True) and (at - start) * by > 0
    ]
    assert find_raised(store, start, by) == min(shown, key=lambda at: abs(at - start), default=None)
