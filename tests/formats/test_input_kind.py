"""Files without times: every byte, however the text around it is laid out."""

import io

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.errors import FileError, InputTextError
from fte_sniff.formats.input_kind import raw_stream_chunks
from fte_sniff.formats.logs import text_lines
from fte_sniff.formats.logs.hex_log import HexLog


def hex_bytes(text: bytes) -> bytes:
    return b"".join(chunk.data for chunk in HexLog.of_stream(io.BytesIO(text), "f"))


@given(st.binary(max_size=300_000))
def test_raw_bytes_come_as_they_are(data: bytes) -> None:
    chunks = list(raw_stream_chunks(io.BytesIO(data), "f"))
    assert b"".join(chunk.data for chunk in chunks) == data
    assert all(chunk.t_ns is None and chunk.port == "f" for chunk in chunks)


@given(
    st.lists(st.binary(min_size=1, max_size=40), max_size=20),
    st.sampled_from([" ", ",0x", "", " 0x"]),
    st.integers(8, 64),
)
def test_very_long_lines_are_cut_between_bytes(
    lines: list[bytes], between: str, longest: int
) -> None:
    lead = "0x" if "0x" in between else ""
    text = "\n".join(lead + between.join(f"{byte:02X}" for byte in line) for line in lines)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(text_lines, "LONGEST_PIECE", longest)
        assert hex_bytes(text.encode()) == b"".join(lines)


def test_a_line_longer_than_a_piece_is_whole_and_its_errors_are_placed() -> None:
    frame = b"AA 01 01 03 E8 00 00 00 00 EE "
    assert hex_bytes(frame * 80_000) == bytes.fromhex(frame.decode()) * 80_000
    with pytest.raises(InputTextError, match=rf"line 2, column {len(frame) * 80_000 + 1}:"):
        hex_bytes(b"AA\n" + frame * 80_000 + b"xyz")


def test_a_comment_reaches_to_the_end_of_a_very_long_line() -> None:
    assert hex_bytes(b"AA # " + b"not hex " * 400_000 + b"\nBB") == b"\xaa\xbb"


def test_text_of_chinese_windows() -> None:
    assert hex_bytes("[10:00:00.123]发→◇AA 01\n".encode("gb18030")) == b"\xaa\x01"
    assert hex_bytes("\ufeffAA 01".encode()) == b"\xaa\x01"


def test_bytes_that_are_no_text() -> None:
    with pytest.raises(FileError, match="--input raw"):
        hex_bytes(b"AA \0 01")
