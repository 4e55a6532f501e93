"""Replaying files: rows, gaps and pages read again."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.row_store import RowStore
from fte_sniff.errors import FileError
from fte_sniff.protocol import KINDS, Fault, PortEvent, PortEventKind, Row, encode
from fte_sniff.protocol.rows import Rows
from fte_sniff.recording import reader as recording_reader
from fte_sniff.session.inputs import InputBatch
from fte_sniff.session.replay import Playback, RecordingPages, ReplaySession
from tests.waiting import BOUND_S, while_waiting

FRAME = bytes.fromhex("AA0000000000000000EE")


def batches(count: int, size: int = 10) -> list[InputBatch]:
    return [
        InputBatch(Rows.of([Row("f", (b * size + i) * 10, FRAME, None) for i in range(size)]))
        for b in range(count)
    ]


def all_of(session: ReplaySession) -> list[Row]:
    rows: list[Row] = []
    for _ in while_waiting(lambda: f"the end of {session}"):
        update = session.poll()
        rows += update.rows
        if not update.state.running:
            break
    return rows


def test_all_rows_come_in_order() -> None:
    made = batches(100)
    session = ReplaySession(made, "file")
    assert all_of(session) == [row for batch in made for row in batch.rows]
    assert session.poll().state.ended is None
    assert list(session.poll().rows) == []


def first_of(session: ReplaySession) -> list[Row]:
    rows: list[Row] = []
    for _ in while_waiting(lambda: "the first rows"):
        if rows := list(session.poll().rows):
            break
    return rows


def test_port_events_come_with_the_rows_among_which_they_stand() -> None:
    lost = PortEvent(5, "f", PortEventKind.LOST, "")
    made = batches(2)
    session = ReplaySession([made[0], InputBatch(made[1].rows.replace([lost]))], "file")
    events: list[PortEvent] = []
    for _ in while_waiting(lambda: f"the end of {session}"):
        update = session.poll()
        events += update.events
        if not update.state.running:
            break
    assert events == [lost]


def test_what_cannot_be_read_ends_it_after_what_could() -> None:
    def reading() -> Iterator[InputBatch]:
        yield from batches(3)
        raise FileError("file: broken here")

    session = ReplaySession(reading(), "file")
    assert len(all_of(session)) == 30
    assert str(session.error) == "file: broken here"
    assert session.poll().state.ended == "file: broken here"


def test_reading_rests_until_the_next_poll() -> None:
    read: queue.Queue[int] = queue.Queue()
    gate = threading.Semaphore(1)

    def reading() -> Iterator[InputBatch]:
        for number, batch in enumerate(batches(5)):
            assert gate.acquire(timeout=BOUND_S)
            read.put(number)
            yield batch

    session = ReplaySession(reading(), "file")
    first_of(session)
    session.poll()
    gate.release()
    assert [read.get(timeout=BOUND_S), read.get(timeout=BOUND_S)] == [0, 1]
    session.rest()
    gate.release(3)
    came = []
    with suppress(queue.Empty):
        while True:
            came.append(read.get(timeout=0.1))
    # A read that is under way when it is paused may still arrive.
    assert came in ([], [2])
    all_of(session)
    assert [read.get(timeout=BOUND_S) for _ in range(3 - len(came))][-1] == 4


def test_stop_ends_the_reading() -> None:
    def endless() -> Iterator[InputBatch]:
        while True:
            yield from batches(1)

    session = ReplaySession(endless(), "file")
    session.stop()
    session._thread.join(BOUND_S)
    assert not session._thread.is_alive()


COUNT = 12_000
"""Rows of a file: more than one batch."""
FRAME_PAGES = encode(KINDS[0], {field.name: field.low for field in KINDS[0].fields})


def made(port: str, count: int) -> list[Row]:
    """Frames, and now and then damage of more than ten bytes."""
    rows: list[Row] = []
    for number in range(count):
        t_ns, offset = 1_000_000 * number + 10**18, 100 * number
        if number % 997:
            rows.append(Row(port, offset, FRAME_PAGES, t_ns))
        else:
            rows.append(
                Row(port, offset, bytes([number % 256]) * 40, t_ns, (Fault.NOISE,), framed=False)
            )
    return rows


@pytest.fixture(autouse=True)
def small_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reading makes several batches of a file."""
    monkeypatch.setattr(recording_reader, "JOB", 200_000)
    monkeypatch.setattr(recording_reader, "_FIRST_JOB", 100_000)


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    return [*made("a", COUNT), *made("b", 1000)]


def loaded(pages: RecordingPages, start: int, count: int) -> list[Row]:
    return list(pages.load(start, count))


def timed_store(times: list[int | None]) -> RowStore:
    store = RowStore(block_rows=3)
    store.append(Rows.of([Row("f", 10 * number, FRAME, t_ns) for number, t_ns in enumerate(times)]))
    return store


def test_playback_shows_rows_at_their_pace_and_speed() -> None:
    store = timed_store([1000, 1010, None, 1020, 1035, 1100])
    play = Playback(store, 1, 1.0, now_ns=5)
    assert (len(store), play.tally.rows, play.t_ns) == (1, 1, 1010)
    assert len(play.advance(5)) == 2, "a row without a time comes with the one before it"
    assert len(play.advance(14)) == 0
    assert [row.t_ns for row in play.advance(15)] == [1020]
    play.paused = True
    assert len(play.advance(1000)) == 0
    play.paused = False
    play.change_speed(1)
    assert len(play.advance(1007)) == 0
    assert [row.t_ns for row in play.advance(1008)] == [1035]
    for _ in range(20):
        play.change_speed(1)
    assert play.speed == 100
    assert not play.is_over
    assert len(play.advance(1009)) == 1
    assert play.is_over
    assert play.tally.rows == len(store) == 6
    for _ in range(20):
        play.change_speed(-1)
    assert play.speed == 0.1
    play.stop()
    assert store.limit is None


@given(st.lists(st.integers(0, 500), max_size=60), st.lists(st.integers(0, 50), max_size=40))
def test_playback_is_the_same_however_often_it_is_polled(
    times: list[int], steps: list[int]
) -> None:
    """Times may fall a little, as those of two ports do."""
    one, other = timed_store([*times]), timed_store([*times])
    often, once = Playback(one, 0, 1.0, 0), Playback(other, 0, 1.0, 0)
    now = 0
    for step in (*steps, 0):
        now += step
        often.advance(now)
    once.advance(now)
    assert one.next == other.next
    assert often.tally.rows == once.tally.rows
