"""Times in logs: lines that are only a time, and the order of day and month in dates."""

from __future__ import annotations

import io
from datetime import date

import pytest

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.hex_log import HexLog
from fte_sniff.formats.logs.log_clock import LogClock
from fte_sniff.formats.logs.text_lines import Piece
from fte_sniff.protocol import iso_time
from tests.formats.forms import bytes_of_text

A = "AA 01 01 03 E8 00 00 00 00 EE"
BYTES = bytes.fromhex(A)


def read(text: str) -> tuple[bytes, list[str]]:
    log = HexLog.of_stream(io.BytesIO(text.encode()), "f")
    return b"".join(chunk.data for chunk in log), log.doubts


@pytest.mark.parametrize(
    ("whole", "cut"),
    [
        (f"[12:00:01.652]收←◆{A}", "[12:00:01.65"),
        (f"[12:00:01.652]收←◆{A}", "[12:00:0"),
        (f"[12:00:01.652]收←◆{A}", "[12"),
        (f"[9:59:59.652]收←◆{A}", "[10:00:00.652"),
        (f"12:00:01.652 -> {A}", "12:00:01"),
        (f"12:00:01.652 -> {A}", "12:0"),
        (f"12:00:01.652 -> {A}", "12"),
        (f"2024-02-08 13:45:12.345 {A}", "2024-02"),
        (f"2024-02-08 13:45:12.345 {A}", "2024"),
        (f"2/14/2024 13:45:12.345 [TX] - {A}", "2/14/2024 13:4"),
        (f"2/14/2024 13:45:12.345 [TX] - {A}", "2/14/2024 13:45:12.345 [T"),
        (f"[2024-02-08 13:45:12.345]# RECV HEX>\n{A}", "[2024-02-0"),
        (f"[2024-02-08 13:45:12.345]# RECV HEX>\n{A}", "[2024-02-08 13:45:12.345"),
        (f"(13:45:12.345) (COM1) (>>) {A}", "(13:45:12.345) (COM"),
        (f"[1706702602.123456789] {A}", "[1706702602.1234"),
        (f"[Thu Feb 08 13:45:12.345 2024] {A}", "[Thu Feb 08 13:4"),
    ],
)
def test_a_log_that_ends_within_a_time(whole: str, cut: str) -> None:
    data, doubts = read(f"{whole}\n{cut}")
    assert data == BYTES
    line = whole.count("\n") + 2
    assert doubts == [
        f"line {line}: '{cut}' is taken for the beginning of a time, and is not read as bytes"
    ]


@pytest.mark.parametrize(
    ("text", "times"),
    [
        (f"12:00:00\n0000  {A}\n12:00:01\n0000  {A}\n", ["12:00:00", "12:00:01"]),
        (f"0000  {A}\n12:00:01\n0000  {A}\n", [None, "12:00:01"]),
        (f"12:00:00\n{A}\n12:00:01\n{A}\n", ["12:00:00", "12:00:01"]),
        (f"[12:00:00.5] {A}\n12:00:01\n{A}\n", ["12:00:00", "12:00:01"]),
        (f"12:00:00\n[12:00:01.5] {A}\n{A}\n", ["12:00:01", "12:00:01"]),
        (f"2024-02-08\n{A}\n{A}\n", [None, None]),
    ],
)
def test_a_time_alone_on_its_line_is_that_of_the_lines_below(
    text: str, times: list[str | None]
) -> None:
    log = HexLog.of_stream(io.BytesIO(text.encode()), "f", LogClock(date(2026, 1, 31)))
    chunks = list(log)
    assert b"".join(chunk.data for chunk in chunks) == BYTES * 2
    assert [chunk.t_ns and iso_time(chunk.t_ns)[11:19] for chunk in chunks] == times


@pytest.mark.parametrize(
    ("text", "data"),
    [
        ("12 00 01 65", "12000165"),
        ("12:00:00:AA\n12:00:00\n11:00:00", "120000AA120000110000"),
        ("12:00:00\n12:00:00:AA", "120000120000AA"),
        ("20-24\n2024-02-08", "202420240208"),
        (f"12:00:01.652 -> {A}\n12\n{A}", f"{A} 12 {A}"),
        (f"[12:00:01.652]# RECV HEX>\n{A}\n12\n2024\n", f"{A} 12 2024"),
        (f"[12:00:01.652] RX: {A}\n99:00", f"{A} 99 00"),
        ("[12:00:01.652] AA:01:01\n03:E8:00\n12:00:00", "AA010103E800120000"),
    ],
)
def test_bytes_are_not_taken_for_times(text: str, data: str) -> None:
    assert read(text)[0] == bytes.fromhex(data)


def test_what_can_be_told_by_nothing_is_bytes_and_that_is_told() -> None:
    told = "line 1: 12:34:56 is read as bytes, not as a time or day"
    data, doubts = read("12:34:56")
    assert data == bytes.fromhex("123456")
    assert told in doubts


@pytest.mark.parametrize("count", [2, 1500])
def test_bytes_that_all_look_like_times_are_told_once(count: int) -> None:
    data, doubts = read("12:34:56\n" * count)
    assert data == bytes.fromhex("123456") * count
    assert [doubt for doubt in doubts if "not as a time" in doubt] == doubts[:1]


def test_times_that_are_cut_are_told_once() -> None:
    whole = f"[12:00:01.652] {A}\n[12:00:0\n"
    data, doubts = read(whole * 3)
    assert (data, len(doubts)) == (BYTES * 3, 1)


@pytest.mark.parametrize("text", [f"RX: {A}\nRX: {A[:-1]}", f"{A}\n{A}\n0", f"{A}\nTX: AA 0"])
def test_half_a_byte_at_the_end_is_none(text: str) -> None:
    with pytest.raises(InputTextError, match=r"has no second digit, as others have, line [23],"):
        bytes_of_text(text)


ZONELESS = "its times name no zone, and are taken as UTC; --zone +08:00 says another"
MONTH_FIRST = "2/8/2024 is taken for 2024-02-08, month first; --date 2024-08-02 says day first"


def read_dates(dates: list[str], day: date | None = None) -> tuple[list[str | None], list[str]]:
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
    assert read_dates(dates) == (days, [])


def test_an_order_that_nothing_shows_is_told_with_the_way_out() -> None:
    assert read_dates(["2/8/2024", "3/8/2024"]) == (["2024-02-08", "2024-03-08"], [MONTH_FIRST])


@pytest.mark.parametrize("day", [date(2024, 2, 8), date(2024, 8, 2)])
def test_the_day_of_the_first_that_the_user_says_is_the_order(day: date) -> None:
    assert read_dates(["2/8/2024"], day) == ([str(day)], [])


def test_a_day_that_is_no_reading_of_the_first_date_changes_nothing() -> None:
    assert read_dates(["2/8/2024"], date(2024, 1, 1)) == (["2024-02-08"], [MONTH_FIRST])


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
        read_dates(dates)


def test_what_is_a_date_in_no_order_is_told() -> None:
    assert read_dates(["13/13/2024"]) == (
        [None],
        ["line 1: 2024-13-13 is no day; rows there have no time"],
    )
