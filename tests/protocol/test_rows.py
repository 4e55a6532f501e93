"""Rows: pickling, statuses, and the marks of line errors."""

from __future__ import annotations

import pickle
from dataclasses import astuple
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.protocol import (
    Chunk,
    Damage,
    Fault,
    Frame,
    Framer,
    LineErrorCounts,
    LineErrorMarker,
    Row,
    Status,
)

ROWS: list[Row] = [
    Frame("p", 1, b"\xaa" + b"\0" * 8 + b"\xee", 2, (Fault.AMBIGUOUS,), 3, True),
    Frame("p", 1, b"\x55" + b"\0" * 8 + b"\xee", None),
    Damage("q", 2**40, b"\xff" * 1024, 2**62, (Fault.NOISE, Fault.LINE_ERROR), None, True),
]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: type(row).__name__)
def test_a_pickled_row_has_all_that_it_had(row: Row) -> None:
    again = pickle.loads(pickle.dumps(row))
    assert type(again) is type(row)
    assert astuple(again) == astuple(row)


FRAME = bytes.fromhex("AA010103E800000000EE")


def marked(chunks):
    framer, marker, rows = Framer("p"), LineErrorMarker(), []
    for chunk in chunks:
        marker.observe(chunk)
        framer.push(chunk)
        rows += marker.mark(framer.drain())
    framer.finish()
    return [*rows, *marker.mark(framer.drain())]


def hit(rows):
    return [row.offset for row in rows if Fault.LINE_ERROR in row.faults]


def test_a_row_with_an_error_in_it_is_suspect_and_still_read():
    rows = marked([Chunk("p", 0, FRAME * 5, ((23, 24),))])
    assert hit(rows) == [20]
    assert (rows[2].status, rows[2].values["rpm"]) == (Status.SUSPECT, 1000)


def test_what_is_malformed_stays_malformed():
    rows = marked([Chunk("p", 0, FRAME * 2 + b"\x77\x78" + FRAME * 2, ((20, 22),))])
    assert [(row.offset, row.faults) for row in rows if row.faults] == [
        (20, (Fault.NOISE, Fault.LINE_ERROR))
    ]
    assert rows[2].status is Status.MALFORMED


def test_an_error_counted_before_its_byte_marks_the_row_that_comes_next():
    rows = marked([Chunk("p", 0, FRAME * 2), Chunk("p", 1, b"", ((0, 1),)), Chunk("p", 2, FRAME)])
    assert hit(rows) == [20]


@given(
    st.integers(1, 30),
    st.lists(st.tuples(st.integers(0, 299), st.integers(1, 20)), max_size=8),
    st.lists(st.integers(0, 300), max_size=6),
)
def test_exactly_the_rows_that_share_a_byte_with_errors_are_marked(count, errors, cuts):
    stream = FRAME * count
    bad = {p for start, size in errors for p in range(start, start + size) if p < len(stream)}
    edges = sorted({0, len(stream), *(cut for cut in cuts if cut < len(stream))})
    chunks = [
        Chunk("p", 0, stream[a:b], tuple((p - a, p - a + 1) for p in sorted(bad) if a <= p < b))
        for a, b in pairwise(edges)
    ]
    rows = marked(chunks)
    assert b"".join(row.raw for row in rows) == stream
    for row in rows:
        assert isinstance(row, Frame | Damage)
        expected = bool(bad & set(range(row.offset, row.offset + len(row.raw))))
        assert (Fault.LINE_ERROR in row.faults) is expected


def test_counts_are_by_value():
    counts = LineErrorCounts(framing=1200, breaks=1) + LineErrorCounts(buffer_overruns=2)
    assert str(counts) == "1,200 framing, 1 break, 2 buffer overrun"
    assert (counts.total, bool(counts), bool(LineErrorCounts())) == (1203, True, False)
