"""Hex as people paste it: the same bytes in each style, and what is not hex is pointed at."""

from __future__ import annotations

from io import BytesIO

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.errors import FileError, InputTextError
from fte_sniff.formats.logs import text as log_text
from fte_sniff.formats.logs.reader import LogReader, PlainLog
from fte_sniff.formats.logs.text import LogOptions
from fte_sniff.session.log_rows import rows_of_log

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
    "unpadded and indented": "  AA 2 2 3 E8 0 0 27 10 EE",
    "lines": "AA 02 02 03 E8\n00 00 27\r\n10 EE\n",
    "words of two bytes": "AA02 0203 E800 0027 10EE",
    "comments": "# sent\nAA 02 02 03 E8 // the limit\n00 00 27 10 EE  # the target",
    "an assistant's time": "[12:00:01.345] AA 02 02 03 E8 00 00 27 10 EE",
    "time, direction": "[12:00:01.345]发→◇AA 02 02 03 E8 00 00 27 10 EE □",
    "time, words": "[2026-01-31 10:15:02.123]# RECV HEX> AA 02 02 03 E8 00 00 27 10 EE",
    "h behind": "AAh 02h 02h 03h E8h 00h 00h 27h 10h EEh",
    "a full stop": "AA 02 02 03 E8 00 00 27 10 EE.",
    "a C declaration": "unsigned char buf[] = {0xAA,0x02,0x02,0x3,0xE8,0x0,0x0,0x27,0x10,0xEE};",
    "a C# array": "byte[] b = {0xAA, 0x02, 0x02, 0x03, 0xE8, 0x00, 0x00, 0x27, 0x10, 0xEE};",
    "a Java array": "byte[] b = {170, 2, 2, 3, 232, 0, 0, 39, 16, 238};",
    "a new Java array": "final byte[] b = new byte[] {-86, 2, 2, 3, -24, 0, 0, 39, 16, -18};",
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
    "an address": "0000: AA 02 02 03 E8 00 00 27 10 EE",
    "base64": "qgICA+gAACcQ7g==",
}


def bytes_of(text: str | bytes, *, whole: bool = False) -> bytes:
    content = text.encode() if isinstance(text, str) else text
    reader = LogReader("x", LogOptions(whole=whole), BytesIO(content))
    return b"".join(row.raw for rows in rows_of_log(reader, lambda _: None) for row in rows)


@pytest.mark.parametrize("text", PASTES.values(), ids=PASTES.keys())
def test_each_style_of_paste_gives_the_same_bytes(text: str) -> None:
    assert bytes_of(text) == FRAME


@pytest.mark.parametrize(
    ("text", "data"),
    [
        ("00:00:27:10:EE", "00002710EE"),
        ("12:34:56", "123456"),
        ("01:01:03 E8 00", "010103E800"),
        ("AA 01 EE 13 55 EE\n77", "AA01EE1355EE77"),
        ("6 00 0F EE AA 01 02 F8 FB 00 00 00 00 EE", "06000FEEAA0102F8FB00000000EE"),
        ("  6 00 0F EE", "06000FEE"),
        ("\x1b[1;31mAA\x1b[0m 01\x1b[K", "AA01"),
        ("01", "01"),
    ],
)
def test_hex_without_a_whole_frame(text: str, data: str) -> None:
    assert bytes_of(text) == bytes.fromhex(data)


def test_no_bytes_at_all() -> None:
    with pytest.raises(FileError, match="is empty; there is nothing to decode"):
        bytes_of(" \n# nothing\n")


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize(
    ("text", "place", "character"),
    [
        ("AA 0G", "line 1, column 5", "'G'"),
        ("AA 01\n02 xyz", "line 2, column 4", "'x'"),
        ("AA 123", "line 1, column 6", "'3'"),
        ("0xAA 0xZZ", "line 1, column 7", "'x'"),
        ("AA 01 €", "line 1, column 7", "'€'"),
        ("AA 00 00 00 00 00 00 00 00 EE\n" * 40 + "zz\n", "line 41, column 1", "'z'"),
        ("AA 01 01 00 64 00 00 00 OO EE", "line 1, column 25", "'O'"),
        ("AA OI 01 00 64 00 00 00 00 EE", "line 1, column 4", "'O'"),
        ("55 01 01 03 E 00 00 00 0F EE", "line 1, column 13", "'E'"),
        ("55 01 01 03 E8 00 00 00 0F EE 5", "line 1, column 31", "'5'"),
        ("55 01 01 03 E8 00 00 00 0F EE 5 6", "line 1, column 31", "'5'"),
        ("55 01 01 03 E8 00 00 00 0F EE 55 01 02 03 E8 00 00 00 0F E", "line 1, column 58", "'E'"),
    ],
)
def test_a_typing_error_is_pointed_at(text: str, place: str, character: str, whole: bool) -> None:
    with pytest.raises(InputTextError) as caught:
        bytes_of(text, whole=whole)
    assert place in str(caught.value)
    assert character in str(caught.value)
    assert "\n" not in str(caught.value)


