"""Durations, recent values, rates, and series over time."""

from __future__ import annotations

import math
import pickle
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.counters import PER_OCTAVE, Durations, Keep, RecentValues, Series
from tests.analysis.pieces import state_of


@given(st.lists(st.integers(0, 10**15), min_size=1, max_size=200), st.integers(0, 200))
def test_percentiles_are_exact_to_three_digits(durations: list[int], cut: int) -> None:
    found = Durations()
    for part in (durations[:cut], durations[cut:]):
        found.observe(np.array(part, np.int64), np.arange(len(part)))
    assert found.count == len(durations)
    assert found.longest_ns == max(durations)
    for percent in (5, 50, 95, 100):
        exact = np.percentile(durations, percent, method="inverted_cdf")
        assert found.percentile_ns(percent) == pytest.approx(
            exact, rel=0.0005, abs=0.1 if exact else 1
        )
    assert found.between(0, 10**18) == len(durations)


@given(st.lists(st.integers(0, 1023), min_size=1, max_size=50))
def test_durations_below_an_octave_of_single_bins_are_exact(durations: list[int]) -> None:
    found = Durations()
    found.observe(np.array(durations), np.arange(len(durations)))
    for percent in (1, 50, 99):
        exact = np.percentile(durations, percent, method="inverted_cdf")
        assert found.percentile_ns(percent) == exact


@given(st.integers(0, 2**53))
def test_a_single_duration_is_exact(duration: int) -> None:
    found = Durations()
    found.observe(np.array([duration]), np.array([0]))
    assert found.percentile_ns(50) == duration


def test_memory_is_bounded_by_the_octaves_there_are() -> None:
    found = Durations()
    for octave in (40, 0, 62, 20):
        found.observe(np.array([2**octave]), np.array([0]))
    assert found._bins.nbytes == 63 * PER_OCTAVE * 8
    assert [found.percentile_ns(percent) for percent in (25, 50, 100)] == [
        1,
        pytest.approx(2**20, rel=0.0005),
        2**62,
    ]


def test_the_longest_duration_has_an_end_and_no_durations_have_no_percentile() -> None:
    found = Durations()
    assert found.percentile_ns(50) is None
    assert found.longest_ns is None
    found.observe(np.array([5, 90, 7]), np.array([100, 200, 300]))
    found.observe(np.array([90, 8]), np.array([400, 500]))
    assert (found.longest_ns, found.longest_at_ns) == (90, 200)
    assert found.between(0, 10) == 3


SECOND = 1_000_000_000


@given(st.lists(st.lists(st.integers(-(2**60), 2**60), max_size=9), max_size=6))
def test_the_latest_values_are_kept_in_order(batches: list[list[int]]) -> None:
    recent = RecentValues(10)
    for batch in batches:
        recent.observe(np.array(batch, np.int64))
    every = [value for batch in batches for value in batch]
    assert recent.values.tolist() == every[-10:]
    for percent in (50, 99):
        rank = sorted(every[-10:])
        wanted = rank[math.ceil(len(rank) * percent / 100) - 1] if rank else None
        assert recent.percentile(percent) == wanted


@pytest.mark.parametrize(
    ("times", "now", "rate"),
    [
        ([], 1.0, None),
        ([1.0], 1.0, None),
        ([1.0], 9.0, 0.0),
        ([1.0, 1.1, 1.2], 1.2, 10.0),
        ([1.0, 2.0, 3.0, 4.0], 4.0, 1.0),
        ([1.0, 2.0, 3.0, 4.0], 30.0, 0.0),
    ],
)
def test_a_rate_is_none_before_two_values_and_0_after_the_last(
    times: list[float], now: float, rate: float | None
) -> None:
    recent = RecentValues()
    recent.observe(np.array([int(time * SECOND) for time in times], np.int64))
    assert recent.per_second(int(now * SECOND)) == (rate and pytest.approx(rate))


