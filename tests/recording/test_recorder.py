"""Files of one capture: rotation, retention, and gaps where the disk refuses them."""

from __future__ import annotations

import shutil
import signal
from collections import namedtuple
from collections.abc import Iterator
from pathlib import Path

import pytest

from fte_sniff.errors import FileError, size_text
from fte_sniff.protocol.items import Gap, GapKind
from fte_sniff.protocol.rows import Row, Rows
from fte_sniff.recording import recorder as recorder_module
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.reader import Recording
from fte_sniff.recording.recorder import Recorder, RecordingOptions
from fte_sniff.recording.writer import RecordingWriter
from tests.recording.conftest import file_size_limit
from tests.recording.samples import (
    BOTH,
    EVENTS,
    FACTS,
    FIRST,
    START,
    STEP,
    events_in,
    flush_each,
    rows_in,
    some_rows,
)
from tests.support.columns import rows_from

ROTATED = RecordingOptions(rotate_bytes=15_000)


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The next attempt after a failure is made at the next flush."""
    monkeypatch.setattr(recorder_module, "RETRY_S", 0.0)


@pytest.fixture
def sizes_are_limited() -> Iterator[None]:
    """A write beyond the limit of a file's size is an error, not a signal."""
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    yield
    signal.signal(signal.SIGXFSZ, before)


