"""One capture in one file or many: rotation, write errors, limits, triggers."""

import errno
import os
import re
import shutil
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from fte_sniff.errors import FileError
from fte_sniff.protocol import Gap, GapKind, PortEvent, PortEventKind, Row
from fte_sniff.protocol.rows import Bools, Rows
from fte_sniff.recording import recorder as recorder_module
from fte_sniff.recording.metadata import (
    GAP_NAME,
    LEFT_OUT_NAME,
    NEXT_NAME,
    PortFacts,
    gap_from_metadata,
    gap_to_metadata,
    library_name,
)
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.reader import RecordingReader
from fte_sniff.recording.recorder import MAX_PENDING, Recorder
from fte_sniff.recording.retention import OnFull, RecordingOptions, TriggerWindow
from tests.examples import examples
from tests.recording.conftest import START, STEP, file_size_limit, some_rows, unprivileged
from tests.slow import crossed
from tests.support.columns import in_columns
from tests.support.recorded_rows import events_in

PORT = PortFacts("/dev/ttyUSB0", 115_200)
ALL = RecordingOptions(min_free_bytes=0)


def _metadata(path: Path) -> list[tuple[str, dict[str, str]]]:
    with path.open("rb") as file:
        return [(one.name, one.metadata) for one in make_reader(file).iter_metadata()]


def _named(path: Path, name: str) -> list[dict[str, str]]:
    return [metadata for found, metadata in _metadata(path) if found == name]


def _rows(path: Path) -> list[Row]:
    """The rows of a file that is valid for the mcap package too."""
    with path.open("rb") as file:
        assert make_reader(file, validate_crcs=True).get_summary() is not None
    reader = RecordingReader(path)
    rows = list(reader)
    assert (reader.ending, reader.losses) == ("", ())
    return rows


def _files(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.mcap"))


def _record(recorder: Recorder, batches: Sequence[Sequence[Row]]) -> None:
    for batch in batches:
        recorder.write(in_columns(batch))
        recorder.flush()


@pytest.mark.parametrize("every_s", [60.0, 3600.0])
def test_flush_is_due_after_the_interval(tmp_path: Path, every_s: float) -> None:
    options = replace(ALL, flush_every_s=every_s)
    recorder = Recorder(tmp_path / "x.mcap", (PORT,), options=options)
    flushed = []
    for number, share in enumerate((0.0, 0.5, 0.99, 1.0, 1.5, 2.5, 2.6, 3.5)):
        recorder.write(in_columns(some_rows(number + 1)[number:]))
        # Intervals that are long, because a slow flush moves the next one.
        recorder.flush_if_due(START + round(share * every_s * 1e9))
        flushed.append(recorder.unflushed_rows == 0)
    recorder.close()
    assert flushed == [True, False, False, True, False, True, False, True]


def test_flush_is_due_when_many_rows_wait(tmp_path: Path) -> None:
    rows, path = some_rows(2 * MAX_PENDING + 5), tmp_path / "x.mcap"
    event = PortEvent(START, PORT.name, PortEventKind.OPENED, "")
    recorder = Recorder(path, (PORT,), options=ALL)
    recorder.write(in_columns(rows[:3], event))
    recorder.write(in_columns(rows[3:-1]))
    assert recorder.unflushed_rows == 4
    recorder.write(in_columns(rows[-1:]))
    assert recorder.unflushed_rows == 5
    recorder.close()
    assert _rows(path) == rows
    assert events_in(RecordingReader(path)) == [event]
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) == 3


@examples(25)
@given(
    sizes=st.lists(st.integers(1, 60), min_size=1, max_size=8),
    most=st.integers(1, 70),
    rotate_bytes=st.sampled_from([None, 1, 25_000]),
    rotate_s=st.sampled_from([None, 0.01, 0.05]),
    cut=st.integers(0, 5),
)
def test_no_row_is_doubled_or_lost_unreported_by_a_flush_amid_a_batch(
    tmp_path_factory: pytest.TempPathFactory,
    sizes: list[int],
    most: int,
    rotate_bytes: int | None,
    rotate_s: float | None,
    cut: int,
) -> None:
    folder, rows, start = tmp_path_factory.mktemp("amid"), some_rows(sum(sizes)), 0
    options = replace(ALL, rotate_bytes=rotate_bytes, rotate_s=rotate_s)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(recorder_module, "MAX_PENDING", most)
        patched.setattr(recorder_module, "RETRY_S", 0.0)
        recorder = Recorder(folder / "x.mcap", [PORT], options=options)
        for number, size in enumerate(sizes):
            with file_size_limit(recorder.path.stat().st_size) if number == cut else nullcontext():
                recorder.write(in_columns(rows[start : start + size]))
            start += size
            assert recorder.unflushed_rows < most
        recorder.close()
    found = [row for file in sorted(_files(folder), key=_part) for row in _rows(file)]
    assert found == [row for row in rows if row in found]
    if len(found) == len(rows):
        assert recorder.failure is None
    else:  # the small file was followed by one that was as small
        assert cut < len(sizes)
        assert str(recorder.failure).startswith(f"{len(rows) - len(found):,} rows ")


