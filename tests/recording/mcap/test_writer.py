"""The file between any two steps of a write, as a kill or a power cut would leave it."""

import errno
import os
import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from io import BytesIO
from itertools import pairwise
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader

from fte_sniff.errors import FileError
from fte_sniff.protocol import Row
from fte_sniff.recording.mcap import writer as mcap_file
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import RecordingReader
from fte_sniff.recording.writer import RecordingWriter
from tests.slow import first
from tests.support.columns import in_columns
from tests.support.recording_kill import opened

Rows = Callable[..., list[Row]]
PORT = PortFacts("/dev/ttyUSB0", 115_200)
PAGE, SECTOR = 4096, 512


@dataclass(frozen=True, slots=True)
class _Step:
    """One write (`data` at `offset`), one change of the length, or one barrier."""

    offset: int
    data: bytes | None = None
    barrier: bool = False

    def apply(self, content: bytearray) -> None:
        if self.barrier:
            return
        if self.data is None:
            del content[self.offset :]
            return
        content.extend(bytes(max(0, self.offset - len(content))))
        content[self.offset : self.offset + len(self.data)] = self.data

    def cut(self, size: int) -> "list[_Step]":
        """The parts of the write that cannot be torn, if whole blocks of `size` cannot."""
        if self.data is None:
            return [self]
        first = size - self.offset % size
        cuts = [0, *range(first, len(self.data), size), len(self.data)]
        return [_Step(self.offset + start, self.data[start:stop]) for start, stop in pairwise(cuts)]


@contextmanager
def _before_each_call(
    monkeypatch: pytest.MonkeyPatch, do: Callable[[_Step], None]
) -> Iterator[None]:
    """Calls `do` before each system call that writes; if it raises, the call fails."""
    pwrite, truncate, sync = os.pwrite, os.ftruncate, os.fdatasync

    def write_after(descriptor: int, data: bytes, offset: int) -> int:
        do(_Step(offset, bytes(data)))
        return pwrite(descriptor, data, offset)

    def truncate_after(descriptor: int, size: int) -> None:
        do(_Step(size))
        truncate(descriptor, size)

    def sync_after(descriptor: int) -> None:
        do(_Step(0, barrier=True))
        sync(descriptor)

    with monkeypatch.context() as patched:
        patched.setattr(os, "pwrite", write_after)
        patched.setattr(os, "ftruncate", truncate_after)
        patched.setattr(os, "fdatasync", sync_after)
        yield


def _sought(content: bytearray) -> int:
    """How many messages a reader that seeks finds, every checksum checked."""
    reader = make_reader(BytesIO(bytes(content)), validate_crcs=True)
    return sum(1 for _ in reader.iter_messages())


def _messages(content: bytearray) -> int:
    """How many messages a reader that seeks finds, and one that does not has no less."""
    found = _sought(content)
    records = StreamReader(BytesIO(bytes(content)), validate_crcs=True).records
    assert sum(isinstance(record, Message) for record in records) >= found
    return found


def _rows_of_whole(content: bytearray, path: Path, *, has_summary: bool) -> list[Row]:
    """The rows; our reader finds nothing wrong."""
    path.write_bytes(content)
    reader = RecordingReader(path)
    rows = list(reader)
    assert (reader.ending, reader.losses) == ("", ())
    assert reader.ports == (PORT,)
    assert reader.is_whole or not has_summary
    return rows


def _flushes(
    path: Path, rows: list[Row], monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[bytearray, list[_Step], int, int]]:
    """For each flush: the file before, its steps, and its messages before and after."""
    sizes = [1, 400, 3, 900, 1, 50, 1500]
    with RecordingWriter(path, [PORT]) as writer:
        for number, size in enumerate(sizes):
            before, start = bytearray(path.read_bytes()), sum(sizes[:number])
            steps: list[_Step] = []
            with _before_each_call(monkeypatch, steps.append):
                writer.write(in_columns(rows[start : start + size]))
                writer.flush()
            yield before, steps, start, start + size


@pytest.mark.parametrize("every", first(1, [5, 1]))
@pytest.mark.parametrize("long_summary", [mcap_file.LONG_SUMMARY, 0])
def test_the_file_opens_after_a_kill_between_any_two_pages_of_any_write(
    tmp_path: Path, make_rows: Rows, monkeypatch: pytest.MonkeyPatch, long_summary: int, every: int
) -> None:
    monkeypatch.setattr(mcap_file, "LONG_SUMMARY", long_summary)
    path, rows, has_summary = tmp_path / "x.mcap", make_rows(2855), long_summary > 0
    states = 0
    for content, steps, before, after in _flushes(path, rows, monkeypatch):
        for step in steps:
            for part in step.cut(PAGE):
                part.apply(content)
                states += 1
                if states % every:
                    continue
                assert _messages(content) in (before, after)
                found = _rows_of_whole(content, tmp_path / "killed.mcap", has_summary=has_summary)
                assert found in (rows[:before], rows[:after])
                assert not has_summary or opened(tmp_path / "killed.mcap")[0] == ""
        assert _messages(content) == after
    assert states > 80


