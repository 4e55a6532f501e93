"""Envelopes: no spike is lost, and times without values are empty."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.traces import Envelope

TIMES = st.lists(st.integers(-(10**6), 10**6), min_size=1, max_size=60).map(sorted)
VALUES = st.integers(-(2**31), 2**31 - 1)


def filled(times: list[int], values: list[int], cuts: list[int], **sizes: int) -> Envelope:
    envelope = Envelope(**sizes)
    edges = [0, *sorted(min(cut, len(times)) for cut in cuts), len(times)]
    for start, end in pairwise(edges):
        envelope.update(np.array(times[start:end], np.int64), np.array(values[start:end], np.int64))
    return envelope


@given(st.data(), TIMES, st.lists(st.integers(0, 60), max_size=4), st.integers(1, 50))
def test_no_spike_is_lost_at_any_resolution(
    data: st.DataObject, times: list[int], cuts: list[int], columns: int
) -> None:
    values = data.draw(st.lists(VALUES, min_size=len(times), max_size=len(times)))
    envelope = filled(times, values, cuts, finest_ns=4, levels=8, buckets=16)
    start = data.draw(st.integers(times[0] - 5, times[-1]))
    end = data.draw(st.integers(start + 1, times[-1] + 5))
    spans = envelope.resample(start, end, columns)
    inside = [value for time, value in zip(times, values, strict=True) if start <= time < end]
    told = ~np.isnan(spans.low)
    assert (told == ~np.isnan(spans.high)).all()
    assert (spans.low[told] <= spans.last[told]).all()
    assert (spans.last[told] <= spans.high[told]).all()
    if inside:
        assert np.nanmin(spans.low) <= min(inside)
        assert np.nanmax(spans.high) >= max(inside)
    shown = {*spans.low[told], *spans.high[told], *spans.last[told]}
    assert shown <= set(values)


@given(st.data(), TIMES, st.lists(st.integers(0, 60), max_size=4))
def test_batches_of_any_size_give_the_same_envelope(
    data: st.DataObject, times: list[int], cuts: list[int]
) -> None:
    values = data.draw(st.lists(VALUES, min_size=len(times), max_size=len(times)))
    sizes = {"finest_ns": 4, "levels": 3, "buckets": 16}
    window = times[-1] - data.draw(st.sampled_from([10, 1000, 10**6])), times[-1] + 1
    once = filled(times, values, [], **sizes).resample(*window, 20)
    parts = filled(times, values, cuts, **sizes).resample(*window, 20)
    for name in ("low", "high", "last"):
        np.testing.assert_array_equal(getattr(once, name), getattr(parts, name))


@given(st.integers(1, 40), st.permutations(range(30)))
def test_falling_times_in_a_batch_are_sorted(columns: int, order: list[int]) -> None:
    times, values = [10 * place for place in order], list(order)
    envelope = filled(times, values, [7, 19], finest_ns=4, levels=2, buckets=1000)
    spans = envelope.resample(0, 300, columns)
    assert np.nanmin(spans.low) == 0
    assert np.nanmax(spans.high) == 29


def test_values_that_left_the_finest_level_come_from_the_next() -> None:
    times = list(range(0, 10_000, 10))
    envelope = filled(times, times, [], finest_ns=10, levels=3, buckets=100)
    late = envelope.resample(9_500, 10_000, 50)
    np.testing.assert_array_equal(late.low, np.arange(9_500, 10_000, 10))
    early = envelope.resample(4_000, 4_800, 10)
    np.testing.assert_array_equal(early.low, np.arange(4_000, 4_800, 80))
    np.testing.assert_array_equal(early.high, early.low + 70)


def test_times_without_values_are_nan() -> None:
    envelope = filled([0, 900], [5, 7], [], finest_ns=10, levels=1, buckets=100)
    spans = envelope.resample(0, 1000, 10)
    assert np.isnan(spans.low[1:9]).all()
    assert (spans.low[0], spans.low[9]) == (5, 7)
    assert np.isnan(Envelope().resample(0, 1000, 10).high).all()
