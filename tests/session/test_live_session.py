"""The capture process and the view's end of it: real processes, real terminals, real files."""

from __future__ import annotations

import os
import resource
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic

import pytest

from fte_sniff.capture.ports import PortSettings
from fte_sniff.errors import FileError, PortError
from fte_sniff.protocol import PortEventKind, Row
from fte_sniff.recording.reader import RecordingReader
from fte_sniff.session.live import LiveSession
from fte_sniff.session.plan import CapturePlan
from tests.cli.processes import BOUND_S

SIM = "sim://?seed=1&rate=1000"


def plan(recording: Path | None = None, port: str = SIM, **limits: float) -> CapturePlan:
    return CapturePlan(port, PortSettings(), recording, **limits)  # type: ignore[arg-type]


def to_the_end(session: LiveSession) -> list[Row]:
    rows: list[Row] = []
    for update in updates(session):
        rows += update.rows
    return rows


def updates(session: LiveSession) -> Iterator:
    deadline = monotonic() + BOUND_S
    while monotonic() < deadline:
        update = session.wait(0.1)
        yield update
        if not update.state.running:
            return
    raise AssertionError("it does not end")


def until(session: LiveSession, holds: Callable[[int], bool]) -> None:
    for update in updates(session):
        if holds(update.state.rows):
            return
    raise AssertionError("it ended too early")


def test_rows_seen_are_rows_recorded(tmp_path: Path) -> None:
    with LiveSession(plan(tmp_path / "x.mcap", count=200)) as session:
        rows = to_the_end(session)
    assert len(rows) == 200
    assert list(RecordingReader(tmp_path / "x.mcap")) == rows
    assert session.error is None


def test_events_are_seen_and_recorded(tmp_path: Path) -> None:
    events = []
    with LiveSession(plan(tmp_path / "x.mcap", duration_s=0.2)) as session:
        for update in updates(session):
            events += update.events
    assert [event.kind for event in events] == [PortEventKind.OPENED, PortEventKind.CLOSED]
    assert list(RecordingReader(tmp_path / "x.mcap").events()) == events


def test_a_view_that_does_not_look_costs_nothing(tmp_path: Path) -> None:
    with LiveSession(plan(tmp_path / "x.mcap", duration_s=1.0)) as session:
        # Nothing is taken from the pipe until the capture is over.
        session._process.join(BOUND_S / 4)  # its last words wait for the view a few seconds
        rows = to_the_end(session)
    recorded = list(RecordingReader(tmp_path / "x.mcap"))
    assert rows == recorded
    assert len(recorded) > 300


def test_stop_ends_it_and_asking_twice_is_asking_once(tmp_path: Path) -> None:
    with LiveSession(plan(tmp_path / "x.mcap")) as session:
        until(session, lambda rows: rows > 20)
        session.stop()
        session.stop()
        to_the_end(session)
        session.stop()
        assert session.poll().state.ended == "stopped"
    reader = RecordingReader(tmp_path / "x.mcap")
    assert len(list(reader)) > 20
    assert reader.complete


def test_leaving_the_session_closes_the_file(tmp_path: Path) -> None:
    with LiveSession(plan(tmp_path / "x.mcap")) as session:
        until(session, lambda rows: rows > 20)
    reader = RecordingReader(tmp_path / "x.mcap")
    assert len(list(reader)) > 20
    assert reader.complete


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_to_the_capture_process_ends_it_well(tmp_path: Path, number: int) -> None:
    with LiveSession(plan(tmp_path / "x.mcap")) as session:
        until(session, lambda rows: rows > 20)
        os.kill(session._process.pid or 0, number)
        rows = to_the_end(session)
        assert session.error is None
    assert list(RecordingReader(tmp_path / "x.mcap"))[-len(rows) :] == rows


def test_ctrl_c_means_nothing_to_the_capture_process(tmp_path: Path) -> None:
    with LiveSession(plan(tmp_path / "x.mcap")) as session:
        os.kill(session._process.pid or 0, signal.SIGINT)
        until(session, lambda rows: rows > 50)
        assert session.poll().state.running


def test_a_killed_capture_is_told(tmp_path: Path) -> None:
    with LiveSession(plan(tmp_path / "x.mcap")) as session:
        until(session, lambda rows: rows > 20)
        session._process.kill()
        to_the_end(session)
        assert isinstance(session.error, PortError)
        assert "unexpectedly" in (session.poll().state.ended or "")
    list(RecordingReader(tmp_path / "x.mcap"))


def test_a_port_that_is_lost_ends_it_and_says_so(tmp_path: Path) -> None:
    with LiveSession(plan(tmp_path / "x.mcap", port=f"{SIM}&frames=30")) as session:
        rows = to_the_end(session)
        assert isinstance(session.error, PortError)
        assert "was lost" in (session.poll().state.ended or "")
    assert len(rows) == 30
    assert list(RecordingReader(tmp_path / "x.mcap")) == rows


def test_what_cannot_start_raises_and_leaves_no_process(tmp_path: Path) -> None:
    with pytest.raises(PortError, match="no such port"):
        LiveSession(plan(port="/dev/ttyNOPE"))
    (tmp_path / "x.mcap").touch()
    with pytest.raises(FileError, match="exists already"):
        LiveSession(plan(tmp_path / "x.mcap"))
    assert (tmp_path / "x.mcap").read_bytes() == b""


def test_a_recording_that_fails_is_told_at_once_and_the_capture_goes_on(tmp_path: Path) -> None:
    with files_bounded(20_000):
        session = LiveSession(plan(tmp_path / "x.mcap", duration_s=2.0))
    with session:
        rows_when_told = None
        for update in updates(session):
            if update.state.recording is None and rows_when_told is None:
                rows_when_told = update.state.rows
        assert isinstance(session.error, FileError)
        assert "recording stopped" in str(session.error)
        assert rows_when_told is not None
        assert session.total_rows > rows_when_told + 200
    assert RecordingReader(tmp_path / "x.mcap").metadata


@contextmanager
def files_bounded(size: int) -> Iterator[None]:
    """Processes started in this context cannot write files longer than `size` bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
