"""The store of rows, its filtered view, landmarks and overview."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from fte_sniff.analysis.facts import Facts
from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.model import StreamChange
from fte_sniff.analysis.row_store import Overview, RowNote, RowStore
from fte_sniff.analysis.search import (
    Bools,
    MatchCounter,
    find_byte,
    find_fault,
    find_step,
    select_rows,
)
from fte_sniff.protocol import (
    KIND_BY_NAME,
    Fault,
    Gap,
    GapKind,
    PortEvent,
    PortEventKind,
    Row,
    encode,
)
from fte_sniff.protocol.rows import Rows
from tests.examples import examples

ROW = st.from_type(Row)
FILTERS = [
    RowFilter.parse(text)
    for text in ("malformed", "TRUE", "FALSE", "length > 10", "raw LIKE '%_0'")
]


class Again:
    """Gives again what was appended."""

    def __init__(self, rows: list[Row]) -> None:
        self.rows = rows
        self.loads = 0

    def load(self, start: int, count: int) -> Rows:
        self.loads += 1
        return Rows.of(self.rows[start : start + count])


class StoreMachine(RuleBasedStateMachine):
    """A store against a plain list of all rows ever appended."""

    @initialize(
        bound=st.integers(1, 12), block_rows=st.integers(1, 5), most=st.none() | st.integers(1, 3)
    )
    def begin(self, bound: int, block_rows: int, most: int | None) -> None:
        self.bound = bound
        self.all: list[Row] = []
        source = None if most is None else Again(self.all)
        self.store = RowStore(bound, block_rows, source, most or 1)
        self.filter: RowFilter | None = None

    @rule(rows=st.lists(ROW, max_size=20))
    def append(self, rows: list[Row]) -> None:
        self.all += rows
        self.store.append(Rows.of(rows))

    @rule(row_filter=st.none() | st.sampled_from(FILTERS), near=st.none() | st.integers(-3, 40))
    def set_filter(self, row_filter: RowFilter | None, near: int | None) -> None:
        self.store.view.set_filter(row_filter, near)
        self.filter = row_filter

    @rule(budget=st.integers(1, 6))
    def step(self, budget: int) -> None:
        before = self.store.view.pending
        done = self.store.view.filter_step(budget)
        assert done == (self.store.view.pending == 0)
        assert before - self.store.view.pending >= min(budget, before)

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
            if self.filter is None or self.filter.select(Rows.of([self.all[index]]))
        ]
        shown = [store.view.index(position) for position in range(store.view.count)]
        if store.view.pending:
            assert shown == [index for index in wanted if index in set(shown)]
        else:
            assert shown == wanted

    @invariant()
    def positions_and_indices_agree(self) -> None:
        store = self.store
        shown = store.view.slice(-3, store.view.count + 3)
        assert [index for index, _ in shown] == [
            store.view.index(position) for position in range(store.view.count)
        ]
        assert [row for _, row in shown] == [self.all[index] for index, _ in shown]
        faulty = [index for index, row in shown if row.faults]
        for index in range(store.first - 2, store.next + 3):
            assert store.view.position_of(index) == sum(other < index for other, _ in shown)
            behind = [other for other in faulty if other > index]
            before = [other for other in faulty if other < index]
            assert find_fault(store, index, 1) == (behind[0] if behind else None)
            assert find_fault(store, index, -1) == (before[-1] if before else None)
            assert store.view.has(index) == any(other == index for other, _ in shown)

    @invariant()
    def what_passes_a_test_is_found_block_by_block(self) -> None:
        store = self.store
        shown = store.view.slice(0, store.view.count)
        for index in range(store.first - 2, store.next + 3):
            behind = [other for other, row in shown if other >= index and len(row.raw) > 10]
            before = [other for other, row in shown if other <= index and len(row.raw) > 10]
            assert _walked(store, index, 1) == (behind[0] if behind else None)
            assert _walked(store, index, -1) == (before[-1] if before else None)
        for _, row in shown[:3]:
            holding = [
                index
                for index, other in shown
                if other.port == row.port
                and other.offset <= row.offset < other.offset + len(other.raw)
            ]
            found = find_byte(store, row.port, row.offset)
            assert found == (holding[0] if holding else None)

    @invariant()
    def any_filter_selects_from_what_is_kept(self) -> None:
        store = self.store
        for row_filter in (None, FILTERS[3]):
            found: list[Row] = []
            at = store.first - 1
            while at < store.next:
                rows, onward = select_rows(store, at, store.next, row_filter)
                assert onward > at
                found, at = [*found, *rows], onward
            kept = self.all[store.first :]
            batch = Rows.of(kept)
            assert found == list(batch if row_filter is None else row_filter.select(batch))


def _walked(store: RowStore, index: int, by: int) -> int | None:
    """The nearest row that is longer than ten bytes, found by the bytes kept aside."""

    def is_long(rows: Rows) -> Bools:
        return np.array([at in rows.long for at in range(len(rows))], np.bool_)

    step = find_step(store, is_long, index, by)
    while step.next_index is not None:
        step = find_step(store, is_long, step.next_index, by)
    return step.found


StoreMachine.TestCase.settings = examples(30, stateful_step_count=15)
test_a_store_is_a_bounded_list_with_a_filter = StoreMachine.TestCase


def test_a_new_filter_starts_near_the_given_row() -> None:
    store = RowStore(1_000, block_rows=10)
    store.append(
        Rows.of([Row("port", at, b"\0", None, (Fault.NOISE,), framed=False) for at in range(100)])
    )
    store.view.set_filter(RowFilter.parse("noise"), near=42)
    assert not store.view.filter_step(1)
    assert [index for index, _ in store.view.slice(0, 100)] == list(range(40, 50))


def test_dropped_blocks_are_loaded_again_when_needed() -> None:
    rows: list[Row] = [
        Row("port", at, bytes(1 + at % 20), None, (Fault.NOISE,), framed=False)
        for at in range(1000)
    ]
    source = Again(rows)
    store = RowStore(1000, 10, source, most_blocks=3)
    store.append(Rows.of(rows))
    assert source.loads == 0
    assert store.rows(970, 1000) == rows[970:]
    assert source.loads == 0
    assert store.rows(0, 20) == rows[:20]
    assert source.loads == 2
    assert store.rows(0, 20) == rows[:20]
    assert source.loads == 2
    store.view.set_filter(RowFilter.parse("length = 7"))
    while not store.view.filter_step(100):
        pass
    loads = source.loads
    assert store.view.count == 50
    assert store.view.position_of(500) == 25
    assert source.loads == loads
    assert [row for _, row in store.view.slice(24, 26)] == [rows[486], rows[506]]
    assert source.loads > loads


def test_a_source_that_loads_other_rows_is_refused() -> None:
    rows: list[Row] = [
        Row("port", at, b"\0", None, (Fault.NOISE,), framed=False) for at in range(100)
    ]
    source = Again(rows)
    store = RowStore(1000, 10, source, most_blocks=1)
    store.append(Rows.of(rows))
    source.rows = rows[:5]
    with pytest.raises(ValueError, match="5 rows came back of 10"):
        store.rows(0, 10)


@pytest.mark.parametrize("position", [-1, 3])
def test_a_position_that_does_not_exist_is_an_error(position: int) -> None:
    store = RowStore()
    store.append(
        Rows.of([Row("port", at, b"\0", None, (Fault.NOISE,), framed=False) for at in range(3)])
    )
    with pytest.raises(IndexError):
        store.view.row(position)
    with pytest.raises(IndexError):
        store.row(position)


@pytest.mark.parametrize(("bound", "block_rows"), [(0, 10), (10, 0), (10, 2**16 + 1)])
def test_sizes_out_of_range_are_refused(bound: int, block_rows: int) -> None:
    with pytest.raises(ValueError, match="cannot be"):
        RowStore(bound, block_rows)


@given(st.integers(0, 60), st.integers(0, 60), st.booleans())
def test_a_limit_hides_rows_as_if_they_had_not_come(count: int, limit: int, filtered: bool) -> None:
    raws = [encode(KIND_BY_NAME["speed"], {"motor": motor, "rpm": 7}) for motor in (1, 2)]
    rows = [Row("p", 10 * number, raws[number % 3 // 2], number) for number in range(count)]
    whole, short = RowStore(block_rows=7), RowStore(block_rows=7)
    whole.append(Rows.of(rows))
    whole.limit = limit
    short.append(Rows.of(rows[:limit]))
    for store in (whole, short):
        store.view.set_filter(RowFilter.parse("motor = 2") if filtered else None)
        store.view.filter_step()
    assert len(whole) == len(short)
    assert whole.view.count == short.view.count
    assert whole.view.slice(0, count) == short.view.slice(0, count)
    assert [whole.view.position_of(index) for index in range(count)] == [
        short.view.position_of(index) for index in range(count)
    ]
    counter = MatchCounter(whole, lambda rows: rows.length > 0)
    while counter.step():
        pass
    assert counter.position(-1).total == min(count, limit)
    whole.limit = None
    assert len(whole) == count


def facts_in_store(rows: Rows, cut: int, **options: Any) -> tuple[RowStore, Rows]:
    """A store of the rows, with the facts of those before a cut; and the rows with all facts."""
    facts = Facts()
    known = Rows.concat([facts.feed(rows), facts.interrupt()])
    store = RowStore(**options)
    store.view.set_filter(RowFilter.parse("unanswered"))
    for start in range(0, len(rows), 7):
        store.append(rows[start : start + 7])
    store.fill(known[:cut])
    return store, known


def commands_without_answer() -> Rows:
    """Feedback, after which a command is known to be unanswered, and commands to two motors."""
    raws = [bytes.fromhex(f"AA010{1 + n % 2}000000000000EE") for n in range(1, 40)]
    raws.insert(0, bytes.fromhex("550101000000000000EE"))
    return Rows.of(Row("p", 10 * n, raw, n * 10**6) for n, raw in enumerate(raws))


@pytest.mark.parametrize("cut", [0, 1, 17, 40])
def test_a_filter_of_facts_shows_rows_once_their_facts_are_known(cut: int) -> None:
    store, known = facts_in_store(commands_without_answer(), cut, block_rows=8)
    assert store.view.count == int((known[:cut].unanswered > 0).sum())
    assert store.known == cut
    store.fill(known[cut:])
    assert store.view.count == int((known.unanswered > 0).sum())
    assert [row.unanswered for row in store.rows(0, 40)] == [row.unanswered for row in known]


def test_facts_stay_with_rows_that_leave_memory_and_come_back() -> None:
    rows = commands_without_answer()
    store, known = facts_in_store(rows, 40, block_rows=8, source=Again([*rows]), most_blocks=1)
    assert [row.unanswered for row in store.rows(0, 40)] == [row.unanswered for row in known]
    assert store.view.count == 37


SOUND = encode(KIND_BY_NAME["speed_feedback"], {"motor": 1, "rpm": 5})
COMMAND = encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 5})
RAISED = encode(KIND_BY_NAME["speed_feedback"], {"motor": 2, "rpm": 5, "error": 4})
EXAMPLES: dict[RowNote, Row] = {
    RowNote.NONE: Row("p", 0, SOUND, 0),
    RowNote.RAISED: Row("p", 0, RAISED, 0),
    RowNote.UNANSWERED: Row("p", 0, COMMAND, 0, unanswered=True),
    RowNote.SUSPECT: Row("p", 0, SOUND, 0, (Fault.AMBIGUOUS,)),
    RowNote.MALFORMED: Row("p", 0, b"\x01", 0, (Fault.NOISE,), framed=False),
}
FILLED = 17
"""Rows whose facts become known at once."""

NOTE_LISTS = st.lists(st.sampled_from(RowNote), max_size=120)


@given(NOTE_LISTS, st.integers(1, 40), st.integers(1, 30), st.booleans())
def test_cells_show_the_worst_rows_of_their_share(
    notes: list[RowNote], bound: int, cells: int, filtered: bool
) -> None:
    store = RowStore(bound=bound, block_rows=7)
    if filtered:
        store.view.set_filter(RowFilter.parse("motor = 1"))
    overview = Overview(store)
    for note in notes:
        row = Rows.of([EXAMPLES[note]])
        store.append(row)
        store.fill(row)
    shown = notes[-bound:]
    if filtered:
        shown = [note for note in shown if note not in (RowNote.RAISED, RowNote.MALFORMED)]
    per_cell = -(-len(shown) // cells) if shown else 1
    shares = [shown[at : at + per_cell] for at in range(0, len(shown), per_cell)]
    # A share of less than eight rows is counted exactly.
    found = overview.cells(cells)
    assert [cell.worst for cell in found] == [max(share) for share in shares]
    for start, share in zip(range(0, len(shown), per_cell), shares, strict=True):
        worst = max(share)
        expected = start + share.index(worst) if worst else None
        assert overview.worst_between(start, start + per_cell) == expected


@given(
    NOTE_LISTS,
    st.lists(st.none() | st.integers(0, 120), min_size=1, max_size=8),
    st.integers(1, 60),
    st.booleans(),
)
def test_cells_are_those_of_the_rows_that_are_played_and_whose_facts_are_known(
    notes: list[RowNote], limits: list[int | None], cells: int, filtered: bool
) -> None:
    store = RowStore(block_rows=64)
    if filtered:
        store.view.set_filter(RowFilter.parse("motor = 1"))
    rows = Rows.of([EXAMPLES[note] for note in notes])
    store.append(rows)
    overview = Overview(store)
    for limit in (None, *limits):
        assert overview.cells(cells) == Overview(store).cells(cells)
        store.limit = limit
        store.fill(rows[store.known : store.known + FILLED])
        assert overview.cells(cells) == Overview(store).cells(cells)


def store_of(count: int) -> RowStore:
    store = RowStore()
    store.append(Rows.of([Row("p", 10 * n, SOUND, 1000 * n) for n in range(count)]))
    return store


@pytest.mark.parametrize("limit", [None, 2])
def test_an_event_is_before_the_first_row_that_is_later(limit: int | None) -> None:
    """Also where playback hides that row: the file may still be read."""
    store = store_of(10)
    store.limit = limit
    landmarks = store.landmarks
    lost = PortEvent(4500, "p", PortEventKind.LOST, "pulled out")
    opened = PortEvent(-5, "p", PortEventKind.OPENED, "")
    last = PortEvent(99_000, "p", PortEventKind.FOUND_AGAIN, "")
    error = PortEvent(5000, "p", PortEventKind.LINE_ERROR, "", 3)
    landmarks.add([lost, opened, last, error], [])
    assert [(one.index, one.what) for one in landmarks.between(0, 11)] == [
        (0, opened),
        (5, lost),
        (10, last),
    ]
    assert [one.what for one in landmarks.beyond(0, 1)] == [lost, last]
    assert [one.what for one in landmarks.beyond(9, -1)] == [lost]


def test_a_gap_is_a_landmark_unless_an_event_reports_it_or_nothing_is_before_it() -> None:
    landmarks = store_of(10).landmarks
    gap = Gap(GapKind.NOT_SHOWN, 7)
    changes = [
        StreamChange(0, Gap(GapKind.OTHER_RECORDING)),
        StreamChange(3, gap),
        StreamChange(6, Gap(GapKind.PORT, port="p")),
    ]
    landmarks.add([], changes)
    assert [one.what for one in landmarks.between(0, 11)] == [gap]
    assert landmarks.gaps == [3, 6]


def test_landmarks_leave_with_their_rows() -> None:
    store = RowStore(bound=5, block_rows=2)
    landmarks = store.landmarks
    store.append(Rows.of([Row("p", 0, SOUND, 0)] * 4))
    landmarks.add([], [StreamChange(2, Gap(GapKind.DAMAGE))])
    store.append(Rows.of([Row("p", 0, SOUND, 0)] * 4))
    landmarks.add([], [StreamChange(7, Gap(GapKind.DAMAGE))])
    assert landmarks.gaps == [7]
    assert [one.index for one in landmarks.between(0, 99)] == [7]
