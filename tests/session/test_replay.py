"""Files as feeds: as fast as they are read, and as fast as the rows came."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fte_sniff.analysis.feed import FeedState, FeedUpdate
from fte_sniff.analysis.model import StreamChange
from fte_sniff.errors import FileError
from fte_sniff.protocol import (
    KINDS,
    Fault,
    Gap,
    GapKind,
    PortEvent,
    PortEventKind,
    Row,
    encode,
)
from fte_sniff.protocol.rows import Rows
from fte_sniff.recording import reader as recording_reader
from fte_sniff.session.inputs import InputBatch
from fte_sniff.session.replay import Played, ReplaySession
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
                Row(port, offset, bytes([number % 256]) * 16, t_ns, (Fault.NOISE,), framed=False)
            )
    return rows


@pytest.fixture(autouse=True)
def small_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reading makes several batches of a file."""
    monkeypatch.setattr(recording_reader, "BATCH", 200_000)


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    return [*made("a", COUNT), *made("b", 1000)]


@dataclass
class Rest:
    """A feed that gives its rows at once."""

    rows: Rows
    events: Sequence[PortEvent] = ()
    changes: Sequence[StreamChange] = ()

    def poll(self) -> FeedUpdate:
        found = FeedUpdate(
            FeedState("f", running=False, live=False), self.rows, self.events, self.changes
        )
        self.rows, self.events, self.changes = self.rows[:0], (), ()
        return found

    def stop(self) -> None:
        pass


@dataclass
class Clock:
    now_ns: int = 5

    def __call__(self) -> int:
        return self.now_ns


def timed(times: Sequence[int | None]) -> Rows:
    return Rows.of([Row("f", 10 * number, FRAME, t_ns) for number, t_ns in enumerate(times)])


def test_rows_are_played_at_their_pace() -> None:
    clock = Clock()
    gap = StreamChange(4, Gap(GapKind.LEFT_OUT))
    event = PortEvent(1030, "f", PortEventKind.CLOCK_SET, "")
    play = Played(Rest(timed([1000, 1010, None, 1020, 1035, 1100]), [event], [gap]), 2.0, clock)

    def polled(now_ns: int) -> FeedUpdate:
        clock.now_ns = now_ns
        return play.poll()

    assert [row.t_ns for row in polled(5).rows] == [1000]
    assert not len(polled(9).rows)
    assert [row.t_ns for row in polled(10).rows] == [1010, None]
    assert [row.t_ns for row in polled(15).rows] == [1020]
    later = polled(23)
    assert ([row.t_ns for row in later.rows], later.events) == ([1035], [event])
    assert [one.index for one in later.changes] == [0]
    assert later.state.running
    last = polled(55)
    assert (len(last.rows), last.state.running, last.state.rows) == (1, False, 6)


@given(st.lists(st.integers(0, 500), max_size=60), st.lists(st.integers(0, 50), max_size=40))
def test_playing_is_the_same_however_often_it_is_polled(times: list[int], steps: list[int]) -> None:
    """Times may fall a little, as those of two ports do."""
    clock, often = Clock(), 0
    one, other = Played(Rest(timed(times)), 1.0, clock), Played(Rest(timed(times)), 1.0, clock)
    other.poll()
    for step in (0, *steps, 0):
        clock.now_ns += step
        often += len(one.poll().rows)
    first = 0 if not times else sum(max(times[: at + 1]) <= times[0] for at in range(len(times)))
    assert often == first + len(other.poll().rows)
