from __future__ import annotations

import polars as pl
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.dataframe import TABLE_SCHEMA, table_frame
from fte_sniff.protocol.columns import COLUMN_BY_NAME, COLUMNS, ColumnType, record
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import Fault
from tests.support.columns import rows_from

ROWS = st.lists(st.from_type(Row), max_size=12)


@given(ROWS)
def test_a_frame_has_the_values_of_the_records(rows: list[Row]) -> None:
    plain = table_frame(rows_from(rows)).with_columns(
        pl.col("time").cast(pl.Int64),
        pl.col("faults").cast(pl.List(pl.String)),
        *(
            pl.col(column.name).cast(pl.String)
            for column in COLUMNS
            if column.type is ColumnType.WORD
        ),
    )
    assert plain.rows(named=True) == [record(row) for row in rows]


@given(ROWS)
def test_a_frame_has_the_types_of_the_contract(rows: list[Row]) -> None:
    assert dict(table_frame(rows_from(rows)).schema) == TABLE_SCHEMA
    assert list(TABLE_SCHEMA) == list(COLUMN_BY_NAME)


@given(ROWS, st.sets(st.sampled_from(list(COLUMN_BY_NAME)), min_size=1))
def test_some_columns_are_those_of_the_whole_frame(rows: list[Row], names: set[str]) -> None:
    wanted = [name for name in COLUMN_BY_NAME if name in names]
    assert table_frame(rows_from(rows), names).equals(table_frame(rows_from(rows)).select(wanted))


def test_a_port_name_that_is_not_text_is_escaped() -> None:
    frame = table_frame(
        rows_from([Row("/dev/\udc80", 0, b"\0", None, (Fault.NOISE,), framed=False)])
    )
    assert frame["port"].to_list() == ["/dev/\\udc80"]
