"""Rows are looked at when they come, not when a clock says so; and no feed hurries the screen."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Iterator
from contextlib import suppress
from time import monotonic

import pytest
from textual.pilot import Pilot

from fte_sniff.analysis.feed import FeedUpdate
from fte_sniff.tui import app as screen
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.view_model import REST_S, WakeUp
from tests.tui.conftest import ListFeed
from tests.tui.playing import Rows, page, play

BOUND_S = 60.0


class ToldFeed(ListFeed):
    """A feed that can be waited for, as a capture process is."""

    def __init__(self) -> None:
        super().__init__()
        self._near, self._far = socket.socketpair()
        self._near.setblocking(False)
        self.polls = 0

    @property
    def descriptor(self) -> int:
        return self._near.fileno()

    def call(self) -> None:
        """Let it be heard that there is something."""
        self._far.send(b".")

    def hang_up(self) -> None:
        """From now on it can be read from for ever."""
        self._far.close()

    def poll(self) -> FeedUpdate:
        self.polls += 1
        with suppress(BlockingIOError):
            self._near.recv(1 << 10)
        return super().poll()

    def close(self) -> None:
        self._near.close()
        self._far.close()


@pytest.fixture
def told() -> Iterator[ToldFeed]:
    feed = ToldFeed()
    yield feed
    feed.close()


@pytest.fixture
def no_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """The screen's own clock does not strike while the test runs."""
    monkeypatch.setattr(screen, "TICK_S", 3600.0)


async def until(pilot: Pilot[None], holds: Callable[[], bool]) -> None:
    end = monotonic() + BOUND_S
    while not holds():
        assert monotonic() < end
        await pilot.pause(0.005)


@pytest.mark.usefixtures("no_clock")
def test_rows_that_come_are_shown_without_a_clock(told: ToldFeed, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        for count in (1, 2, 3):
            told.give(speed_rows(1, start=count - 1))
            told.call()
            await until(pilot, lambda count=count: f"{count} rows" in page(app))  # type: ignore[misc]

    play(told, scenario)


@pytest.mark.usefixtures("no_clock")
def test_a_feed_that_has_ended_wakes_nobody(told: ToldFeed) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        told.end("unplugged")
        told.hang_up()
        await until(pilot, lambda: "unplugged" in page(app))
        polls = told.polls
        await pilot.pause(3 * REST_S)
        assert told.polls == polls

    play(told, scenario)


def test_a_feed_cannot_hurry_the_screen() -> None:
    async def scenario() -> None:
        near, far = socket.socketpair()
        woken: list[float] = []
        third = asyncio.Event()

        def wake() -> None:
            woken.append(monotonic())
            if len(woken) == 3:
                third.set()

        with near, far:
            far.send(b".")  # never read: it can be read from all the time
            waking = WakeUp(near.fileno(), wake)
            await asyncio.wait_for(third.wait(), BOUND_S)
            waking.end()
            waking.end()
        assert woken[2] - woken[0] >= 1.9 * REST_S

    asyncio.run(scenario())
