"""Times of logs: each form, what they count from, and their order."""

from __future__ import annotations

import os
from datetime import UTC, date, datetime, timedelta, timezone
from io import BytesIO
from itertools import pairwise
from pathlib import Path

import pytest

from fte_sniff.analysis.time_text import day_of, zone_of
from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.reader import LogReader
from fte_sniff.formats.logs.text import LogOptions
from fte_sniff.protocol import Row, iso_time
from fte_sniff.protocol.spec import DEFAULT_BAUD, byte_time_ns
from fte_sniff.session.log_rows import rows_of_log

BYTES = "AA 01 01 03 E8 00 00 00 00 EE"
FRAME_NS = 10 * byte_time_ns(DEFAULT_BAUD)
DAY = date(2026, 1, 31)
CHINA = timezone(timedelta(hours=8))


def read(text: str, options: LogOptions | None = None) -> tuple[list[Row], list[str]]:
    notes: list[str] = []
    reader = LogReader("log", options or LogOptions(DAY, UTC), BytesIO(text.encode()))
    return [row for rows in rows_of_log(reader, notes.append) for row in rows], notes


def times_of(text: str, options: LogOptions | None = None) -> list[str | None]:
    """When the last bytes of the rows had arrived, in milliseconds."""
    rows, _ = read(text, options)
    return [row.t_ns and iso_time(row.t_ns + FRAME_NS)[:23] for row in rows]


@pytest.mark.parametrize(
    ("head", "time"),
    [
        ("[14:03:22.123]收←◆", "2026-01-31T14:03:22.123"),
        ("【14:03:22.123】接收：", "2026-01-31T14:03:22.123"),
        ("[2026-02-01 14:03:22.123]# RECV HEX>", "2026-02-01T14:03:22.123"),
        ("[14:03:22:123] RX: ", "2026-01-31T14:03:22.123"),
        ("14:03:22.123 -> ", "2026-01-31T14:03:22.123"),
        ("2026/2/1 14:03:22 TX ", "2026-02-01T14:03:22.000"),
        ("2026-02-01 14:03:22,123 - INFO - TX: ", "2026-02-01T14:03:22.123"),
        ("2026-02-01T14:03:22.5+08:00 ", "2026-02-01T06:03:22.500"),
        ("2026-02-01T14:03:22Z 发送: ", "2026-02-01T14:03:22.000"),
        ("2026年2月1日 14:03:22 接收: ", "2026-02-01T14:03:22.000"),
        ("01.02.26 14:03:22 ", "2026-02-01T14:03:22.000"),
        ("February 1, 2026 14:03:22 ", "2026-02-01T14:03:22.000"),
        ("[2:03:22 PM] OUT ", "2026-01-31T14:03:22.000"),
        ("下午 2:03:22 收 ", "2026-01-31T14:03:22.000"),
        ("[Sun Feb 01 14:03:22.123 2026] ", "2026-02-01T14:03:22.123"),
        ("Feb  1 14:03:22 host uart: ", "2026-02-01T14:03:22.000"),
        ("01 Feb 2026 14:03:22 ", "2026-02-01T14:03:22.000"),
        ("02-01 14:03:22.123  99 D Usb: ", "2026-02-01T14:03:22.123"),
        ("25.02.2026 14:03:22.123 [TX] - ", "2026-02-25T14:03:22.123"),
        ("2/25/2026 2:03:22.123 PM [TX] - ", "2026-02-25T14:03:22.123"),
        ("(1769954602.123456) can0 TX ", "2026-02-01T14:03:22.123"),
        ("[INFO] [1769954602.123456789] [base]: TX: ", "2026-02-01T14:03:22.123"),
        ("1769954602123 tx ", "2026-02-01T14:03:22.123"),
        ("1769954602123456000,0,", "2026-02-01T14:03:22.123"),
        ("20260201140322.123 TX ", "2026-02-01T14:03:22.123"),
        ("20260201T140322.123+00:00 TX ", "2026-02-01T14:03:22.123"),
        ("2026-02-01T14:03:22,123456+00:00 TX ", "2026-02-01T14:03:22.123"),
        ("20260201-140322.123 TX ", "2026-02-01T14:03:22.123"),
        ("20260201_140322 TX ", "2026-02-01T14:03:22.000"),
        ("260201 140322.123 TX ", "2026-02-01T14:03:22.123"),
        ("时间：14:03:22.123，方向：接收，数据：", "2026-01-31T14:03:22.123"),
        ("time:14:03:22.123 data:", "2026-01-31T14:03:22.123"),
        ("01/02/2026, 14:03:22node: ", "2026-02-01T14:03:22.000"),
        ("TX: ", None),
    ],
)
def test_each_form_of_a_time(head: str, time: str | None) -> None:
    found = times_of(f"{head}{BYTES}\n" * 3)
    assert found[0] == time
    assert (None in found) == (time is None)


