"""When the feed is polled: the clock, keys, files, rows that are read again."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from textual.pilot import Pilot

from fte_sniff.analysis.feed import FeedUpdate
from fte_sniff.analysis.model import BaudChange, StreamChange
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.errors import FileError
from fte_sniff.protocol import (
    KIND_BY_NAME,
    Gap,
    GapKind,
    PortEvent,
    PortEventKind,
    Row,
    encode,
)
from fte_sniff.protocol import rows as columns
from fte_sniff.tui import options as start_options
from fte_sniff.tui import view_model
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.i18n import set_language
from fte_sniff.tui.panes import switcher
from fte_sniff.tui.view_model import PollInterval, ViewModel
from tests.tui.conftest import (
    NOON_NS,
    STEP_NS,
    ListFeed,
    Rows,
    enter_line,
    page,
    play,
    press,
    rpms,
    settle,
    table,
    type_line,
    until,
)

SECOND_NS = 1_000_000_000
RESET = encode(KIND_BY_NAME["reset"], {})


class Resting(ListFeed):
    """A feed that can be asked to rest."""

    rests = 0

    def rest(self) -> None:
        self.rests += 1


@pytest.mark.parametrize(("keys_ns", "come"), [(0, False), (3_600_000_000_000, True)])
def test_a_key_holds_for_a_while_and_lets_the_feed_rest(
    monkeypatch: pytest.MonkeyPatch, keys_ns: int, come: bool
) -> None:
    monkeypatch.setattr(view_model, "KEY_PAUSE_NS", keys_ns)
    feed = Resting()
    interval = PollInterval(feed)
    assert not interval.key_was_recent
    interval.on_key()
    assert interval.key_was_recent is come
    assert feed.rests == 1


def test_a_feed_that_cannot_rest_is_polled_after_a_key() -> None:
    interval = PollInterval(ListFeed())
    interval.on_key()
    assert interval.on_clock()


@pytest.mark.parametrize(("pause_ns", "polls"), [(0, 10), (3_600_000_000_000, 100)])
def test_a_feed_at_rest_is_polled_seldom_unless_the_user_acts(
    monkeypatch: pytest.MonkeyPatch, pause_ns: int, polls: int
) -> None:
    monkeypatch.setattr(view_model, "INPUT_PAUSE_NS", pause_ns)
    interval = PollInterval(ListFeed())
    interval.on_input()
    assert sum(interval.on_clock(at_rest=True) for _ in range(100)) == polls
    assert all(interval.on_clock() for _ in range(100))


@pytest.mark.parametrize("share", [1e-12, 1e12])
def test_rows_of_a_capture_wait_if_drawing_takes_more_than_its_share_of_a_core(
    monkeypatch: pytest.MonkeyPatch, share: float
) -> None:
    monkeypatch.setattr(view_model, "SHARE_OF_CORE", share)
    monkeypatch.setattr(view_model, "LONGEST_INTERVAL_S", 3600.0)
    interval = PollInterval(ListFeed())
    assert interval.on_clock(captures=True)
    assert interval.on_clock(captures=True) is (share > 1)
    assert interval.on_clock(), "a file is polled at every tick"


def test_port_events_of_a_file_are_reported_once_and_calmly(feed: Any, speed_rows: Rows) -> None:
    feed.state = replace(feed.state, live=False)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(100))
        for at in range(300):
            feed.emit(PortEvent(NOON_NS + at, "/dev/ttyUSB0", PortEventKind.LINE_ERROR, "", 1))
        feed.emit(PortEvent(NOON_NS, "/dev/ttyUSB0", PortEventKind.LOST, "gone"))
        feed.emit(PortEvent(NOON_NS, "/dev/ttyUSB0", PortEventKind.CLOSED, ""))
        await settle(app, pilot)
        assert "port events while" not in page(app)
        feed.end("")
        await settle(app, pilot)
        words = page(app)
        assert "i port events while it was recorded: line error 300, lost 1" in words
        await press(app, pilot, "S")
        await settle(app, pilot)
        assert "line error 300" in page(app)

    play(feed, scenario, size=(120, 40))


@pytest.mark.parametrize(("kind", "count"), [("LOST", 1), ("OPENED", 0), ("CLOSED", 0)])
def test_port_events_that_not_every_recording_has_are_counted(
    feed: Any, kind: str, count: int
) -> None:
    feed.state = replace(feed.state, live=False)
    feed.emit(PortEvent(NOON_NS, "/dev/ttyUSB0", PortEventKind[kind], ""))
    model = ViewModel(feed, None, RowStore())
    model.poll(0)
    assert model.events_text.count("lost 1") == count
    set_language("zh")
    assert bool(model.events_text) == bool(count)
    assert "lost" not in model.events_text
    set_language("en")


def test_playing_a_file_leaves_its_port_events_as_they_are(feed: Any, speed_rows: Rows) -> None:
    feed.state = replace(feed.state, live=False)
    feed.give(speed_rows(30))
    event = PortEvent(NOON_NS + 10 * STEP_NS, "/dev/ttyUSB0", PortEventKind.LOST, "")
    feed.emit(event)
    store = RowStore()
    model = ViewModel(feed, None, store)
    model.poll(0)
    model.play(0, 1.0, 0)
    assert model.poll(SECOND_NS).events == [event]
    assert [one.what for one in store.landmarks.between(0, 31)] == [event]


def test_keys_come_before_the_rows_of_a_file(
    feed: Any, speed_rows: Rows, monkeypatch: pytest.MonkeyPatch
) -> None:
    rests: list[bool] = []
    feed.rest = lambda: rests.append(True)
    feed.state = replace(feed.state, live=False)
    monkeypatch.setattr(view_model, "KEY_PAUSE_NS", 3_600_000_000_000)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        assert rests == []
        await press(app, pilot, "slash")
        assert rests == [True]
        feed.give(speed_rows(10, start=10))
        await settle(app, pilot)
        assert len(app._model.store) == 10
        await type_line(app, pilot, "rpm")
        assert "rpm" in page(app)
        monkeypatch.setattr(view_model, "KEY_PAUSE_NS", 0)
        await settle(app, pilot)
        assert len(app._model.store) == 20

    play(feed, scenario, rows=10)


def test_keys_do_not_keep_a_wire_waiting(feed: Any, speed_rows: Rows) -> None:
    feed.rest = pytest.fail

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "k")
        feed.give(speed_rows(10))
        await settle(app, pilot)
        assert len(app._model.store) == 10

    play(feed, scenario)


def test_a_gap_in_a_file_is_not_silence(feed: Any, speed_rows: Rows) -> None:
    """What stands between rows gets to the numbers, whatever came before."""
    feed.state = replace(feed.state, live=False)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give([*speed_rows(10, start=10), *speed_rows(10, start=5000)])
        baud = BaudChange("/dev/ttyUSB0", 57_600)
        feed.changes = [StreamChange(10, Gap(GapKind.DAMAGE)), StreamChange(10, baud)]
        feed.end("")
        await settle(app, pilot)
        await press(app, pilot, "S")
        for _round in range(200):
            await settle(app, pilot)
            if "57,600 baud" in (words := page(app)):
                break
        assert "57,600 baud" in words
        assert "longest silence 132 µs" in words

    play(feed, scenario, size=(120, 40), rows=10)


class Rereading:
    """A file that can be taken away."""

    def __init__(self, rows: list[Row]) -> None:
        self.rows = rows
        self.gone = False
        self.starts: list[int] = []

    def load(self, start: int, count: int) -> columns.Rows:
        if self.gone:
            raise FileError("run.mcap: no such file any more")
        self.starts.append(start)
        return columns.Rows.of(self.rows[start : start + count])


@pytest.fixture
def few_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks of a hundred rows, of which two stay."""

    def small(bound: int, source: Any, most_blocks: int) -> RowStore:
        return RowStore(bound, 100, source, 2)

    monkeypatch.setattr(start_options, "RowStore", small)


