"""A live session: real processes, ports and files."""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict, replace
from functools import reduce
from pathlib import Path
from time import monotonic

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.feed import FeedState
from fte_sniff.capture.port_source import PortGroup
from fte_sniff.errors import FileError, PortError
from fte_sniff.protocol import PortEvent, PortEventKind, Row
from fte_sniff.protocol.rows import NO_ROWS
from fte_sniff.recording.output_file import Existing
from fte_sniff.recording.reader import Recording
from fte_sniff.recording.recorder import Change, Outcome
from fte_sniff.session import live_session as live
from fte_sniff.session.capture_process import (
    CapturePlan,
    Ended,
    Message,
    RowsMessage,
    Started,
    WriteProgress,
    capture,
)
from fte_sniff.session.live_session import CaptureState, LiveSession
from fte_sniff.session.worker_process import start_worker
from tests.cli.processes import holding
from tests.recording.conftest import file_size_limit
from tests.support.columns import read_rows
from tests.support.in_workers import falls_silent
from tests.support.recorded_rows import events_in
from tests.waiting import BOUND_S, wait_until, while_waiting

pytestmark = pytest.mark.program

SIM = "sim://?seed=1&rate=1000"


def plan(recording: Path | None = None, port: str = SIM, **limits: float) -> CapturePlan:
    return CapturePlan(PortGroup((port,)), recording, **limits)  # type: ignore[arg-type]


@pytest.fixture
def quickly_overdue(monkeypatch: pytest.MonkeyPatch) -> float:
    """After so many seconds a capture that was asked to end is overdue."""
    monkeypatch.setattr(live, "END_WITHIN_S", 0.3)
    return 0.3


