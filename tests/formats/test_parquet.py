"""Parquet: what `decode` writes is read back row by row; other files are refused by name."""

from __future__ import annotations

import errno
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.dataframe import TABLE_SCHEMA, table_frame
from fte_sniff.errors import FileError
from fte_sniff.formats import parquet
from fte_sniff.formats.parquet import ParquetRows, write_parquet
from fte_sniff.protocol import Fault, Row
from fte_sniff.protocol.rows import Rows
from tests.analysis import conftest

ROWS = conftest.FRAMES | conftest.DAMAGES.filter(lambda row: row.raw)


def written(rows: list[Row], path: Path) -> Path:
    write_parquet(iter([table_frame(Rows.of(rows))]), path, dict(TABLE_SCHEMA))
    return path


@given(st.lists(ROWS, max_size=12), st.integers(1, 5))
def test_rows_come_back_as_they_were(rows: list[Row], size: int) -> None:
    with TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr(parquet, "BATCH_ROWS", size)
        found = ParquetRows(written(rows, Path(folder) / "a.parquet"))
        assert [row for batch in found.batches() for row in batch] == rows
        assert found.count == len(rows)
        assert found.used_ports == list(dict.fromkeys(row.port for row in rows))
        times = [row.t_ns for row in rows if row.t_ns is not None]
        complete = len(times) == len(rows) > 0
        assert found.times() == ((times[0], max(times)) if complete else None)


SOUND = Row("a", 0, bytes.fromhex("AA0101000100000000EE"), 5)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (pl.col("raw").alias("bytes"), ""),
        (pl.lit("AA01").alias("raw"), "row 0"),
        (pl.lit("AA0101000100000000EF").alias("raw"), "row 0"),
        (pl.lit("BB0101000100000000EE").alias("raw"), "row 0"),
        (pl.lit("no hex").alias("raw"), "row 0"),
        (pl.lit(None, pl.String).alias("raw"), "row 0"),
        (pl.lit(None, pl.String).alias("port"), "row 0"),
        (pl.lit(None, pl.Int64).alias("offset"), "row 0"),
        (pl.concat_list(pl.lit("smudge")).alias("faults"), "smudge"),
        (pl.col("offset").cast(pl.String), "its column offset is String"),
        (pl.col("time").dt.replace_time_zone(None), "its column time is Datetime"),
    ],
)
def test_a_value_that_no_row_has_is_refused(tmp_path: Path, change: pl.Expr, reason: str) -> None:
    path = tmp_path / "a.parquet"
    table_frame(Rows.of([SOUND])).with_columns(change).write_parquet(path)
    if not reason:
        assert [row for batch in ParquetRows(path).batches() for row in batch] == [SOUND]
        return
    with pytest.raises(FileError, match=reason) as refused:
        list(ParquetRows(path).batches())
    assert str(refused.value).startswith(str(path))
    assert "`fte-sniff decode` wrote" in str(refused.value)


@pytest.mark.parametrize("name", ["time", "port", "offset", "cmd", "faults", "raw"])
def test_a_parquet_file_of_another_program_is_refused_by_name(tmp_path: Path, name: str) -> None:
    path = tmp_path / "foreign.parquet"
    table_frame(Rows.of([SOUND])).drop(name).write_parquet(path)
    with pytest.raises(FileError, match=f"foreign.parquet has no column {name}; only Parquet"):
        ParquetRows(path)


@pytest.mark.parametrize("content", [b"", b"PAR1", b"PAR1" + bytes(100)])
def test_a_damaged_parquet_file_is_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.parquet"
    path.write_bytes(content)
    with pytest.raises(FileError, match=r"a\.parquet cannot be read as Parquet: [^\n]+$"):
        list(ParquetRows(path).batches())


def test_the_words_of_faults_may_be_plain_text(tmp_path: Path) -> None:
    row = replace(SOUND, faults=(Fault.BAD_MOTOR, Fault.LINE_ERROR))
    words = pl.col("faults").cast(pl.List(pl.String))
    table_frame(Rows.of([row])).with_columns(words).write_parquet(tmp_path / "a.parquet")
    assert list(next(ParquetRows(tmp_path / "a.parquet").batches())) == [row]


def test_an_error_of_polars_is_a_failed_write_in_one_line(tmp_path: Path) -> None:
    frames = iter([pl.DataFrame({"number": ["text"]})])
    with pytest.raises(OSError, match=r"a write failed \(.+\)") as caught:
        write_parquet(frames, tmp_path / "a.parquet", {"number": pl.Int64()})
    assert caught.value.errno == errno.EIO
    assert "\n" not in str(caught.value)
