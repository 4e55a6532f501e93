"""Notes beside recordings, and the place where a view was left."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.errors import FileError
from fte_sniff.protocol import KIND_BY_NAME, Frame, encode
from fte_sniff.protocol.rows import Rows
from fte_sniff.session.notes import (
    MOST_PLACES,
    START,
    Note,
    Notes,
    Place,
    RowKey,
    capture_path,
    capture_start,
    located,
    read_place,
    save_place,
)

T_NS = 1_769_860_800_000_000_123


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's state folder."""
    folder = tmp_path / "state"
    monkeypatch.setenv("XDG_STATE_HOME", str(folder))
    return folder


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return tmp_path / "run.mcap"


def beside(recording: Path) -> Path:
    return recording.with_name(recording.name + ".notes.jsonl")


@given(
    st.none() | st.integers(0, 2**62),
    st.text(),
    st.integers(0, 2**62),
    st.text(max_size=500),
    st.none() | st.text(max_size=40),
)
def test_a_line_holds_a_whole_note(
    t_ns: int | None, port: str, offset: int, text: str, capture: str | None
) -> None:
    note = Note(t_ns, port, offset, text, capture)
    line = note.line()
    assert "\n" not in line
    names = ["time", "port", "offset", "text"] + ["capture"] * (capture is not None)
    assert list(json.loads(line)) == names
    assert Note.parse(line) == note


ODD_TEXTS = ["\u2028", "\x85", "\x0c\x1e", "\r\n", "\udcff", "收到"]


@pytest.mark.parametrize("odd", ODD_TEXTS)
def test_any_name_of_a_port_and_any_text_can_be_read_again(recording: Path, odd: str) -> None:
    notes = Notes([recording])
    for offset in range(3):
        notes.set(Note(T_NS, f"a{odd}b", offset, f"c{odd}d"))
    assert notes.save() is None
    again = Notes([recording])
    assert again.damage == []
    assert [note.text for note in again.notes.values()] == [f"c{odd}d"] * 3


@pytest.mark.parametrize(
    "line",
    [
        *("x", "[]", "{}", '{"time": null, "port": "p", "offset": "0", "text": ""}'),
        '{"time": "noon", "port": "p", "offset": 0, "text": ""}',
        '{"time": null, "port": "p", "offset": 0, "text": 7}',
        '{"time": null, "port": "p", "offset": true, "text": ""}',
        "[" * 100_000,
    ],
)
def test_a_damaged_file_is_one_warning_and_is_not_overwritten(
    recording: Path, state: Path, line: str
) -> None:
    good = Note(T_NS, "p", 0, "kept").line()
    beside(recording).write_text(f"{good}\n{line}\n")
    notes = Notes([recording])
    (damage,) = notes.damage
    assert str(beside(recording)) in damage
    assert "line 2" in damage
    assert notes.notes[RowKey("p", 0)].text == "kept"
    notes.set(Note(None, "p", 10, "new"))
    assert notes.save() is None
    assert beside(recording).read_text() == f"{good}\n{line}\n"
    assert state in notes.written[0].parents
    assert set(Notes([recording]).notes) == {RowKey("p", 0), RowKey("p", 10)}


def test_a_note_that_could_not_be_saved_is_saved_later(recording: Path, state: Path) -> None:
    notes = Notes([recording])
    beside(recording).mkdir()
    state.write_text("no folder")
    notes.set(Note(T_NS, "p", 0, "first"))
    notes.set(Note(T_NS, "p", 10, "second"))
    assert "not saved" in str(notes.save())
    notes.set(Note(T_NS, "p", 10, "changed"))
    assert "not saved" in str(notes.save())
    state.unlink()
    notes.set(Note(T_NS, "p", 20, "third"))
    assert notes.save() is None
    found = {key.offset: note.text for key, note in Notes([recording]).notes.items()}
    assert found == {0: "first", 10: "changed", 20: "third"}


