"""Times and durations in every accepted form, and in forms that are refused."""

from __future__ import annotations

import time
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.time_text import (
    DAY_NS,
    LOCAL,
    SECOND_NS,
    clock_time,
    duration_ns,
    time_ns,
    zone_of,
)
from fte_sniff.errors import InputTextError
from fte_sniff.protocol.columns import iso_time

NOON_NS = 1_769_860_800 * SECOND_NS
"""2026-01-31T12:00:00Z."""

CHINA = timezone(timedelta(hours=8))


@pytest.mark.parametrize(
    ("text", "t_ns"),
    [
        ("2026-01-31T12:00:00Z", NOON_NS),
        (" 2026-01-31 12:00 ", NOON_NS),
        ("2026-01-31", NOON_NS - DAY_NS // 2),
        ("2026-01-31T20:00:00.000000001+08:00", NOON_NS + 1),
        ("1969-12-31T23:59:59.5Z", -SECOND_NS // 2),
        ("2026-02-30", None),
        ("12:00", None),
        ("", None),
    ],
)
def test_a_time(text: str, t_ns: int | None) -> None:
    assert time_ns(text) == t_ns


@given(st.integers(-(2**62), 2**62))
def test_a_formatted_time_parses_to_itself(t_ns: int) -> None:
    assert time_ns(iso_time(t_ns)) == t_ns


@pytest.mark.parametrize(
    ("text", "ns"),
    [
        ("9:05", 32_700 * SECOND_NS),
        ("12:00:00.25Z", 43_200 * SECOND_NS + SECOND_NS // 4),
        ("23:59:59.999999999", DAY_NS - 1),
        ("4:00:00.5 +0800", 72_000 * SECOND_NS + SECOND_NS // 2),
        ("24:00", None),
        ("12:00+25:00", None),
        ("12", None),
        ("12:0", None),
        ("\u0661\u0662:00", None),
    ],
)
def test_a_time_of_day(text: str, ns: int | None) -> None:
    clock = clock_time(text)
    assert (clock and clock.since_midnight_ns()) == ns


@pytest.mark.parametrize(
    ("text", "zone", "same"),
    [
        ("12:00", UTC, "2026-01-31T12:00:00Z"),
        ("07:00:00.5", CHINA, "2026-01-31T23:00:00.5Z"),
    ],
)
def test_a_time_of_day_uses_the_day_of_its_zone(text: str, zone: tzinfo, same: str) -> None:
    late = NOON_NS + 8 * 3600 * SECOND_NS  # 20:00 in UTC, and 04:00 the day after in China
    clock = clock_time(text)
    assert clock is not None
    assert clock.on_day_of(late, zone) == time_ns(same)


@pytest.mark.parametrize(
    ("text", "ns"),
    [
        ("10s", 10 * SECOND_NS),
        ("1.5S", 3 * SECOND_NS // 2),
        (".5ms", SECOND_NS // 2000),
        ("1m30s", 90 * SECOND_NS),
        ("1.5 h", 5400 * SECOND_NS),
        ("1h2min3s4ms5us6ns", 3_723_004_005_006),
        ("0.0000000001s", 0),
        ("10", None),
        ("1s2", None),
        ("", None),
    ],
)
def test_a_duration(text: str, ns: int | None) -> None:
    assert duration_ns(text) == ns


@pytest.mark.parametrize(
    ("text", "hours"), [("+8", 8), ("-08:30", -8.5), ("+0800", 8), ("utc", 0), ("Asia/Shanghai", 8)]
)
def test_a_zone(text: str, hours: float) -> None:
    assert zone_of(text).utcoffset(datetime(2026, 1, 31)) == timedelta(hours=hours)


@pytest.mark.parametrize("text", ["Asia/Shanghia", "CST6", "", "+", "+25:00", "+8.5", "../x"])
def test_unknown_zone_is_refused(text: str) -> None:
    with pytest.raises(InputTextError, match=r"write \+08:00, UTC, local or Asia/Shanghai"):
        zone_of(text)


@given(t_ns=st.integers(0, 2**62))
def test_local_zone_is_that_of_the_machine(t_ns: int) -> None:
    """Also in the hour that comes twice when summer time ends."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("Europe/Berlin", "Asia/Shanghai", "Australia/Lord_Howe"):
            patch.setenv("TZ", name)
            time.tzset()
            for t in (t_ns, *_AUTUMN_NS):
                assert iso_time(t, zone_of("local")) == iso_time(t, ZoneInfo(name))
                moment = datetime.fromtimestamp(t // SECOND_NS, LOCAL)
                assert moment.timestamp() == t // SECOND_NS
                if t > _RULES_NS:
                    assert time_ns(f"{moment:%Y-%m-%dT%H:30}", LOCAL) == time_ns(
                        f"{moment:%Y-%m-%dT%H:30}", ZoneInfo(name)
                    )
    time.tzset()


_RULES_NS = time_ns("2000-01-01") or 0
_AUTUMN_NS = [time_ns(f"2026-10-25T0{hour}:30Z") or 0 for hour in range(3)]
"""Around the end of summer time in Berlin."""


@pytest.mark.parametrize(
    ("text", "zone", "ns"),
    [
        ("20:00", CHINA, 43_200 * SECOND_NS),
        ("20:00:05.5", ZoneInfo("Asia/Shanghai"), 43_205 * SECOND_NS + SECOND_NS // 2),
        ("20:00+01:00", ZoneInfo("Europe/Berlin"), 68_400 * SECOND_NS),
        ("20:00", ZoneInfo("Europe/Berlin"), None),
    ],
)
def test_time_of_day_without_an_offset_has_that_of_the_zone(
    text: str, zone: tzinfo, ns: int | None
) -> None:
    clock = clock_time(text)
    assert clock is not None
    assert clock.since_midnight_ns(zone) == ns
