from __future__ import annotations

from itertools import compress

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.counters import Tally
from fte_sniff.protocol import Damage, Fault, Frame, Row
from fte_sniff.row_batch import ROW_TYPE, Codebook, PackedRows, pack, unpack


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


TIMED_ROWS = st.lists(st.from_type(Frame) | st.from_type(Damage), max_size=12).map(
    lambda rows: [row for row in rows if row.t_ns is not None]
)


def packed(rows: list[Row]) -> PackedRows:
    codebook = Codebook()
    return PackedRows(*pack(rows, codebook), codebook)


@given(TIMED_ROWS, st.data())
def test_packed_rows_are_a_sequence_of_those_rows(rows: list[Row], data: st.DataObject) -> None:
    found = packed(rows)
    assert list(found) == rows
    assert len(found) == len(rows)
    start, end = data.draw(st.integers(-13, 13)), data.draw(st.integers(-13, 13))
    assert found[start:end] == rows[start:end]
    if rows:
        place = data.draw(st.integers(-len(rows), len(rows) - 1))
        assert found[place] == rows[place]
        assert type(found[place]) is type(rows[place])


@given(TIMED_ROWS, TIMED_ROWS)
def test_packed_rows_are_packed_and_joined_as_the_rows_are(one: list[Row], two: list[Row]) -> None:
    joined = PackedRows.concat([packed(one), packed(two)])
    assert list(joined) == one + two
    codebook = Codebook()
    codebook.port_code("another first")
    codebook.fault_code(tuple(Fault))
    assert unpack(*pack(joined, codebook), codebook) == one + two


@given(TIMED_ROWS, st.data())
def test_packed_rows_are_parted_and_poured_out_as_the_rows_are(
    rows: list[Row], data: st.DataObject
) -> None:
    found = packed(rows)
    assert found.tobytes() == b"".join(row.raw for row in rows)
    start, end = data.draw(st.integers(-13, 13)), data.draw(st.integers(-13, 13))
    assert list(found.select(slice(start, end))) == rows[start:end]
    mask = data.draw(st.lists(st.booleans(), min_size=len(rows), max_size=len(rows)))
    assert list(found.select(np.array(mask, np.bool_))) == list(compress(rows, mask))
    assert found.select(slice(1, None)).tobytes() == b"".join(row.raw for row in rows[1:])


@given(TIMED_ROWS)
def test_packed_rows_are_counted_as_the_rows_are(rows: list[Row]) -> None:
    found, expected = Tally(), Tally()
    found.update(packed(rows))
    expected.update(rows)
    assert found == expected
