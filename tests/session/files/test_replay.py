"""A file as a feed: all its rows, in order, at the view's own pace."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from contextlib import suppress
from time import monotonic

from fte_sniff.errors import FileError
from fte_sniff.protocol import Frame, PortEvent, PortEventKind, Row
from fte_sniff.row_batch import RowBatch, packed_rows
from fte_sniff.session.replay import MOST_BATCHES_AHEAD, Read, ReplaySession

FRAME = bytes.fromhex("AA0000000000000000EE")


def batches(count: int, size: int = 10) -> list[Read]:
    return [
        Read([Frame("f", (b * size + i) * 10, FRAME, None) for i in range(size)])
        for b in range(count)
    ]


def all_of(session: ReplaySession) -> list[Row]:
    rows: list[Row] = []
    deadline = monotonic() + 60
    while monotonic() < deadline:
        update = session.poll()
        rows += update.rows
        if not update.state.running:
            return rows
    raise AssertionError("it does not end")


def test_all_rows_come_in_order() -> None:
    made = batches(100)
    session = ReplaySession(made, "file")
    assert all_of(session) == [row for batch in made for row in batch.rows]
    assert session.poll().state.ended is None
    assert session.poll().rows == []


def test_reading_waits_for_the_view() -> None:
    read = []
    enough = threading.Event()

    def reading() -> Iterator[Read]:
        for number, batch in enumerate(batches(1000)):
            read.append(number)
            if len(read) > MOST_BATCHES_AHEAD:
                enough.set()
            yield batch

    session = ReplaySession(reading(), "file")
    rows = first_of(session)
    rows += session.poll().rows
    assert enough.wait(60)
    assert len(read) <= MOST_BATCHES_AHEAD + 3
    assert len(rows) + len(all_of(session)) == 10_000


def test_no_more_than_the_first_batch_is_read_before_it_was_taken() -> None:
    read = []

    def reading() -> Iterator[Read]:
        for number, batch in enumerate(batches(3)):
            read.append(number)
            yield batch

    session = ReplaySession(reading(), "file")
    assert len(first_of(session)) == 10
    assert read == [0]
    assert len(all_of(session)) == 20


def first_of(session: ReplaySession) -> list[Row]:
    deadline = monotonic() + 60
    while monotonic() < deadline:
        if rows := session.poll().rows:
            return list(rows)
    raise AssertionError("nothing comes")


def test_port_events_come_with_the_rows_among_which_they_stand() -> None:
    lost = PortEvent(5, "f", PortEventKind.LOST, "")
    made = batches(2)
    session = ReplaySession([made[0], Read(made[1].rows, [lost])], "file")
    events: list[PortEvent] = []
    deadline = monotonic() + 60
    while monotonic() < deadline:
        update = session.poll()
        events += update.events
        if not update.state.running:
            break
    assert events == [lost]


def test_what_cannot_be_read_ends_it_after_what_could() -> None:
    def reading() -> Iterator[Read]:
        yield from batches(3)
        raise FileError("file: broken here")

    session = ReplaySession(reading(), "file")
    assert len(all_of(session)) == 30
    assert str(session.error) == "file: broken here"
    assert session.poll().state.ended == "file: broken here"


def test_reading_rests_until_the_next_poll() -> None:
    read: queue.Queue[int] = queue.Queue()
    gate = threading.Semaphore(1)

    def reading() -> Iterator[Read]:
        for number, batch in enumerate(batches(5)):
            assert gate.acquire(timeout=60)
            read.put(number)
            yield batch

    session = ReplaySession(reading(), "file")
    deadline = monotonic() + 60
    while not session.poll().rows and monotonic() < deadline:
        pass
    session.poll()
    gate.release()
    assert [read.get(timeout=60), read.get(timeout=60)] == [0, 1]
    session.rest()
    gate.release(3)
    came = []
    with suppress(queue.Empty):
        while True:
            came.append(read.get(timeout=0.1))
    # What is being read when it is told to rest may still come.
    assert came in ([], [2])
    all_of(session)
    assert [read.get(timeout=60) for _ in range(3 - len(came))][-1] == 4


def test_a_session_that_was_stopped_does_not_rest_for_ever() -> None:
    session = ReplaySession(batches(100), "file")
    session.stop()
    session.rest()
    session._thread.join(timeout=60)
    assert not session._thread.is_alive()


def test_stop_ends_the_reading() -> None:
    def endless() -> Iterator[Read]:
        while True:
            yield from batches(1)

    session = ReplaySession(endless(), "file")
    session.stop()
    session._thread.join(60)
    assert not session._thread.is_alive()


def test_packed_rows_come_in_order_and_tell_how_far_they_are() -> None:
    rows: list[Row] = [Frame("f", place * 10, FRAME, place) for place in range(1000)]
    parts = [RowBatch.from_rows(rows[at : at + 100]) for at in range(0, 1000, 100)]
    session = ReplaySession((Read(packed_rows(part)) for part in parts), "file", 1000)
    found: list[Row] = []
    told = []
    deadline = monotonic() + 60
    while monotonic() < deadline:
        update = session.poll()
        found += update.rows
        if not update.state.running:
            break
        told.append((update.state.progress, len(found) / 1000))
    assert found == rows
    assert all(progress == share for progress, share in told)
    assert session.poll().state.progress is None


def test_what_the_file_lacks_stands_as_soon_as_it_is_known() -> None:
    for count in (1, 3):
        losses = [f"bytes {number} are gone" for number in range(count)]
        session = ReplaySession([*batches(3), Read((), (), losses)], "file")
        assert len(all_of(session)) == 30
        trouble = session.poll().state.trouble
        assert trouble is not None
        assert losses[0] in trouble
        assert ("2 more" in trouble) == (count == 3)
    whole = ReplaySession(batches(3), "file")
    all_of(whole)
    assert whole.poll().state.trouble is None