@pytest.fixture
def no_backoff(monkeypatch: pytest.MonkeyPatch) -> None:
    """The next attempt to record is made at once."""
    monkeypatch.setattr(recorder_module, "RETRY_S", 0.0)
    monkeypatch.setattr(recorder_module, "MAX_RETRY_S", 0.0)


@examples(20)
@given(
    sizes=st.lists(st.integers(1, 60), min_size=1, max_size=12),
    rotate=st.sampled_from(
        [("bytes", 1), ("bytes", 25_000), ("s", 0.01), ("s", 0.05), ("s", 9.0), ("index", 8_600)]
    ),
    ports=st.integers(1, 2),
)
def test_no_row_is_lost_or_doubled_by_rotation(
    tmp_path_factory: pytest.TempPathFactory,
    sizes: list[int],
    rotate: tuple[str, float],
    ports: int,
) -> None:
    folder = tmp_path_factory.mktemp("rotation")
    what, limit = rotate
    options = replace(ALL, rotate_bytes=int(limit) if what == "bytes" else None)
    options = replace(options, rotate_s=limit if what == "s" else None)
    options = replace(options, max_index_bytes=int(limit) if what == "index" else None)
    streams = [some_rows(sum(sizes), f"port{n}", START + n) for n in range(ports)]
    recorder = Recorder(folder / "x.mcap", [PORT], options=options)
    start = 0
    for size in sizes:
        _record(recorder, [[row for stream in streams for row in stream[start : start + size]]])
        start += size
    recorder.close()
    assert recorder.failure is None
    files = _files(folder)
    names = [f"x_{n:05}.mcap" for n in range(1, len(files) + 1)]
    if what == "index":
        names[0] = "x.mcap"
    assert [file.name for file in files] == names
    found = [row for file in files for row in _rows(file)]
    for stream in streams:
        assert [row for row in found if row.port == stream[0].port] == stream
    assert len(found) == len(streams) * len(streams[0])
    for before, after in pairwise(files):
        assert _named(before, NEXT_NAME) == [{"file": after.name}]
        assert RecordingReader(before).next_path == after
        (facts,) = _named(after, "fte-sniff")
        assert facts["previous"] == before.name
    if limit == 1:
        assert len(files) == len(sizes) + 1


@examples(20)
@given(
    sizes=st.lists(st.integers(1, 60), min_size=1, max_size=12),
    steps=st.integers(1, 70),
    flushes=st.booleans(),
)
def test_a_file_that_rotates_by_time_ends_at_that_time(
    tmp_path_factory: pytest.TempPathFactory, sizes: list[int], steps: int, *, flushes: bool
) -> None:
    """However the rows come, and however seldom they are flushed."""
    folder = tmp_path_factory.mktemp("rotation")
    rows = some_rows(sum(sizes))
    options = replace(ALL, rotate_s=steps * STEP / 1e9)
    recorder = Recorder(folder / "x.mcap", [PORT], options=options)
    start = 0
    for size in sizes:
        recorder.write(in_columns(rows[start : start + size]))
        start += size
        if flushes:
            recorder.flush()
    recorder.close()
    found = [_rows(file) for file in _files(folder)]
    expected = [rows[first : first + steps] for first in range(0, len(rows), steps)]
    assert [one for one in found if one] == expected


def test_a_file_with_only_a_port_event_ends_at_its_time_too(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "x.mcap", [PORT], options=replace(ALL, rotate_s=10 * STEP / 1e9))
    recorder.write(in_columns(PortEvent(START, PORT.name, PortEventKind.OPENED, "")))
    rows = some_rows(25, start=START + 10 * STEP)
    recorder.write(in_columns(rows))
    recorder.close()
    found = [_rows(file) for file in _files(tmp_path)]
    assert found == [[], rows[:10], rows[10:20], rows[20:]]


