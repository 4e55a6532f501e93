"""Gaps and baud changes between rows, the same in batches of any size; counts and rates of rows."""

from __future__ import annotations

from collections import Counter, OrderedDict, defaultdict, deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.model import (
    GapDetector,
    Model,
    Rate,
    RowCount,
    StreamChange,
    Tally,
    shifted,
)
from fte_sniff.protocol import Fault, Gap, GapKind, PortEvent, PortEventKind, Row, Status
from fte_sniff.protocol.items import BaudChange
from fte_sniff.protocol.rows import Rows

RAW = bytes.fromhex("AA00000000000000 00EE".replace(" ", ""))
TIMES = st.lists(st.integers(0, 50), max_size=30).map(sorted)
SECOND = 1_000_000_000
GAPS = st.lists(st.tuples(st.integers(0, 50), st.integers(0, 9)), max_size=4)


def rows_at(times: list[int]) -> list[Row]:
    return [Row("p", 10 * at, RAW, t_ns) for at, t_ns in enumerate(times)]


@given(TIMES, GAPS, st.integers(0, 30))
def test_a_gap_separates_the_rows_before_it_from_those_after(
    times: list[int], gaps: list[tuple[int, int]], cut: int
) -> None:
    detector = GapDetector()
    reported = [Gap(GapKind.LEFT_OUT, 1, first, first + length) for first, length in gaps]
    assert detector.begin({}, reported) == []
    rows = rows_at(times)
    found: list[StreamChange] = list(detector.changes(Rows.of(rows[:cut])))
    found += shifted(detector.changes(Rows.of(rows[cut:])), len(rows[:cut]))
    places = {change.index for change in found}
    for first, length in gaps:
        behind = [at for at, t_ns in enumerate(times) if t_ns > first + length]
        before = [at for at, t_ns in enumerate(times) if t_ns < first]
        if before and behind:
            assert any(before[-1] < place <= behind[0] for place in places)
    for place in places:
        ends = [t_ns for first, length in gaps for t_ns in (first, first + length + 1)]
        assert any(
            (place == 0 or times[place - 1] < t_ns) and t_ns <= times[place] for t_ns in ends
        )


def test_events_stand_before_the_first_row_at_their_time() -> None:
    detector = GapDetector()
    assert detector.begin({"p": 9600}) == [StreamChange(0, BaudChange("p", 9600))]
    assert detector.begin({"p": 9600}) == []
    events = [
        PortEvent(5, "q", PortEventKind.OPENED, ""),
        PortEvent(20, "p", PortEventKind.LOST, "gone"),
        PortEvent(25, "p", PortEventKind.BAUD_CHANGED, "", 1200),
        PortEvent(25, "q", PortEventKind.BAUD_CHANGED, "", 1200),
        PortEvent(90, "p", PortEventKind.OVERRUN, "", 7),
    ]
    assert detector.changes(Rows.of(rows_at([10, 20, 30]), events=events)) == [
        StreamChange(1, Gap(GapKind.PORT, None, 20, 20, "gone", "p", port_lost=True)),
        StreamChange(2, BaudChange("p", 1200)),
        StreamChange(3, Gap(GapKind.PORT, None, 90, 90, "", "p", port_lost=True)),
    ]
    found = [PortEvent(95, name, PortEventKind.FOUND_AGAIN, "") for name in "qp"]
    assert [
        change.what.port_lost
        for change in detector.changes(Rows.of(rows_at([99]), events=found))
        if isinstance(change.what, Gap)
    ] == [True, False]
    assert (detector.lost, detector.found) == (set(), {"q"})


def test_rows_that_a_slow_view_missed_are_a_gap_before_the_next_batch() -> None:
    detector = GapDetector()
    assert detector.changes(Rows.of(rows_at([1, 2]))) == []
    assert detector.changes(Rows.of(rows_at([8, 9])), not_shown=5) == [
        StreamChange(0, Gap(GapKind.NOT_SHOWN, 5))
    ]
    assert detector.changes(Rows.of(rows_at([10])), not_shown=5) == []


def test_an_interruption_is_a_gap_once_the_rows_on_both_sides_have_times() -> None:
    detector = GapDetector()
    detector.interrupt(GapKind.DAMAGE)
    assert detector.observe((5, 20)) is None
    assert detector.observe((10, 10)) is None
    change = detector.interrupt(GapKind.DAMAGE, "why")
    assert change == StreamChange(0, Gap(GapKind.DAMAGE, reason="why"))
    assert detector.observe(None) is None
    assert detector.observe((30, 40)) == Gap(GapKind.DAMAGE, None, 21, 29, "why")
    assert detector.observe((50, 60)) is None
    detector.interrupt(GapKind.DAMAGE)
    assert detector.observe((61, 61)) is None