def test_the_file_opens_after_a_power_cut_in_any_write_after_the_guard(
    tmp_path: Path, make_rows: Rows, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sectors between two barriers reach the disk in any order.

    Without any chunk the package's reader does not use the index, so the first flush is left out.
    """
    rng = random.Random(1)
    tried = 0
    for content, steps, before, _ in _flushes(tmp_path / "x.mcap", make_rows(2855), monkeypatch):
        first = next(number for number, step in enumerate(steps) if step.barrier)
        second = next(number for number, step in enumerate(steps[first + 1 :]) if step.barrier)
        for step in steps[:first]:
            step.apply(content)
        assert _messages(content) == before
        if not before:
            continue
        sectors = [part for step in steps[first : first + 1 + second] for part in step.cut(SECTOR)]
        for _ in range(20):
            torn = bytearray(content)
            for part in rng.sample(sectors, rng.randrange(len(sectors) + 1)):
                part.apply(torn)
            assert _sought(torn) == before
            tried += 1
    assert tried == 120


def test_a_footer_is_never_written_across_two_sectors(
    tmp_path: Path, make_rows: Rows, monkeypatch: pytest.MonkeyPatch
) -> None:
    footers = 0
    for _, steps, _, _ in _flushes(tmp_path / "x.mcap", make_rows(2855), monkeypatch):
        for step in steps:
            if (
                step.data is not None
                and step.data.endswith(b"\x89MCAP0\r\n")
                and len(step.data) < 40
            ):
                footers += 1
                assert len(step.cut(SECTOR)) == 1
    assert footers == 14


CALLS = 8
"""System calls of a flush with a guard, and a few of the next one."""


def _flushed(path: Path, rows: list[Row]) -> RecordingWriter:
    writer = RecordingWriter(path, [PORT])
    for part in (rows[:500], rows[500:700]):
        writer.write(in_columns(part))
        writer.flush()
    return writer


@pytest.mark.parametrize("failing", ["writes", "writes and syncs", "syncs", "all"])
@pytest.mark.parametrize("first", range(CALLS))
def test_after_calls_that_fail_from_one_on_the_file_opens_and_the_message_is_true(
    tmp_path: Path, make_rows: Rows, monkeypatch: pytest.MonkeyPatch, failing: str, first: int
) -> None:
    path, rows = tmp_path / "x.mcap", make_rows(900)
    writer = _flushed(path, rows)
    size, calls = writer.size, 0

    def fail(step: _Step) -> None:
        nonlocal calls
        calls += 1
        is_write = step.data is not None
        fails = failing == "all" or (is_write and "writes" in failing)
        if calls > first and (fails or (step.barrier and "syncs" in failing)):
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    writer.write(in_columns(rows[700:]))
    with suppress(FileError), _before_each_call(monkeypatch, fail):
        writer.flush()
    expected = 900 if writer.failure is None else 700
    if writer.failure is not None:
        is_restored = path.stat().st_size == size
        assert ("complete up to there (700 rows)" in str(writer.failure)) == is_restored
        assert ("bytes of the failed write" in str(writer.failure)) != is_restored
    writer.close()
    assert _messages(bytearray(path.read_bytes())) == expected
    reader = RecordingReader(path)
    found = list(reader)
    # The bytes of the failed write may be all that it wrote.
    assert found == rows[:expected] or (found == rows and path.stat().st_size > size)
    assert (reader.ending, reader.losses) == ("", ())


@pytest.mark.parametrize("left", [0, 100, 7000, -1])
@pytest.mark.parametrize("call", range(CALLS))
def test_a_file_that_is_cut_off_before_any_call_is_reported(
    tmp_path: Path, make_rows: Rows, monkeypatch: pytest.MonkeyPatch, left: int, call: int
) -> None:
    path, rows = tmp_path / "x.mcap", make_rows(900)
    writer = _flushed(path, rows)
    size, calls = writer.size, 0
    assert size > 7000

    def cut(_: _Step) -> None:
        nonlocal calls
        calls += 1
        if calls == call:
            os.truncate(path, size + left if left < 0 else left)

    if not call:
        os.truncate(path, size + left if left < 0 else left)
    writer.write(in_columns(rows[700:]))
    with suppress(FileError), _before_each_call(monkeypatch, cut):
        writer.flush()
        writer.close()
    assert "another program cut off" in str(writer.failure)
    assert writer.is_gone
    writer.close()