TIMES = st.lists(st.integers(-(10**6), 10**6), min_size=1, max_size=60).map(sorted)
VALUES = st.integers(-(2**31), 2**31 - 1)


def filled(times: list[int], values: list[int], cuts: list[int], **sizes: int) -> Series:
    series = Series(Keep.LOW, Keep.HIGH, Keep.LAST, **sizes)
    edges = [0, *sorted(min(cut, len(times)) for cut in cuts), len(times)]
    for start, end in pairwise(edges):
        series.observe(np.array(times[start:end], np.int64), np.array(values[start:end], np.int64))
    return series


@given(st.data(), TIMES, st.lists(st.integers(0, 60), max_size=4), st.integers(1, 50))
def test_no_spike_is_lost_at_any_resolution(
    data: st.DataObject, times: list[int], cuts: list[int], columns: int
) -> None:
    values = data.draw(st.lists(VALUES, min_size=len(times), max_size=len(times)))
    series = filled(times, values, cuts, shortest_ns=4, levels=8, windows=16)
    start = data.draw(st.integers(times[0] - 5, times[-1]))
    end = data.draw(st.integers(start + 1, times[-1] + 5))
    spans = series.envelope(0, (start, end), columns)
    inside = [value for time, value in zip(times, values, strict=True) if start <= time < end]
    reported = ~np.isnan(spans.low)
    assert (reported == ~np.isnan(spans.high)).all()
    assert (spans.low[reported] <= spans.last[reported]).all()
    assert (spans.last[reported] <= spans.high[reported]).all()
    if inside:
        assert np.nanmin(spans.low) <= min(inside)
        assert np.nanmax(spans.high) >= max(inside)
    shown = {*spans.low[reported], *spans.high[reported], *spans.last[reported]}
    assert shown <= set(values)


@given(st.data(), TIMES, st.lists(st.integers(0, 60), max_size=4))
def test_batches_of_any_size_give_the_same_series(
    data: st.DataObject, times: list[int], cuts: list[int]
) -> None:
    values = data.draw(st.lists(VALUES, min_size=len(times), max_size=len(times)))
    sizes = {"shortest_ns": 4, "levels": 3, "windows": 16}
    window = times[-1] - data.draw(st.sampled_from([10, 1000, 10**6])), times[-1] + 1
    once = filled(times, values, [], **sizes).envelope(0, window, 20)
    parts = filled(times, values, cuts, **sizes).envelope(0, window, 20)
    for name in ("low", "high", "last"):
        np.testing.assert_array_equal(getattr(once, name), getattr(parts, name))


@given(st.integers(1, 40), st.permutations(range(30)))
def test_falling_times_in_a_batch_are_sorted(columns: int, order: list[int]) -> None:
    times, values = [10 * place for place in order], list(order)
    series = filled(times, values, [7, 19], shortest_ns=4, levels=2, windows=1000)
    spans = series.envelope(0, (0, 300), columns)
    assert np.nanmin(spans.low) == 0
    assert np.nanmax(spans.high) == 29


def test_values_that_left_the_finest_level_come_from_the_next() -> None:
    times = list(range(0, 10_000, 10))
    series = filled(times, times, [], shortest_ns=10, levels=3, windows=100)
    late = series.envelope(0, (9_500, 10_000), 50)
    np.testing.assert_array_equal(late.low, np.arange(9_500, 10_000, 10))
    early = series.envelope(0, (4_000, 4_800), 10)
    np.testing.assert_array_equal(early.low, np.arange(4_000, 4_800, 80))
    np.testing.assert_array_equal(early.high, early.low + 70)


def test_times_without_values_are_nan() -> None:
    series = filled([0, 900], [5, 7], [], shortest_ns=10, levels=1, windows=100)
    spans = series.envelope(0, (0, 1000), 10)
    assert np.isnan(spans.low[1:9]).all()
    assert (spans.low[0], spans.low[9]) == (5, 7)
    assert np.isnan(filled([], [], []).envelope(0, (0, 1000), 10).high).all()


