"""Rows side by side: what is known of them without looking at each."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.protocol import Damage, Fault
from fte_sniff.row_batch import RowBatch


@given(st.lists(st.tuples(st.sampled_from("abc"), st.integers(1, 30)), max_size=30))
def test_where_the_rows_of_each_port_end(lengths: list[tuple[str, int]]) -> None:
    ends: dict[str, int] = {}
    rows = []
    for port, length in lengths:
        offset = ends.get(port, 0)
        rows.append(Damage(port, offset, bytes(length), 1, (Fault.NOISE,)))
        ends[port] = offset + length
    assert RowBatch.from_rows(rows).end_offsets() == ends
