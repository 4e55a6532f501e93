"""Notes beside a recording: whatever several programs append is read again, and nothing is lost."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from fte_sniff.errors import FileError
from fte_sniff.protocol.rows import Row
from fte_sniff.session.notes import Notes, RowKey, line_of, located, notes_path, parse_line
from tests.beside import running
from tests.support.columns import rows_from
from tests.waiting import BOUND_S

NOON_NS = 1_769_860_800_000_000_000
KEY = RowKey("p", 40, NOON_NS)
keys = st.builds(RowKey, st.text(), st.integers(0, 2**63 - 1), st.none() | st.integers(0, 2**62))
texts = st.none() | st.text()


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return tmp_path / "run.mcap"


def opened(*recordings: Path) -> Notes:
    return Notes(dict.fromkeys(recordings))


@given(key=keys, text=texts)
def test_a_line_is_read_as_it_was_written(key: RowKey, text: str | None) -> None:
    line = line_of(key, text)
    assert parse_line(line.decode()) == (key, text)
    assert line.count(b"\n") == 1


@example(changes=[(KEY, "one\x85line\u2028of a note")])
@given(changes=st.lists(st.tuples(st.sampled_from([KEY, KEY._replace(offset=50)]), texts)))
def test_the_last_line_about_a_row_holds(
    tmp_path_factory: pytest.TempPathFactory, changes: list[tuple[RowKey, str | None]]
) -> None:
    recording = tmp_path_factory.mktemp("notes") / "run.mcap"
    notes = opened(recording)
    for key, text in changes:
        notes.set(key, text)
    left = {key: text for key, text in dict(changes).items() if text is not None}
    assert opened(recording).notes == notes.notes == left


def test_notes_of_older_versions_are_read(recording: Path) -> None:
    notes_path(recording).write_text(
        '{"time": "2026-01-31T12:00:00Z", "port": "p", "offset": 40, "text": "old",'
        ' "capture": "x"}\n'
        '{"time": null, "port": "p", "offset": 50, "text": ""}\n'
    )
    assert {key.offset: text for key, text in opened(recording).notes.items()} == {
        40: "old",
        50: "",
    }


@pytest.mark.parametrize("content", [b"nothing\n", b"[[[[[", b"\xff\xfe\n", b"[" * 100_000, b"1\n"])
def test_what_is_not_a_note_is_ignored_and_the_rest_is_read(
    recording: Path, content: bytes
) -> None:
    notes_path(recording).write_bytes(content.rstrip() + b"\n" + line_of(KEY, "kept"))
    notes = opened(recording)
    assert notes.notes == {KEY: "kept"}
    assert notes.damage == []


_ADD = """
import sys
from pathlib import Path
from fte_sniff.session.notes import Notes, RowKey
notes = Notes({Path(sys.argv[1]): None})
for number in range(200):
    notes.set(RowKey(sys.argv[2], number), "x" * 400)
"""


def test_no_note_is_lost_while_several_programs_write(recording: Path) -> None:
    import sys

    words = [sys.executable, "-c", _ADD, str(recording)]
    with running([*words, "a"]) as one, running([*words, "b"]) as other:
        assert one.wait(BOUND_S) == other.wait(BOUND_S) == 0
    notes = opened(recording)
    assert (len(notes.notes), notes.damage) == (400, [])


def test_the_files_of_a_capture_share_their_notes(recording: Path) -> None:
    second = recording.with_stem("run_00002")
    notes = opened(recording, second)
    notes.set(KEY, "shared")
    assert notes.written == [recording.with_name("run.mcap.notes.jsonl")]
    assert opened(second).notes == notes.notes


def test_a_note_is_stored_beside_the_capture_that_began_before_its_row(tmp_path: Path) -> None:
    first, later = tmp_path / "a.mcap", tmp_path / "b.mcap"
    notes = Notes({later: NOON_NS + 100, first: NOON_NS})
    for t_ns in (NOON_NS + 50, NOON_NS + 150, None):
        notes.set(RowKey("p", 0, t_ns), str(t_ns))
    assert {*opened(first).notes.values()} == {str(NOON_NS + 50), "None"}
    assert {*opened(later).notes.values()} == {str(NOON_NS + 150)}


def test_the_file_of_notes_is_announced_when_it_is_first_written(recording: Path) -> None:
    notes = opened(recording)
    assert notes.set(KEY, "x") == notes_path(recording)
    assert notes.set(KEY, "y") is None
    assert Notes().set(KEY, "x") is None


def test_a_note_that_cannot_be_saved_is_one_line(recording: Path) -> None:
    notes_path(recording).mkdir()
    notes = opened(recording)
    with pytest.raises(FileError, match=f"the note is not saved: {notes_path(recording)}: "):
        notes.set(KEY, "x")
    assert notes.notes == {KEY: "x"}


@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_notes_are_not_written_through_a_link_or_to_a_pipe(recording: Path, kind: str) -> None:
    target = recording.with_name("precious")
    target.write_text("mine")
    if kind == "link":
        notes_path(recording).symlink_to(target)
    else:
        os.mkfifo(notes_path(recording))
    notes = opened(recording)
    with pytest.raises(FileError):
        notes.set(KEY, "x")
    assert target.read_text() == "mine"


def test_the_row_that_contains_the_byte_at_that_time_is_found() -> None:
    rows = rows_from(
        Row("p", 10 * number, bytes.fromhex("AA0000000000000000EE"), NOON_NS + number * 10**9)
        for number in range(3)
    )
    wanted = [RowKey("p", 15, NOON_NS + 10**9), RowKey("p", 20), RowKey("q", 0)]
    assert [*located(rows, wanted)] == [(1, wanted[0]), (2, wanted[1])]
    assert [*located(rows, [RowKey("p", 10, NOON_NS + 60 * 10**9)])] == []
