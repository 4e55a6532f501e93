"""A file as a feed: all its rows, in order, at the view's own pace."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from time import monotonic

from fte_sniff.errors import FileError
from fte_sniff.protocol import Frame, Row
from fte_sniff.recording.columns import RowColumns, Words
from fte_sniff.session.packed import packed_rows
from fte_sniff.session.replay import MOST_BATCHES_AHEAD, ReplaySession

FRAME = bytes.fromhex("AA0000000000000000EE")


def batches(count: int, size: int = 10) -> list[list[Row]]:
    return [
        [Frame("f", (b * size + i) * 10, FRAME, None) for i in range(size)] for b in range(count)
    ]


def all_of(session: ReplaySession) -> list[Row]:
    rows: list[Row] = []
    deadline = monotonic() + 20
    while monotonic() < deadline:
        update = session.poll()
        rows += update.rows
        if not update.state.running:
            return rows
    raise AssertionError("it does not end")


def test_all_rows_come_in_order() -> None:
    made = batches(100)
    session = ReplaySession(made, "file")
    assert all_of(session) == [row for batch in made for row in batch]
    assert session.poll().state.ended is None
    assert session.poll().rows == []


def test_reading_waits_for_the_view() -> None:
    read = []
    enough = threading.Event()

    def reading() -> Iterator[list[Row]]:
        for number, batch in enumerate(batches(1000)):
            read.append(number)
            if len(read) > MOST_BATCHES_AHEAD:
                enough.set()
            yield batch

    session = ReplaySession(reading(), "file")
    assert enough.wait(20)
    assert len(read) <= MOST_BATCHES_AHEAD + 1
    assert len(all_of(session)) == 10_000


def test_what_cannot_be_read_ends_it_after_what_could() -> None:
    def reading() -> Iterator[list[Row]]:
        yield from batches(3)
        raise FileError("file: broken here")

    session = ReplaySession(reading(), "file")
    assert len(all_of(session)) == 30
    assert str(session.error) == "file: broken here"
    assert session.poll().state.ended == "file: broken here"


def test_stop_ends_the_reading() -> None:
    def endless() -> Iterator[list[Row]]:
        while True:
            yield from batches(1)

    session = ReplaySession(endless(), "file")
    session.stop()
    session._thread.join(20)
    assert not session._thread.is_alive()


def test_packed_rows_come_in_order_and_tell_how_far_they_are() -> None:
    rows: list[Row] = [Frame("f", place * 10, FRAME, place) for place in range(1000)]
    words = Words()
    parts = [RowColumns.of_rows(words, rows[at : at + 100]) for at in range(0, 1000, 100)]
    session = ReplaySession(map(packed_rows, parts), "file", 1000)
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
