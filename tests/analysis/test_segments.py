"""Segments of a stream have the relations of the whole, wherever it is cut."""

from __future__ import annotations

from dataclasses import replace

import polars as pl
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.segments import Segments, added
from fte_sniff.analysis.table import Table
from fte_sniff.protocol.rows import FACTS, Item, Row, Rows
from tests.analysis.captures import captures, items_of, polled, table_of


def tables(steps: list[Row | Item], most: int) -> list[Table]:
    """The tables of steps that come one by one."""
    cutter = Segments(most=most)
    cutter.begin("file")
    found = [table for step in steps for item in items_of([step]) for table in cutter.push(item)]
    return [*found, cutter.rest()]


@given(captures(), st.integers(1, 12))
def test_segments_have_the_facts_and_numbers_of_the_whole(
    steps: list[Row | Item], most: int
) -> None:
    whole, parts = table_of(steps), tables(steps, most)
    facts = Rows.concat([one.with_facts.select(slice(one.start, one.stop)) for one in parts])
    for name in FACTS:
        assert facts.columns[name].tolist() == whole.with_facts.columns[name].tolist(), name
    assert pl.concat(one.frame for one in parts).equals(whole.frame)
    assert [event for one in parts for event in one.events] == [*whole.events]


@given(captures(), st.integers(1, 12))
def test_answers_of_segments_are_those_of_the_whole(steps: list[Row | Item], most: int) -> None:
    names = ["motor", "kind", "state", "delay_ns", "t_ns", "end_ns"]
    found = pl.concat(one.answers.select(names) for one in tables(steps, most))
    assert found.sort(names).equals(table_of(steps).answers.select(names).sort(names))


def test_selected_rows_are_measured_among_themselves() -> None:
    rows = polled(30, motors=(1, 2))
    whole = replace(table_of(rows), test=lambda rows: rows.nums == 2)
    cutter = Segments(most=5, test=lambda rows: rows.nums == 2)
    parts = [one for item in items_of(rows) for one in cutter.push(item)] + [cutter.rest()]
    assert set(whole.frame["motor"]) == {2}
    assert whole.frame["period_ns"].drop_nulls().unique().to_list() == [50_000_000]
    assert pl.concat(one.frame for one in parts)["step_ns"].to_list() == [
        *whole.frame["step_ns"].to_list()
    ]
    assert sum(len(one.answers) for one in parts) == len(whole.answers) == 30


def test_counts_add_up_as_their_names_say() -> None:
    parts = [
        pl.DataFrame({"key": "a", "sum n": 1, "greatest ns": 5, "until ns": 50, "least t": None}),
        pl.DataFrame({"key": "a", "sum n": 2, "greatest ns": 7, "until ns": 30, "least t": 4}),
        pl.DataFrame({"key": "b", "sum n": 3, "greatest ns": 7, "until ns": 31, "least t": 1}),
    ]
    assert added(one.cast({"least t": pl.Int64}) for one in parts).to_dicts() == [
        {"key": "a", "sum n": 3, "greatest ns": 7, "until ns": 30, "least t": 4},
        {"key": "b", "sum n": 3, "greatest ns": 7, "until ns": 31, "least t": 1},
    ]
