from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.counters import PER_OCTAVE, SLOTS, CountsOverTime, Durations

TIMES = st.lists(st.integers(-(2**61), 2**61) | st.integers(0, 10**10), min_size=1, max_size=30)


@given(st.lists(st.integers(0, 10**15), min_size=1, max_size=200), st.integers(0, 200))
def test_percentiles_are_right_in_three_digits(durations: list[int], cut: int) -> None:
    found = Durations()
    for part in (durations[:cut], durations[cut:]):
        found.add(np.array(part, np.int64), np.arange(len(part)))
    assert found.count == len(durations)
    assert found.longest_ns == max(durations)
    for percent in (5, 50, 95, 100):
        exact = np.percentile(durations, percent, method="inverted_cdf")
        assert found.percentile_ns(percent) == pytest.approx(
            exact, rel=0.0005, abs=0.1 if exact else 1
        )
    assert found.between(0, 10**18) == len(durations)


@given(st.lists(st.integers(1, 1023), min_size=1, max_size=50))
def test_few_nanoseconds_are_told_exactly(durations: list[int]) -> None:
    found = Durations()
    found.add(np.array(durations), np.arange(len(durations)))
    for percent in (1, 50, 99):
        exact = np.percentile(durations, percent, method="inverted_cdf")
        assert found.percentile_ns(percent) == exact


@given(st.integers(0, 2**53))
def test_a_single_duration_is_told_exactly(duration: int) -> None:
    found = Durations()
    found.add(np.array([duration]), np.array([0]))
    assert found.percentile_ns(50) == duration


def test_memory_is_bounded_by_the_octaves_there_are() -> None:
    found = Durations()
    for octave in (40, 0, 62, 20):
        found.add(np.array([2**octave]), np.array([0]))
    assert found._bins.nbytes == 63 * PER_OCTAVE * 8
    assert [found.percentile_ns(percent) for percent in (25, 50, 100)] == [
        1,
        pytest.approx(2**20, rel=0.0005),
        2**62,
    ]


def test_the_longest_is_told_with_its_end_and_nothing_without_any() -> None:
    found = Durations()
    assert found.percentile_ns(50) is None
    assert found.longest_ns is None
    found.add(np.array([5, 90, 7]), np.array([100, 200, 300]))
    found.add(np.array([90, 8]), np.array([400, 500]))
    assert (found.longest_ns, found.longest_at_ns) == (90, 200)
    assert found.between(0, 10) == 3


@given(TIMES, st.integers(0, 30), st.data())
def test_counts_over_time_lose_nothing_and_stay_in_bounds(
    times: list[int], cut: int, data: st.DataObject
) -> None:
    sorts = data.draw(st.lists(st.integers(0, 4), min_size=len(times), max_size=len(times)))
    counts = CountsOverTime(shortest_ns=1000)
    for part in (slice(cut), slice(cut, None)):
        counts.add(np.array(sorts[part], np.int64), np.array(times[part], np.int64))
    slots = len(counts.of(0))
    assert 0 < slots <= SLOTS
    for sort in range(6):
        table = [0] * slots
        for own, time in zip(sorts, times, strict=True):
            if own == sort:
                table[(time - counts.start_ns) // counts.slot_ns] += 1
        assert counts.of(sort).tolist() == table
    span = max(times) - min(times)
    assert counts.slot_ns == 1000 or counts.slot_ns * SLOTS <= 4 * span + 4000
