"""Rows in a list and in a batch: every command sees and writes the same."""

import io
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.dataframe import TABLE_SCHEMA, table_frame
from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.tally import Tally
from fte_sniff.errors import FileError
from fte_sniff.formats.parquet import write_parquet
from fte_sniff.formats.writers import TEXT_FORMATS, OutputFormat, row_writer
from fte_sniff.protocol import KINDS, Damage, Fault, Frame, Row, encode
from fte_sniff.recording.bulk_writer import write_recording
from fte_sniff.recording.row_ranges import TimeRange
from fte_sniff.row_batch import RowBatch
from fte_sniff.session.inputs import InputBatch
from fte_sniff.session.save import write_rows

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


def both(rows: list[Row]) -> tuple[InputBatch, InputBatch]:
    return InputBatch(rows), InputBatch(RowBatch.from_rows(rows))


def written(batch: InputBatch, form: OutputFormat) -> str:
    stream = io.StringIO()
    writer = row_writer(form, stream, ports=True)
    write_rows(writer, batch.rows)
    writer.close()
    return stream.getvalue()


@pytest.mark.parametrize("form", [*TEXT_FORMATS, OutputFormat.HEX])
@given(rows=ROWS | UNTIMED)
def test_the_text_is_the_same_byte_for_byte(form: OutputFormat, rows: list[Row]) -> None:
    one_by_one, at_once = both(rows)
    if rows:
        assert written(at_once, form) == written(one_by_one, form)


@given(ROWS | UNTIMED)
def test_the_count_is_the_same(rows: list[Row]) -> None:
    one_by_one, at_once = Tally(), Tally()
    for tally, batch in zip((one_by_one, at_once), both(rows), strict=True):
        tally.update(batch.rows)
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
    one_by_one, at_once = both(rows)
    assert list(at_once.select(wanted).rows) == one_by_one.select(wanted).rows


@given(ROWS, st.integers(0, 14))
def test_the_first_rows_are_the_same(rows: list[Row], count: int) -> None:
    assert all(list(batch.first(count).rows) == rows[:count] for batch in both(rows))


@given(ROWS | UNTIMED)
def test_the_times_are_the_same(rows: list[Row]) -> None:
    one_by_one, at_once = both(rows)
    assert at_once.times == one_by_one.times


@given(ROWS, st.integers(0, 2**63 - 1), st.integers(0, 2**63 - 1))
def test_a_span_holds_the_same(rows: list[Row], first_ns: int, end_ns: int) -> None:
    span = TimeRange(first_ns, end_ns)
    inside = [row for row in rows if span.contains(row)]
    assert list(span.select(RowBatch.from_rows(rows))) == inside


@given(UNTIMED.filter(lambda rows: any(row.t_ns is None for row in rows)))
def test_a_recording_takes_no_row_without_time(
    tmp_path_factory: pytest.TempPathFactory, rows: list[Row]
) -> None:
    with pytest.raises(FileError, match="has no time since 1970"):
        write_recording(tmp_path_factory.getbasetemp() / "x", [], [RowBatch.from_rows(rows)])


@given(ROWS)
def test_the_frame_is_the_same(rows: list[Row]) -> None:
    one_by_one, at_once = (table_frame(batch.rows) for batch in both(rows))
    assert at_once.equals(one_by_one)
    assert at_once.schema == one_by_one.schema == TABLE_SCHEMA


def test_parquet_is_the_frames_one_behind_the_other(tmp_path: Path) -> None:
    rows: list[Row] = [Damage("p", at, b"x", at, (Fault.NOISE,)) for at in range(100)]
    batches = [both(rows[:30])[0], both(rows[30:])[1]]
    path = tmp_path / "rows.parquet"
    write_parquet((table_frame(batch.rows) for batch in batches), path, dict(TABLE_SCHEMA))
    found = pl.read_parquet(path)
    assert found.equals(table_frame(rows))
