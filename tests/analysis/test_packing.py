from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.packing import ROW_TYPE, Codebook, pack, unpack
from fte_sniff.protocol import Damage, Frame, Row


@given(st.lists(st.from_type(Frame) | st.from_type(Damage), max_size=12), st.data())
def test_packing_loses_nothing(rows: list[Row], data: st.DataObject) -> None:
    codebook = Codebook()
    packed, long = pack(rows, codebook)
    start = data.draw(st.integers(0, len(rows)))
    again = unpack(packed[start:], long, codebook, start)
    assert again == rows[start:]
    assert [type(row) for row in again] == [type(row) for row in rows[start:]]
    assert [row.read_delay_ns for row in again] == [row.read_delay_ns for row in rows[start:]]
    assert [row.order_uncertain for row in again] == [row.order_uncertain for row in rows[start:]]


def test_a_row_and_its_place_under_a_filter_take_no_more_than_64_bytes() -> None:
    assert ROW_TYPE.itemsize + 2 <= 64
