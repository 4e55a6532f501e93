"""Lines that are nothing but a time, or the beginning of one, hold no bytes."""

from __future__ import annotations

import io
from datetime import date

import pytest

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.hex_log import HexLog
from fte_sniff.formats.logs.log_clock import LogClock
from fte_sniff.formats.logs.pastes import bytes_of_text
from fte_sniff.protocol import iso_time

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
