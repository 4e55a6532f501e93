"""Lines of any length: cut where no byte is split, and read in time that grows as they do."""

from __future__ import annotations

import io
import time

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fte_sniff.errors import InputTextError
from fte_sniff.formats.logs import text_lines
from fte_sniff.formats.logs.hex_log import HexLog

FRAME = bytes.fromhex("AA1121 13E8 10101010 EE")


def read(text: str, encoding: str = "utf-8") -> bytes:
    log = HexLog.of_stream(io.BytesIO(text.encode(encoding)), "f")
    return b"".join(chunk.data for chunk in log)


STYLES = {
    **{f"between {between!r}": ("", between, "") for between in ":-;|. ,\t" if between},
    "unseparated": ("", "", ""),
    "after a direction": ("TX: ", "", ""),
    "after a time": ("[12:00:00.958] RX:", ":", ""),
    "0x": ("{0x", ", 0x", "};"),
    "0x without blanks": ("{0x", ",0x", "}"),
    "escapes": ('"\\x', "\\x", '"'),
    "Unicode escapes": ('"\\u00', "\\u00", '"'),
    "per cent": ("%", "%", ""),
    "dollar": ("$", "$", ""),
    "&h": ("&h", "&h", ""),
    "Chinese commas": ("", "、", "。"),
    "brackets": ("[", "][", "]"),
}
"""What stands before, between and behind pairs of digits."""


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("encoding", ["utf-8", "gb18030"])
@given(data=st.binary(min_size=1, max_size=200), longest=st.integers(32, 90))
def test_a_cut_splits_no_byte(style: str, encoding: str, data: bytes, longest: int) -> None:
    before, between, behind = STYLES[style]
    text = before + between.join(f"{byte:02X}" for byte in data) + behind
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(text_lines, "LONGEST_PIECE", longest)
        assert read(text, encoding) == data


@pytest.mark.parametrize("signed", [False, True])
@given(data=st.binary(min_size=1, max_size=200), longest=st.integers(32, 90))
def test_a_cut_splits_no_decimal_number(signed: bool, data: bytes, longest: int) -> None:
    numbers = [byte - 256 if signed and byte > 127 else byte for byte in b"\xaa\x55" + data]
    for text in (str(numbers), str(numbers).replace(" ", "")):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(text_lines, "LONGEST_PIECE", longest)
            assert read(text) == b"\xaa\x55" + data


@given(data=st.binary(max_size=300), longest=st.integers(32, 90))
@example(data=bytes(6) + b"#" + bytes(2), longest=32)
def test_a_cut_splits_no_bytes_literal(data: bytes, longest: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(text_lines, "LONGEST_PIECE", longest)
        assert read(f"data = {data!r} # b'") == data
        assert read(f"AA {data!r} /* b' */ {data!r}") == b"\xaa" + data * 2


@given(data=st.binary(min_size=1, max_size=200), longest=st.integers(32, 90))
def test_a_cut_splits_no_full_width_digits(data: bytes, longest: int) -> None:
    wide = {ord(digit): ord(digit) + 0xFEE0 for digit in "0123456789ABCDEF"}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(text_lines, "LONGEST_PIECE", longest)
        assert read(data.hex().upper().translate(wide)) == data


@pytest.mark.parametrize("between", ["", ":"])
def test_a_line_that_is_longer_than_a_piece(between: str) -> None:
    text = between.join([FRAME.hex(between) if between else FRAME.hex()] * 60_000)
    assert len(text) > text_lines.LONGEST_PIECE
    assert read(text) == FRAME * 60_000


LINES = {
    "blanks in front": lambda n: " " * n + "AA zz",
    "blanks behind a direction": lambda n: "TX (len" + " " * n + "AA zz",
    "blanks behind a word": lambda n: "frame" + " " * n + "AA zz",
    "blanks behind a bracket": lambda n: "[" + " " * n + "AA zz",
    "blanks and braces": lambda n: "{ " * n + "AA zz",
    "blanks behind an address": lambda n: "00000000" + " " * n + "AA zz",
    "comments": lambda n: "/**/" * n + "zz",
    "literals and comments": lambda n: "b'\\xaa' /* */" * n + "zz",
    "open literals": lambda n: "b'\\'\" " * n + "zz",
    "digits and a letter": lambda n: "A" * n + "z",
    "words": lambda n: "int " * n + "zz",
    "numbers": lambda n: "1 " * n + "zz",
    "colons": lambda n: ": " * n + "zz",
    "brackets": lambda n: "[a " * n + "zz",
    "dots": lambda n: "AA." * n + "zz",
    "base64": lambda n: "qgEB" * n + "~",
}


@pytest.mark.parametrize("name", LINES)
def test_a_line_is_read_in_time_that_grows_as_it_does(name: str) -> None:
    line = LINES[name]
    size = len(line(1000)) / 1000
    # A time that grows with the square of the length would be hours.
    text = line(int(500_000 / size))
    begun = time.process_time()
    with pytest.raises(InputTextError):
        read(text)
    assert time.process_time() - begun < 30


def test_blanks_longer_than_a_piece() -> None:
    begun = time.process_time()
    assert read(" " * 5_000_000 + "AA 01") == b"\xaa\x01"
    assert time.process_time() - begun < 30
