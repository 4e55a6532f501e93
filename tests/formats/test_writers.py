"""Texts of whole columns are those of single rows."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone, tzinfo
from zoneinfo import ZoneInfo

import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.formats.writers import time_texts
from fte_sniff.protocol.columns import iso_time, iso_time_ns

SECOND_NS = 1_000_000_000
_SUMMER_TIME_ENDS_S = int(datetime(2026, 10, 25, 1, tzinfo=UTC).timestamp())
NEAR_A_CHANGE = st.integers(-3600, 3600).map(lambda s: (_SUMMER_TIME_ENDS_S + s) * SECOND_NS)
TIMES = st.lists(st.none() | NEAR_A_CHANGE | st.integers(0, 2**63 - 1 - 86_400 * SECOND_NS))
ZONES = [
    UTC,
    timezone(timedelta(0)),
    timezone(timedelta(hours=8)),
    ZoneInfo("Europe/Berlin"),
    ZoneInfo("Australia/Lord_Howe"),
    ZoneInfo("Africa/Monrovia"),
]
"""The last had an offset with seconds until 1972."""


@pytest.mark.parametrize("zone", ZONES, ids=str)
@given(times=TIMES)
def test_times_of_a_column_are_those_of_its_rows(zone: tzinfo, times: list[int | None]) -> None:
    texts = time_texts(pl.Series(times, dtype=pl.Datetime("ns", "UTC")), zone).to_list()
    assert texts == [None if t_ns is None else iso_time(t_ns, zone) for t_ns in times]


@pytest.mark.parametrize("zone", ZONES, ids=str)
@given(t_ns=NEAR_A_CHANGE | st.integers(0, 2**62))
def test_time_in_a_zone_is_the_same_moment(zone: tzinfo, t_ns: int) -> None:
    text = iso_time(t_ns, zone)
    assert datetime.fromisoformat(f"{text[:19]}{text[29:]}").timestamp() == t_ns // SECOND_NS
    assert iso_time_ns(text) == t_ns
    assert iso_time_ns(text.replace("-", "-99", 1)) is iso_time_ns(text[:-1]) is None
