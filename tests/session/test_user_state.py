"""What the program stores for a user is read again; what is damaged counts as empty."""

from __future__ import annotations

from pathlib import Path

import pytest

from fte_sniff.errors import FileError
from fte_sniff.session.notes import RowKey
from fte_sniff.session.user_state import (
    MOST_PLACES,
    START,
    Place,
    read_choices,
    read_place,
    save_choices,
    save_place,
)

PLACE = Place("motor = 1", ("time", "kind"), RowKey("p", 40, 7))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The state folder of the program."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return tmp_path / "fte-sniff"


def test_a_view_reopens_where_it_was_left(folder: Path, tmp_path: Path) -> None:
    files = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    assert read_place(files) == START
    save_place(files, PLACE)
    found = read_place(files)
    assert (found.filter, found.columns) == (PLACE.filter, PLACE.columns)
    assert found.cursor == RowKey("p", 40)
    assert read_place(files[:1]) == START


def test_only_the_latest_places_are_kept(folder: Path, tmp_path: Path) -> None:
    for number in range(MOST_PLACES + 1):
        save_place([tmp_path / f"{number}.mcap"], PLACE)
    assert read_place([tmp_path / "0.mcap"]) == START
    assert read_place([tmp_path / "1.mcap"]) != START


def test_choices_are_read_again(folder: Path) -> None:
    assert read_choices() == {}
    save_choices({"theme": "nord", "filters": {"a": "motor = 1"}})
    assert read_choices() == {"theme": "nord", "filters": {"a": "motor = 1"}}


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff", b"[" * 100_000, b'{"a": {"b": 1}}'])
def test_what_is_damaged_counts_as_empty(folder: Path, tmp_path: Path, content: bytes) -> None:
    folder.mkdir()
    for name in ("views.json", "screen.json"):
        (folder / name).write_bytes(content)
    assert read_place([tmp_path / "a.mcap"]) == START
    assert not {"theme", "filters"} & {*read_choices()}
    save_choices({"theme": "nord"})
    assert read_choices() == {"theme": "nord"}


def test_what_cannot_be_saved_is_one_line(folder: Path, tmp_path: Path) -> None:
    folder.parent.joinpath("fte-sniff").touch()
    for save in (lambda: save_place([tmp_path], PLACE), lambda: save_choices({})):
        with pytest.raises(FileError, match="cannot be written"):
            save()
