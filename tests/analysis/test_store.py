from __future__ import annotations

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from fte_sniff.analysis.filter import RowFilter
from fte_sniff.analysis.store import RowStore
from fte_sniff.protocol import Damage, Fault, Frame, Row

ROW = st.from_type(Frame) | st.from_type(Damage)
FILTERS = [
    RowFilter.parse(text) for text in ("malformed", "TRUE", "FALSE", "length > 10", "raw LIKE '%0'")
]


class StoreMachine(RuleBasedStateMachine):
    """A store against a plain list of all rows ever appended."""

    @initialize(bound=st.integers(1, 12), block_rows=st.integers(1, 5))
    def begin(self, bound: int, block_rows: int) -> None:
        self.bound = bound
        self.store = RowStore(bound, block_rows)
        self.all: list[Row] = []
        self.filter: RowFilter | None = None

    @rule(rows=st.lists(ROW, max_size=20))
    def append(self, rows: list[Row]) -> None:
        self.store.append(rows)
        self.all += rows

    @rule(row_filter=st.none() | st.sampled_from(FILTERS), near=st.none() | st.integers(-3, 40))
    def set_filter(self, row_filter: RowFilter | None, near: int | None) -> None:
        self.store.set_filter(row_filter, near)
        self.filter = row_filter

    @rule(budget=st.integers(1, 6))
    def step(self, budget: int) -> None:
        before = self.store.pending
        done = self.store.filter_step(budget)
        assert done == (self.store.pending == 0)
        assert before - self.store.pending >= min(budget, before)

    @invariant()
    def the_latest_rows_are_kept_as_they_came(self) -> None:
        store = self.store
        assert store.next == len(self.all)
        assert len(store) == min(len(self.all), self.bound)
        assert store.first == store.next - len(store)
        kept = store.rows(-5, store.next + 5)
        assert kept == self.all[store.first :]
        assert [store.row(index) for index in range(store.first, store.next)] == kept

    @invariant()
    def the_filter_shows_what_it_wants(self) -> None:
        store = self.store
        wanted = [
            index
            for index in range(store.first, store.next)
            if self.filter is None or self.filter.select([self.all[index]])
        ]
        shown = [store.shown_index(position) for position in range(store.shown_count)]
        if store.pending:
            assert shown == [index for index in wanted if index in set(shown)]
        else:
            assert shown == wanted

    @invariant()
    def positions_and_indices_agree(self) -> None:
        store = self.store
        shown = store.shown_slice(-3, store.shown_count + 3)
        assert [index for index, _ in shown] == [
            store.shown_index(position) for position in range(store.shown_count)
        ]
        assert [row for _, row in shown] == [self.all[index] for index, _ in shown]
        faulty = [index for index, row in shown if row.faults]
        for index in range(store.first - 2, store.next + 3):
            assert store.position_of(index) == sum(other < index for other, _ in shown)
            behind = [other for other in faulty if other > index]
            before = [other for other in faulty if other < index]
            assert store.fault_index(index, 1) == (behind[0] if behind else None)
            assert store.fault_index(index, -1) == (before[-1] if before else None)


StoreMachine.TestCase.settings = settings(max_examples=60, stateful_step_count=15, deadline=None)
test_a_store_is_a_bounded_list_with_a_filter = StoreMachine.TestCase


def test_a_new_filter_begins_where_one_looks() -> None:
    store = RowStore(1_000, block_rows=10)
    store.append([Damage("port", at, b"\0", None, (Fault.NOISE,)) for at in range(100)])
    store.set_filter(RowFilter.parse("noise"), near=42)
    assert not store.filter_step(1)
    assert [index for index, _ in store.shown_slice(0, 100)] == list(range(40, 50))


@pytest.mark.parametrize("position", [-1, 3])
def test_a_position_that_is_not_there_is_an_error(position: int) -> None:
    store = RowStore()
    store.append([Damage("port", at, b"\0", None, (Fault.NOISE,)) for at in range(3)])
    with pytest.raises(IndexError):
        store.shown_row(position)
    with pytest.raises(IndexError):
        store.row(position)


@pytest.mark.parametrize(("bound", "block_rows"), [(0, 10), (10, 0), (10, 2**16 + 1)])
def test_a_store_of_no_rows_cannot_be(bound: int, block_rows: int) -> None:
    with pytest.raises(ValueError, match="cannot be"):
        RowStore(bound, block_rows)
