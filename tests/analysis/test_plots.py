"""The data of the plots: every row is in its series, and thinning loses no spike."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.model import StreamChange
from fte_sniff.analysis.plots import ALL_MOTORS, Points, Timeline, limits, medians, points_of_median
from fte_sniff.protocol import KIND_BY_NAME, KINDS, MOTORS, Direction, Gap, GapKind, Row, encode
from fte_sniff.protocol.rows import Rows
from tests.analysis import conftest
from tests.analysis.pieces import PORTS

VALUES = st.integers(-(2**31), 2**31 - 1)
POINTS = st.lists(st.tuples(st.integers(0, 10**6), VALUES), min_size=1, max_size=80)


def filled(points: list[tuple[int, int]]) -> Points:
    series = Points()
    for t_ns, value in points:
        series.append(np.array([t_ns]), np.array([value]))
    return series


def pairs(series: Points) -> list[tuple[int, int]]:
    t_ns, values = series.points()
    return list(zip(t_ns.tolist(), values.tolist(), strict=True))


@given(POINTS)
def test_points_come_in_order_of_time(points: list[tuple[int, int]]) -> None:
    assert pairs(filled(points)) == sorted(points, key=lambda point: point[0])


@given(POINTS, st.integers(1, 12), st.data())
def test_thinning_keeps_minimum_and_maximum_of_every_bin(
    points: list[tuple[int, int]], bins: int, data: st.DataObject
) -> None:
    series = filled(points)
    before = pairs(series)
    series.thin(bins)
    kept = pairs(series)
    assert set(kept) <= set(before)
    assert len(kept) <= max(4 * bins, len(before) if len(before) <= 4 * bins else 0)
    assert (kept[0], kept[-1]) == (before[0], before[-1])
    width = (before[-1][0] - before[0][0]) // bins + 1
    start = before[0][0] + width * data.draw(st.integers(0, bins - 1))
    inside = [value for t_ns, value in before if start <= t_ns < start + width]
    left = [value for t_ns, value in kept if start <= t_ns < start + width]
    if inside:
        assert (min(left), max(left)) == (min(inside), max(inside))


def expected(rows: list[Row], kind: str, motor: int, name: str) -> list[tuple[int, int]]:
    return sorted(
        (
            (row.t_ns, row.values[name] if name else 0)
            for row in rows
            if row.framed and row.t_ns is not None
            if row.kind is not None and row.kind.name == kind
            if motor in (ALL_MOTORS, row.values.get("motor"))
        ),
        key=lambda point: point[0],
    )


@given(st.lists(conftest.FRAMES, max_size=40), st.integers(1, 10))
def test_every_row_with_a_time_is_in_its_series(rows: list[Row], size: int) -> None:
    timeline = Timeline()
    for start in range(0, len(rows), size):
        timeline.observe(Rows.of(rows[start : start + size]))
    for trace, series in timeline.traces.items():
        assert pairs(series) == expected(rows, trace.kind.name, trace.motor, trace.field)
    known = {
        (row.kind.name, row.values.get("motor", ALL_MOTORS))
        for row in rows
        if row.framed and row.t_ns is not None and row.kind is not None
        if not row.kind.names_motor or row.values["motor"] in MOTORS
    }
    assert {(trace.kind.name, trace.motor) for trace in timeline.traces} == known
    faulty = [row for row in rows if row.t_ns is not None and row.faults]
    for fault, series in timeline.faults.items():
        t_ns, numbers = series.points()
        having = sorted(row.t_ns for row in faulty if fault in row.faults)
        assert t_ns.tolist() == having
        for time, number in zip(t_ns.tolist(), numbers.tolist(), strict=True):
            assert (timeline.damaged[number].t_ns, fault in timeline.damaged[number].faults) == (
                time,
                True,
            )
    assert sum(len(row.faults) for row in faulty) == sum(
        len(series.points()[0]) for series in timeline.faults.values()
    )


def test_kinds_have_the_fields_of_the_frame_table() -> None:
    frames = [
        Row(PORTS[0], 0, bytes([kind.header, kind.cmds[0], 1, *bytes(6), 0xEE]), 7, (), delay_ns=0)
        for kind in KINDS
    ]
    timeline = Timeline()
    timeline.observe(Rows.of(frames))
    for kind in KINDS:
        fields = {trace.field for trace in timeline.traces if trace.kind is kind}
        if kind.names_motor:
            assert fields == {kind.subject}
        else:
            assert fields == ({one.name for one in kind.fields if one.unit} or {""})
    assert {
        trace.motor for trace in timeline.traces if trace.kind.direction is Direction.FEEDBACK
    } == {1}


def test_memory_is_bounded_and_the_spike_stays() -> None:
    timeline = Timeline(most_points=30_000)
    frame = bytes([0x55, 0x01, 0x01, 0x00, 0x64, 0, 0, 0x00, 0x0F, 0xEE])
    spike = bytes([0x55, 0x01, 0x01, 0x0B, 0xB8, 0, 0, 0x00, 0x0F, 0xEE])
    for start in range(0, 100_000, 10_000):
        rows = [
            Row("a", 10 * at, spike if at == 54_321 else frame, at * 1000, (), delay_ns=0)
            for at in range(start, start + 10_000)
        ]
        timeline.observe(Rows.of(rows))
    (series,) = timeline.traces.values()
    found = pairs(series)
    assert timeline.thinned
    assert len(found) <= 50_000
    assert (54_321_000, 3000) in found
    assert (found[0], found[-1]) == ((0, 100), (99_999_000, 100))


def test_all_points_are_kept_up_to_the_limit() -> None:
    timeline = Timeline(most_points=60)
    for at in range(61):
        assert not timeline.thinned
        raw = encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": at})
        timeline.observe(Rows.of([Row("a", 10 * at, raw, at * 1000, (), delay_ns=0)]))
    assert timeline.thinned


@given(st.lists(st.booleans(), min_size=2, max_size=30), st.integers(1, 7))
def test_a_break_is_at_the_last_row_before_each_gap(gaps: list[bool], size: int) -> None:
    rows = [
        Row("a", 10 * number, encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 5}), 1000 + number)
        for number in range(len(gaps))
    ]
    timeline, gap = Timeline(), Gap(GapKind.PORT)
    for start in range(0, len(rows), size):
        part = gaps[start : start + size]
        changes = [StreamChange(at, gap) for at, ends in enumerate(part) if ends]
        timeline.observe(Rows.of(rows[start : start + size]), changes)
    assert timeline.breaks == [999 + at for at, ends in enumerate(gaps) if ends and at]


def test_a_long_capture_with_many_flipped_bits_keeps_its_usual_range() -> None:
    """In 40,000 reports of which 5 % are wrong, some wrong ones are neighbours."""
    values = 1000 * np.sin(np.arange(40_000) / 300)
    wrong = np.random.default_rng(1).random(len(values)) < 0.05
    values[wrong] += 16_384
    low, high = limits(medians(values, points_of_median(len(values))))
    assert -2100 < low < -1000
    assert 1000 < high < 2100
    assert limits(medians(values))[1] > 10_000
