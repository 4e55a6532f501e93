"""Lines of any length and number: no byte is split, and the time grows as they do."""

from __future__ import annotations

import io
import time
from collections.abc import Iterator

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from fte_sniff.errors import FteSniffError, InputTextError
from fte_sniff.formats.logs import text_lines
from fte_sniff.formats.logs.hex_log import HexLog
from fte_sniff.formats.logs.pastes import Logged, logged_bytes
from fte_sniff.formats.logs.text_lines import Piece, TextPieces

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


PLAIN = ["AA 01 01 03 E8 00 00 00 00 EE", "55", "aa\t01", "10 20", "99", "00 01", "12 34 "]
OTHER = [
    "",
    "AA  01",
    "AA01",
    "170",
    "[170, 1, 1]",
    "-86, 1",
    "[10:00:00.123]发→◇AA 01",
    "TX:",
    "RX: AA",
    "2026-01-31 10:15:02",
    "1: AA 01",
    "1 AA 01",
    "2 AA 01",
    "/* a comment",
    "its end */",
    "AA # to the end",
    "0000 aa 01 01 03 e8 00 00 00 00 ee 55 01 01 03 e8 00  ..........U.....",
    "0010",
    "00000010: aa01 0103 e800 0000 00ee 5501 0103 e800  ..........U.....",
    "00000020: aa01 0103 e800 0000 00ee 5501 0103 e800  ..........U.....",
    "*",
    "b'\\xaa",
    "uint8_t f[] = {0xAA, 0x01};",
    "nothing",
]
texts = st.lists(
    st.tuples(
        st.sampled_from(PLAIN) | st.sampled_from(OTHER),
        st.integers(1, 4),
        st.sampled_from(["\n", "\n", "\r\n", "\r"]),
    ),
    max_size=8,
).map(lambda taken: "".join((line + end) * times for line, times, end in taken))

Told = tuple[bytes, list[tuple[object, ...]], list[str], str]


def told(pieces: Iterator[Piece] | list[Piece]) -> Told:
    """The bytes, which of them have a time or a direction, the notes, and the error."""
    data = b""
    said: list[tuple[object, ...]] = []
    notes: list[str] = []
    error = ""
    try:
        for logged in logged_bytes(pieces, notes.append):
            data += logged.data
            if logged.stamp is not None or logged.mark is not None:
                said.append(_said(logged, len(data)))
    except FteSniffError as refused:
        error = str(refused)
    return data, said, notes, error


def _said(logged: Logged, stop: int) -> tuple[object, ...]:
    return logged.line, logged.stamp, logged.mark, logged.data, stop


@settings(max_examples=500, deadline=None)
@given(texts)
def test_many_at_once_are_read_as_one_by_one(text: str) -> None:
    pieces = list(TextPieces(io.BytesIO(text.encode()), "f"))
    alone = [one for piece in pieces for one in piece.each()]
    assert [one.line for one in alone] == list(range(1, len(alone) + 1))
    assert told(pieces) == told(alone)


def test_plain_lines_in_a_comment_are_no_bytes_of_decimals_either() -> None:
    line = "AA 01 01 03 E8 00 00 00 00 EE\n"
    text = f"170\n170\n/* a comment\n{line * 2}its end */\n1, 1, 3"
    pieces = list(TextPieces(io.BytesIO(text.encode()), "f"))
    data, _, _, error = told(pieces)
    assert (data, error) == (b"\xaa\xaa\x01\x01\x03", "")


def test_plain_lines_come_together() -> None:
    text = b"AA 01\nBB 02\r\nCC 03\n\nDD 04\nEE 05"
    pieces = list(TextPieces(io.BytesIO(text), "f"))
    assert [(piece.line, piece.lines) for piece in pieces] == [(1, 3), (4, 1), (5, 1), (6, 1)]


def test_a_stream_tells_when_it_has_to_be_waited_for() -> None:
    class Slow(io.BytesIO):
        def read1(self, size: int | None = -1) -> bytes:
            return self.read(6)

    pieces = TextPieces(Slow(b"AA 01\nBB\nCC\nDD 02\n"), "f")
    assert [(piece.text, pieces.drained) for piece in pieces] == [
        ("AA 01", True),
        ("BB\nCC\n", True),
        ("DD 02", True),
    ]