@pytest.mark.usefixtures("few_in_memory")
def test_rows_that_were_dropped_are_read_again_as_one_goes_there(
    feed: Any, speed_rows: Rows
) -> None:
    rows = speed_rows(3000)
    feed.give(rows)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "g")
        assert rpms(app)[0] == 0
        await enter_line(app, pilot, "slash", "rpm=1234")
        assert table(app).viewport.cursor == 1234
        await press(app, pilot, "f")
        await type_line(app, pilot, "motor = 1")
        await press(app, pilot, "enter", "g")
        await settle(app, pilot)
        assert rpms(app)[:3] == [0, 4, 8]
        assert "750 of 3,000 rows" in page(app)

    play(feed, scenario, source=Rereading(rows))


@pytest.mark.usefixtures("few_in_memory")
def test_rows_that_cannot_be_read_any_more_end_the_screen_with_a_reason(
    feed: Any, speed_rows: Rows, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(switcher, "HEALTH_EVERY_NS", 0)  # health needs the cursor's row each time
    source = Rereading(speed_rows(3000))
    feed.give(source.rows)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        source.gone = True
        await enter_line(app, pilot, "slash", "rpm=1234")
        await settle(app, pilot)
        assert "run.mcap: no such file any more" in page(app)
        assert app.failure is None
        await press(app, pilot, "g")
        await settle(app, pilot)

    app = play(feed, scenario, source=source)
    assert isinstance(app.failure, FileError)


class Pieces(ListFeed):
    """A file that is read faster than it is counted: a hundred rows at each look."""

    def __init__(self, rows: list[Row]) -> None:
        super().__init__()
        self._left = rows
        self.state = replace(self.state, live=False, recording=None)

    def poll(self) -> FeedUpdate:
        self.give(self._left[:100])
        self._left = self._left[100:]
        if not self._left:
            self.end("")
        return super().poll()


def test_rows_are_counted_before_they_leave_memory(
    monkeypatch: pytest.MonkeyPatch, speed_rows: Rows
) -> None:
    def small(bound: int, source: Any, most_blocks: int) -> RowStore:
        return RowStore(bound, 100, source, 8)

    monkeypatch.setattr(start_options, "RowStore", small)
    monkeypatch.setattr(switcher, "STEP_ROWS", 50)
    monkeypatch.setattr(switcher, "CLOSED_BUDGET_S", 0.0)
    # Nothing answers a reset, so that no search for answers reads other rows meanwhile.
    rows: list[Row] = [replace(row, raw=RESET) for row in speed_rows(1200)]
    source = Rereading(rows)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await until(app, pilot, lambda: "ENDED" in page(app) or "FILE" in page(app))
        await press(app, pilot, "S")
        # What is left, and does not yet leave memory, is counted while somebody looks.
        await until(app, pilot, lambda: "rows to go" not in page(app))

    play(Pieces(rows), scenario, source=source)
    # The first block is where the cursor stays.
    assert set(source.starts) <= {0}
