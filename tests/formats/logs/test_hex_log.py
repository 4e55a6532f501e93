"""Logs of serial assistants: which moment each line is, and which way its bytes went."""

from __future__ import annotations

from datetime import date, timedelta, timezone

import pytest

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.hex_log import HexLog, at_own_times
from fte_sniff.formats.logs.line_head import Mark
from fte_sniff.formats.logs.log_clock import LogClock, day_of, zone_of
from fte_sniff.formats.logs.pastes import logged_bytes
from fte_sniff.formats.logs.text_lines import Piece
from fte_sniff.protocol import Frame, Framer, Row, iso_time

OUTSIDE = "line 2: its time is not from 1970 to 2262; rows there have no time"
DAY = date(2026, 1, 31)
CHINA = timezone(timedelta(hours=8))
SENT, RECEIVED = Mark.SENT, Mark.RECEIVED
BYTES = "AA 01 01 03 E8 00 00 00 00 EE"


def log_of(text: str, clock: LogClock | None = None) -> HexLog:
    lines = enumerate(text.splitlines(), start=1)
    return HexLog((Piece(line, number, 0) for number, line in lines), "f", clock)


def times_of(text: str, clock: LogClock) -> list[str | None]:
    return [chunk.t_ns and iso_time(chunk.t_ns) for chunk in log_of(text, clock)]


@pytest.mark.parametrize(
    ("head", "time", "mark"),
    [
        ("[14:03:22.123]收←◆", "2026-01-31T14:03:22.123", RECEIVED),
        ("[14:03:22.123]发→◇", "2026-01-31T14:03:22.123", SENT),
        ("【14:03:22.123】接收：", "2026-01-31T14:03:22.123", RECEIVED),
        ("[2026-02-01 14:03:22.123]# RECV HEX>", "2026-02-01T14:03:22.123", RECEIVED),
        ("[2026-02-01 14:03:22.123]# SEND HEX>", "2026-02-01T14:03:22.123", SENT),
        ("[14:03:22:123] RX: ", "2026-01-31T14:03:22.123", RECEIVED),
        ("14:03:22:123 -> ", "2026-01-31T14:03:22.123", None),
        ("14:03:22.123 -> ", "2026-01-31T14:03:22.123", None),
        ("2026/2/1 14:03:22 TX ", "2026-02-01T14:03:22.000", SENT),
        ("2026-02-01 14:03:22,123 - INFO - TX: ", "2026-02-01T14:03:22.123", SENT),
        ("2026-02-01 14:03:22.123 [RX] - ", "2026-02-01T14:03:22.123", RECEIVED),
        ("2026-02-01T14:03:22.5+08:00 ", "2026-02-01T06:03:22.500", None),
        ("2026-02-01T14:03:22Z 发送: ", "2026-02-01T14:03:22.000", SENT),
        ("2026年2月1日 14:03:22 接收: ", "2026-02-01T14:03:22.000", RECEIVED),
        ("[2:03:22 PM] OUT ", "2026-01-31T14:03:22.000", SENT),
        ("[INFO] [1769868202.123456789] [base]: TX: ", "2026-01-31T14:03:22.123", SENT),
        ("14:03:22:123 ", "2026-01-31T14:03:22.123", None),
        ("[a_node-1] [INFO] [1769868202.123456789] [a]: TX: ", "2026-01-31T14:03:22.123", SENT),
        ("I (1234) uart: ", None, None),
        ("R: ", None, RECEIVED),
        ("T:", None, SENT),
        ("COM3 RX: ", None, RECEIVED),
        ("/dev/ttyUSB0: TX: ", None, SENT),
        ("Received 10 bytes: ", None, RECEIVED),
        ("TX (10): ", None, SENT),
        ("000012.345 RX ", None, RECEIVED),
        ("[   12.345678] ", None, None),
        ("[25:03:22.123] ", None, None),
        ("[2026-02-31 14:03:22.123] ", None, None),
    ],
)
def test_what_stands_before_the_bytes(head: str, time: str | None, mark: Mark | None) -> None:
    log = log_of(f"{head}{BYTES}", LogClock(DAY))
    (chunk,) = log
    assert chunk.data == bytes.fromhex(BYTES)
    assert (chunk.t_ns and iso_time(chunk.t_ns)[:23]) == time
    (logged,) = logged_bytes([Piece(f"{head}{BYTES}", 1, 0)])
    assert logged.mark is mark


