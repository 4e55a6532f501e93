"""A file is deleted only if it is still the one that was written here."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.output_file import Existing, FileIdentity, OutputPath
from fte_sniff.recording.writer import RecordingWriter
from tests.recording.conftest import some_rows
from tests.support.columns import in_columns

PORT = PortFacts("/dev/ttyUSB0", 115_200)
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
