"""What the program stores for a user is read again; what is damaged counts as empty."""

from __future__ import annotations

from pathlib import Path

import pytest

from fte_sniff.errors import FileError
from fte_sniff.session.user_state import read_choices, save_choices


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The state folder of the program."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return tmp_path / "fte-sniff"


def test_choices_are_read_again(folder: Path) -> None:
    assert read_choices() == {}
    save_choices({"theme": "nord", "filters": {"a": "motor = 1"}})
    assert read_choices() == {"theme": "nord", "filters": {"a": "motor = 1"}}


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff", b"[" * 100_000, b'{"a": {"b": 1}}'])
def test_what_is_damaged_counts_as_empty(folder: Path, content: bytes) -> None:
    folder.mkdir()
    (folder / "screen.json").write_bytes(content)
    assert not {"theme", "filters"} & {*read_choices()}
    save_choices({"theme": "nord"})
    assert read_choices() == {"theme": "nord"}


def test_what_cannot_be_saved_is_one_line(folder: Path) -> None:
    folder.parent.joinpath("fte-sniff").touch()
    with pytest.raises(FileError, match="cannot be written"):
        save_choices({})