SIZES: list[dict[str, int]] = [
    {"shortest_ns": 1000, "windows": 512},
    {"shortest_ns": 4, "windows": 16, "levels": 3},
]
POINTS = st.lists(
    st.tuples(st.integers(-(2**61), 2**61) | st.integers(0, 10**6), VALUES, st.integers(0, 4)),
    min_size=1,
    max_size=30,
)


def observed(points: list[tuple[int, int, int]], *keep: Keep, **sizes: int) -> Series:
    series = Series(*keep, **sizes)
    if points:
        times, values, groups = np.array(points, np.int64).T
        series.observe(times, values, groups)
    return series


@given(POINTS, st.integers(0, 30), st.sampled_from(SIZES))
def test_totals_lose_nothing_and_stay_in_bounds(
    points: list[tuple[int, int, int]], cut: int, sizes: dict[str, int]
) -> None:
    series = observed(points[:cut], **sizes)
    series.merge(observed(points[cut:], **sizes))
    for group in range(6):
        found = series.counts(group)
        assert 0 < len(found.values) <= sizes["windows"]
        wanted = [0] * len(found.values)
        for time, value, of_group in points:
            if of_group == group:
                wanted[(time - found.start_ns) // found.window_ns] += value
        assert found.values == wanted
    times = [time for time, _, _ in points]
    span, shortest = max(times) - min(times), sizes["shortest_ns"]
    longest_needed = 16 * (span // sizes["windows"] + shortest)
    assert found.window_ns == shortest or found.window_ns <= longest_needed


@given(POINTS, st.lists(st.integers(0, 30), max_size=4), st.sampled_from(SIZES))
def test_any_pieces_merge_to_the_series_of_a_single_pass(
    points: list[tuple[int, int, int]], cuts: list[int], sizes: dict[str, int]
) -> None:
    points = sorted(points, key=lambda point: point[0])
    keep = (Keep.TOTAL, Keep.LOW, Keep.HIGH, Keep.LAST)
    whole, merged = observed(points, *keep, **sizes), Series(*keep, **sizes)
    edges = [0, *sorted(min(cut, len(points)) for cut in cuts), len(points)]
    for start, end in pairwise(edges):
        before, kept = merged.copy(), state_of(merged)
        merged.merge(pickle.loads(pickle.dumps(observed(points[start:end], *keep, **sizes))))
        assert state_of(before) == kept
    assert state_of(merged) == state_of(whole)


def test_groups_can_get_other_numbers_when_they_merge() -> None:
    series, later = Series(shortest_ns=10), Series(shortest_ns=10)
    series.observe(np.array([5, 25]), group=0)
    later.observe(np.array([15, 25, 25]), np.array([1, 2, 3]), np.array([0, 1, 1]))
    series.merge(later, [2, 0, 5])
    assert [series.counts(group).values for group in range(4)] == [
        [1, 0, 6],
        [0, 0, 0],
        [0, 1, 0],
        [0, 0, 0],
    ]


@given(POINTS, st.integers(0, 10**6))
def test_the_value_before_a_time_is_the_last_of_a_window_before_it(
    points: list[tuple[int, int, int]], t_ns: int
) -> None:
    points = [(abs(time) % 10**6, value, group) for time, value, group in points]
    points.sort(key=lambda point: point[0])
    series = observed(points, Keep.LAST, shortest_ns=1000, windows=16, levels=3)
    for group in range(5):
        found: Any = series.before(group, t_ns)
        own = [(time, value) for time, value, of_group in points if of_group == group]
        early = [(time, value) for time, value in own if time < t_ns]
        if found is None:
            assert all(time >= t_ns - 64_000 for time, _ in early)
        else:
            time, value = found
            assert any(value == other and time <= at < t_ns for at, other in own)
