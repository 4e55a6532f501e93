"""Logs in spans: the framer's rows, and nothing waits for what has not come."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fte_sniff.errors import FileError, InputTextError
from fte_sniff.protocol import Chunk, Framer, Row
from fte_sniff.recording.row_ranges import TimeRange
from fte_sniff.session.inputs import FEW, SPAN_BYTES, LogInput, decided_spans, rows_of_spans
from tests.protocol.streams import raw_bytes

FRAME = bytes.fromhex("AA 01 01 03 E8 00 00 00 00 EE")
CUT = ["f: ends in the middle of a frame (4 of 10 bytes)"]


def rows_of(log: LogInput, notes: list[str], span: TimeRange | None = None) -> list[list[Row]]:
    return [list(batch.rows) for batch in log.batches(span, notes.append)]


@settings(max_examples=30, deadline=None)
@given(raw_bytes, st.integers(1, 9), st.booleans(), st.sampled_from([0, 10**18]))
def test_rows_are_the_framers(data: bytes, repeated: int, waiting: bool, start_ns: int) -> None:
    data = data * (4000 * repeated // (len(data) + 1) + 1)
    cut = [data[at : at + 40_000] for at in range(0, len(data), 40_000)]
    chunks = [
        Chunk("f", start_ns + at if start_ns else None, piece) for at, piece in enumerate(cut)
    ]
    framer = Framer("f")
    expected = [row for chunk in chunks for row in framer.feed(chunk)] + framer.flush()
    if data:
        for few in (0, 1000, FEW):
            spans = decided_spans(chunks, "f", lambda _: None, lambda: waiting)
            found = [row for rows in rows_of_spans(spans, few) for row in rows]
            assert found == expected


def test_spans_are_bounded() -> None:
    chunks = (Chunk("f", None, FRAME) for _ in range(SPAN_BYTES // 4))
    notes: list[str] = []
    sizes = [len(rows) for rows in rows_of(LogInput(chunks, "f"), notes)]
    assert sum(sizes) == SPAN_BYTES // 4
    assert max(sizes) <= SPAN_BYTES // len(FRAME) + 1


def test_what_has_come_is_handed_on_before_more_is_waited_for() -> None:
    asked: list[int] = []

    def chunks() -> Iterator[Chunk]:
        for at in range(3):
            asked.append(at)
            yield Chunk("f", None, FRAME * 5)

    handed: list[tuple[int, int]] = []
    for batch in LogInput(chunks(), "f", lambda: True).batches(None, lambda _: None):
        handed.append((len(asked), len(batch.rows)))
    assert handed == [(1, 5), (2, 5), (3, 5), (3, 0)]


def test_the_end_is_told() -> None:
    notes: list[str] = []
    rows_of(LogInput([Chunk("f", None, FRAME * 3000 + FRAME[:4])], "f"), notes)
    assert notes == CUT
    with pytest.raises(FileError, match="f: is empty"):
        rows_of(LogInput([], "f"), notes)


def test_rows_before_an_error_are_not_lost() -> None:
    def chunks() -> Iterator[Chunk]:
        yield Chunk("f", None, FRAME * 3)
        yield Chunk("f", None, FRAME[:4])
        raise InputTextError("no hex")

    batches = LogInput(chunks(), "f").batches(None, lambda _: None)
    assert [len(row.raw) for row in next(batches).rows] == [10, 10, 10, 4]
    with pytest.raises(InputTextError):
        next(batches)


@pytest.mark.parametrize("count", [10, FEW])
def test_a_span_takes_what_lies_in_it(count: int) -> None:
    chunks = [Chunk("f", 10**18 + at * 10**9, FRAME) for at in range(count)]
    notes: list[str] = []
    inside = TimeRange(10**18 + 2 * 10**9, 10**18 + 5 * 10**9)
    found = rows_of(LogInput(chunks, "f"), notes, inside)
    assert [row.offset for rows in found for row in rows] == [30, 40, 50]
    assert not notes
    assert not any(rows_of(LogInput(chunks, "f"), notes, TimeRange(0, 10)))
    assert f"none of its {count:,} rows lies between" in notes[0]


def test_a_large_file_is_read_in_pieces(tmp_path: Path) -> None:
    from fte_sniff.cli.input_files import ReadOptions, open_inputs

    path = tmp_path / "large.bin"
    path.write_bytes(FRAME * 200_000)
    (one,) = open_inputs([path], ReadOptions())
    sizes = [len(batch.rows) for batch in one.batches(None, lambda _: None)]
    assert sum(sizes) == 200_000
    assert max(sizes) <= SPAN_BYTES // len(FRAME) + 1
