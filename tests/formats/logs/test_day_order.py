"""Dates such as 2/8/2024: the order that a line shows holds for all, or it is told."""

from __future__ import annotations

from datetime import date

import pytest

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.hex_log import HexLog
from fte_sniff.formats.logs.log_clock import LogClock
from fte_sniff.formats.logs.text_lines import Piece
from fte_sniff.protocol import iso_time

ZONELESS = "its times name no zone, and are taken as UTC; --zone +08:00 says another"
MONTH_FIRST = "2/8/2024 is taken for 2024-02-08, month first; --date 2024-08-02 says day first"


def read(dates: list[str], day: date | None = None) -> tuple[list[str | None], list[str]]:
    pieces = [
        Piece(f"{written} 13:45:12.345 [TX] - AA", number, 0)
        for number, written in enumerate(dates, start=1)
    ]
    log = HexLog(pieces, "f", LogClock(day))
    times = [chunk.t_ns and iso_time(chunk.t_ns)[:10] for chunk in log]
    return times, [one for one in log.about_times if one != ZONELESS]


@pytest.mark.parametrize(
    ("dates", "days"),
    [
        (["08.02.2024"], ["2024-02-08"]),
        (["25/10/2018"], ["2018-10-25"]),
        (["10/25/2018"], ["2018-10-25"]),
        (["5/5/2024"], ["2024-05-05"]),
        (["2/8/2024", "2/13/2024"], ["2024-02-08", "2024-02-13"]),
        (["2/8/2024", "13/8/2024"], ["2024-08-02", "2024-08-13"]),
        (["02-08-2024", "13-08-2024"], ["2024-08-02", "2024-08-13"]),
        (["13/8/2024", "1/9/2024"], ["2024-08-13", "2024-09-01"]),
        (["2024/2/8"], ["2024-02-08"]),
    ],
)
def test_one_date_shows_the_order_of_all(dates: list[str], days: list[str]) -> None:
    assert read(dates) == (days, [])


def test_an_order_that_nothing_shows_is_told_with_the_way_out() -> None:
    assert read(["2/8/2024", "3/8/2024"]) == (["2024-02-08", "2024-03-08"], [MONTH_FIRST])


@pytest.mark.parametrize("day", [date(2024, 2, 8), date(2024, 8, 2)])
def test_the_day_of_the_first_that_the_user_says_is_the_order(day: date) -> None:
    assert read(["2/8/2024"], day) == ([str(day)], [])


def test_a_day_that_is_no_reading_of_the_first_date_changes_nothing() -> None:
    assert read(["2/8/2024"], date(2024, 1, 1)) == (["2024-02-08"], [MONTH_FIRST])


@pytest.mark.parametrize(
    ("dates", "said"),
    [
        (["13/8/2024", "8/13/2024"], "line 2: 8/13/2024 has its month first, .* split the log"),
        (
            ["2/8/2024"] * 1001 + ["13/8/2024"],
            "line 1002: .* way; add --date 2024-08-02, the day",
        ),
    ],
)
def test_dates_of_both_orders_are_refused(dates: list[str], said: str) -> None:
    with pytest.raises(InputTextError, match=said):
        read(dates)


def test_what_is_a_date_in_no_order_is_told() -> None:
    assert read(["13/13/2024"]) == (
        [None],
        ["line 1: 2024-13-13 is no day; rows there have no time"],
    )
