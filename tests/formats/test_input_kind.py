"""The format of a file, and raw bytes as they are."""

import io
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.errors import UsageError
from fte_sniff.formats.input_kind import MCAP_MAGIC, InputKind, kind_of_file, raw_stream_chunks


@given(st.binary(max_size=300_000))
def test_raw_bytes_come_as_they_are(data: bytes) -> None:
    chunks = list(raw_stream_chunks(io.BytesIO(data), "f"))
    assert b"".join(chunk.data for chunk in chunks) == data
    assert all(chunk.t_ns is None and chunk.port == "f" for chunk in chunks)


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
