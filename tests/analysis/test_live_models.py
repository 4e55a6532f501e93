"""Models that follow a growing store, and states and traces of the past."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.facts import Facts
from fte_sniff.analysis.live_models import LiveModels
from fte_sniff.analysis.model import BaudChange, StreamChange
from fte_sniff.analysis.motors import Motors
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.statistics import LineSetup
from fte_sniff.protocol import (
    KIND_BY_NAME,
    Direction,
    Gap,
    GapKind,
    PortEvent,
    PortEventKind,
    Row,
    encode,
)
from fte_sniff.protocol.rows import Rows

MILLISECOND = 1_000_000


def _rows(count: int) -> list[Row]:
    rows: list[Row] = []
    for number in range(count):
        kind = KIND_BY_NAME["speed" if number % 3 == 0 else "speed_feedback"]
        raw = encode(kind, {"motor": 1 + number % 4, "rpm": number})
        rows.append(Row("p", 10 * number, raw, number * MILLISECOND))
    return rows


def _motors(rows: Sequence[Row]) -> Motors:
    motors = Motors()
    motors.observe(Rows.of(rows))
    return motors


@given(
    st.integers(1, 60),
    st.integers(1, 20),
    st.integers(1, 20),
    st.integers(1, 9),
    st.lists(st.integers(0, 60), max_size=4),
)
def test_the_state_at_a_row_equals_that_after_all_rows_up_to_it(
    count: int, budget: int, every: int, block_rows: int, looks: list[int]
) -> None:
    rows = _rows(count)
    store = RowStore(1000, block_rows)
    following = LiveModels(store, LineSetup(), every)
    for start in range(0, count, 7):
        store.append(Rows.of(rows[start : start + 7]))
        following.step(budget)
    while not following.step(budget):
        pass
    for index in looks:
        motors = following.motors_at(index)
        if index >= count:
            assert motors is None
        else:
            assert motors is not None
            now = index * MILLISECOND
            assert motors.states(now) == _motors(rows[: index + 1]).states(now)


def test_rows_that_leave_before_they_are_observed_are_counted() -> None:
    store = RowStore(100, 32)
    following = LiveModels(store, LineSetup(), 32)
    store.append(Rows.of(_rows(250)))
    assert following.pending == 100
    assert following.step(1000)
    assert following.missed == 150
    assert following.motors.states(None)[0].commands + following.pending == 8
    assert following.motors_at(200) is not None


def test_rows_that_were_not_observed_have_no_state() -> None:
    store = RowStore()
    following = LiveModels(store, LineSetup())
    store.append(Rows.of(_rows(50)))
    assert not following.step(20)
    assert following.motors_at(20) is None
    assert following.motors_at(19) is following.motors


@pytest.mark.parametrize("window_ms", [10, 200, 5000])
def test_traces_of_the_past_cover_the_window(window_ms: int) -> None:
    rows = _rows(2000)
    store = RowStore(5000, 64)
    following = LiveModels(store, LineSetup(), 128)
    store.append(Rows.of(rows))
    following.step(10**6)
    index = 1000
    end = index * MILLISECOND
    window = (end - window_ms * MILLISECOND, end + 1)
    traces, _events = following.past(index, window[0])
    spans = traces.resample(2, Direction.FEEDBACK, "rpm", window, 40)
    inside = [
        row.values["rpm"]
        for row in rows[: index + 1]
        if row.framed
        and row.direction is Direction.FEEDBACK
        and row.values["motor"] == 2
        and row.t_ns is not None
        and row.t_ns >= window[0]
    ]
    assert np.nanmax(spans.high) == max(inside)
    assert np.nanmin(spans.low) <= min(inside)
    assert np.isnan(traces.resample(2, Direction.FEEDBACK, "pulses", window, 40).low).all()


@given(
    st.integers(1, 40),
    st.integers(1, 20),
    st.integers(1, 20),
    st.lists(st.integers(0, 40), max_size=4).map(sorted),
    st.lists(st.sampled_from([None, True, False]), min_size=41, max_size=41),
    st.integers(0, 39),
)
def test_no_measurement_spans_a_gap_or_a_lost_port(
    count: int, budget: int, every: int, places: list[int], lost: list[bool | None], look: int
) -> None:
    rows = _rows(count)
    store = RowStore(1000, 7)
    following = LiveModels(store, LineSetup(), every)
    for start in range(0, count, 9):
        gaps = [place for place in places if start <= place < start + 9]
        following.add(
            changes=[StreamChange(at, Gap(GapKind.PORT, port_lost=lost[at])) for at in gaps]
        )
        store.append(Rows.of(rows[start : start + 9]))
        following.step(budget)
    while not following.step(budget):
        pass
    inside = {place for place in places if 0 < place < count}
    (port,) = following.statistics.ports()
    assert port.silences.count == count - 1 - len(inside)
    if look < count:
        expected = Motors()
        for row in range(look + 1):
            if row in places:
                expected.interrupt(Gap(GapKind.PORT, port_lost=lost[row]))
            expected.observe(Rows.of(rows[row : row + 1]))
        motors = following.motors_at(look)
        assert motors is not None
        assert motors.states(rows[look].t_ns) == expected.states(rows[look].t_ns)


def test_missed_rows_are_not_silence() -> None:
    store = RowStore(10, 5)
    following = LiveModels(store, LineSetup())
    rows = _rows(100)
    store.append(Rows.of(rows[:5]))
    while not following.step(100):
        pass
    store.append(Rows.of(rows[5:]))
    while not following.step(100):
        pass
    assert following.missed == 85
    (port,) = following.statistics.ports()
    assert port.silences.count == 4 + 9


def test_utilization_uses_the_recorded_baud() -> None:
    store = RowStore(100)
    following = LiveModels(store, LineSetup())
    bauds = [(0, 9600), (3, 57_600)]
    following.add(changes=[StreamChange(at, BaudChange("p", baud)) for at, baud in bauds])
    store.append(Rows.of(_rows(3)))
    following.step(100)
    assert following.statistics.ports()[0].baud == 9600
    store.append(Rows.of(_rows(3)))
    following.step(100)
    assert following.statistics.ports()[0].baud == 57_600


def test_port_events_need_no_rows_after_them() -> None:
    store = RowStore(100)
    following = LiveModels(store, LineSetup())
    store.append(Rows.of(_rows(3)))
    following.step(100)
    following.add([PortEvent(2 * MILLISECOND, "p", PortEventKind.LOST, "")])
    assert following.copy_findings().events.lost == [("p", 2 * MILLISECOND, None)]
    assert following.step(100)
    (port,) = following.statistics.ports()
    assert [event.count for event in port.events] == [1]


def test_flags_on_both_sides_of_missed_rows_are_not_in_a_row() -> None:
    store, facts = RowStore(5, 5), Facts()
    following = LiveModels(store, LineSetup())
    raised = [True, True, *[False] * 5, True, *[False] * 4]
    kind = KIND_BY_NAME["speed_feedback"]
    rows = Rows.of(
        Row("p", 10 * at, encode(kind, {"motor": 1, "rpm": 0, "error": one}), at * MILLISECOND)
        for at, one in enumerate(raised)
    )
    for part in (rows[:2], rows[2:]):
        store.append(part)
        store.fill(facts.feed(part))
        assert following.step(100)
    assert following.missed == 5
    assert following.copy_findings().events.windows.count("raised 1").sum() == 0
