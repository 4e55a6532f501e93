"""How people write times: each form, and what is none."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.filter.moments import DAY_NS, SECOND_NS, clock_ns, length_ns, time_ns
from fte_sniff.protocol import iso_time

NOON_NS = 1_769_860_800 * SECOND_NS
"""2026-01-31T12:00:00Z."""


@pytest.mark.parametrize(
    ("text", "t_ns"),
    [
        ("2026-01-31T12:00:00Z", NOON_NS),
        (" 2026-01-31 12:00 ", NOON_NS),
        ("2026-01-31", NOON_NS - DAY_NS // 2),
        ("2026-01-31T20:00:00.000000001+08:00", NOON_NS + 1),
        ("2026-01-31T20:00+0800", NOON_NS),
        ("1969-12-31T23:59:59.5Z", -SECOND_NS // 2),
        ("2026-02-30", None),
        ("2026-01-31T25:00", None),
        ("12:00", None),
        ("yesterday", None),
        ("", None),
    ],
)
def test_a_time(text: str, t_ns: int | None) -> None:
    assert time_ns(text) == t_ns


@given(st.integers(-(2**62), 2**62))
def test_a_time_that_the_program_writes_it_reads(t_ns: int) -> None:
    assert time_ns(iso_time(t_ns)) == t_ns


@pytest.mark.parametrize(
    ("text", "ns"),
    [
        ("00:00", 0),
        ("9:05", 32_700 * SECOND_NS),
        ("12:00:00.25Z", 43_200 * SECOND_NS + SECOND_NS // 4),
        ("23:59:59.999999999", DAY_NS - 1),
        ("24:00", None),
        ("12:60", None),
        ("12:00:61", None),
        ("12", None),
        ("12:0", None),
        ("\u0661\u0662:00", None),
    ],
)
def test_a_time_of_day(text: str, ns: int | None) -> None:
    assert clock_ns(text) == ns


@pytest.mark.parametrize(
    ("text", "ns"),
    [
        ("10s", 10 * SECOND_NS),
        ("1.5S", 3 * SECOND_NS // 2),
        (".5ms", SECOND_NS // 2000),
        ("2.s", 2 * SECOND_NS),
        ("1m30s", 90 * SECOND_NS),
        ("1min", 60 * SECOND_NS),
        ("1h2min3s4ms5us6ns", 3_723_004_005_006),
        ("0.0000000001s", 0),
        ("10", None),
        ("s", None),
        (".s", None),
        ("1s2", None),
        ("", None),
    ],
)
def test_a_length(text: str, ns: int | None) -> None:
    assert length_ns(text) == ns