def test_a_recording_that_replaces_another_has_no_notes_of_it(recording: Path) -> None:
    starts = ["2026-01-31T12:00:00.000000000Z", "2026-02-01T12:00:00.000000000Z"]
    for start in starts:
        notes = Notes([recording], [start])
        assert notes.notes == {}
        notes.set(Note(T_NS, "p", 0, start))
        assert notes.save() is None
    for start in starts:
        (found,) = Notes([recording], [start]).notes.values()
        assert (found.text, found.capture) == (start, start)
    both = Notes([recording.with_name("run_00001.mcap"), recording], starts)
    assert {key.capture: note.text for key, note in both.notes.items()} == dict(enumerate(starts))


def test_the_file_of_notes_is_named_once_and_again_where_it_changes(recording: Path) -> None:
    notes = Notes([recording])
    assert notes.news() == beside(recording)
    notes.set(Note(T_NS, "p", 0))
    assert notes.save() is None
    assert notes.news() is None
    beside(recording).unlink()
    beside(recording).mkdir()
    notes.set(Note(T_NS, "p", 10))
    assert notes.save() is None
    assert notes.news() == notes.written[0] != beside(recording)


def test_the_start_of_a_capture_is_read_from_its_recording(tmp_path: Path) -> None:
    sample = Path(__file__).parents[2] / "samples" / "clean.mcap"
    assert capture_start(sample) == "2026-01-31T12:00:00.000000000Z"
    (tmp_path / "x.log").write_text("AA")
    assert capture_start(tmp_path / "x.log") is None
    assert capture_start(tmp_path / "none.mcap") is None


def test_notes_of_two_screens_are_merged_and_removed(recording: Path) -> None:
    one, other = Notes([recording]), Notes([recording])
    one.set(Note(T_NS, "p", 0, "one"))
    other.set(Note(T_NS, "p", 10, "other"))
    assert one.save() is other.save() is None
    assert {key: note.text for key, note in Notes([recording]).notes.items()} == {
        RowKey("p", 0): "one",
        RowKey("p", 10): "other",
    }
    one.remove(Note(T_NS, "p", 10))
    one.save()
    assert [json.loads(line)["text"] for line in beside(recording).read_text().splitlines()] == [
        "one"
    ]
    assert not [path for path in recording.parent.iterdir() if path.name.startswith(".")]


@pytest.mark.parametrize("name", ["run.mcap", "run_00001.mcap", "run_00017.mcap"])
def test_the_files_of_a_capture_share_one_file_of_notes(recording: Path, name: str) -> None:
    assert capture_path(recording.with_name(name)) == recording
    notes = Notes([recording.with_name(name)])
    notes.set(Note(T_NS, "p", 0))
    notes.save()
    assert beside(recording).exists()


def test_where_nothing_can_be_written_that_is_reported(recording: Path, state: Path) -> None:
    beside(recording).mkdir()
    state.write_text("no folder")
    notes = Notes([recording])
    notes.set(Note(T_NS, "p", 0, "here"))
    assert "not saved" in str(notes.save())


def test_the_row_that_contains_the_byte_is_found() -> None:
    raw = encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 5})
    rows = Rows.from_rows([Frame(port, 10 * n, raw, T_NS) for n in range(4) for port in "pq"])
    keys = [RowKey("p", 0), RowKey("q", 25), RowKey("q", 40), RowKey("r", 0), RowKey("p", 30, 1)]
    keys.append(RowKey("p", 30))
    assert sorted(located(rows, keys)) == [(0, keys[0]), (5, keys[1]), (6, keys[5]), (6, keys[4])]


def test_a_view_reopens_where_it_was_left(recording: Path, state: Path) -> None:
    assert read_place([recording]) == START
    place = Place("motor = 1", ("time", "raw"), RowKey("p", 30, 1))
    save_place([recording], place)
    assert read_place([recording]) == place
    assert read_place([recording, recording]) == START
    for number in range(MOST_PLACES):
        save_place([Path(f"{number}.mcap")], START)
    assert read_place([recording]) == START
    for content in ("", "[]", "{", '{"x": {"filter": 7}}', "[" * 100_000):
        (state / "fte-sniff" / "views.json").write_text(content)
        assert read_place([recording]) == START


def test_a_place_that_cannot_be_saved_is_one_line(recording: Path, state: Path) -> None:
    state.write_text("no folder")
    assert read_place([recording]) == START
    with pytest.raises(FileError, match=r"views\.json cannot be written: .*directory"):
        save_place([recording], Place("motor = 1"))