def test_a_time_of_day_alone_is_no_time_and_that_is_told() -> None:
    log = log_of(f"[14:03:22.123] {BYTES}\n[14:03:23.123] {BYTES}")
    assert [chunk.t_ns for chunk in log] == [None, None]
    assert log.about_times == [
        "its times have no date, and are left out; --date 2026-01-31 says the day"
    ]


def test_a_clock_that_falls_has_passed_midnight() -> None:
    text = "\n".join(f"[{time}] AA" for time in ("23:59:59.9", "00:00:00.1", "00:00:00.0"))
    assert [time and time[:21] for time in times_of(text, LogClock(DAY))] == [
        "2026-01-31T23:59:59.9",
        "2026-02-01T00:00:00.1",
        "2026-02-01T00:00:00.0",
    ]


def test_a_time_in_a_zone() -> None:
    text = "[2026-01-31 07:00:00.5] AA\n[2026-01-31 07:00:00.5Z] BB"
    clock = LogClock(None, CHINA)
    assert times_of(text, clock) == [
        "2026-01-30T23:00:00.500000000Z",
        "2026-01-31T07:00:00.500000000Z",
    ]
    assert not clock.zoneless
    unsaid = log_of(text)
    assert {chunk.t_ns for chunk in unsaid} == {1_769_842_800_500_000_000}
    assert unsaid.about_times == [
        "its times name no zone, and are taken as UTC; --zone +08:00 says another"
    ]


def rows_of(log: HexLog) -> list[Row]:
    framer = Framer("f")
    fed = map(framer.feed, at_own_times(log, framer))
    return [row for rows in fed for row in rows] + framer.flush()


@pytest.mark.parametrize(
    ("times", "told"),
    [
        (["31 14:00:00", "31 14:00:01"], []),
        (["31 14:00:00", "30 14:00:00"], ["line 2: the time goes back by 1 day"]),
        (
            ["31 14:00:00", "31 13:00:01", "31 13:00:02"],
            ["line 2: the time goes back by 59 min 59 s"],
        ),
        (["31 14:00:00.002", "31 14:00:00.001"], ["line 2: the time goes back by 1 ms"]),
        (
            ["31 14:00:00", "28 12:00:00", "27 12:00:00"],
            ["line 2: the time goes back by 3 days 2 h, and once more"],
        ),
        (
            ["31 14:00:01", "31 14:00:00"] * 4,
            ["line 2: the time goes back by 1 s, and 3 times more"],
        ),
    ],
)
def test_times_that_go_back_are_kept_and_told_once(times: list[str], told: list[str]) -> None:
    log = log_of("\n".join(f"[2026-01-{time}Z] {BYTES}" for time in times))
    one_byte_ns = 86_805
    found = [iso_time((row.t_ns or 0) + 10 * one_byte_ns + 600_00)[8:19] for row in rows_of(log)]
    assert found == [time.replace(" ", "T")[:11] for time in times]
    assert log.about_times == told


@pytest.mark.parametrize(
    ("time", "is_at", "told"),
    [
        ("2026-01-31 24:00:00Z", "2026-02-01T00:00:00", []),
        ("2026-02-30 14:00:00Z", None, ["line 2: 2026-02-30 is no day; rows there have no time"]),
        (
            "2026-01-31 25:00:00Z",
            None,
            ["line 2: 25:00:00 is no time of day; rows there have no time"],
        ),
        ("2262-04-11 23:47:16.854Z", "2262-04-11T23:47:16", []),
        ("1970-01-01 07:59:59+08:00", None, [OUTSIDE]),
        ("1969-12-31 23:59:59Z", None, [OUTSIDE]),
        ("0001-01-01 00:00:00+09:00", None, [OUTSIDE]),
        ("2262-04-11 23:47:16.855Z", None, [OUTSIDE]),
        ("9999-12-31 23:59:59-09:00", None, [OUTSIDE]),
        ("9999-12-31 24:00:00Z", None, [OUTSIDE]),
        ("9999999999.123", None, [OUTSIDE]),
        (
            "2026-01-31 14:00:00+99:99",
            None,
            ["line 2: its zone is none, for it is a day or more from UTC; rows there have no time"],
        ),
    ],
)
def test_a_time_that_is_none_is_told_with_its_line(
    time: str, is_at: str | None, told: list[str]
) -> None:
    log = log_of(f"[2026-01-31 10:00:00Z] AA\n[{time}] AA")
    _, t_ns = (chunk.t_ns for chunk in log)
    assert (None if t_ns is None else iso_time(t_ns)[:19]) == is_at
    assert log.about_times == told