def test_a_capture_without_rotation_is_one_file_of_the_given_name(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "x.mcap", [PORT], options=ALL)
    _record(recorder, [some_rows(30)])
    recorder.close()
    recorder.close()
    assert [path.name for path in _files(tmp_path)] == ["x.mcap"]
    assert "part" not in _named(tmp_path / "x.mcap", "fte-sniff")[0]


def test_a_sequence_that_is_there_is_not_mixed_with_another(tmp_path: Path) -> None:
    options = replace(ALL, rotate_bytes=1)
    (tmp_path / "x_00002.mcap").write_bytes(b"precious")
    named = rf"^{re.escape(str(tmp_path / 'x.mcap'))}"
    for one in (options, ALL):
        with pytest.raises(FileError, match=rf"{named}: x_00002\.mcap exists already, .* --force"):
            Recorder(tmp_path / "x.mcap", [PORT], options=one)
    (tmp_path / "x.mcap").write_bytes(b"precious")
    with pytest.raises(FileError, match=rf"{named} exists already; .* --force"):
        Recorder(tmp_path / "x.mcap", [PORT], options=ALL)
    (tmp_path / "x.mcap").unlink()
    numbered = Recorder(tmp_path / "x.mcap", [PORT], options=options, existing=Existing.NUMBER)
    numbered.close()
    assert numbered.path.name == "x-2_00001.mcap"
    replacing = Recorder(tmp_path / "x.mcap", [PORT], options=options, existing=Existing.REPLACE)
    _record(replacing, [some_rows(5)])
    replacing.close()
    assert (tmp_path / "x_00002.mcap").read_bytes() != b"precious"


def test_a_file_that_may_not_grow_is_followed_by_another_and_no_row_is_lost(
    tmp_path: Path,
) -> None:
    rows = some_rows(2000)
    recorder = Recorder(tmp_path / "x.mcap", [PORT], options=ALL)
    _record(recorder, [rows[:1500]])
    with file_size_limit((tmp_path / "x.mcap").stat().st_size + 100):
        _record(recorder, [rows[1500:1600]])
    _record(recorder, [rows[1600:]])
    recorder.close()
    stopped, goes_on = recorder.changes()
    assert stopped.path is None
    assert "recording stopped" in str(stopped.failure)
    assert goes_on.path == tmp_path / "x_00002.mcap"
    assert recorder.failure is None
    assert _rows(tmp_path / "x.mcap") + _rows(tmp_path / "x_00002.mcap") == rows


@pytest.mark.usefixtures("no_backoff")
@pytest.mark.parametrize("way", ["deleted", "moved", "folder"])
def test_a_file_that_is_deleted_or_moved_leaves_a_gap(tmp_path: Path, way: str) -> None:
    folder = tmp_path / "here"
    folder.mkdir()
    rows = some_rows(60)
    recorder = Recorder(folder / "x.mcap", [PORT], options=ALL)
    _record(recorder, [rows[:20]])
    if way == "deleted":
        (folder / "x.mcap").unlink()
    elif way == "moved":
        (folder / "x.mcap").rename(tmp_path / "moved.mcap")
    else:
        shutil.rmtree(folder)
    _record(recorder, [rows[20:30]])
    first = recorder.changes()
    assert "recording stopped" in str(first[0].failure)
    if way == "folder":
        assert len(first) == 1
        _record(recorder, [rows[30:40]])
        folder.mkdir()
        recorder.flush()
    _record(recorder, [rows[40:]])
    recorder.close()
    (file,) = _files(folder)
    assert file.name == "x_00002.mcap"
    assert _rows(file) == rows[40:]
    (gap,) = _named(file, GAP_NAME)
    assert gap["rows"] == ("40" if way == "folder" else "30")
    assert gap["from"].startswith("2026-02-02")
    assert f"{gap['rows']} rows and port events" in str(recorder.failure)
    assert "\n" not in str(recorder.failure)


@pytest.mark.parametrize("left", [0, 3000])
def test_a_file_that_another_program_cuts_off_leaves_a_gap(tmp_path: Path, left: int) -> None:
    rows = some_rows(60)
    recorder = Recorder(tmp_path / "x.mcap", [PORT], options=ALL)
    _record(recorder, [rows[:20]])
    os.truncate(tmp_path / "x.mcap", left)
    _record(recorder, [rows[20:40], rows[40:]])
    recorder.close()
    assert (tmp_path / "x.mcap").stat().st_size == left
    assert _rows(tmp_path / "x_00002.mcap") == rows[20:]
    (gap,) = _named(tmp_path / "x_00002.mcap", GAP_NAME)
    assert gap["rows"] == "20"
    assert "20 rows and port events" in str(recorder.failure)
    assert "another program cut off" in str(recorder.failure)