@pytest.fixture
def free_space(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The free bytes of the disk: the last number."""
    usage = namedtuple("usage", "total used free")
    found = [10**12]
    monkeypatch.setattr(shutil, "disk_usage", lambda _path: usage(10**12, 0, found[-1]))
    return found


@pytest.fixture
def nothing_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """No row waits for the next file."""
    monkeypatch.setattr(recorder_module, "MOST_WAITING", 0)


def files_in(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.mcap"))


def all_rows(folder: Path) -> list[Row]:
    """The rows of all files, in the order of their names."""
    return [row for path in files_in(folder) for row in rows_in(path)]


def test_rotated_files_have_all_rows_and_name_each_other(tmp_path: Path) -> None:
    rows = some_rows(900, BOTH)
    recorder = Recorder(tmp_path / "x.mcap", BOTH, FACTS, options=ROTATED)
    flush_each(recorder, rows)
    recorder.write(*EVENTS)
    recorder.close()
    files = files_in(tmp_path)
    assert len(files) > 2
    assert all_rows(tmp_path) == rows
    assert events_in(files[-1]) == EVENTS
    for number, (path, following) in enumerate(zip(files, [*files[1:], None], strict=True), 1):
        recording = Recording(path)
        assert path.name == f"x_{number:05}.mcap"
        assert recording.is_whole
        assert path.stat().st_size < 30_000
        assert recording.find_next() == following
        assert recording.facts["part"] == str(number)
        assert recording.facts.get("previous") == (files[number - 2].name if number > 1 else None)
    assert recorder.failure is None
    assert recorder.files == files
    assert recorder.path == files[-1]


def test_a_file_begins_after_a_time(tmp_path: Path) -> None:
    options = RecordingOptions(rotate_s=100 * STEP / 1e9)
    recorder = Recorder(tmp_path / "x.mcap", [FIRST], options=options)
    flush_each(recorder, some_rows(240))
    assert len(files_in(tmp_path)) == 3
    recorder.close()


def test_what_is_shown_at_once_is_on_the_disk_when_its_time_has_come(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, rows, syncs = tmp_path / "x.mcap", some_rows(20), list[int]()
    recorder = Recorder(path, [FIRST])
    monkeypatch.setattr("fte_sniff.recording.writer.sync_data", syncs.append)
    recorder.flush_if_due(START, at_once=True)
    assert not syncs, "the head is on the disk"
    recorder.write(rows_from(rows))
    recorder.flush_if_due(START + 10**9 - 1, at_once=True)
    assert (rows_in(path), syncs) == (rows, [])
    recorder.flush_if_due(START + 10**9, at_once=True)
    assert syncs
    recorder.close()


def test_many_rows_are_flushed_before_their_time(tmp_path: Path) -> None:
    path, rows = tmp_path / "x.mcap", rows_from(some_rows(1000))
    recorder = Recorder(path, [FIRST])
    many = Rows.concat([rows] * 40)
    recorder.write(many)
    assert recorder.unflushed_rows == len(many) % recorder_module.MOST_ROWS
    recorder.close()
    assert Recording(path).count == len(many)


def test_the_newest_files_are_kept(tmp_path: Path) -> None:
    rows = some_rows(4000, BOTH)
    options = RecordingOptions(keep_bytes=80_000, rotate_bytes=15_000)
    recorder = Recorder(tmp_path / "x.mcap", BOTH, options=options)
    for start in range(0, len(rows), 40):
        flush_each(recorder, rows[start : start + 40])
        assert sum(path.stat().st_size for path in files_in(tmp_path)) < 90_000
    recorder.close()
    left = all_rows(tmp_path)
    assert left == rows[-len(left) :]
    assert 0 < len(left) < len(rows)
    assert [path for path in recorder.files if path.exists()] == files_in(tmp_path)


def test_a_file_of_somebody_else_is_not_deleted(tmp_path: Path) -> None:
    rows = some_rows(4000, BOTH)
    options = RecordingOptions(keep_bytes=60_000, rotate_bytes=15_000)
    recorder = Recorder(tmp_path / "x.mcap", BOTH, options=options)
    flush_each(recorder, rows[:400])
    first, second = files_in(tmp_path)[:2]
    first.unlink()
    first.write_bytes(b"precious")
    second.rename(tmp_path / "mine")
    second.symlink_to(tmp_path / "mine")
    flush_each(recorder, rows[400:])
    recorder.close()
    assert len(recorder.files) - len(files_in(tmp_path)) > 1
    assert first.read_bytes() == b"precious"
    assert Recording(tmp_path / "mine").is_whole


def test_oldest_files_make_room_where_the_newest_are_kept(
    tmp_path: Path, free_space: list[int]
) -> None:
    rows = some_rows(2000, BOTH)
    options = RecordingOptions(keep_bytes=10**9, rotate_bytes=15_000, min_free_bytes=1000)
    recorder = Recorder(tmp_path / "x.mcap", BOTH, options=options)
    flush_each(recorder, rows[:1000])
    assert len(files_in(tmp_path)) > 3
    free_space.append(999)
    flush_each(recorder, rows[1000:1040])
    free_space.append(1000)
    flush_each(recorder, rows[1040:])
    recorder.close()
    left = all_rows(tmp_path)
    assert left == rows[-len(left) :]
    assert len(left) >= 1000
    assert (recorder.failure, [path for path in recorder.files if path.exists()]) == (
        None,
        files_in(tmp_path),
    )


@pytest.mark.usefixtures("nothing_waits")
def test_a_gap_is_reported_before_the_file_that_reports_it_is_deleted(
    tmp_path: Path, free_space: list[int]
) -> None:
    rows = some_rows(4000, BOTH)
    options = RecordingOptions(keep_bytes=60_000, rotate_bytes=15_000, min_free_bytes=1000)
    recorder = Recorder(tmp_path / "x.mcap", BOTH, options=options)
    flush_each(recorder, rows[:40])
    free_space.append(999)
    recorder.flush()
    recorder.write(rows_from(rows[40:60]))
    free_space.append(10**12)
    recorder.flush()
    seen: list[list[Gap]] = []
    for start in range(60, 4000, 40):
        flush_each(recorder, rows[start : start + 40])
        seen.append([gap for path in files_in(tmp_path) for gap in Recording(path).gaps()])
    recorder.close()
    assert len(recorder.files) - len(files_in(tmp_path)) > 10
    expected = Gap(GapKind.WRITE_ERROR, 20, rows[40].t_ns, rows[59].t_ns)
    assert all(gaps and all(gap[:4] == expected[:4] for gap in gaps) for gaps in seen)


@pytest.mark.parametrize("most", [0, 7, 100])
def test_rows_that_came_while_the_disk_was_full_are_in_the_next_file(
    tmp_path: Path, free_space: list[int], monkeypatch: pytest.MonkeyPatch, most: int
) -> None:
    monkeypatch.setattr(recorder_module, "MOST_WAITING", most)
    rows = some_rows(100)
    recorder = Recorder(tmp_path / "x.mcap", [FIRST], options=RecordingOptions(min_free_bytes=9))
    flush_each(recorder, rows[:40])
    free_space.append(8)
    recorder.flush()
    for row in rows[40:60]:
        recorder.write(rows_from([row]))
        recorder.flush()
    free_space.append(9)
    recorder.flush()
    flush_each(recorder, rows[60:])
    recorder.close()
    lost = max(0, 20 - most)
    assert all_rows(tmp_path) == rows[:40] + rows[40 + lost :]
    assert (recorder.failure is None) == (lost == 0)
    gaps = Recording(recorder.path).gaps()
    assert [gap.rows for gap in gaps] == ([lost] if lost else [])


@pytest.mark.usefixtures("nothing_waits")
def test_a_full_disk_leaves_a_gap_that_the_next_file_reports(
    tmp_path: Path, free_space: list[int]
) -> None:
    rows = some_rows(200)
    path = tmp_path / "x.mcap"
    recorder = Recorder(path, [FIRST], FACTS, options=RecordingOptions(min_free_bytes=10**6))
    flush_each(recorder, rows[:80])
    free_space.append(900_000)
    recorder.flush()
    assert "the disk has only 900 kB free (--min-free 1 MB)" in str(recorder.failure)
    assert "x.mcap is complete up to there (80 rows)" in str(recorder.failure)
    recorder.write(rows_from(rows[80:100]), EVENTS[1])
    recorder.flush()
    free_space.append(10**7)
    recorder.flush()
    flush_each(recorder, rows[100:])
    recorder.close()
    following = tmp_path / "x_00002.mcap"
    assert rows_in(path) + rows_in(following) == rows[:80] + rows[100:]
    (gap,) = Recording(following).gaps()
    assert gap[:2] == (GapKind.WRITE_ERROR, 20)
    assert (gap.start_ns, gap.end_ns) == (rows[80].t_ns, rows[99].t_ns)
    assert [event.detail for event in events_in(following)] == [EVENTS[1].detail]
    assert Recording(path).is_whole
    assert Recording(path).find_next() == following
    assert (recorder.files, recorder.is_stopped) == ([path, following], False)
    assert "x.mcap is complete up to there (80 rows)" in str(recorder.trouble)
    assert str(recorder.failure).startswith("20 rows from 2026-")


@pytest.mark.usefixtures("sizes_are_limited")
def test_rows_that_one_file_refuses_go_into_the_next(tmp_path: Path) -> None:
    path, rows = tmp_path / "x.mcap", some_rows(2000, BOTH)
    recorder = Recorder(path, BOTH)
    with file_size_limit(25_000):
        flush_each(recorder, rows)
        recorder.close()
    assert len(files_in(tmp_path)) > 2
    assert all_rows(tmp_path) == rows
    assert recorder.failure is None
    assert Recording(path).losses == []
    assert Recording(path).find_next() == tmp_path / "x_00002.mcap"


@pytest.mark.usefixtures("sizes_are_limited")
def test_what_no_file_takes_is_counted(tmp_path: Path) -> None:
    path, rows = tmp_path / "x.mcap", some_rows(100)
    recorder = Recorder(path, [FIRST])
    flush_each(recorder, rows[:40])
    with file_size_limit(100):
        recorder.write(rows_from(rows[40:60]), *EVENTS)
        recorder.flush()
        recorder.write(rows_from(rows[60:]))
        recorder.close()
    assert rows_in(path) == rows[:40]
    assert str(recorder.failure).startswith("60 rows from 2026-")
    assert "recorded: File too large" in str(recorder.failure)
    assert files_in(tmp_path) == [path]


def test_rows_of_a_deleted_file_are_a_gap(tmp_path: Path) -> None:
    path, rows = tmp_path / "x.mcap", some_rows(120)
    recorder = Recorder(path, [FIRST])
    flush_each(recorder, rows[:40])
    path.unlink()
    flush_each(recorder, rows[40:])
    recorder.close()
    (following,) = files_in(tmp_path)
    assert rows_in(following) == rows[40:]
    (gap,) = Recording(following).gaps()
    assert gap[:4] == (GapKind.WRITE_ERROR, 40, rows[0].t_ns, rows[39].t_ns)
    assert "was deleted, moved, replaced or cut off" in gap.reason


def test_a_capture_does_not_begin_on_a_full_disk(tmp_path: Path, free_space: list[int]) -> None:
    free_space.append(5)
    with pytest.raises(FileError, match=r"cannot be written: the disk has only 5 bytes free"):
        Recorder(tmp_path / "x.mcap", [FIRST], options=RecordingOptions(min_free_bytes=6))
    assert files_in(tmp_path) == []
    Recorder(tmp_path / "x.mcap", [FIRST]).close()


def test_files_of_an_earlier_capture_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    first, second = tmp_path / "x_00001.mcap", tmp_path / "x_00002.mcap"
    first.write_bytes(b"precious")
    with pytest.raises(FileError, match=r"x_00001\.mcap exists"):
        Recorder(path, [FIRST], options=ROTATED)
    first.unlink()
    RecordingWriter(second, [FIRST], {"previous": first.name, "start": "earlier"}).close()
    before = second.read_bytes()
    recorder = Recorder(path, BOTH, options=ROTATED)
    rows = some_rows(400, BOTH)
    flush_each(recorder, rows)
    recorder.close()
    assert second.read_bytes() == before
    assert recorder.path == tmp_path / "x_00002-2.mcap"
    assert rows_in(first) + rows_in(recorder.path) == rows
    assert Recording(first).find_next() == recorder.path
    recorder = Recorder(path, BOTH, options=ROTATED, existing=Existing.REPLACE)
    flush_each(recorder, rows)
    recorder.close()
    assert rows_in(first) + rows_in(second) == rows


@pytest.mark.parametrize(
    ("size", "text"),
    [(999, "999 bytes"), (999_600, "1 MB"), (1_230_000_000, "1.23 GB"), (5 * 10**12, "5 TB")],
)
def test_size_is_written_without_an_exponent(size: int, text: str) -> None:
    assert size_text(size) == text
