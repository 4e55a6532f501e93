"""Marks, against a plain set of indices."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.tui.table.viewport import RowMarks

INDICES = st.lists(st.integers(0, 30), max_size=40)


@given(INDICES, st.integers(0, 30), st.integers(0, 30))
def test_marks_are_a_set_that_knows_its_order(toggled: list[int], here: int, first: int) -> None:
    marks, expected, latest = RowMarks(), set[int](), list[int]()
    for index in toggled:
        assert marks.toggle(index) == (index not in expected)
        expected ^= {index}
        latest = [*(one for one in latest if one != index), *([index] if index in expected else [])]
    for index in range(31):
        assert (index in marks) == (index in expected)
    assert len(marks) == len(expected)
    assert marks.latest == (latest[-1] if latest else None)
    assert list(marks.beyond(here, 1)) == sorted(one for one in expected if one > here)
    below = sorted((one for one in expected if one < here), reverse=True)
    assert list(marks.beyond(here, -1)) == below
    marks.forget_before(first)
    assert [index in marks for index in range(31)] == [
        index in expected and index >= first for index in range(31)
    ]
    assert marks.latest == next((one for one in reversed(latest) if one >= first), None)
