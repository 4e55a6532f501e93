"""A file that grows is valid at every moment: replayed writes, kills, refused writes."""

from __future__ import annotations

import errno
import io
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.records import Metadata

from fte_sniff.errors import FileError
from fte_sniff.protocol.rows import Row
from fte_sniff.recording import writer as writer_module
from fte_sniff.recording.reader import Recording
from fte_sniff.recording.writer import END, RecordingWriter
from tests.recording.conftest import file_size_limit
from tests.recording.samples import BOTH, FACTS, FIRST, flush_each, rows_in, rows_of, some_rows
from tests.support.columns import rows_from
from tests.support.recording_kill import kill_one

SIZE = 30
"""Rows of each flush."""


class Write(NamedTuple):
    """A write, or a cut of the file where `data` is None."""

    data: bytes | None
    offset: int


@pytest.fixture
def writes(monkeypatch: pytest.MonkeyPatch) -> list[Write]:
    """The writes of this test, as the system is given them."""
    found: list[Write] = []
    write_at, truncate = writer_module.write_at, os.ftruncate

    def noted(descriptor: int, data: bytes | memoryview, offset: int) -> int:
        found.append(Write(bytes(data), offset))
        return write_at(descriptor, data, offset)

    def noted_cut(descriptor: int, size: int) -> None:
        found.append(Write(None, size))
        truncate(descriptor, size)

    monkeypatch.setattr(writer_module, "write_at", noted)
    monkeypatch.setattr(os, "ftruncate", noted_cut)
    return found