def test_what_a_head_says_holds_for_the_lines_below_it() -> None:
    text = "[2026-01-31 10:00:00.5]# RECV HEX>\nAA 01\n01 03\n[2026-01-31 10:00:01.5]\nE8"
    assert [time and time[17:21] for time in times_of(text, LogClock())] == ["00.5", "00.5", "01.5"]


@pytest.mark.parametrize("text", ["31.1.2026", "2026-02-31", ""])
def test_what_is_no_day(text: str) -> None:
    with pytest.raises(InputTextError, match=r"--date: .* is no day; write it as 2026-01-31"):
        day_of(text)


@pytest.mark.parametrize("text", ["9999-12-31", "1969-12-31", "2263-01-01"])
def test_a_day_whose_times_cannot_be_kept(text: str) -> None:
    with pytest.raises(InputTextError, match=f"--date: {text} cannot be kept; times go from 1970"):
        day_of(text)


def test_the_first_row_of_all_times_is_not_before_them() -> None:
    rows = rows_of(log_of(f"[1970-01-01 00:00:00Z] {BYTES}"))
    assert [row.t_ns for row in rows] == [0]


def test_midnight_may_pass_on_the_last_day() -> None:
    text = "[2262-12-31 00:00:00Z] AA\n[23:00:00] AA\n[01:00:00] AA"
    log = log_of(text, LogClock(date.max))
    assert [chunk.t_ns for chunk in log] == [None, None, None]


@pytest.mark.parametrize(
    "text", ["Beijing", "+99:99", "", "../etc", "+24", "+08:60", "+23:59:59.5", "+8:", "8", "+٨"]
)
def test_what_is_no_zone(text: str) -> None:
    with pytest.raises(InputTextError, match=r"--zone: .* is no zone; write \+08:00"):
        zone_of(text)


def test_what_fills_a_screen_is_not_quoted_whole() -> None:
    for of in (day_of, zone_of):
        with pytest.raises(InputTextError) as caught:
            of("X" * 5000)
        assert len(str(caught.value)) < 200


def test_a_zone_west_of_utc() -> None:
    clock = LogClock(DAY, zone_of("-3:30"))
    assert times_of("[08:00:00.0] AA", clock) == ["2026-01-31T11:30:00.000000000Z"]


@pytest.mark.parametrize("text", ["+08:00", "+0800", "+08", "+8", "+8:00", "Asia/Shanghai"])
def test_a_zone_can_be_written_so(text: str) -> None:
    clock = LogClock(DAY, zone_of(text))
    assert times_of("[08:00:00.0] AA", clock) == ["2026-01-31T00:00:00.000000000Z"]


def headers(rows: list[Row]) -> list[tuple[int, int]]:
    return [(row.offset, row.raw[0]) for row in rows if isinstance(row, Frame)]


def compared(text: str) -> list[str]:
    log = log_of(text)
    framer = Framer("f")
    for chunk in log:
        log.compare(headers(framer.feed(chunk)))
    log.compare(headers(framer.flush()))
    return log.doubts


def test_marks_that_contradict_the_headers_are_told_once() -> None:
    control, feedback = BYTES, "55 01 01 03 E8 00 00 00 0F EE"
    assert compared(f"TX: {control}\nRX: {feedback}\n" * 20) == []
    assert compared(f"{control}\n{feedback}\n") == []
    assert compared(f"TX: {control}\nRX: {feedback}\nTX: {feedback}\nTX: {feedback}") == [
        "2 of 4 frames go the other way than the log says (line 3 says sent, header 55 says"
        " feedback): a tap logs so, or the wires are swapped"
    ]


def test_a_frame_goes_the_way_of_the_line_that_it_begins_on() -> None:
    assert compared("TX: AA 01 01 03 E8\nRX: 00 00 00 00 EE\n" * 5) == []


def test_a_direction_holds_for_lines_below_only_where_it_stands_alone() -> None:
    feedback = "55 01 01 03 E8 00 00 00 0F EE"
    assert compared(f"TX: {BYTES}\n{feedback}") == []
    assert len(compared(f"[10:00:00.5]# SEND HEX>\n{BYTES}\n{feedback}")) == 1