@pytest.mark.parametrize(
    "number",
    [
        "12.345", "000012.345", "[   12.345]", "I (12345) uart:", "t=12345ms", "+12345.0ms",
        "12.345s", "12345000us", "12345000 µs",
    ],
)  # fmt: skip
def test_seconds_count_from_the_start_that_is_given(number: str) -> None:
    start = int(datetime(2026, 1, 31, tzinfo=UTC).timestamp()) * 10**9
    later = number.replace("12", "13", 1)
    rest = number.replace("12", "14", 1)
    text = "".join(f"{one} RX: {BYTES}\n" for one in (number, later, rest))
    found = times_of(text, LogOptions(start_ns=start))
    assert found == [f"2026-01-31T00:00:{second}.345" for second in (12, 13, 14)]
    _, notes = read(text, LogOptions())
    assert any("count seconds from a start" in note and "--start" in note for note in notes)


@pytest.mark.parametrize(
    ("number", "step", "step_s"),
    [
        (1_234_590_958, 29_851, 0.029851),  # usbmon: microseconds since boot, for 32 bits
        (3_575_914_555, 29_851, 0.029851),
        (1_769_954_602, 60, 60),  # seconds since 1970
    ],
)
def test_the_unit_of_ten_digits_is_one_in_which_lines_are_dense(
    number: int, step: int, step_s: float
) -> None:
    text = "".join(f"ffff8880 {number + n * step} S Bo: = {BYTES}\n" for n in range(4))
    times = [row.t_ns or 0 for row in read(text)[0]]
    assert {later - earlier for earlier, later in pairwise(times)} == {round(step_s * 1e9)}


@pytest.mark.parametrize(
    ("stamp", "first_s", "lines"),
    [
        ("{}.123456", 1_760_000_000, 8),
        ("{}123", 1_760_000_000, 8),
        ("{}123456", 1_760_000_000, 8),
        ("{}123456789", 1_760_000_000, 8),
        ("{}", 1_760_000_000, 2),
        ("[ {}.123456]", 100, 8),
        ("{} s", 100, 8),
    ],
)
def test_lines_may_be_hours_apart(stamp: str, first_s: int, lines: int) -> None:
    heads = [stamp.format(first_s + 7200 * number) for number in range(lines)]
    rows, _ = read("".join(f"{head} RX: {BYTES}\n" for head in heads))
    times = [row.t_ns or 0 for row in rows]
    assert {later - earlier for earlier, later in pairwise(times)} == {7200 * 10**9}


@pytest.mark.parametrize("first_ns", [86_800, 900_000_000, 2_500_000_000, 1_700_000_000_000])
def test_the_unit_in_a_heading_holds_for_any_number_of_digits(first_ns: int) -> None:
    lines = [f"{n},{first_ns + n * 20_000_000}.00,{BYTES}\n" for n in range(60)]
    times = [row.t_ns or 0 for row in read("Id,Time[ns],UART\n" + "".join(lines))[0]]
    assert {later - earlier for earlier, later in pairwise(times)} == {20_000_000}


@pytest.mark.parametrize("name", ["capture_20260131_120000.log", "2026-01-31 at 12.00.00.txt"])
def test_a_start_comes_from_the_name_or_the_modification_time(tmp_path: Path, name: str) -> None:
    text = "".join(f"{second}.5 RX: {BYTES}\n" for second in (1, 2, 3))
    named = tmp_path / name
    named.write_text(text)
    rows = [row for rows in rows_of_log(LogReader(str(named)), lambda _: None) for row in rows]
    assert iso_time((rows[0].t_ns or 0) + FRAME_NS)[:21] == "2026-01-31T12:00:01.5"
    other = tmp_path / "x.log"
    other.write_text(text)
    os.utime(other, ns=(10**18, 10**18))
    rows = [row for rows in rows_of_log(LogReader(str(other)), lambda _: None) for row in rows]
    assert rows[-1].t_ns == 10**18