def test_a_port_event_in_a_file_that_is_cut_off_is_reported(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "x.mcap", [PORT], options=ALL)
    recorder.write(in_columns(PortEvent(START, PORT.name, PortEventKind.OPENED, "")))
    recorder.flush()
    os.truncate(tmp_path / "x.mcap", 0)
    recorder.close()
    assert "1 rows and port events from 2026-02-02" in str(recorder.failure)


@contextmanager
def _small_disk(folder: Path, size: str) -> Iterator[Path]:
    """A file system of its own, of a few hundred kB."""
    folder.mkdir()
    made = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder], capture_output=True
    )
    if made.returncode:
        pytest.skip("mounting a small file system needs to be root")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", folder], check=True)


@pytest.mark.usefixtures("no_backoff")
def test_a_full_disk_leaves_valid_files_and_recording_goes_on_when_there_is_space(
    tmp_path: Path,
) -> None:
    batches = [some_rows(500, start=START + n * 500 * STEP) for n in range(14)]
    with _small_disk(tmp_path / "small", "300k") as folder:
        ballast = folder / "ballast"
        ballast.write_bytes(bytes(150_000))
        recorder = Recorder(folder / "x.mcap", [PORT], options=ALL)
        _record(recorder, batches[:10])
        stopped = recorder.changes()
        assert "the disk is full" in str(stopped[0].failure)
        before = _rows(folder / "x.mcap")
        assert before == [row for batch in batches[:10] for row in batch][: len(before)]
        assert len(before) % 500 == 0
        ballast.unlink()
        recorder.flush()
        assert recorder.changes()[-1].path is not None
        _record(recorder, batches[10:])
        recorder.close()
        files = _files(folder)
        found = [row for file in files for row in _rows(file)]
        reported = [gap for file in files for gap in _named(file, GAP_NAME)]
        assert sum(int(gap["rows"]) for gap in reported) + len(found) == 14 * 500
        assert found[: len(before)] == before
        assert found[-2000:] == [row for batch in batches[10:] for row in batch]
        assert "were not recorded: recording stopped: the disk is full" in str(recorder.failure)


def test_the_oldest_of_our_own_files_is_deleted_for_space_and_no_other(tmp_path: Path) -> None:
    batches = [some_rows(300, start=START + n * 300 * STEP) for n in range(60)]
    with _small_disk(tmp_path / "small", "400k") as folder:
        for name in ("w_00001.mcap", "x_0.mcap", "y.mcap"):
            (folder / name).write_bytes(b"precious")
        options = replace(
            ALL, on_full=OnFull.ROTATE_OLDEST, rotate_bytes=60_000, min_free_bytes=120_000
        )
        recorder = Recorder(folder / "x.mcap", [PORT], options=options)
        _record(recorder, batches)
        recorder.close()
        assert recorder.failure is None
        assert all(change.failure is None for change in recorder.changes())
        for name in ("w_00001.mcap", "x_0.mcap", "y.mcap"):
            assert (folder / name).read_bytes() == b"precious"
        files = sorted(folder.glob("x_0????.mcap"))
        assert files[0].name != "x_00001.mcap"
        assert len(files) >= 2
        everything = [row for batch in batches for row in batch]
        found = [row for file in files for row in _rows(file)]
        assert found == everything[-len(found) :]


@pytest.mark.parametrize("rotate_bytes", [60_000, None])
def test_a_disk_without_any_space_left_costs_old_files_only(
    tmp_path: Path, rotate_bytes: int | None
) -> None:
    batches = [some_rows(500, start=START + n * 500 * STEP) for n in range(60)]
    with _small_disk(tmp_path / "small", "300k") as folder:
        options = replace(ALL, on_full=OnFull.ROTATE_OLDEST, rotate_bytes=rotate_bytes)
        options = replace(options, max_bytes=500_000)
        recorder = Recorder(folder / "x.mcap", [PORT], options=options)
        _record(recorder, batches[:30])
        with suppress(OSError):  # another program takes the rest of the disk
            (folder / "ballast").write_bytes(bytes(60_000))
        _record(recorder, batches[30:])
        recorder.close()
        assert recorder.failure is None
        everything = [row for batch in batches for row in batch]
        found = [row for file in _files(folder) for row in _rows(file)]
        assert found == everything[-len(found) :]
        outcome = recorder.outcome
        assert outcome.deleted_rows + len(found) == len(everything)
        assert outcome.deleted_files > 3


