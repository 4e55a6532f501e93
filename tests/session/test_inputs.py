"""Logs in spans, rows in lists and in batches: every reading and every format gives the same."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fte_sniff.analysis.dataframe import TABLE_SCHEMA, table_frame
from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.errors import FileError, InputTextError
from fte_sniff.formats.parquet import write_parquet
from fte_sniff.formats.writers import TEXT_FORMATS, OutputFormat, RowWriter, row_writer
from fte_sniff.protocol import KINDS, Chunk, Damage, Fault, Frame, Framer, Row, encode
from fte_sniff.protocol.rows import Rows
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import RecordingReader
from fte_sniff.recording.reading_pass import TimeRange
from fte_sniff.session import save
from fte_sniff.session.inputs import InputBatch, LogInput, RecordingInput
from fte_sniff.session.log_rows import SPAN_BYTES, rows_of_chunks
from fte_sniff.session.save import write_rows
from tests.protocol.streams import raw_bytes
from tests.support.recorded_rows import write_recording

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
        parts = rows_of_chunks(chunks, "f", lambda _: None, lambda: waiting)
        assert [row for rows in parts for row in rows] == expected


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


def test_the_end_is_reported() -> None:
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


@pytest.mark.parametrize("count", [10, 20_000])
def test_a_span_takes_what_lies_in_it(count: int) -> None:
    chunks = [Chunk("f", 10**18 + at * 10**9, FRAME) for at in range(count)]
    notes: list[str] = []
    inside = TimeRange(10**18 + 2 * 10**9, 10**18 + 5 * 10**9)
    found = rows_of(LogInput(chunks, "f"), notes, inside)
    assert [row.offset for rows in found for row in rows] == [30, 40, 50]
    assert not notes
    assert not any(rows_of(LogInput(chunks, "f"), notes, TimeRange(0, 10)))
    assert f"none of its {count:,} rows is between" in notes[0]


def test_a_large_file_is_read_in_pieces(tmp_path: Path) -> None:
    from fte_sniff.cli.input_files import InputQuery

    path = tmp_path / "large.bin"
    path.write_bytes(FRAME * 200_000)
    (one,) = InputQuery((path,)).read(None).inputs
    sizes = [len(batch.rows) for batch in one.batches(None, lambda _: None)]
    assert sum(sizes) == 200_000
    assert max(sizes) <= SPAN_BYTES // len(FRAME) + 1


PORTS = [
    "/dev/ttyUSB0",
    "",
    'a "quoted", port',
    "zwei\nZeilen",
    "тест ✓",
    "back\\slash",
    "\x1b[31m",
]
TIMES = st.integers(0, 2**63 - 1) | st.sampled_from([0, 1, 10**9, 1_770_000_000_000_000_000])
FAULTS = st.lists(st.sampled_from(list(Fault)), max_size=4).map(tuple)


@st.composite
def row(draw: st.DrawFn) -> Row:
    port, t_ns, faults = draw(st.sampled_from(PORTS)), draw(TIMES), draw(FAULTS)
    offset = draw(st.integers(0, 2**63 - 1))
    if draw(st.booleans()):
        raw = draw(st.binary(min_size=1, max_size=40))
        return Damage(port, offset, raw, t_ns, faults)
    kind = draw(st.sampled_from(KINDS))
    raw = encode(kind, {f.name: draw(st.integers(f.low, f.high)) for f in kind.fields})
    if draw(st.booleans()):
        raw = raw[:1] + b"\x77" + raw[2:]
    return Frame(port, offset, raw, t_ns, faults)


ROWS = st.lists(row(), max_size=12)
UNTIMED = st.lists(
    st.builds(lambda row, kept: row if kept else replace(row, t_ns=None), row(), st.booleans()),
    max_size=12,
)


def written(write: Callable[[RowWriter], None], form: OutputFormat) -> str:
    stream = io.StringIO()
    writer = row_writer(form, stream, ports=True)
    write(writer)
    writer.close()
    return stream.getvalue()


@pytest.mark.parametrize("form", [*TEXT_FORMATS, OutputFormat.HEX])
@given(rows=ROWS | UNTIMED)
def test_columns_are_written_byte_for_byte_as_rows(form: OutputFormat, rows: list[Row]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(save, "_FEWEST", 0)
        by_columns = written(lambda writer: write_rows(writer, Rows.from_rows(rows), 10**9), form)
    assert by_columns == written(lambda writer: writer.write(rows), form)


@given(
    ROWS,
    st.sampled_from(
        [
            "motor = 1 AND rpm * 1000 > 500",
            "faults = 'noise'",
            "faults IS NULL",
            "malformed OR length > 10",
            "raw LIKE 'AA 01%'",
            "time > '2026-01-31'",
            "port = ''",
            "kind IS DISTINCT FROM 'speed'",
            "online & 1 = 0",
            "TRUE",
        ]
    ),
)
def test_a_filter_selects_each_row_by_itself(rows: list[Row], text: str) -> None:
    wanted = RowFilter.parse(text)
    one_by_one = [row for row in rows if wanted.select(Rows.from_rows([row]))]
    assert list(InputBatch(Rows.from_rows(rows)).select(wanted).rows) == one_by_one


@given(ROWS, st.integers(0, 14))
def test_the_first_rows(rows: list[Row], count: int) -> None:
    assert list(InputBatch(Rows.from_rows(rows)).first(count).rows) == rows[:count]


@given(ROWS, st.integers(0, 2**63 - 1), st.integers(0, 2**63 - 1))
def test_a_span_holds_the_same(rows: list[Row], first_ns: int, end_ns: int) -> None:
    span = TimeRange(first_ns, end_ns)
    inside = [row for row in rows if span.contains(row)]
    assert list(span.select(Rows.from_rows(rows))) == inside


@given(UNTIMED.filter(lambda rows: any(row.t_ns is None for row in rows)))
def test_a_recording_takes_no_row_without_time(
    tmp_path_factory: pytest.TempPathFactory, rows: list[Row]
) -> None:
    with pytest.raises(FileError, match="has no time since 1970"):
        write_recording(tmp_path_factory.getbasetemp() / "x", [], [Rows.from_rows(rows)])


def test_parquet_is_the_frames_one_behind_the_other(tmp_path: Path) -> None:
    rows: list[Row] = [Damage("p", at, b"x", at, (Fault.NOISE,)) for at in range(100)]
    batches = [Rows.from_rows(rows[:30]), Rows.from_rows(rows[30:])]
    path = tmp_path / "rows.parquet"
    write_parquet((table_frame(batch) for batch in batches), path, dict(TABLE_SCHEMA))
    found = pl.read_parquet(path)
    assert found.equals(table_frame(Rows.from_rows(rows)))


def test_a_recording_of_which_nothing_can_be_read_is_reported(tmp_path: Path) -> None:
    """Its first batch is empty and has no place in the file."""
    path = tmp_path / "a.mcap"
    rows = [Frame("p", 10 * at, FRAME, 10**18 + at) for at in range(100)]
    write_recording(path, [PortFacts("p")], [Rows.from_rows(rows)])
    content = path.read_bytes()
    at = content.index(b"\x06", 200)
    found = []
    for start in range(at - 30, at + 200, 10):
        path.write_bytes(content[:start] + content[start + 1 :])
        with suppress(FileError):
            recording = RecordingInput(RecordingReader(path))
            found += [len(batch.rows) for batch in recording.batches(None, lambda _: None)]
            assert recording.losses
    assert 0 in found
