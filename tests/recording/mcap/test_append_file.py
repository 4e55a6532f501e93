"""The file between any two steps of a write, as a kill or a power cut would leave it."""

import os
import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from itertools import pairwise
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader

from fte_sniff.protocol import Row
from fte_sniff.recording.mcap import writer as mcap_file
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.writer import RecordingWriter

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
def _watched(monkeypatch: pytest.MonkeyPatch, steps: list[_Step]) -> Iterator[None]:
    """Notes each system call that writes, and lets it through."""
    pwrite, truncate, sync = os.pwrite, os.ftruncate, os.fdatasync

    def noted_write(descriptor: int, data: bytes, offset: int) -> int:
        steps.append(_Step(offset, bytes(data)))
        return pwrite(descriptor, data, offset)

    def noted_truncate(descriptor: int, size: int) -> None:
        steps.append(_Step(size))
        truncate(descriptor, size)

    def noted_sync(descriptor: int) -> None:
        steps.append(_Step(0, barrier=True))
        sync(descriptor)

    with monkeypatch.context() as patched:
        patched.setattr(os, "pwrite", noted_write)
        patched.setattr(os, "ftruncate", noted_truncate)
        patched.setattr(os, "fdatasync", noted_sync)
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


def _flushes(
    path: Path, rows: list[Row], monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[bytearray, list[_Step], int, int]]:
    """For each flush: the file before, its steps, and its messages before and after."""
    sizes = [1, 400, 3, 900, 1, 50, 1500]
    with RecordingWriter(path, [PORT]) as writer:
        for number, size in enumerate(sizes):
            before, start = bytearray(path.read_bytes()), sum(sizes[:number])
            steps: list[_Step] = []
            with _watched(monkeypatch, steps):
                writer.write(rows[start : start + size])
                writer.flush()
            yield before, steps, start, start + size


@pytest.mark.parametrize("long_summary", [mcap_file.LONG_SUMMARY, 0])
def test_the_file_opens_after_a_kill_between_any_two_pages_of_any_write(
    tmp_path: Path, make_rows: Rows, monkeypatch: pytest.MonkeyPatch, long_summary: int
) -> None:
    monkeypatch.setattr(mcap_file, "LONG_SUMMARY", long_summary)
    path = tmp_path / "x.mcap"
    states = 0
    for content, steps, before, after in _flushes(path, make_rows(2855), monkeypatch):
        for step in steps:
            for part in step.cut(PAGE):
                part.apply(content)
                assert _messages(content) in (before, after)
                states += 1
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