LIMITED = RecordingOptions(
    min_free_bytes=0, on_full=OnFull.ROTATE_OLDEST, rotate_bytes=1, max_bytes=100_000
)


def _batches(numbers: range) -> list[list[Row]]:
    return [some_rows(300, start=START + n * 300 * STEP) for n in numbers]


@pytest.mark.parametrize("is_closed", [True, False])
def test_another_file_on_the_name_of_ours_is_not_deleted(tmp_path: Path, is_closed: bool) -> None:
    recorder = Recorder(tmp_path / "x.mcap", [PORT], options=LIMITED)
    other = tmp_path / "other"
    other.write_bytes(b"precious")
    _record(recorder, _batches(range(1)))
    taken = tmp_path / "x_00001.mcap" if is_closed else recorder.path
    other.replace(taken)
    _record(recorder, _batches(range(1, 12)))
    recorder.close()
    assert taken.read_bytes() == b"precious"
    assert recorder.outcome.deleted_files > 0
    assert recorder.outcome.first != taken
    ours = [path for path in _files(tmp_path) if path != taken]
    assert sum(path.stat().st_size for path in ours) < 100_000 + 40_000


def test_files_that_are_touched_count_for_the_limit_and_are_deleted(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "x.mcap", [PORT], options=LIMITED)
    for batch in _batches(range(12)):
        _record(recorder, [batch])
        for path in _files(tmp_path):
            os.utime(path, ns=(1, 1))
    recorder.close()
    assert not (tmp_path / "x_00001.mcap").exists()
    assert sum(path.stat().st_size for path in _files(tmp_path)) < 100_000 + 40_000


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give its files away")
def test_files_that_cannot_be_deleted_stop_the_recording_at_its_limit(tmp_path: Path) -> None:
    """In a sticky folder, files of others can be read and not deleted."""
    tmp_path.chmod(0o1777)
    for parent in tmp_path.parents[:3]:
        parent.chmod(parent.stat().st_mode | 0o011)
    library_name()  # read once: the installed package may be closed to others
    with unprivileged():
        recorder = Recorder(tmp_path / "x.mcap", [PORT], options=LIMITED)
        for batch in _batches(range(12)):
            _record(recorder, [batch])
            os.seteuid(0)
            for path in _files(tmp_path):
                os.chown(path, 0, 0)
                path.chmod(0o644)
            os.seteuid(65_534)
        recorder.close()
    failures = [str(change.failure) for change in recorder.changes() if change.failure]
    assert len(failures) == 1
    oldest = tmp_path / "x_00001.mcap"
    assert f"{oldest} cannot be deleted: Operation not permitted" in failures[0]
    assert oldest.exists()
    assert sum(path.stat().st_size for path in _files(tmp_path)) < 100_000 + 40_000


@pytest.mark.parametrize(
    ("on_full", "advice"),
    [
        (OnFull.STOP, "or delete the oldest files with --on-full rotate-oldest"),
        (OnFull.ROTATE_OLDEST, "no older file of this capture is left to delete"),
    ],
)
def test_the_limit_of_all_files_stops_the_recording_and_is_reported(
    tmp_path: Path, on_full: OnFull, advice: str
) -> None:
    options = RecordingOptions(
        min_free_bytes=0, max_bytes=60_000, on_full=on_full, rotate_bytes=1_000_000
    )
    batches = [some_rows(300, start=START + n * 300 * STEP) for n in range(8)]
    recorder = Recorder(tmp_path / "x.mcap", [PORT], options=options)
    _record(recorder, batches)
    recorder.close()
    (change,) = recorder.changes()
    assert "its files have reached 60 kB (--max-size)" in str(change.failure)
    assert advice in str(change.failure)
    (file,) = _files(tmp_path)
    kept = _rows(file)
    assert kept == [row for batch in batches for row in batch][: len(kept)]
    assert file.stat().st_size < 90_000
    assert f"{8 * 300 - len(kept):,} rows" in str(recorder.failure)


def test_a_disk_without_space_is_reported_before_a_file_is_made(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="--min-free"):
        Recorder(tmp_path / "x.mcap", [PORT], options=RecordingOptions(min_free_bytes=2**60))
    assert _files(tmp_path) == []


