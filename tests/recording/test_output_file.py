"""Output files and streams: locks, names, replaced and removed files, pipes; own files deleted."""

import os
import socket
import stat
import subprocess
import sys
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import pytest
from mcap.reader import make_reader

from fte_sniff.errors import FileError
from fte_sniff.protocol import Row
from fte_sniff.recording import output_file
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.output_file import Existing, FileIdentity, OutputPath
from fte_sniff.recording.reader import RecordingReader
from fte_sniff.recording.recorder import Recorder
from fte_sniff.recording.writer import RecordingWriter
from tests.recording.conftest import file_size_limit, some_rows
from tests.support.columns import in_columns
from tests.waiting import BOUND_S

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


def test_what_is_being_recorded_to_is_not_replaced(tmp_path: Path, make_rows: Rows) -> None:
    path = tmp_path / "x.mcap"
    rows = make_rows(20)
    for existing in (Existing.REFUSE, Existing.REPLACE):
        with RecordingWriter(path, [PORT], existing=existing) as writer:
            writer.write(in_columns(rows[:10]))
            writer.flush()
            message = refused(path, Existing.REPLACE)
            assert "is being recorded to by another program; name another file" in message
            writer.write(in_columns(rows[10:]))
        assert list(RecordingReader(path)) == rows
    with RecordingWriter(path, [PORT], existing=Existing.REPLACE):
        pass
    assert list(RecordingReader(path)) == []
    assert files_in(tmp_path) == ["x.mcap"]


@pytest.mark.parametrize("existing", Existing)
def test_a_start_that_fails_changes_nothing(tmp_path: Path, existing: Existing) -> None:
    path = tmp_path / "x.mcap"
    if existing is Existing.REPLACE:
        path.write_bytes(b"precious")
    before = files_in(tmp_path)
    with file_size_limit(100):
        assert "cannot be written" in refused(path, existing)
    assert files_in(tmp_path) == before
    if existing is Existing.REPLACE:
        assert path.read_bytes() == b"precious"
        with RecordingWriter(path, [PORT], existing=existing):
            pass  # nothing holds the old file any more


def test_a_replaced_file_passes_on_its_permissions(tmp_path: Path) -> None:
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
def test_a_path_that_is_not_a_regular_file_is_refused(tmp_path: Path, existing: Existing) -> None:
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


def deletes_the_folder(path: Path) -> None:
    path.unlink()
    path.parent.rmdir()


@pytest.mark.parametrize(
    ("happens", "words"),
    [
        (deletes, "was deleted while it was being written; its 5 rows are lost"),
        (deletes_the_folder, "was deleted while it was being written; its 5 rows are lost"),
        (moves, "was moved or replaced"),
        (replaces, "was moved or replaced"),
    ],
)
@pytest.mark.parametrize("at_the_end", [False, True])
def test_a_file_that_is_deleted_or_moved_is_detected(
    tmp_path: Path, make_rows: Rows, happens: Callable[[Path], None], words: str, at_the_end: bool
) -> None:
    path = tmp_path / "sub" / "x.mcap"
    path.parent.mkdir()
    rows = make_rows(5)
    writer = RecordingWriter(path, [PORT])
    writer.write(in_columns(rows))
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


def _record(path: Path, rows: list[Row]) -> None:
    with RecordingWriter(path, [PortFacts(rows[0].port)]) as writer:
        for start in range(0, len(rows), 20):
            writer.write(in_columns(rows[start : start + 20]))
            writer.flush()


@pytest.mark.parametrize("reader_is_late", [False, True])
def test_a_named_pipe_brings_a_whole_recording(
    tmp_path: Path, make_rows: Rows, reader_is_late: bool
) -> None:
    rows = make_rows(60)
    pipe, copy = tmp_path / "pipe", tmp_path / "copy.mcap"
    os.mkfifo(pipe)
    late = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK) if not reader_is_late else None
    with RecordingWriter(pipe, [PortFacts(rows[0].port)]) as writer:
        assert writer.waits_for_reader == reader_is_late
        for start in range(0, 60, 20):
            writer.write(in_columns(rows[start : start + 20]))
            writer.flush()
        # All of it fits into a pipe.
        late = late or os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    with os.fdopen(late, "rb") as stream:
        content = stream.read()
    copy.write_bytes(content)
    reader = RecordingReader(copy)
    assert list(reader) == rows
    assert (reader.ending, reader.losses) == ("", ())
    package = make_reader(BytesIO(content), validate_crcs=True)
    summary = package.get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) == 3
    assert sum(1 for _ in package.iter_messages()) == 60


STANDARD = """
import sys
from pathlib import Path
from tests.recording.conftest import some_rows
from tests.recording.test_output_file import _record
_record(Path(sys.argv[1]), some_rows(60))
"""


@pytest.mark.parametrize("name", ["-", "/dev/stdout"])
def test_standard_output_into_a_pipe(tmp_path: Path, make_rows: Rows, name: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", STANDARD, name], stdout=subprocess.PIPE, check=True, timeout=BOUND_S
    )
    (tmp_path / "copy.mcap").write_bytes(done.stdout)
    assert list(RecordingReader(tmp_path / "copy.mcap")) == make_rows(60)


def test_a_pipe_without_reader_ends_in_one_line(tmp_path: Path, make_rows: Rows) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    writer = RecordingWriter(pipe, [PortFacts("p")])
    os.close(reader)
    writer.write(in_columns(make_rows(5)))
    with pytest.raises(
        FileError, match=r"pipe: its reader is gone; .* ended after 0 rows"
    ) as caught:
        writer.flush()
    assert "\n" not in str(caught.value)
    writer.close()
    assert pipe.is_fifo()


