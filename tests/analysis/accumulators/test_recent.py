from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.counters import Recent

SECOND = 1_000_000_000


@given(st.lists(st.lists(st.integers(-(2**60), 2**60), max_size=9), max_size=6))
def test_the_latest_are_kept_in_order(batches: list[list[int]]) -> None:
    recent = Recent(10)
    for batch in batches:
        recent.add(np.array(batch, np.int64))
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
def test_a_rate_is_none_before_two_came_and_0_after_the_last(
    times: list[float], now: float, rate: float | None
) -> None:
    recent = Recent()
    recent.add(np.array([int(time * SECOND) for time in times], np.int64))
    assert recent.per_second(int(now * SECOND)) == (rate and pytest.approx(rate))