def test_a_clipped_gap_has_an_unknown_number_of_rows() -> None:
    gap = Gap(GapKind.LEFT_OUT, 7, 10, 20, "why")
    assert gap.within(None, 20) is gap
    assert gap.within(11, None) == gap._replace(rows=None, start_ns=11)
    assert gap.within(5, 10) == gap._replace(rows=None, end_ns=10)
    assert gap.within(21, None) is None


ROWS = st.lists(st.from_type(Row), max_size=12)


def count_by_hand(rows: list[Row]) -> RowCount:
    times = [row.t_ns for row in rows if row.t_ns is not None]
    size = sum(len(row.raw) for row in rows)
    return RowCount(len(rows), size, min(times, default=None), max(times, default=None))


@given(rows=ROWS, cut=st.integers(0, 12))
def test_a_tally_equals_a_count_by_hand(rows: list[Row], cut: int) -> None:
    tally, later = Tally(), Tally()
    tally.observe(Rows.of(rows[:cut]))
    later.observe(Rows.of(rows[cut:]).select(slice(None)))
    tally.merge(later)
    assert type(tally.bytes) is int  # which JSON can hold
    assert vars(count_by_hand(rows)).items() <= vars(tally).items()
    assert tally.frames == sum(row.framed for row in rows)
    assert tally.malformed == sum(row.status is Status.MALFORMED for row in rows)
    assert tally.ports == tuple(dict.fromkeys(row.port for row in rows))
    for port in (None, *tally.ports):
        own = [row for row in rows if port in (None, row.port)]
        assert tally.by_status(port) == {
            status: count_by_hand([row for row in own if row.status is status]) for status in Status
        }
        assert tally.by_fault(port) == {
            fault: count_by_hand(having)
            for fault in Fault
            if (having := [row for row in own if fault in row.faults])
        }


def test_the_malformed_share_is_of_all_rows() -> None:
    tally = Tally()
    assert tally.malformed_share == 0
    noise = Row("port", 0, b"\0", None, (Fault.NOISE,), framed=False)
    suspect = Row("port", 1, bytes.fromhex("AA000000000000000001EE")[:10], None)
    tally.observe(Rows.of([noise, suspect, suspect, suspect]))
    assert tally.malformed_share == 0.25


@pytest.mark.parametrize(
    ("fed", "now", "rate"),
    [
        ([], 5.0, 0.0),
        ([(10, 0.0)], 0.0, 0.0),
        ([(0, 0.0), (10, 1.0)], 1.0, 10.0),
        ([(0, 0.0), (10, 1.0), (10, 2.0)], 2.0, 10.0),
        ([(0, 0.0), (50, 1.0), (10, 2.0), (20, 3.0)], 3.0, 15.0),
        ([(0, 0.0), (10, 1.0)], 2.5, 5.0),
        ([(0, 0.0), (10, 1.0)], 3.0, 0.0),
        ([(0, 0.0), (10, 1.0)], 9.0, 0.0),
    ],
)
def test_a_rate_looks_back_two_seconds(
    fed: list[tuple[int, float]], now: float, rate: float
) -> None:
    meter = Rate(2 * SECOND)
    for count, at in fed:
        meter.observe(count, int(at * SECOND))
    assert meter.per_second(int(now * SECOND)) == pytest.approx(rate)


@dataclass
class State(Model):
    value: Any


@pytest.mark.parametrize(
    ("value", "change"),
    [
        ({1: [2]}, lambda value: value[1].append(3)),
        (Counter("aab"), lambda value: value.update("ab")),
        (defaultdict(list, {1: [2]}), lambda value: value[3].append(4)),
        (OrderedDict({1: {2: 3}}), lambda value: value[1].update({2: 4})),
        ([{1}, {2}], lambda value: value[0].add(3)),
        (deque([[1], [2]], 2), lambda value: value.append([3])),
        (deque([[1], [2]], 2), lambda value: value[0].append(3)),
        ({1, 2}, lambda value: value.add(3)),
        (State([1]), lambda value: value.value.append(2)),
        (np.arange(3), lambda value: value.fill(7)),
        ({1: np.arange(3)}, lambda value: value[1].fill(7)),
    ],
)
def test_copy_is_independent_and_has_the_same_types(
    value: Any, change: Callable[[Any], object]
) -> None:
    before, changed = repr(value), State(value).copy().value
    assert repr(changed) == before
    change(changed)
    assert repr(value) == before
    change(value)
    assert repr(value) == repr(changed) != before