@pytest.mark.parametrize("is_long", [False, True])
def test_a_pipe_that_nobody_opens_is_reported(
    tmp_path: Path, make_rows: Rows, monkeypatch: pytest.MonkeyPatch, is_long: bool
) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    recorder = Recorder(pipe, [PortFacts("p")])
    if is_long:
        monkeypatch.setattr(output_file, "MAX_UNREAD", 1000)
    recorder.write(in_columns(make_rows(5)))
    recorder.flush()
    assert (recorder.failure is not None) == is_long
    recorder.write(in_columns(make_rows(1000)))
    recorder.close()
    assert "1,005 rows and port events from" in str(recorder.failure)
    assert f"no program has opened {pipe} for reading" in str(recorder.failure)


def test_a_terminal_is_refused() -> None:
    far, near = os.openpty()
    try:
        with pytest.raises(FileError, match="is a terminal"):
            RecordingWriter(Path(os.ttyname(near)), [PortFacts("p")])
    finally:
        os.close(far)
        os.close(near)


PRECIOUS = b"precious"


def _recorded(path: Path) -> FileIdentity:
    with RecordingWriter(path, [PORT]) as writer:
        writer.write(in_columns(some_rows()))
    assert writer.identity is not None
    return writer.identity


def _other_at(path: Path) -> None:
    other = path.with_suffix(".other")
    other.write_bytes(PRECIOUS)
    other.replace(path)


def _same_size_at(path: Path) -> None:
    """Another file of the same size, in the same inode if the system uses it again."""
    size = path.stat().st_size
    path.unlink()
    path.write_bytes(PRECIOUS.ljust(size, b"."))


def _overwrite(path: Path) -> None:
    path.write_bytes(PRECIOUS)


def _overwrite_the_end(path: Path) -> None:
    with path.open("r+b") as file:
        file.seek(-len(PRECIOUS), os.SEEK_END)
        file.write(PRECIOUS)


def _link_to_it(path: Path) -> None:
    path.rename(path.with_suffix(".moved"))
    path.symlink_to(path.with_suffix(".moved"))


def _pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


@pytest.mark.parametrize(
    "change",
    [_other_at, _same_size_at, _overwrite, _overwrite_the_end, _link_to_it, _pipe],
)
def test_another_file_is_left_alone(tmp_path: Path, change: Callable[[Path], None]) -> None:
    path = tmp_path / "x.mcap"
    identity = _recorded(path)
    change(path)
    names = sorted(tmp_path.iterdir())
    assert not identity.is_at(path)
    assert not identity.delete(path)
    assert sorted(tmp_path.iterdir()) == names


def _touch(path: Path) -> None:
    os.utime(path, ns=(1, 1))


def _chmod(path: Path) -> None:
    path.chmod(0o600)


def _hard_link(path: Path) -> None:
    path.with_name("kept").hardlink_to(path)


@pytest.mark.parametrize("change", [_touch, _chmod, _hard_link, lambda _path: None])
def test_the_own_file_is_deleted(tmp_path: Path, change: Callable[[Path], None]) -> None:
    path = tmp_path / "x.mcap"
    identity = _recorded(path)
    change(path)
    assert identity.delete(path)
    assert [one.name for one in tmp_path.iterdir() if one.name != "kept"] == []


def test_a_file_that_is_gone_is_not_deleted(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    identity = _recorded(path)
    path.unlink()
    assert not identity.delete(path)


@pytest.mark.parametrize("is_taken", [False, True])
def test_a_file_that_gets_the_name_in_the_last_moment_is_given_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_taken: bool
) -> None:
    """The moment is between the comparison and the rename."""
    path = tmp_path / "x.mcap"
    identity = _recorded(path)
    rename = Path.rename

    def late(self: Path, target: Path) -> Path:
        if self != path:
            return rename(self, target)
        _other_at(path)
        rename(self, target)
        if is_taken:
            path.write_bytes(b"newer")
        return target

    monkeypatch.setattr(Path, "rename", late)
    assert not identity.delete(path)
    assert path.read_bytes() == (b"newer" if is_taken else PRECIOUS)
    contents = {one.read_bytes() for one in tmp_path.iterdir()}
    assert contents == ({b"newer", PRECIOUS} if is_taken else {PRECIOUS})


def test_discarding_an_output_deletes_no_file_of_others(tmp_path: Path) -> None:
    output = OutputPath(tmp_path / "x.mcap", Existing.REFUSE)
    output.commit()
    _other_at(tmp_path / "x.mcap")
    output.discard()
    assert (tmp_path / "x.mcap").read_bytes() == PRECIOUS


def test_the_folder_is_synced_after_create_replace_and_delete(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[tuple[Path, list[str]]] = []
    fsync = os.fsync

    def logged(descriptor: int) -> None:
        folder = Path(f"/proc/self/fd/{descriptor}").readlink()
        if folder.is_dir():
            synced.append((folder, sorted(one.name for one in folder.iterdir())))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", logged)
    path = tmp_path / "x.mcap"
    identity = _recorded(path)
    assert synced == [(tmp_path, ["x.mcap"])]
    with RecordingWriter(path, [PORT], existing=Existing.REPLACE) as writer:
        assert synced[1:] == [(tmp_path, ["x.mcap"])]
    assert writer.identity not in (None, identity)
    assert writer.identity is not None
    assert writer.identity.delete(path)
    assert synced[2:] == [(tmp_path, [])]
