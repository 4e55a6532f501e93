"""Reads and writes at an offset, with the calls of POSIX and without them."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from fte_sniff import platform
from fte_sniff.platform import read_at, write_at


@pytest.mark.parametrize("posix", [True, False])
def test_position_stays_after_a_read_and_a_write_at_an_offset(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, posix: bool
) -> None:
    monkeypatch.setattr(platform, "POSIX", posix)
    path = tmp_path / "x"
    path.write_bytes(b"0123456789")
    with path.open("r+b", buffering=0) as file:
        file.seek(3)
        assert read_at(file.fileno(), 4, 5) == b"5678"
        assert file.tell() == 3
        assert write_at(file.fileno(), b"ab", 1) == 2
        assert file.tell() == 3
        assert os.fstat(file.fileno()).st_size == 10
    assert path.read_bytes() == b"0ab3456789"