@pytest.mark.usefixtures("no_backoff")
@pytest.mark.parametrize(
    ("number", "call"),
    crossed([errno.EIO, errno.EDQUOT, errno.ENOSPC], ["pwrite", "fdatasync", "ftruncate"]),
)
def test_whatever_a_disk_refuses_the_file_stays_valid(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, call: str
) -> None:
    """The n-th system call of a flush is refused, for each n; then the disk works again."""
    rows = some_rows(90)
    real: Callable[..., object] = getattr(os, call)
    for nth in range(1, 8):
        folder = tmp_path / str(nth)
        folder.mkdir()
        recorder = Recorder(folder / "x.mcap", [PORT], options=ALL)
        _record(recorder, [rows[:30]])
        calls = 0

        def refuse(*given: object) -> object:
            nonlocal calls
            calls += 1
            if calls == nth:  # noqa: B023
                raise OSError(number, os.strerror(number))
            return real(*given)

        with monkeypatch.context() as patched:
            patched.setattr(os, call, refuse)
            _record(recorder, [rows[30:60]])
        _record(recorder, [rows[60:]])
        recorder.close()
        found = [row for file in sorted(_files(folder), key=_part) for row in _rows(file)]
        assert found == rows
        assert recorder.failure is None


def _part(path: Path) -> str:
    return path.stem


def _matches(rows: Rows) -> Bools:
    found: Bools = rows.offset % 97 == 0
    return found


@examples(25)
@given(
    sizes=st.lists(st.integers(1, 80), min_size=1, max_size=10),
    before=st.integers(0, 40),
    after=st.integers(0, 40),
)
def test_a_trigger_keeps_exactly_its_window(
    tmp_path_factory: pytest.TempPathFactory, sizes: list[int], before: int, after: int
) -> None:
    path = tmp_path_factory.mktemp("trigger") / "x.mcap"
    rows = some_rows(sum(sizes))
    around = TriggerWindow(before * STEP / 1e9, after * STEP / 1e9)
    options = replace(ALL, trigger_window=around)
    event = PortEvent(START, PORT.name, PortEventKind.OPENED, "")
    with_event = Recorder(path, [PORT], options=options, select=_matches)
    with_event.write(in_columns(event))
    start = 0
    for size in sizes:
        _record(with_event, [rows[start : start + size]])
        start += size
    with_event.close()
    picked = [row.t_ns or 0 for row in rows if row.offset % 97 == 0]
    wanted = [
        row
        for row in rows
        if any(t - before * STEP <= (row.t_ns or 0) <= t + after * STEP for t in picked)
    ]
    assert _rows(path) == wanted
    assert events_in(RecordingReader(path)) == [event]
    reported = _named(path, LEFT_OUT_NAME)
    assert sum(int(one["rows"]) for one in reported) == len(rows) - len(wanted)


def test_rows_that_wait_for_a_trigger_are_limited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fte_sniff.recording.retention.MAX_WAITING_ROWS", 50)
    rows = some_rows(400)
    options = replace(ALL, trigger_window=TriggerWindow(1e6, 0))
    recorder = Recorder(
        tmp_path / "x.mcap",
        [PORT],
        options=options,
        select=lambda given: given.offset == rows[300].offset,
    )
    _record(recorder, [rows[start : start + 10] for start in range(0, len(rows), 10)])
    recorder.close()
    assert _rows(tmp_path / "x.mcap") == rows[250:301]
    assert sum(int(one["rows"]) for one in _named(tmp_path / "x.mcap", LEFT_OUT_NAME)) == 349


@pytest.mark.parametrize(
    "changed",
    [
        {"rows": "0"},
        {"rows": "-1"},
        {"rows": "9" * 5000},
        {"rows": "٣"},
        {"from": "yesterday"},
        {"from": "2026-02-31T00:00:00.000000000Z"},
        {"to": "1999-01-01T00:00:00.000000000Z"},
    ],
)
def test_metadata_that_makes_no_sense_is_not_a_gap(changed: dict[str, str]) -> None:
    gap = Gap(GapKind.WRITE_ERROR, 3, START, START + 5, "why")
    items = gap_to_metadata(gap)
    assert gap_from_metadata(GAP_NAME, items) == gap
    assert gap_from_metadata(LEFT_OUT_NAME, items) == gap._replace(kind=GapKind.LEFT_OUT)
    assert gap_from_metadata(NEXT_NAME, items) is None
    assert gap_from_metadata(GAP_NAME, items | changed) is None