def test_a_clock_that_falls_has_passed_midnight() -> None:
    text = "".join(f"[{time}] {BYTES}\n" for time in ("23:59:59.9", "00:00:00.1", "00:00:00.2"))
    assert times_of(text) == [
        "2026-01-31T23:59:59.900", "2026-02-01T00:00:00.100", "2026-02-01T00:00:00.200",
    ]  # fmt: skip


def test_the_zone_of_times() -> None:
    text = f"[2026-01-31 07:00:00.5] {BYTES}\n"
    assert times_of(text, LogOptions(zone=CHINA)) == ["2026-01-30T23:00:00.500"]
    _, notes = read(text, LogOptions())
    assert any("its times name no zone, and are taken as UTC; --zone" in note for note in notes)


def test_a_line_without_the_zone_of_the_others_lacks_a_time() -> None:
    zones = ["+08:00", "+08:00", "", "+01:00"]
    rows, notes = read("".join(f"[2026-01-31 09:00:00{zone}] {BYTES}\n" for zone in zones))
    assert [iso_time((row.t_ns or 0) + FRAME_NS)[11:13] for row in rows] == ["01", "01", "01", "08"]
    assert notes == ["log: line 3 lacks a time; that of the line before is taken"]


def test_local_times_are_those_of_their_season() -> None:
    days = ["2026-01-31", "2026-07-31"]
    text = "".join(f"[{day} 12:00:00] {BYTES}\n" for day in days)
    found = times_of(text, LogOptions(zone=zone_of("Europe/Berlin")))
    assert found == ["2026-01-31T11:00:00.000", "2026-07-31T10:00:00.000"]


def test_dates_that_do_not_exist_are_reported() -> None:
    text = f"[2026-02-31 12:00:00] RX: {BYTES}\n" * 3
    assert times_of(text) == [None] * 3
    assert any("what may be times is not read" in note for note in read(text)[1])


