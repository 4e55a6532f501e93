"""Where a recording lies: held by one program alone, put in place whole, missed when it is gone."""

import resource
import socket
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from fte_sniff.errors import FileError
from fte_sniff.protocol import Row
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.reader import RecordingReader
from fte_sniff.recording.writer import RecordingWriter

Rows = Callable[..., list[Row]]
PORT = PortFacts("/dev/ttyUSB0", 115_200)


def files_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def refused(path: Path, existing: Existing = Existing.REFUSE) -> str:
    with pytest.raises(FileError) as caught:
        RecordingWriter(path, [PORT], existing=existing)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@contextmanager
def no_room() -> Iterator[None]:
    """In this context no file can become longer than 100 bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_what_is_being_recorded_to_is_not_replaced(tmp_path: Path, make_rows: Rows) -> None:
    path = tmp_path / "x.mcap"
    rows = make_rows(20)
    for existing in (Existing.REFUSE, Existing.REPLACE):
        with RecordingWriter(path, [PORT], existing=existing) as writer:
            writer.write(rows[:10])
            writer.flush()
            told = refused(path, Existing.REPLACE)
            assert "is being recorded to by another program; name another file" in told
            writer.write(rows[10:])
        assert list(RecordingReader(path)) == rows
    with RecordingWriter(path, [PORT], existing=Existing.REPLACE):
        pass
    assert list(RecordingReader(path)) == []
    assert files_in(tmp_path) == ["x.mcap"]


@pytest.mark.parametrize("existing", Existing)
def test_a_start_that_fails_leaves_all_as_it_was(tmp_path: Path, existing: Existing) -> None:
    path = tmp_path / "x.mcap"
    if existing is Existing.REPLACE:
        path.write_bytes(b"precious")
    before = files_in(tmp_path)
    with no_room():
        assert "cannot be written" in refused(path, existing)
    assert files_in(tmp_path) == before
    if existing is Existing.REPLACE:
        assert path.read_bytes() == b"precious"
        with RecordingWriter(path, [PORT], existing=existing):
            pass  # nothing holds the old file any more


def test_who_replaces_a_file_keeps_its_permissions(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(b"old")
    path.chmod(0o640)
    RecordingWriter(path, [PORT], existing=Existing.REPLACE).close()
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_a_new_file_has_the_permissions_of_any_new_file(tmp_path: Path) -> None:
    (tmp_path / "any").touch()
    RecordingWriter(tmp_path / "x.mcap", [PORT]).close()
    modes = {path.stat().st_mode for path in tmp_path.iterdir()}
    assert len(modes) == 1


def test_the_next_number_is_taken_where_that_was_asked_for(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_bytes(b"precious")
    writers = [
        RecordingWriter(tmp_path / "x.mcap", [PORT], existing=Existing.NUMBER) for _ in range(3)
    ]
    assert [writer.path.name for writer in writers] == ["x-2.mcap", "x-3.mcap", "x-4.mcap"]
    for writer in writers:
        writer.close()
        assert list(RecordingReader(writer.path)) == []
    assert (tmp_path / "x.mcap").read_bytes() == b"precious"


@pytest.mark.parametrize("existing", Existing)
def test_what_is_no_file_of_its_own_cannot_be_recorded(tmp_path: Path, existing: Existing) -> None:
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "socket"))
    (tmp_path / "target").write_bytes(b"precious")
    (tmp_path / "link").symlink_to("target")
    (tmp_path / "nowhere").symlink_to("absent")
    for name in ("socket", "link", "nowhere"):
        assert "not a regular file" in refused(tmp_path / name, existing)
    assert (tmp_path / "target").read_bytes() == b"precious"
    assert not (tmp_path / "absent").exists()


def deletes(path: Path) -> None:
    path.unlink()


def moves(path: Path) -> None:
    path.rename(path.with_name("moved.mcap"))


def replaces(path: Path) -> None:
    moves(path)
    path.write_bytes(b"another")


def takes_the_folder(path: Path) -> None:
    path.unlink()
    path.parent.rmdir()


@pytest.mark.parametrize(
    ("happens", "words"),
    [
        (deletes, "was deleted while it was being written; the 5 rows in it are lost"),
        (takes_the_folder, "was deleted while it was being written; the 5 rows in it are lost"),
        (moves, "was moved or replaced"),
        (replaces, "was moved or replaced"),
    ],
)
@pytest.mark.parametrize("at_the_end", [False, True])
def test_a_file_that_is_taken_away_is_missed(
    tmp_path: Path, make_rows: Rows, happens: Callable[[Path], None], words: str, at_the_end: bool
) -> None:
    path = tmp_path / "sub" / "x.mcap"
    path.parent.mkdir()
    rows = make_rows(5)
    writer = RecordingWriter(path, [PORT])
    writer.write(rows)
    writer.flush()
    happens(path)
    with pytest.raises(FileError, match=r"^recording stopped: ") as caught:
        writer.close() if at_the_end else writer.flush()
    assert words in str(caught.value)
    assert writer.failure is caught.value
    writer.close()
    moved = path.with_name("moved.mcap")
    if moved.exists():
        assert list(RecordingReader(moved)) == rows
