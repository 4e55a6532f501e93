"""`Rows` holds the rows that it is made of; single rows; the marks of line errors."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import astuple
from itertools import compress, pairwise

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fte_sniff.protocol import (
    KINDS,
    VALUE_FIELDS,
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
from fte_sniff.protocol import rows as rows_module
from fte_sniff.protocol.rows import COLUMNS, NO_KIND, Codebook, Rows
from tests.analysis import conftest as _row_strategies  # noqa: F401
from tests.protocol.streams import raw_bytes
from tests.support.faults import damaged_stream

ROWS = st.lists(st.from_type(Frame) | st.from_type(Damage), max_size=12)
INDEX = st.integers(-13, 13)


def facts(rows: Sequence[Row]) -> list[tuple[object, ...]]:
    """All facts of rows, also those that equality ignores."""
    return [(type(row), row, row.read_delay_ns, row.order_uncertain) for row in rows]


@given(ROWS, st.data())
def test_a_batch_is_a_sequence_of_its_rows(rows: list[Row], data: st.DataObject) -> None:
    batch = Rows.from_rows(rows)
    assert facts(batch) == facts(rows)
    assert len(batch) == len(rows)
    start, end = data.draw(INDEX), data.draw(INDEX)
    assert facts(batch[start:end]) == facts(rows[start:end])
    if rows:
        at = data.draw(st.integers(-len(rows), len(rows) - 1))
        assert facts([batch[at]]) == facts([rows[at]])


@given(ROWS, ROWS)
def test_batches_are_concatenated_and_recoded(one: list[Row], two: list[Row]) -> None:
    whole = Rows.concat([Rows.from_rows(one), Rows.from_rows(two)])
    assert facts(whole) == facts(one + two)
    codebook = Codebook()
    codebook.port_code("another first")
    codebook.fault_code(tuple(Fault))
    recoded = whole.recoded(codebook)
    assert recoded.codebook is codebook
    assert facts(recoded) == facts(one + two)


@given(ROWS, st.data())
def test_rows_are_selected_by_slice_mask_and_index(rows: list[Row], data: st.DataObject) -> None:
    batch = Rows.from_rows(rows)
    mask = data.draw(st.lists(st.booleans(), min_size=len(rows), max_size=len(rows)))
    assert list(batch.select(np.array(mask, np.bool_))) == list(compress(rows, mask))
    if rows:
        indices = data.draw(st.lists(st.integers(0, len(rows) - 1), max_size=5))
        assert list(batch.select(np.array(indices, np.int64))) == [rows[at] for at in indices]
    start, end = data.draw(INDEX), data.draw(INDEX)
    assert list(batch.select(slice(start, end))) == rows[start:end]


@given(ROWS, ROWS)
def test_allocated_rows_are_filled_in(one: list[Row], two: list[Row]) -> None:
    codebook = Codebook()
    batch = Rows.allocate(codebook, len(one) + len(two))
    batch.assign(0, Rows.from_rows(one, codebook))
    batch.assign(len(one), Rows.from_rows(two, codebook))
    assert facts(batch) == facts(one + two)


@pytest.mark.parametrize("few", [0, 10**9], ids=["numpy", "without numpy"])
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(rows=ROWS)
def test_the_bytes_of_a_batch_are_those_of_its_rows(
    few: int, monkeypatch: pytest.MonkeyPatch, rows: list[Row]
) -> None:
    monkeypatch.setattr(rows_module, "FEW", few)
    monkeypatch.setattr(rows_module, "_FEWEST", few)
    batch = Rows.from_rows(rows)
    assert batch.tobytes() == b"".join(row.raw for row in rows)
    assert batch[1:].tobytes() == b"".join(row.raw for row in rows[1:])


@given(ROWS)
def test_rows_cross_a_pipe(rows: list[Row]) -> None:
    batch = pickle.loads(pickle.dumps(Rows.from_rows(rows)))
    assert facts(batch) == facts(rows)
    assert facts(Rows.concat([batch, Rows.from_rows(rows)])) == facts(rows + rows)


@given(ROWS)
def test_times_are_the_first_and_the_latest(rows: list[Row]) -> None:
    times = [row.t_ns for row in rows]
    known = [time for time in times if time is not None]
    expected = (known[0], max(known)) if times and len(known) == len(times) else None
    assert Rows.from_rows(rows).times == expected


def test_a_row_and_its_index_under_a_filter_take_no_more_than_48_bytes() -> None:
    batch = Rows.allocate(Codebook(), 1)
    assert sum(getattr(batch, name).nbytes for name in (*COLUMNS, "raw")) + 2 <= 48


# Rows of the framer

TIMES = st.none() | st.integers(0, 2**62) | st.integers(10**18, 10**18 + 10**9)


def pieces(data: bytes, sizes: Sequence[int]) -> list[bytes]:
    """The data cut into pieces of these sizes, again and again."""
    found: list[bytes] = []
    at = turn = 0
    while at < len(data):
        size = sizes[turn % len(sizes)]
        found.append(data[at : at + size])
        at, turn = at + size, turn + 1
    return found


def one_by_one(chunks: Sequence[Chunk]) -> list[Row]:
    framer = Framer("p")
    fed = [framer.feed(chunk) for chunk in chunks]
    return [row for rows in fed for row in rows] + framer.flush()


def drained(chunks: Sequence[Chunk], taken_after: int) -> list[Rows]:
    """The rows of the same chunks, drained after every `taken_after` of them."""
    framer, found = Framer("p"), []
    for count, chunk in enumerate(chunks):
        framer.push(chunk)
        if count % taken_after == 0:
            found.append(framer.drain())
    framer.finish()
    return [*found, framer.drain()]


def check(chunks: Sequence[Chunk], taken_after: int) -> None:
    expected = facts(one_by_one(chunks))
    batches = drained(chunks, taken_after)
    assert facts([row for batch in batches for row in batch]) == expected
    assert facts(Rows.concat(batches)) == expected


@settings(deadline=None)
@given(
    raw_bytes,
    st.lists(st.integers(1, 120), min_size=1, max_size=4),
    st.just([None]) | st.lists(TIMES, min_size=1, max_size=20),
    st.integers(1, 5),
)
def test_draining_gives_the_rows_of_feeding(
    data: bytes, sizes: list[int], times: list[int | None], taken_after: int
) -> None:
    cut = pieces(data, sizes)
    chunks = [Chunk("p", times[at % len(times)], piece) for at, piece in enumerate(cut)]
    check(chunks, taken_after)


@pytest.mark.parametrize(("share", "payload"), [(0.001, "ordinary"), (0.2, "hostile")])
def test_large_pieces_give_the_rows(share: float, payload: str) -> None:
    stream, _ = damaged_stream(3, 12_000 if share < 0.1 else 2000, share, payload)
    check([Chunk("p", None, piece) for piece in pieces(stream, [1 << 12, 99_991])], 1)


@pytest.mark.parametrize(
    ("share", "payload"), [(0.0, "ordinary"), (0.01, "ordinary"), (0.2, "hostile")]
)
def test_columns_have_the_values_of_the_rows(share: float, payload: str) -> None:
    stream, _ = damaged_stream(3, 3000, share, payload)
    chunk = Chunk("p", None, stream)
    rows = one_by_one([chunk])
    batch = Rows.concat(drained([chunk], 1))
    assert batch.offset.tolist() == [row.offset for row in rows]
    assert batch.length.tolist() == [len(row.raw) for row in rows]
    assert batch.framed.tolist() == [isinstance(row, Frame) for row in rows]
    assert [batch.codebook.faults[code] for code in batch.faults] == [row.faults for row in rows]
    kinds = [row.kind if isinstance(row, Frame) else None for row in rows]
    assert batch.kinds.tolist() == [KINDS.index(k) if k else NO_KIND for k in kinds]
    for field in VALUE_FIELDS:
        values, known = batch.field(field.name)
        expected = [row.values.get(field.name) if isinstance(row, Frame) else None for row in rows]
        got = [int(v) if k else None for v, k in zip(values, known, strict=True)]
        assert got == expected


@given(st.lists(st.tuples(st.sampled_from("abc"), st.integers(1, 30)), max_size=30))
def test_the_end_offset_of_a_port_is_after_its_last_row(
    lengths: list[tuple[str, int]],
) -> None:
    ends: dict[str, int] = {}
    rows = []
    for port, length in lengths:
        offset = ends.get(port, 0)
        rows.append(Damage(port, offset, bytes(length), 1, (Fault.NOISE,)))
        ends[port] = offset + length
    assert Rows.from_rows(rows).end_offsets() == ends


# Single rows


@given(st.from_type(Frame) | st.from_type(Damage))
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
