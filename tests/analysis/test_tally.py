"""Counts of rows."""

from __future__ import annotations

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.tally import Tally
from fte_sniff.protocol.rows import Row
from tests.support.columns import rows_from


@given(rows=st.lists(st.from_type(Row), max_size=12), cut=st.integers(0, 12))
def test_a_tally_equals_a_count_by_hand(rows: list[Row], cut: int) -> None:
    tally, later = Tally(), Tally()
    tally.observe(rows_from(rows[:cut]))
    later.observe(rows_from(rows[cut:]))
    tally.merge(later)
    times = [row.t_ns for row in rows if row.t_ns is not None]
    assert (tally.rows, tally.frames) == (len(rows), sum(row.framed for row in rows))
    assert tally.times == ((min(times), max(times)) if times else None)
    assert tally.by_status == Counter(row.status for row in rows)
    by_hand = Counter(fault for row in rows for fault in row.faults)
    assert tally.by_fault == by_hand
    assert {*tally.by_fault} == {*by_hand}
