"""Hex as people paste it: the same bytes in each style, and what is refused is named."""

from __future__ import annotations

from itertools import count

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs.pastes import logged_bytes
from fte_sniff.formats.logs.text_lines import Piece
from tests.formats.forms import bytes_of_text

FRAME = bytes.fromhex("AA0202 03E8 00002710 EE")

PASTES = {
    "spaces": "AA 02 02 03 E8 00 00 27 10 EE",
    "none": "AA020203E800002710EE",
    "lower case": "aa 02 02 03 e8 00 00 27 10 ee",
    "commas": "AA,02,02,03,E8,00,00,27,10,EE",
    "0x": "0xAA 0x02 0x02 0x03 0xE8 0x00 0x00 0x27 0x10 0xEE",
    "0X, unpadded": "0XAA, 0X2, 0X2, 0X3, 0XE8, 0X0, 0X0, 0X27, 0X10, 0XEE",
    "a C array": "{0xAA,0x02,0x02,0x03,0xE8,0x00,0x00,0x27,0x10,0xEE};",
    "backslash x": r"\xAA\x02\x02\x03\xE8\x00\x00\x27\x10\xEE",
    "a shell string": r"'\xaa\x02\x02\x03\xe8\x00\x00\x27\x10\xee'",
    "a Python literal": r"""b"\xaa\x02\x02\x03\xe8\x00\x00'\x10\xee\"""".replace('\\"', '"'),
    "colons": "AA:02:02:03:E8:00:00:27:10:EE",
    "dashes": "AA-02-02-03-E8-00-00-27-10-EE",
    "unpadded": "AA 2 2 3 E8 0 0 27 10 EE",
    "lines": "AA 02 02 03 E8\n00 00 27\r\n10 EE\n",
    "words of two bytes": "AA02 0203 E800 0027 10EE",
    "comments": "# sent\nAA 02 02 03 E8 // the limit\n00 00 27 10 EE  # the target",
    "an assistant's time": "[12:00:01.345] AA 02 02 03 E8 00 00 27 10 EE",
    "time, direction": "[12:00:01.345]发→◇AA 02 02 03 E8 00 00 27 10 EE □",
    "time, words": "[2026-01-31 10:15:02.123]# RECV HEX> AA 02 02 03 E8 00 00 27 10 EE",
    "h behind": "AAh 02h 02h 03h E8h 00h 00h 27h 10h EEh",
    "a full stop": "AA 02 02 03 E8 00 00 27 10 EE.",
    "a C declaration": "unsigned char buf[] = {0xAA,0x02,0x02,3,0xE8,0,0,0x27,0x10,0xEE};",
    "a C# array": "byte[] b = {0xAA, 0x02, 0x02, 0x03, 0xE8, 0x00, 0x00, 0x27, 0x10, 0xEE};",
    "a Java array": "byte[] b = {170, 2, 2, 3, 232, 0, 0, 39, 16, 238};",
    "a new Java array": "final byte[] b = new byte[] {-86, 2, 2, 3, -24, 0, 0, 39, 16, -18};",
    "a Java array as C has it": "byte b [] = {-86, 2, 2, 3, -24, 0, 0, 39, 16, -18};",
    "a Python list": "data = [0xAA, 0x02, 0x02, 0x03, 0xE8, 0x00, 0x00, 0x27, 0x10, 0xEE]",
    "a bytearray": r"""bytearray(b"\xaa\x02\x02\x03\xe8\x00\x00'\x10\xee\"""".replace('\\"', '"')
    + ")",
    "a bare time": "12:00:01.345 AA 02 02 03 E8 00 00 27 10 EE",
    "a whole date": "2026-01-31 12:00:01.345 RX: AA 02 02 03 E8 00 00 27 10 EE",
    "a time, no fraction": "12:00:01 AA 02 02 03 E8 00 00 27 10 EE",
    "a direction": "TX: AA 02 02 03 E8 00 00 27 10 EE",
    "a direction in Chinese": "发送：AA 02 02 03 E8 00 00 27 10 EE",
    "an arrow": "<< AA 02 02 03 E8 00 00 27 10 EE",
    "full-width commas": "AA，02，02，03，E8，00，00，27，10，EE",
}


@pytest.mark.parametrize("text", PASTES.values(), ids=PASTES.keys())
def test_each_style_of_paste_gives_the_same_bytes(text: str) -> None:
    assert bytes_of_text(text) == FRAME


def test_colons_between_decimal_looking_bytes_are_no_time() -> None:
    assert bytes_of_text("00:00:27:10:EE") == bytes.fromhex("00002710EE")
    assert bytes_of_text("12:34:56") == bytes.fromhex("123456")
    assert bytes_of_text("01:01:03 E8 00") == bytes.fromhex("010103E800")