def states(writes: list[Write]) -> Iterator[tuple[int, bool, bytes]]:
    """The file after each write, and in the middle of it: the number of whole writes."""
    content = bytearray()
    for number, (data, offset) in enumerate(writes, 1):
        if data is None:
            del content[offset:]
            yield number, True, bytes(content)
            continue
        content += bytes(max(0, offset - len(content)))
        for size in sorted({1, 4, 9, len(data) // 2, len(data)}):
            is_whole = size == len(data)
            if number > 1 or is_whole:
                content[offset : offset + size] = data[:size]
                yield number - (not is_whole), is_whole, bytes(content)


def messages_in(content: bytes, reader: type[SeekingReader | NonSeekingReader]) -> int:
    """The number of messages that the mcap package finds."""
    return sum(1 for _ in reader(io.BytesIO(content), validate_crcs=True).iter_messages())


def test_a_power_cut_between_any_writes_costs_at_most_the_last_flush(
    tmp_path: Path, writes: list[Write]
) -> None:
    """A cut within a write of few bytes, which a disk does at once, may leave a torn record."""
    path, copy, rows = tmp_path / "x.mcap", tmp_path / "copy.mcap", some_rows(200, BOTH)
    flushed: list[int] = []
    with RecordingWriter(path, BOTH, FACTS) as writer:
        assert len(writes) == 1, "the head is one write"
        for start in range(0, len(rows), SIZE):
            flush_each(writer, rows[start : start + SIZE], SIZE)
            flushed.append(len(writes))
        writer.write_metadata(Metadata("x", {"a": "b"}))
    for number, is_whole, content in states(writes):
        copy.write_bytes(content)
        least = min(len(rows), SIZE * sum(one <= number for one in flushed))
        found = rows_in(copy)
        assert found == rows[: len(found)]
        assert least <= len(found) <= least + SIZE
        if is_whole:
            assert Recording(copy).losses == []
            for reader in (SeekingReader, NonSeekingReader):
                assert messages_in(content, reader) == len(found)


@pytest.mark.program
def test_a_kill_at_any_time_leaves_a_file_that_opens_with_all_flushed_rows(tmp_path: Path) -> None:
    for number in range(6):
        left = kill_one(tmp_path / f"{number}.mcap", 0, number / 12, after_rows=number * 12)
        assert (left.problem, left.missing) == ("", 0)


def refused(writer: RecordingWriter, rows: list[Row]) -> str:
    """The error of a flush that the system refuses."""
    writer.write(rows_from(rows))
    with pytest.raises(FileError) as caught:
        writer.flush()
    writer.output.close()
    return str(caught.value)


def test_a_full_disk_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    path, rows = tmp_path / "x.mcap", some_rows(600, BOTH)
    writer = RecordingWriter(path, BOTH, FACTS)
    flush_each(writer, rows[:60], 60)
    before = path.read_bytes()
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        for limit in (1, 40, 700, 3000):
            with file_size_limit(len(before) + limit):
                writer.unflushed = []
                writer.write(rows_from(rows[60:]))
                with pytest.raises(FileError, match=r"is complete up to there \(60 rows\)"):
                    writer.flush()
            assert path.read_bytes() == before
    finally:
        signal.signal(signal.SIGXFSZ, handler)
    writer.output.close()
    assert rows_in(path) == rows[:60]


@pytest.mark.parametrize("written", range(4))
@pytest.mark.parametrize("share", [0, 0.5, 0.9])
def test_bytes_of_a_refused_chunk_that_stay_behind_the_end_are_not_read(
    written: int, share: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk takes some writes of a chunk, then a share of one, and does not cut off the file."""
    path, rows, write_at = tmp_path / "x.mcap", some_rows(600, BOTH), writer_module.write_at
    writer = RecordingWriter(path, BOTH, FACTS)
    flush_each(writer, rows[:60], 60)
    given: list[int] = []

    def refuse(*_call: object) -> int:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    def write_some(descriptor: int, data: bytes | memoryview, offset: int) -> int:
        given.append(offset)
        if len(given) != written + 1 or written == 3:
            return write_at(descriptor, data, offset)
        write_at(descriptor, data[: int(share * len(data))], offset)
        return refuse()

    monkeypatch.setattr(writer_module, "write_at", write_some)
    monkeypatch.setattr(os, "ftruncate", refuse)
    assert "Input/output error" in refused(writer, rows[60:])
    content, recording = path.read_bytes(), Recording(path)
    assert content[writer.size :].startswith(END)
    assert rows_of(recording.items()) == rows[:60]
    assert recording.losses == []
    assert messages_in(content, NonSeekingReader) == 60


@pytest.mark.parametrize(
    "change",
    [
        lambda path: path.unlink(),
        lambda path: path.rename(path.with_name("y")),
        lambda path: os.truncate(path, 500),
    ],
)
def test_a_file_that_another_program_takes_is_reported(change, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    path, rows = tmp_path / "x.mcap", some_rows()
    writer = RecordingWriter(path, [FIRST])
    flush_each(writer, rows[:30], 30)
    change(path)
    assert "was deleted, moved, replaced or cut off while" in refused(writer, rows[30:])
    assert writer.is_gone


@pytest.mark.parametrize("wait", range(3))
def test_a_file_that_is_cut_off_while_the_disk_is_awaited_is_reported(
    wait: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next write would make the file as long as it was, with a hole."""
    path, rows, sync_data = tmp_path / "x.mcap", some_rows(), writer_module.sync_data
    writer = RecordingWriter(path, [FIRST])
    flush_each(writer, rows[:30], 30)
    waits = iter(range(3))

    def cut(descriptor: int) -> None:
        sync_data(descriptor)
        if next(waits) == wait:
            os.truncate(path, 500)

    monkeypatch.setattr(writer_module, "sync_data", cut)
    assert "was deleted, moved, replaced or cut off while" in refused(writer, rows[30:])
    assert writer.is_gone


def test_a_folder_that_refuses_files_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="its folder does not exist"):
        RecordingWriter(tmp_path / "none" / "x.mcap", [FIRST])
    with pytest.raises(FileError, match="is a directory"):
        RecordingWriter(tmp_path, [FIRST])
    assert [*tmp_path.iterdir()] == []


def test_a_file_without_space_for_its_head_is_not_left(tmp_path: Path) -> None:
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        with file_size_limit(100), pytest.raises(FileError, match="cannot be written"):
            RecordingWriter(tmp_path / "x.mcap", [FIRST])
    finally:
        signal.signal(signal.SIGXFSZ, handler)
    assert [*tmp_path.iterdir()] == []
