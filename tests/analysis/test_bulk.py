"""The bulk path: the same rows as the framer gives, as columns."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.faults import damaged_stream
from fte_sniff.analysis.bulk import NO_KIND, bulk_columns, plain_frames
from fte_sniff.protocol import FRAME_LENGTH, KINDS, VALUE_FIELDS, Chunk, Frame, Framer
from fte_sniff.protocol.patterns import PLAIN_RUN


@pytest.mark.parametrize(
    ("share", "payload"), [(0.0, "ordinary"), (0.01, "ordinary"), (0.2, "hostile")]
)
def test_columns_are_the_rows(share: float, payload: str) -> None:
    stream, _ = damaged_stream(3, 3000, share, payload)
    framer = Framer("p")
    rows = framer.feed(Chunk("p", None, stream)) + framer.flush()
    columns = bulk_columns("p", stream)
    assert columns.offset.tolist() == [row.offset for row in rows]
    assert columns.length.tolist() == [len(row.raw) for row in rows]
    assert columns.framed.tolist() == [isinstance(row, Frame) for row in rows]
    assert [columns.fault_sets[code] for code in columns.faults] == [row.faults for row in rows]
    kinds = [row.kind if isinstance(row, Frame) else None for row in rows]
    assert columns.kind.tolist() == [KINDS.index(k) if k else NO_KIND for k in kinds]
    for field in VALUE_FIELDS:
        known, values = columns.known(field.name), columns.values[field.name]
        expected = [row.values.get(field.name) if isinstance(row, Frame) else None for row in rows]
        got = [int(v) if k else None for v, k in zip(values, known, strict=True)]
        assert got == expected


def test_no_bytes_give_no_rows() -> None:
    columns = bulk_columns("p", b"")
    assert len(columns.kind) == len(columns.offset) == 0


byte = st.one_of(
    st.sampled_from([0xAA, 0x55, 0xEE, 0, 1, 2, 3, 4, 0x0F, 0x10]), st.integers(0, 255)
)


@settings(max_examples=300)
@given(st.integers(0, 5000), st.lists(st.tuples(st.integers(0, 399), byte), max_size=4))
def test_a_run_is_never_counted_longer_than_it_is(
    seed: int, changes: list[tuple[int, int]]
) -> None:
    stream = bytearray(damaged_stream(seed, 40, 0, "hostile" if seed % 2 else "ordinary")[0])
    for place, value in changes:
        stream[place] = value
    data = bytes(stream)
    match = PLAIN_RUN.match(data)
    assert match is not None
    assert plain_frames(data, 0) <= match.end() // FRAME_LENGTH


@settings(max_examples=50)
@given(st.integers(0, 5000))
def test_a_run_of_plain_frames_is_counted_whole(seed: int) -> None:
    frame = damaged_stream(seed, 1, 0, "ordinary")[0]
    if not any(value in b"\xaa\x55\xee" for value in frame[1:9]):
        assert plain_frames(frame * 5000, 0) == 5000
