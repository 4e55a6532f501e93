"""Following: the files of a capture, while a recorder writes them."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest

from fte_sniff.protocol import PortEvent, PortEventKind, Row
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import Recording
from fte_sniff.recording.recorder import Recorder, RecordingOptions
from fte_sniff.recording.writer import RecordingWriter
from fte_sniff.session import following as followed_module
from fte_sniff.session.following import POLL_S, FollowedInput, Following
from fte_sniff.session.inputs import InputReading
from tests.cli.processes import wait_until
from tests.session.test_file_jobs import reset_at
from tests.support.columns import entries

PORTS = [PortFacts("a", 115_200)]
FACTS = {"start": "2026-01-31T12:00:00.000000000Z", "host": "here"}
OPENED, CLOSED, LOST, FOUND_AGAIN = (
    PortEvent(10**18, "a", kind, "")
    for kind in (
        PortEventKind.OPENED,
        PortEventKind.CLOSED,
        PortEventKind.LOST,
        PortEventKind.FOUND_AGAIN,
    )
)


class Observed(Following):
    """Remembers what it opened, without keeping it."""

    def __init__(self) -> None:
        super().__init__()
        self.opened: list[weakref.ref[FollowedInput]] = []
        self.rows = 0

    def open(self, path: Path) -> FollowedInput:
        found = super().open(path)
        self.opened.append(weakref.ref(found))
        return found


@contextmanager
def follower(path: Path) -> Iterator[tuple[Observed, Future[tuple[InputReading, list[Row]]]]]:
    """Follows a recording in a thread, until its writer ends; it has seen the writer's lock."""
    following = Observed()

    def read() -> tuple[InputReading, list[Row]]:
        reading = InputReading([following.open(path)])
        found: list[Row] = []
        for batch in reading:
            found += batch.rows
            following.rows = len(found)
        return reading, found

    with ThreadPoolExecutor(1) as executor:
        future = executor.submit(read)
        try:
            wait_until(lambda: following.has_lock or future.done())
            yield following, future
        finally:
            following.stop()


def test_a_flush_is_seen_well_within_a_second() -> None:
    assert POLL_S <= 0.25


def test_a_long_capture_is_followed_without_keeping_its_files(tmp_path: Path) -> None:
    options = RecordingOptions(rotate_s=0.5)
    recorder = Recorder(tmp_path / "x.mcap", PORTS, FACTS, options=options)
    rows = [reset_at(number) for number in range(20)]
    with follower(recorder.path) as (following, future):
        for row in rows:
            recorder.write(*entries([row]))
            recorder.flush()
        recorder.close()
        reading, found = future.result()
        gc.collect()
        assert found == rows
        assert len(following.opened) >= 10
        assert sum(one() is not None for one in following.opened) <= 2
    assert reading.tally.rows == 20


def test_a_next_file_that_comes_later_and_was_not_named_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    searches: list[Path | None] = []

    def find_next(reader: Recording) -> Path | None:
        searches.append(found(reader))
        return searches[-1]

    found = Recording.find_next
    monkeypatch.setattr(Recording, "find_next", find_next)
    monkeypatch.setattr(followed_module, "_RELEASE_S", 600.0)
    rows = [reset_at(number) for number in range(4)]
    first = RecordingWriter(tmp_path / "x.mcap", PORTS, FACTS)
    with follower(first.path) as (following, future):
        first.write(*entries([OPENED, *rows[:2]]))
        first.close()
        wait_until(lambda: len(searches) > 1)
        part = {"part": "2", "previous": "x.mcap"}
        with RecordingWriter(tmp_path / "x_00002.mcap", PORTS, FACTS | part) as second:
            wait_until(lambda: len(following.opened) == 2)
            second.write(*entries([*rows[2:], CLOSED]))
        assert future.result()[1] == rows
    assert following.ended == f"{second.path}: the program that recorded it has ended"


@pytest.mark.parametrize(
    ("events", "still_open"),
    [
        ([], set()),
        ([OPENED], {"a"}),
        ([OPENED, CLOSED], set()),
        ([OPENED, LOST], set()),
        ([OPENED, LOST, FOUND_AGAIN], {"a"}),
        ([CLOSED], set()),
    ],
)
def test_a_writer_that_left_a_port_open_did_not_end_by_itself(
    events: list[PortEvent], still_open: set[str]
) -> None:
    following = Following()
    following.has_lock = True
    following.observe(events)
    assert following.open_ports == still_open
    assert ("ended without closing a" in following.end("x", "")) == bool(still_open)
