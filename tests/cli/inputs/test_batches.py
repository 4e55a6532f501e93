"""Rows one by one and rows side by side: every command sees and writes the same."""

import io
from pathlib import Path

import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.accumulators.tally import Tally
from fte_sniff.analysis.columns.table import TABLE_SCHEMA
from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.cli.inputs.batches import Batch, ColumnBatch, RowBatch
from fte_sniff.formats.tables.parquet import write_parquet
from fte_sniff.formats.tables.writers import TEXT_FORMS, OutputFormat, row_writer
from fte_sniff.protocol import KINDS, Damage, Fault, Frame, Row, encode
from fte_sniff.recording.encoding.columns import RowColumns, Words

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


def both(rows: list[Row]) -> tuple[RowBatch, ColumnBatch]:
    return RowBatch(rows), ColumnBatch(RowColumns.of_rows(Words(), rows))


def written(batch: Batch, form: OutputFormat) -> str:
    stream = io.StringIO()
    writer = row_writer(form, stream, ports=True)
    batch.write_to(writer)
    writer.end()
    return stream.getvalue()


@pytest.mark.parametrize("form", [*TEXT_FORMS, OutputFormat.HEX])
@given(rows=ROWS)
def test_the_text_is_the_same_byte_for_byte(form: OutputFormat, rows: list[Row]) -> None:
    one_by_one, at_once = both(rows)
    if rows:
        assert written(at_once, form) == written(one_by_one, form)


@given(ROWS)
def test_the_count_is_the_same(rows: list[Row]) -> None:
    one_by_one, at_once = Tally(), Tally()
    for tally, batch in zip((one_by_one, at_once), both(rows), strict=True):
        batch.count(tally)
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
    assert at_once.wanted(wanted).rows() == one_by_one.wanted(wanted).rows()


@given(ROWS, st.integers(0, 14))
def test_the_first_rows_are_the_same(rows: list[Row], count: int) -> None:
    one_by_one, at_once = both(rows)
    assert at_once.first(count).rows() == one_by_one.first(count).rows() == rows[:count]


@given(ROWS)
def test_the_frame_is_the_same(rows: list[Row]) -> None:
    one_by_one, at_once = both(rows)
    assert at_once.frame().equals(one_by_one.frame())
    assert at_once.frame().schema == TABLE_SCHEMA


def test_parquet_is_the_frames_one_behind_the_other(tmp_path: Path) -> None:
    rows: list[Row] = [Damage("p", at, b"x", at, (Fault.NOISE,)) for at in range(100)]
    batches = [both(rows[:30])[0], both(rows[30:])[1]]
    path = tmp_path / "rows.parquet"
    write_parquet((batch.frame() for batch in batches), path, dict(TABLE_SCHEMA))
    found = pl.read_parquet(path)
    assert found.equals(both(rows)[1].frame())