@given(
    st.binary(min_size=1, max_size=40),
    st.sampled_from([" ", "", ",", ", ", ":", "-", "\n", " 0x", "\\x", ";", "\t"]),
    st.booleans(),
)
def test_any_bytes_in_any_style_come_back(data: bytes, between: str, upper: bool) -> None:
    digits = data.hex().upper() if upper else data.hex()
    pairs = [digits[at : at + 2] for at in range(0, len(digits), 2)]
    lead = between.strip() if between.strip() in ("0x", "\\x") else ""
    assert bytes_of(lead + between.join(pairs)) == data


@given(st.text(max_size=60), st.booleans())
def test_any_text_is_bytes_or_one_clear_line(text: str, whole: bool) -> None:
    try:
        bytes_of(text.encode("utf-8", "surrogatepass"), whole=whole)
    except (InputTextError, FileError) as error:
        assert "\n" not in str(error)  # noqa: PT017


@given(
    st.lists(st.binary(min_size=1, max_size=400), min_size=1, max_size=9),
    st.sampled_from([" ", ",0x", "", " 0x"]),
    st.integers(100, 300),
)
def test_very_long_lines_are_cut_between_bytes(
    lines: list[bytes], between: str, longest: int
) -> None:
    lead = "0x" if "0x" in between else ""
    text = "\n".join(lead + between.join(f"{byte:02X}" for byte in line) for line in lines)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(log_text, "LONGEST_LINE", longest)
        patch.setattr(log_text, "BLOCK_BYTES", 64)
        assert bytes_of(text) == b"".join(lines)


def test_a_line_longer_than_a_piece_is_whole_and_its_errors_are_placed() -> None:
    frame = b"AA 01 01 03 E8 00 00 00 00 EE "
    assert bytes_of(frame * 40_000, whole=True) == bytes.fromhex(frame.decode()) * 40_000
    with pytest.raises(InputTextError, match=rf"line 2, column {len(frame) * 40_000 + 1}:"):
        bytes_of(b"AA\n" + frame * 40_000 + b"xyz", whole=True)


def test_a_comment_reaches_to_the_end_of_a_very_long_line() -> None:
    assert bytes_of(b"AA # " + b"not hex " * 400_000 + b"\nBB", whole=True) == b"\xaa\xbb"


A = "AA 01 01 00 64 00 00 00 00 EE"
F = "55 01 01 00 64 00 00 00 0F EE"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"{A} 收到 {F}", "收到"),
        (f"{A} answer: {F}", "answer"),
        (f"{A} ответ {F}", "ответ"),
    ],
)
def test_words_beside_frames_are_not_bytes_and_reported(text: str, words: str) -> None:
    notes: list[str] = []
    reader = LogReader("x", LogOptions(whole=False), BytesIO(text.encode()))
    rows = [row for rows in rows_of_log(reader, notes.append) for row in rows]
    assert [row.raw for row in rows] == [bytes.fromhex(A), bytes.fromhex(F)]
    assert notes == [f"x: line 1 holds words that are not read as bytes: {words!r}"]


@pytest.mark.parametrize(
    ("comments", "is_plain"),
    [
        (("# sent", "# sent", ""), True),
        (("# sent", "// received", ""), False),
        (("# 12:00:01.345", "", ""), True),
        (("# 12:00:01.345", "// 12:00:01.350", ""), False),
    ],
)
def test_comments_with_directions_or_times_make_it_another_log(
    comments: tuple[str, ...], is_plain: bool
) -> None:
    lines = [f"{A} {comment}\n".encode() for comment in comments]
    assert (PlainLog.by_sample(lines) is not None) == is_plain


def test_lines_without_a_digit_are_not_plain_hex() -> None:
    with pytest.raises(InputTextError, match="no frames found in 3 lines"):
        list(rows_of_log(LogReader("x", stream=BytesIO(b"[\n-\n]\n")), lambda _note: None))