@contextmanager
def alarms(do: Callable[[], None], every_s: float) -> Iterator[None]:
    """While in this context, something is done every now and then, whatever else waits."""
    before = signal.signal(signal.SIGALRM, lambda *_: do())
    signal.setitimer(signal.ITIMER_REAL, every_s, every_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


@contextmanager
def running(wanted: CapturePlan | LiveSession) -> Iterator[LiveSession]:
    session = LiveSession(wanted) if isinstance(wanted, CapturePlan) else wanted
    with closing(session):
        session.begin()
        yield session


def to_the_end(session: LiveSession) -> list[Row]:
    rows: list[Row] = []
    for update in updates(session):
        rows += update.rows
    return rows


def updates(session: LiveSession) -> Iterator:
    for _ in while_waiting(lambda: f"the end of {session.state}"):
        update = session.wait(0.1)
        yield update
        if not update.state.running:
            return


def until(session: LiveSession, holds: Callable[[int], bool]) -> None:
    for update in updates(session):
        if holds(update.state.rows):
            return
    raise AssertionError("it ended too early")


def test_rows_and_events_seen_are_those_recorded(tmp_path: Path) -> None:
    rows, events = list[Row](), list[PortEvent]()
    with running(plan(tmp_path / "x.mcap", count=200)) as session:
        for update in updates(session):
            rows += update.rows
            events += update.events
    reader = Recording(tmp_path / "x.mcap")
    assert len(rows) == 200
    assert list(reader) == rows
    assert [event.kind for event in events] == [PortEventKind.OPENED, PortEventKind.CLOSED]
    assert events_in(reader) == events
    assert session.state.error is None


def test_a_view_that_does_not_look_costs_nothing(tmp_path: Path) -> None:
    with running(plan(tmp_path / "x.mcap", duration_s=1.0)) as session:
        # Nothing is taken from the pipe until the file is closed.
        wait_until(lambda: not holding(tmp_path / "x.mcap"))
        rows = to_the_end(session)
    recorded = read_rows(tmp_path / "x.mcap")
    assert rows == recorded
    assert len(recorded) > 300


def test_stop_ends_it_and_asking_twice_is_asking_once(tmp_path: Path) -> None:
    with running(plan(tmp_path / "x.mcap")) as session:
        until(session, lambda rows: rows > 20)
        assert not session.stopping
        session.stop()
        session.stop()
        to_the_end(session)
        session.stop()
        assert session.poll().state.ended == "stopped"
    reader = Recording(tmp_path / "x.mcap")
    assert len(list(reader)) > 20
    assert (reader.ending, reader.losses) == ("", ())


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_to_the_capture_process_ends_it_well(tmp_path: Path, number: int) -> None:
    with running(plan(tmp_path / "x.mcap")) as session:
        until(session, lambda rows: rows > 20)
        os.kill(session.capture_pid, number)
        rows = to_the_end(session)
        assert session.state.error is None
    assert read_rows(tmp_path / "x.mcap")[-len(rows) :] == rows


def test_ctrl_c_means_nothing_to_the_capture_process_and_leaving_the_session_ends_it(
    tmp_path: Path,
) -> None:
    with running(plan(tmp_path / "x.mcap")) as session:
        os.kill(session.capture_pid, signal.SIGINT)
        until(session, lambda rows: rows > 50)
        assert session.poll().state.running
    reader = Recording(tmp_path / "x.mcap")
    assert len(list(reader)) > 50
    assert (reader.ending, reader.losses) == ("", ())


def test_a_killed_capture_is_reported(tmp_path: Path) -> None:
    with running(plan(tmp_path / "x.mcap")) as session:
        until(session, lambda rows: rows > 20)
        session._process.kill()
        to_the_end(session)
        assert isinstance(session.state.error, PortError)
        assert "unexpectedly" in (session.poll().state.ended or "")
    read_rows(tmp_path / "x.mcap")


def test_a_lost_port_ends_it_and_is_reported(tmp_path: Path) -> None:
    with running(plan(tmp_path / "x.mcap", port=f"{SIM}&frames=30")) as session:
        rows = to_the_end(session)
        assert isinstance(session.state.error, PortError)
        assert "was lost" in (session.poll().state.ended or "")
    assert len(rows) == 30
    assert read_rows(tmp_path / "x.mcap") == rows


def test_what_cannot_start_raises_and_leaves_no_process(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").touch()
    sessions = [LiveSession(plan(port="/dev/ttyNOPE")), LiveSession(plan(tmp_path / "x.mcap"))]
    for session, refusal, words in zip(
        sessions, (PortError, FileError), ("no such port", "exists already"), strict=True
    ):
        with pytest.raises(refusal, match=words):
            session.begin()
        assert session._process.poll() is not None
    assert (tmp_path / "x.mcap").read_bytes() == b""


def test_a_recording_that_fails_is_reported_at_once_and_the_capture_goes_on(tmp_path: Path) -> None:
    with file_size_limit(20_000):
        session = LiveSession(plan(tmp_path / "x.mcap"))
    with running(session):
        until(session, lambda _rows: session.state.recording is None)
        assert isinstance(session.state.error, FileError)
        assert "recording stopped" in str(session.state.error)
        told_at = session.state.total_rows
        until(session, lambda rows: rows > told_at + 200)
    reported = Recording(tmp_path / "x.mcap").metadata["fte-sniff"]
    assert reported["port.1.granted"] == "no low latency setting; line errors unavailable"


def test_a_recording_that_is_deleted_is_reported_at_once_and_the_capture_goes_on(
    tmp_path: Path,
) -> None:
    with running(plan(tmp_path / "x.mcap")) as session:
        until(session, lambda rows: rows > 20)
        (tmp_path / "x.mcap").unlink()
        until(session, lambda _rows: session.state.error is not None)
        state = session.poll().state
        assert (state.running, state.recording) == (True, str(tmp_path / "x_00002.mcap"))
        assert state.files == (str(tmp_path / "x.mcap"), str(tmp_path / "x_00002.mcap"))
        assert "x.mcap was deleted" in (state.trouble or "")
        assert "recording goes on in" in (state.trouble or "")
        told_at = state.rows
        until(session, lambda rows: rows > told_at + 100)
    assert isinstance(session.state.error, FileError)
    assert not (tmp_path / "x.mcap").exists()


def test_a_stuck_capture_is_killed_and_reported(tmp_path: Path, quickly_overdue: float) -> None:
    with running(plan(tmp_path / "x.mcap")) as session:
        wait_until(lambda: bool(read_rows(tmp_path / "x.mcap")))
        os.kill(session.capture_pid, signal.SIGSTOP)
        start = monotonic()
        session.stop()
    assert monotonic() - start >= quickly_overdue
    assert isinstance(session.state.error, PortError)
    assert "was killed" in (session.poll().state.ended or "")
    assert session._process.poll() is not None
    assert read_rows(tmp_path / "x.mcap")


def test_a_capture_that_is_stuck_within_a_message_is_killed_by_asking_again(
    monkeypatch: pytest.MonkeyPatch, quickly_overdue: float
) -> None:
    monkeypatch.setattr(live, "capture", falls_silent)
    with running(plan()) as session, alarms(session.stop, quickly_overdue):
        to_the_end(session)
        assert isinstance(session.state.error, PortError)


def test_stop_while_the_port_is_not_open_yet_ends_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Nothing kills it, and a server that takes no connection lets no port open.
    monkeypatch.setattr(live, "END_WITHIN_S", BOUND_S)
    with socket.socket() as server, socket.socket() as first:
        server.bind(("127.0.0.1", 0))
        server.listen(0)
        first.connect(server.getsockname())
        host, number = server.getsockname()
        session = LiveSession(plan(tmp_path / "x.mcap", port=f"socket://{host}:{number}"))
        session.stop()
        session.stop()
        session.begin()
        assert not session.poll().state.running
        session.close()
    assert session.state.error is None
    assert session.state.recording is None
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("existing", [Existing.REFUSE, Existing.REPLACE])
def test_a_capture_whose_view_went_before_it_began_writes_and_leaves_nothing(
    tmp_path: Path, existing: Existing
) -> None:
    if existing is Existing.REPLACE:
        (tmp_path / "x.mcap").write_bytes(b"precious")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    wanted = replace(plan(tmp_path / "x.mcap"), existing=existing)
    process, connection = start_worker(capture, wanted)
    connection.close()
    # A traceback would come with another exit code.
    assert process.wait(BOUND_S) == 0
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_captures_that_begin_together_take_a_name_each(tmp_path: Path) -> None:
    wanted = replace(plan(tmp_path / "x.mcap", count=30), existing=Existing.NUMBER)
    sessions = [LiveSession(wanted) for _ in range(2)]
    for session in sessions:
        with running(session):
            assert session.state.recording is not None
            rows = to_the_end(session)
            assert session.poll().state.recording == str(session.state.recording)
        assert read_rows(session.state.recording) == rows
    assert {session.state.recording for session in sessions} == set(tmp_path.iterdir())
    assert len(list(tmp_path.iterdir())) == 2


ONE, TWO = Path("one.mcap"), Path("two.mcap")
FULL = FileError("one.mcap: recording stopped: the disk is full")
NEW = CaptureState(("a", "b"))
BEGUN = Started(ONE)


def batch(*changes: Change, rows: int = 0, **events: PortEventKind) -> RowsMessage:
    happened = [PortEvent(0, port, kind, "") for port, kind in events.items()]
    return RowsMessage(NO_ROWS.replace(happened), rows, 3, changes)


def _reporting(*events: PortEvent) -> RowsMessage:
    return replace(batch(), rows=NO_ROWS.replace(events))


def left_over(waiting: int) -> RowsMessage:
    """Of many bytes that waited when reading ended, some wait still."""
    return replace(batch(), leftover=1 << 20, progress=WriteProgress(waiting=waiting))


def after(*messages: Message, of: CaptureState = NEW) -> CaptureState:
    return reduce(CaptureState.after, messages, of)


@pytest.mark.parametrize(
    ("messages", "shown"),
    [
        ((), asdict(FeedState("a + b"))),
        ((Started(None),), {}),
        ((BEGUN,), {"recording": "one.mcap", "files": ("one.mcap",)}),
        ((BEGUN, batch(rows=7)), {"rows": 7, "not_shown": 3}),
        ((batch(a=PortEventKind.LOST),), {"waiting": True}),
        ((batch(a=PortEventKind.LOST), batch(b=PortEventKind.FOUND_AGAIN)), {"waiting": True}),
        ((batch(a=PortEventKind.LOST), batch(a=PortEventKind.FOUND_AGAIN)), {"waiting": False}),
        ((batch(a=PortEventKind.LOST), Ended()), {"waiting": False, "ended": "stopped"}),
        ((left_over(9),), {"trouble": "writing received data: 1,048,576 bytes left"}),
        ((left_over(0),), {"trouble": None}),
        ((BEGUN, batch(Change(None, FULL))), {"recording": None, "trouble": str(FULL)}),
        (
            (BEGUN, batch(Change(None, FULL)), batch(Change(TWO))),
            {
                "recording": "two.mcap",
                "files": ("one.mcap", "two.mcap"),
                "trouble": f"{FULL}; recording goes on in two.mcap",
            },
        ),
        ((BEGUN, batch(Change(None, FULL)), Ended("gone")), {"trouble": None, "ended": "gone"}),
        ((Started(None, "/dev/pts/7"),), {"title": "a + /dev/pts/7"}),
    ],
)
def test_what_a_view_is_shown(messages: tuple[Message, ...], shown: dict[str, object]) -> None:
    state = after(*messages).feed_state
    usual = FeedState("a + b", running=not any(isinstance(one, Ended) for one in messages))
    expected = {**{name: getattr(usual, name) for name in ("title", "running", "waiting")}, **shown}
    assert {name: getattr(state, name) for name in expected} == expected


def test_why_a_recording_stopped_is_kept_while_it_goes_on_elsewhere() -> None:
    reported = after(BEGUN, batch(Change(None, FULL), Change(TWO)), batch())
    assert (reported.error, reported.stopped_recording) == (FULL, FULL)
    assert (reported.recording, reported.recordings) == (TWO, (ONE, TWO))


def test_the_end_has_the_last_word_on_what_went_wrong() -> None:
    lost, outcome = PortError("a: lost"), Outcome(ONE, TWO)
    reported = after(BEGUN, batch(Change(None, FULL)), Ended("lost", lost, outcome))
    assert (reported.error, reported.stopped_recording, reported.outcome) == (lost, FULL, outcome)
    assert after(BEGUN, batch(Change(None, FULL)), Ended()).error is None
    assert after(BEGUN).outcome is None


@given(
    st.lists(
        st.tuples(
            st.sampled_from("ab"), st.sampled_from([PortEventKind.LOST, PortEventKind.FOUND_AGAIN])
        )
    )
)
def test_a_port_is_away_from_its_loss_until_it_is_found(happened: list) -> None:
    events = [PortEvent(0, port, kind, "") for port, kind in happened]
    last = dict(happened)
    away = {port for port, kind in last.items() if kind is PortEventKind.LOST}
    assert after(_reporting(*events)).lost == away
    assert after(*map(_reporting, events)).lost == away
