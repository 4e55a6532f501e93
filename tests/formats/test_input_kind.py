"""Files without times: every byte, however the text around it is laid out."""

import io
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.errors import FileError, InputTextError, UsageError
from fte_sniff.formats.input_kind import MCAP_MAGIC, InputKind, kind_of_file, raw_stream_chunks
from fte_sniff.formats.logs import text as log_text
from fte_sniff.formats.logs.reader import LogReader
from fte_sniff.formats.logs.text import LogOptions
from fte_sniff.session.log_rows import rows_of_log


def hex_bytes(text: bytes, *, whole: bool = True) -> bytes:
    rows = rows_of_log(LogReader("f", LogOptions(whole=whole), io.BytesIO(text)), lambda _: None)
    return b"".join(row.raw for some in rows for row in some)


@given(st.binary(max_size=300_000))
def test_raw_bytes_come_as_they_are(data: bytes) -> None:
    chunks = list(raw_stream_chunks(io.BytesIO(data), "f"))
    assert b"".join(chunk.data for chunk in chunks) == data
    assert all(chunk.t_ns is None and chunk.port == "f" for chunk in chunks)


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
        assert hex_bytes(text.encode(), whole=False) == b"".join(lines)


def test_a_line_longer_than_a_piece_is_whole_and_its_errors_are_placed() -> None:
    frame = b"AA 01 01 03 E8 00 00 00 00 EE "
    assert hex_bytes(frame * 80_000) == bytes.fromhex(frame.decode()) * 80_000
    with pytest.raises(InputTextError, match=rf"line 2, column {len(frame) * 80_000 + 1}:"):
        hex_bytes(b"AA\n" + frame * 80_000 + b"xyz")


def test_a_comment_reaches_to_the_end_of_a_very_long_line() -> None:
    assert hex_bytes(b"AA # " + b"not hex " * 400_000 + b"\nBB") == b"\xaa\xbb"


def test_text_of_chinese_windows() -> None:
    frame = bytes.fromhex("AA0102000000000000EE")
    text = f"[10:00:00.123]发→◇{frame.hex(' ')}\n"
    assert hex_bytes(text.encode("gb18030")) == frame
    assert hex_bytes("\ufeffAA 01".encode()) == b"\xaa\x01"


def test_bytes_that_are_no_text() -> None:
    with pytest.raises(FileError, match="--input raw"):
        hex_bytes(b"\xaa\x01\x02\xee" * 20)


def test_the_first_bytes_decide_where_the_name_does_not(tmp_path: Path) -> None:
    path = tmp_path / "minicom.cap"
    path.write_text("[12:00:01] RX: 55 01 01 03 E8 00 00 00 0F EE\n")
    assert kind_of_file(path) is InputKind.HEX
    path.write_bytes(MCAP_MAGIC)
    assert kind_of_file(path) is InputKind.MCAP
    for unknown in (b"", bytes.fromhex("55 01 01 03 E8 00 00 00 0F EE")):
        path.write_bytes(unknown)
        with pytest.raises(UsageError, match="its name does not show its format"):
            kind_of_file(path)
