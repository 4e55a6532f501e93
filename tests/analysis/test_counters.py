"""Durations, recent values, tallies and rates."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.counters import (
    PER_OCTAVE,
    Durations,
    Rate,
    RecentValues,
)
from fte_sniff.analysis.tally import RowCount, Tally
from fte_sniff.protocol import Damage, Fault, Frame, Row, Status
from fte_sniff.protocol.rows import Rows


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


ROWS = st.lists(st.from_type(Frame) | st.from_type(Damage), max_size=12)
MANY = st.tuples(ROWS, st.sampled_from([1, 8])).map(lambda drawn: drawn[0] * drawn[1])
"""Few rows, or so many that they are counted as arrays."""


@given(MANY)
def test_a_tally_equals_a_count_by_hand(rows: list[Row]) -> None:
    tally = Tally()
    tally.observe(Rows.from_rows(rows))
    times = [row.t_ns for row in rows if row.t_ns is not None]
    frames = [row for row in rows if isinstance(row, Frame)]
    assert tally.rows == len(rows)
    assert tally.frames == len(frames)
    assert tally.bytes == sum(len(row.raw) for row in rows)
    assert tally.malformed == sum(row.status is Status.MALFORMED for row in rows)
    for status in Status:
        assert tally.by_status()[status].rows == sum(row.status is status for row in rows)
    for fault in Fault:
        own = [row for row in rows if fault in row.faults]
        assert (tally.by_fault().get(fault) or RowCount()).rows == len(own)
    assert tally.ports == tuple(dict.fromkeys(row.port for row in rows))
    for port in tally.ports:
        here = [row for row in rows if row.port == port]
        bytes_ = dict.fromkeys(Status, 0)
        for row in here:
            bytes_[row.status] += len(row.raw)
        found = tally.by_status(port)
        assert {status: count.bytes for status, count in found.items()} == bytes_
    assert tally.first_ns == min(times, default=None)
    assert tally.last_ns == max(times, default=None)
    assert tally.duration_ns == (max(times) - min(times) if times else None)


@given(MANY, st.data())
def test_batches_of_any_size_give_the_same_tally(rows: list[Row], data: st.DataObject) -> None:
    cut = data.draw(st.integers(0, len(rows)))
    once, parts = Tally(), Tally()
    once.observe(Rows.from_rows(rows))
    parts.observe(Rows.from_rows(rows[:cut]))
    parts.observe(Rows.from_rows(rows[cut:]))
    assert parts == once


def test_the_malformed_share_is_of_all_rows() -> None:
    tally = Tally()
    assert tally.malformed_share == 0
    noise = Damage("port", 0, b"\0", None, (Fault.NOISE,))
    suspect = Frame("port", 1, bytes.fromhex("AA000000000000000001EE")[:10], None)
    tally.observe(Rows.from_rows([noise, suspect, suspect, suspect]))
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
