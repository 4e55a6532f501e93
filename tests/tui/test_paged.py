"""The screen on rows of which only a few lie in memory."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import pytest

from fte_sniff.analysis.feed import FeedUpdate
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.errors import FileError
from fte_sniff.protocol import Row
from fte_sniff.row_batch import Codebook, RowBatch
from fte_sniff.tui import options as opening
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.panes import switcher as panes
from tests.tui.conftest import ListFeed
from tests.tui.playing import Rows, page, press, rpms, settle, table, type_line, until


class Rereading:
    """A file that can be taken away."""

    def __init__(self, rows: list[Row]) -> None:
        self.rows = rows
        self.gone = False
        self.starts: list[int] = []

    def load(self, start: int, count: int, codebook: Codebook) -> RowBatch:
        if self.gone:
            raise FileError("run.mcap: there is no such file any more")
        self.starts.append(start)
        return RowBatch.from_rows(self.rows[start : start + count], codebook)


@pytest.fixture
def few_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks of a hundred rows, of which two stay."""

    def small(bound: int, source: Any, most_blocks: int) -> RowStore:
        return RowStore(bound, 100, source, 2)

    monkeypatch.setattr(opening, "RowStore", small)


@pytest.mark.usefixtures("few_in_memory")
def test_rows_that_were_dropped_are_read_again_as_one_goes_there(
    feed: Any, speed_rows: Rows
) -> None:
    rows = speed_rows(3000)
    app = SniffApp(feed, source=Rereading(rows))

    async def run() -> None:
        async with app.run_test(size=(80, 24)) as pilot:
            feed.give(rows)
            await settle(app, pilot)
            await press(app, pilot, "g")
            assert rpms(app)[0] == 0
            await press(app, pilot, "slash")
            await type_line(app, pilot, "rpm=1234")
            await press(app, pilot, "enter")
            assert table(app).viewport.cursor == 1234
            await press(app, pilot, "f")
            await type_line(app, pilot, "motor = 1")
            await press(app, pilot, "enter", "g")
            await settle(app, pilot)
            assert rpms(app)[:3] == [0, 4, 8]
            assert "750 of 3,000 rows" in page(app)

    asyncio.run(run())


@pytest.mark.usefixtures("few_in_memory")
def test_rows_that_cannot_be_read_any_more_end_the_screen_with_a_reason(
    feed: Any, speed_rows: Rows
) -> None:
    source = Rereading(speed_rows(3000))
    app = SniffApp(feed, source=source)

    async def run() -> None:
        async with app.run_test(size=(80, 24)) as pilot:
            feed.give(source.rows)
            await settle(app, pilot)
            source.gone = True
            await press(app, pilot, "slash")
            await type_line(app, pilot, "rpm=1234")
            await press(app, pilot, "enter")
            await settle(app, pilot)
            assert "run.mcap: there is no such file any more" in page(app)
            assert app.failure is None
            await press(app, pilot, "g")
            await settle(app, pilot)

    asyncio.run(run())
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

    monkeypatch.setattr(opening, "RowStore", small)
    monkeypatch.setattr(panes, "STEP_ROWS", 50)
    monkeypatch.setattr(panes, "UNSEEN_S", 0.0)
    rows = speed_rows(1200)
    source = Rereading(rows)
    app = SniffApp(Pieces(rows), source=source)

    async def run() -> None:
        async with app.run_test(size=(80, 24)) as pilot:
            await until(app, pilot, lambda: "ENDED" in page(app) or "FILE" in page(app))
            await press(app, pilot, "S")
            # What is left, and does not yet leave memory, is counted while somebody looks.
            await until(app, pilot, lambda: "rows to go" not in page(app))

    asyncio.run(run())
    # The first block is where the cursor stays.
    assert set(source.starts) <= {0}
