"""The rows of a screen: what a store and its matches hold, however the rows came."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.store import Matches, RowStore
from fte_sniff.protocol.rows import FACTS, Item, Row
from tests.analysis.captures import MS, captures, frame, items_of, polled, table_of
from tests.support.columns import rows_from

BLOCK = 8


def stored(steps: list[Row | Item], memory_rows: int = 2 * BLOCK) -> RowStore:
    """A store of small blocks, of which the later ones are in a file; steps come one by one."""
    store = RowStore(BLOCK, memory_rows)
    for step in steps:
        for item in items_of([step]):
            store.append(item)
    store.end()
    return store


@given(captures(), st.integers(0, 40), st.integers(0, 40))
def test_store_has_all_rows_with_the_facts_of_the_whole(
    steps: list[Row | Item], start: int, count: int
) -> None:
    store, table = stored(steps), table_of(steps)
    found, whole = store.batch(0, store.next), table.with_facts
    assert [*found] == [*whole]
    assert store.known == store.next == len(whole)
    for name in FACTS:
        assert found.columns[name].tolist() == whole.columns[name].tolist()
    assert [*store.batch(start, start + count)] == [*whole[start : start + count]]
    at = np.arange(len(whole))[start::3]
    assert [*store.rows_at(at)] == [*whole.select(at)]


@given(captures(), st.integers(0, 40), st.integers(0, 40))
def test_runs_of_a_span_are_those_of_the_whole(
    steps: list[Row | Item], start: int, count: int
) -> None:
    store, runs = stored(steps), table_of(steps).runs
    found, own = store.runs(start, start + count), slice(start, start + count)
    for name in ("feedback_seen", "lost", "hidden"):
        assert found[name].tolist() == runs[name][own].tolist()
    assert (np.diff(found["number"]) > 0).tolist() == (np.diff(runs["number"][own]) > 0).tolist()


@given(captures(), st.integers(1, 9))
def test_matches_are_the_rows_that_pass_in_any_steps(steps: list[Row | Item], most: int) -> None:
    store = RowStore(BLOCK)
    found = Matches(store, RowFilter.parse("motor_hint > 0"))
    every = Matches(store, RowFilter.parse("TRUE"))
    for item in items_of(steps):
        store.append(item)
        found.extend(most)
    store.end()
    while found.extend(most) or every.extend(most):
        pass
    every.extend()
    hints = table_of(steps).with_facts.motor_hint
    assert found.indices.tolist() == np.flatnonzero(hints > 0).tolist()
    assert every.indices.tolist() == [*range(store.next)]
    assert [found.position_of(index) for index in found.indices] == [*range(found.count)]


def test_row_that_needs_no_facts_is_shown_at_once() -> None:
    store = RowStore()
    store.append(rows_from([frame("speed", 0)]))
    shown, waiting = (Matches(store, RowFilter.parse(text)) for text in ("speed", "NOT unanswered"))
    shown.extend()
    waiting.extend()
    assert (shown.count, waiting.count) == (1, 0)


@pytest.mark.parametrize(("t_ms", "index"), [(-1, 0), (0, 0), (0.5, 1), (449, 36), (1e6, 80)])
def test_index_of_a_time(t_ms: float, index: int) -> None:
    store = stored([*polled(10)])
    first = store.batch(0, 1).t_ns[0]
    rising = np.sort(store.batch(0, 80).t_ns)
    assert store.index_at(int(first + t_ms * MS)) == np.searchsorted(rising, first + t_ms * MS)