@pytest.mark.parametrize("number", [2**63 // 10**9, 8 * 10**9, 10**20])
def test_numbers_that_no_clock_reaches_are_not_times(number: int) -> None:
    assert times_of("".join(f"{number}.99{n} RX: {BYTES}\n" for n in range(5))) == [None] * 5


@pytest.mark.parametrize(
    ("dates", "first"),
    [(["13/02/2026", "14/02/2026"], "2026-02-13"), (["02/13/2026", "02/14/2026"], "2026-02-13"),
     (["03/02/2026", "04/02/2026"], "2026-02-03"), (["02/03/2026", "02/04/2026"], "2026-02-03")],
)  # fmt: skip
def test_the_whole_log_decides_the_order_of_day_and_month(dates: list[str], first: str) -> None:
    text = "".join(f"{day} 12:00:00 RX: {BYTES}\n" for day in dates)
    assert (times_of(text)[0] or "")[:10] == first


def test_an_order_that_nothing_shows_is_reported() -> None:
    text = f"02/03/2026 12:00:00 RX: {BYTES}\n" * 2
    _, notes = read(text, LogOptions())
    assert any("could be day or month first" in note for note in notes)
    assert (times_of(text, LogOptions(date(2026, 2, 3)))[0] or "")[:10] == "2026-02-03"
    assert (times_of(text, LogOptions(date(2026, 3, 2)))[0] or "")[:10] == "2026-03-02"


def test_microseconds_that_are_padded_to_nine_digits() -> None:
    lines = "".join(
        f"> 2026/01/31 12:00:00.000{us:06}  length=10 from=0 to=9\n {BYTES.lower()}\n"
        for us in (123456, 223456, 323456)
    )
    assert [(time or "")[20:] for time in times_of(lines)] == ["123", "223", "323"]


def test_times_that_go_back_are_kept_and_reported_once() -> None:
    text = "".join(f"[2026-01-31 14:00:{s}Z] {BYTES}\n" for s in ("05", "04", "06", "03"))
    rows, notes = read(text)
    assert [iso_time((row.t_ns or 0) + FRAME_NS)[17:19] for row in rows] == ["05", "04", "06", "03"]
    assert notes == ["log: 2 lines step back in time, for example line 2: '1 s'"]


def test_a_time_before_1970_is_that_of_1970() -> None:
    text = "".join(f"1969-12-31 23:5{minute}:00 RX: {BYTES}\n" for minute in range(5))
    assert times_of(text) == [0] * 5


def test_a_head_holds_for_the_lines_below_it() -> None:
    head = "[2026-01-31 10:00:0{}.5]# RECV HEX>"
    text = "".join(f"{head.format(second)}\n{BYTES}\n" for second in range(2))
    assert [(time or "")[17:21] for time in times_of(text)] == ["00.5", "01.5"]


def test_seconds_above_the_bytes_are_not_dropped_without_a_note() -> None:
    text = "".join(f"packet at {second}.125\n{BYTES}\n" for second in range(1, 6))
    assert times_of(text) == [None] * 5
    assert (
        "log: numbers in the lines above the bytes may be times; they are not read" in read(text)[1]
    )


def test_what_may_be_a_time_but_is_not_read_is_reported() -> None:
    text = "".join(f"motor.log:{line}:09:41:0{line}.5 RX {BYTES}\n" for line in range(1, 6))
    assert times_of(text) == [None] * 5
    assert any("'09:41:01.5'; --input-regex can say where" in note for note in read(text)[1])


def test_silence_below_the_resolution_of_the_stamps_is_none() -> None:
    text = (
        "".join(
            f"[2026-01-31 12:00:{s:02}] RX: {part}\n"
            for s in range(0, 20, 2)
            for part in (BYTES[:11], BYTES[12:])
        )
        + f"[2026-01-31 12:00:20] RX: {BYTES[:11]}\n[2026-01-31 12:00:21] RX: {BYTES[12:]}\n"
    )
    rows, _ = read(text)
    assert {row.raw for row in rows} == {bytes.fromhex(BYTES)}


@pytest.mark.parametrize("text", ["31.1.2026", "2026-02-31", ""])
def test_what_is_not_a_day(text: str) -> None:
    with pytest.raises(InputTextError, match=r"--date: .* is not a day; write it as 2026-01-31"):
        day_of(text)


@pytest.mark.parametrize("text", ["9999-12-31", "1969-12-31", "2263-01-01"])
def test_a_day_whose_times_cannot_be_kept(text: str) -> None:
    with pytest.raises(InputTextError, match=f"--date: {text} is out of range; times go from 1970"):
        day_of(text)


@pytest.mark.parametrize(
    "text", ["Beijing", "+99:99", "", "../etc", "+24", "+08:60", "+23:59:59.5", "+8:", "8", "+٨"]
)
def test_what_is_not_a_zone(text: str) -> None:
    with pytest.raises(InputTextError, match=r"--zone: .* is not a time zone; write \+08:00"):
        zone_of(text)


@pytest.mark.parametrize("text", ["+08:00", "+0800", "+08", "+8", "+8:00", "Asia/Shanghai"])
def test_a_zone_can_be_written_so(text: str) -> None:
    options = LogOptions(DAY, zone_of(text))
    assert times_of(f"[08:00:00.0] {BYTES}\n", options) == ["2026-01-31T00:00:00.000"]


def test_what_fills_a_screen_is_not_quoted_whole() -> None:
    for of in (day_of, zone_of):
        with pytest.raises(InputTextError) as caught:
            of("X" * 5000)
        assert len(str(caught.value)) < 200


def file_of(path: Path, lines: list[str]) -> tuple[list[Row], list[str]]:
    path.write_text("".join(f"{line} RX: {BYTES}\n" for line in lines))
    notes: list[str] = []
    rows = [row for rows in rows_of_log(LogReader(str(path)), notes.append) for row in rows]
    return rows, notes


def far_from_the_sample(usual: str, other: str) -> list[str]:
    """Lines of which one, that is in none of the four blocks of a sample, differs."""
    return [*[usual] * 1000, other, *[usual] * 5000]


def test_a_date_anywhere_in_a_file_decides_the_order_of_day_and_month(tmp_path: Path) -> None:
    lines = far_from_the_sample("02/03/2026 12:00:00", "02/13/2026 12:00:00")
    rows, notes = file_of(tmp_path / "x.log", lines)
    assert iso_time(rows[0].t_ns or 0)[:10] == "2026-02-03"
    assert not any("day or month first" in note for note in notes)


def test_a_time_anywhere_in_a_file_decides_the_resolution(tmp_path: Path) -> None:
    """A second of silence is none if the stamps have seconds, and ends a frame if they have ms."""
    cut = [f"2026-01-31 12:00:00.000Z RX: {BYTES}"] * 6000
    for second, (start, stop) in enumerate(((0, 14), (15, 29)), 58):
        cut.append(f"2026-01-31 12:00:{second}.000Z RX: {BYTES[start:stop]}")
    for other, frames in (("12:00:00.000", 6001), ("12:00:00.007", 6000)):
        cut[1000] = f"2026-01-31 {other}Z RX: {BYTES}"
        (tmp_path / "x.log").write_text("\n".join(cut))
        rows = [
            row for some in rows_of_log(LogReader(str(tmp_path / "x.log")), len) for row in some
        ]
        assert sum(row.raw == bytes.fromhex(BYTES) for row in rows) == frames


def test_what_contradicts_the_first_lines_of_a_pipe_is_reported() -> None:
    first = [f"0{2 + n // 1500}/02/2026 12:00:00.000" for n in range(2999)]
    later = ["01/13/2026 12:00:00.000", "03/02/2026 12:00:00.005"]
    text = "".join(f"{line} RX: {BYTES}\n" for line in first + later)
    rows, notes = read(text, LogOptions(zone=UTC))
    assert len(rows) == 3001
    assert "log: line 3000 lacks a time; that of the line before is taken" in notes
    assert "log: line 3001 shows a finer time than the first lines" in notes


@pytest.mark.parametrize(
    ("name", "day", "found", "source"),
    [
        ("x.log", DAY, "2026-01-31", None),
        ("x-20240305.log", DAY, "2026-01-31", None),
        ("x-20240305.log", None, "2024-03-05", "the file's name"),
        ("x.log", None, "2001-09-09", "the file's modification time"),
    ],
)
def test_the_date_of_times_of_day(
    tmp_path: Path, name: str, day: date | None, found: str, source: str | None
) -> None:
    path = tmp_path / name
    path.write_text(f"12:00:05.5 RX: {BYTES}\n" * 3)
    os.utime(path, ns=(10**18, 10**18))
    notes: list[str] = []
    reader = LogReader(str(path), LogOptions(day, UTC))
    rows = [row for rows in rows_of_log(reader, notes.append) for row in rows]
    assert iso_time((rows[0].t_ns or 0) + FRAME_NS)[:21] == f"{found}T12:00:05.5"
    bases = [note for note in notes if "its times have no date" in note]
    assert len(bases) == (source is not None)
    assert all(f"the date is {found} by {source}; --date" in note for note in bases)


def test_the_seconds_of_a_pipe_count_from_its_first_read() -> None:
    before = datetime.now(UTC)
    rows, notes = read("".join(f"{n}.5 RX: {BYTES}\n" for n in range(3)), LogOptions())
    since = (rows[1].t_ns or 0) + FRAME_NS - 1_500_000_000 - int(before.timestamp() * 10**9)
    assert -(10**9) < since < 60 * 10**9
    assert any("by the time of the first read; --start" in note for note in notes)


def test_lines_without_a_time_are_reported() -> None:
    lines = [f"[2026-01-31 12:00:0{n}Z] {BYTES}" for n in range(5)]
    rows, notes = read("\n".join([*lines, f"[] {BYTES}"]), LogOptions())
    assert rows[-1].t_ns == rows[-2].t_ns
    assert notes == ["log: line 6 lacks a time; that of the line before is taken"]


def test_one_line_without_a_number_does_not_drop_the_others() -> None:
    text = "".join(f"{second}.5 RX: {BYTES}\n" for second in range(5)) + f" RX: {BYTES}\n"
    found = times_of(text, LogOptions(start_ns=10**18))
    assert None not in found
    assert found[5] == found[4]
