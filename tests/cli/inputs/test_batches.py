"""Rows one by one, packed and in columns: every command sees and writes the same."""

import io
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.counters import Tally
from fte_sniff.analysis.dataframe import TABLE_SCHEMA
from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.errors import FileError
from fte_sniff.formats.parquet import write_parquet
from fte_sniff.formats.writers import TEXT_FORMATS, OutputFormat, row_writer
from fte_sniff.protocol import KINDS, Damage, Fault, Frame, Row, encode
from fte_sniff.recording.bulk_writer import write_recording
from fte_sniff.recording.row_ranges import TimeRange
from fte_sniff.row_batch import Codebook, PackedRows, RowBatch, pack
from fte_sniff.session.inputs import ColumnBatch, InputBatch, ListBatch, PackedBatch

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


def both(rows: list[Row]) -> tuple[ListBatch, ColumnBatch]:
    return ListBatch(rows), ColumnBatch(RowBatch.from_rows(rows))


def packed(rows: list[Row]) -> PackedBatch:
    codebook = Codebook()
    return PackedBatch(PackedRows(*pack(rows, codebook), codebook))


def each(rows: list[Row]) -> tuple[ListBatch, ColumnBatch, PackedBatch]:
    return (*both(rows), packed(rows))


def written(batch: InputBatch, form: OutputFormat) -> str:
    stream = io.StringIO()
    writer = row_writer(form, stream, ports=True)
    batch.write_to(writer)
    writer.close()
    return stream.getvalue()


@pytest.mark.parametrize("form", [*TEXT_FORMATS, OutputFormat.HEX])
@given(rows=ROWS)
def test_the_text_is_the_same_byte_for_byte(form: OutputFormat, rows: list[Row]) -> None:
    one_by_one, *others = each(rows)
    if rows:
        for batch in others:
            assert written(batch, form) == written(one_by_one, form)


@pytest.mark.parametrize("form", [*TEXT_FORMATS, OutputFormat.HEX])
@given(rows=UNTIMED)
def test_also_where_rows_have_no_times(form: OutputFormat, rows: list[Row]) -> None:
    assert written(packed(rows), form) == written(ListBatch(rows), form)


@given(ROWS)
def test_the_count_is_the_same(rows: list[Row]) -> None:
    tallies = Tally(), Tally(), Tally()
    for tally, batch in zip(tallies, each(rows), strict=True):
        batch.count(tally)
    assert tallies[0] == tallies[1] == tallies[2]


@given(UNTIMED)
def test_also_without_times(rows: list[Row]) -> None:
    one_by_one, at_once = Tally(), Tally()
    ListBatch(rows).count(one_by_one)
    packed(rows).count(at_once)
    assert at_once == one_by_one


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
def test_a_filter_wants_the_same(rows: list[Row], text: str) -> None:
    wanted = RowFilter.parse(text)
    one_by_one, *others = each(rows)
    for batch in others:
        assert batch.wanted(wanted).rows() == one_by_one.wanted(wanted).rows()


@given(ROWS, st.integers(0, 14))
def test_the_first_rows_are_the_same(rows: list[Row], count: int) -> None:
    assert all(batch.first(count).rows() == rows[:count] for batch in each(rows))


@given(UNTIMED, st.integers(0, 2**63 - 1), st.integers(0, 2**63 - 1))
def test_a_span_holds_the_same(rows: list[Row], first_ns: int, end_ns: int) -> None:
    span = TimeRange(first_ns, end_ns)
    one_by_one, at_once = ListBatch(rows), packed(rows)
    assert at_once.timed == one_by_one.timed
    assert at_once.within(span).rows() == one_by_one.within(span).rows()


@given(ROWS)
def test_the_columns_of_a_recording_are_the_same(rows: list[Row]) -> None:
    for batch in each(rows):
        assert list(batch.columns(Codebook())) == rows


@given(UNTIMED.filter(lambda rows: any(row.t_ns is None for row in rows)))
def test_a_recording_takes_no_row_without_time(
    tmp_path_factory: pytest.TempPathFactory, rows: list[Row]
) -> None:
    for batch in (ListBatch(rows), packed(rows)):
        with pytest.raises(FileError, match="has no time since 1970"):
            write_recording(tmp_path_factory.getbasetemp() / "x", [], [batch.columns(Codebook())])


@given(ROWS)
def test_the_frame_is_the_same(rows: list[Row]) -> None:
    one_by_one, *others = each(rows)
    for batch in others:
        assert batch.frame().equals(one_by_one.frame())
        assert batch.frame().schema == TABLE_SCHEMA


def test_parquet_is_the_frames_one_behind_the_other(tmp_path: Path) -> None:
    rows: list[Row] = [Damage("p", at, b"x", at, (Fault.NOISE,)) for at in range(100)]
    batches = [both(rows[:30])[0], both(rows[30:])[1]]
    path = tmp_path / "rows.parquet"
    write_parquet((batch.frame() for batch in batches), path, dict(TABLE_SCHEMA))
    found = pl.read_parquet(path)
    assert found.equals(both(rows)[1].frame())