def test_several_frames_and_bytes_between_them() -> None:
    assert bytes_of_text("AA 01 EE 13 55 EE\n77") == bytes.fromhex("AA01EE1355EE77")


def test_no_bytes_at_all() -> None:
    assert bytes_of_text(" \n# nothing\n") == b""


@pytest.mark.parametrize(
    ("text", "place", "character"),
    [
        ("AA 0G", "line 1, column 5", "'G'"),
        ("AA 01\n02 xyz", "line 2, column 4", "'x'"),
        ("hello", "line 1, column 1", "'h'"),
        ("AA 123", "line 1, column 6", "'3'"),
        ("0xAA 0xZZ", "line 1, column 7", "'x'"),
        ("AA 01 €", "line 1, column 7", "'€'"),
        (r"b'\xa'", "line 1, column 1", "'b'"),
    ],
)
def test_what_is_no_hex_is_pointed_at(text: str, place: str, character: str) -> None:
    with pytest.raises(InputTextError) as caught:
        bytes_of_text(text)
    assert place in str(caught.value)
    assert character in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_terminal_escape_in_the_text_is_shown_not_obeyed() -> None:
    with pytest.raises(InputTextError) as caught:
        bytes_of_text("AA \x1b[2J")
    assert "\x1b" not in str(caught.value)


def test_colours_are_passed_over() -> None:
    assert bytes_of_text("\x1b[1;31mAA\x1b[0m 01\x1b[K") == b"\xaa\x01"


@given(
    st.binary(min_size=1, max_size=40),
    st.sampled_from([" ", "", ",", ", ", ":", "-", "\n", " 0x", "\\x", ";", "\t"]),
    st.booleans(),
)
def test_any_bytes_in_any_style_come_back(data: bytes, between: str, upper: bool) -> None:
    digits = data.hex().upper() if upper else data.hex()
    pairs = [digits[at : at + 2] for at in range(0, len(digits), 2)]
    lead = between.strip() if between.strip() in ("0x", "\\x") else ""
    assert bytes_of_text(lead + between.join(pairs)) == data


@given(st.text(max_size=60))
def test_any_text_is_bytes_or_one_clear_line(text: str) -> None:
    outcome = None
    try:
        bytes_of_text(text)
    except InputTextError as error:
        outcome = str(error)
    assert outcome is None or "column" in outcome


@given(st.binary(max_size=60))
def test_a_bytes_literal_is_what_python_prints(data: bytes) -> None:
    assert bytes_of_text(repr(data)) == data


def test_lines_are_read_one_by_one() -> None:
    pieces = (Piece("AA 01", number, 0) for number in count(1))
    assert next(logged_bytes(pieces)).data == b"\xaa\x01"


A = "AA 01 01 00 64 00 00 00 00 EE"
F = "55 01 01 00 64 00 00 00 0F EE"
BYTES = bytes.fromhex(A + F)


def read(text: str) -> tuple[bytes, list[str]]:
    told: list[str] = []
    return bytes_of_text(text, told.append), told


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"{A} 收到 {F}", "收到"),
        (f"{A}，收到：{F}", "收到"),
        (f"{A}收到{F}", "收到"),
        (f"{A} 收到了 {F} 回复", "收到了 回复"),
        (f"{A} answer: {F}", "answer"),
        (f"电机: {A} 答复 {F}", "电机 答复"),
        (f"{A} ответ {F}", "ответ"),
        (f"0x{A.replace(' ', ' 0x')} 收到 0x{F.replace(' ', ', 0x')}", "收到"),
    ],
)
def test_words_beside_frames_are_no_bytes_and_told(text: str, words: str) -> None:
    data, told = read(text)
    assert data == BYTES
    assert told == [f"line 1: {words!r} beside frames is no hex, and is left out"]


def test_of_many_lines_the_first_is_told_and_how_many_more() -> None:
    data, told = read(f"{A} 收到 {F}\n" * 1500)
    assert data == BYTES * 1500
    assert told == [
        "line 1: '收到' beside frames is no hex, and is left out, as words on 1,499 more lines are"
    ]


@pytest.mark.parametrize(
    "text",
    [
        f"{A[:-2]}收到 {F}",
        f"{A} 收到 01 01 00 64 00 00 00 0F EE",
        f"{A} SS 01 01 00 64 00 00 00 0F EE",
        "AA OI 01 00 64 00 00 00 00 EE",
        "AA 01 01 00 64 00 00 00 OO EE",
        "AA 01 01 00 64 00 00 00 00 Ee 5S",
        f"{A} 收到 10 字节 {F}",
        "停止",
        f"{A} GG",
        f"{A} OFF0 {F}",
        "nothing here",
    ],
)
def test_what_may_be_a_mistyped_byte_is_refused(text: str) -> None:
    with pytest.raises(InputTextError) as caught:
        read(text)
    assert "not hex: " in str(caught.value)
