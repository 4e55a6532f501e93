"""Plain lines are read many at once, and give what they give one by one."""

from __future__ import annotations

import io
from collections.abc import Iterator

from hypothesis import given, settings
from hypothesis import strategies as st

from fte_sniff.errors import FteSniffError
from fte_sniff.formats.logs.pastes import Logged, logged_bytes
from fte_sniff.formats.logs.text_lines import Piece, TextPieces

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
