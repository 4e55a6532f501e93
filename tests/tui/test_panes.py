"""The panes on the whole screen, driven by keys."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest
from textual.pilot import Pilot

from fte_sniff.analysis.statistics import LineSetup
from fte_sniff.protocol import KIND_BY_NAME, Frame, PortEvent, PortEventKind, Row, encode
from fte_sniff.tui.app import LOW, SniffApp
from fte_sniff.tui.options import StartOptions
from fte_sniff.tui.panes.bytes import BytesPane
from fte_sniff.tui.panes.detail import DetailPane
from fte_sniff.tui.panes.motors import MotorsPane
from fte_sniff.tui.panes.pane import Pane
from fte_sniff.tui.panes.statistics import StatisticsPane

from .conftest import NOON_NS, STEP_NS
from .test_screen import page, play, press, settle, table

Rows = Callable[..., list[Row]]

PANES = {"i": DetailPane, "enter": DetailPane, "b": BytesPane, "M": MotorsPane, "S": StatisticsPane}


def feedback_rows(count: int) -> list[Row]:
    rows: list[Row] = []
    for number in range(count):
        name = "speed" if number % 2 else "speed_feedback"
        raw = encode(KIND_BY_NAME[name], {"motor": 1 + number // 2 % 4, "rpm": number})
        rows.append(Frame("/dev/ttyUSB0", 10 * number, raw, NOON_NS + number * STEP_NS))
    return rows


def shown(app: SniffApp) -> list[type[Pane]]:
    return [type(pane) for pane in app.query(Pane) if pane.display]


@pytest.mark.parametrize("width", [40, 100])
def test_the_motors_of_an_old_row_say_of_which(feed: Any, width: int) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(feedback_rows(400))
        await settle(app, pilot)
        await press(app, pilot, "M")
        await settle(app, pilot)
        title = app.query_one(MotorsPane)
        assert "as of" not in str(title.border_title)
        await press(app, pilot, "g")
        app._panes.look()
        assert "as of row 1, 12:00:00.000 - G: end" in str(title.border_title)

    play(feed, scenario, (width, 24))


def test_a_pane_that_has_no_place_yet_draws_nothing(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(feedback_rows(400))
        await settle(app, pilot)
        app._panes.toggle("motors")
        app._panes.look()
        assert app.query_one(MotorsPane)._drawn is None
        await settle(app, pilot)
        app._panes.look()
        drawn = app.query_one(MotorsPane)._drawn
        assert drawn is not None
        assert "motor 4" in drawn.plain

    play(feed, scenario)


@pytest.mark.parametrize("size", [(40, 12), (80, 24), (200, 60)])
@pytest.mark.parametrize("key", PANES)
def test_a_key_opens_a_pane_and_the_table_stays(feed: Any, key: str, size: tuple[int, int]) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(feedback_rows(400))
        await settle(app, pilot)
        await press(app, pilot, key)
        await settle(app, pilot)
        assert shown(app) == [PANES[key]]
        assert app.focused is table(app)
        assert table(app).size.height >= (2 if size[1] < LOW else 3)
        cursor = table(app).cursor_row
        await press(app, pilot, "k")
        assert table(app).cursor_row != cursor
        await press(app, pilot, key)
        assert shown(app) == []
        await press(app, pilot, key, "escape", "escape")
        assert shown(app) == []
        assert app.is_running

    play(feed, scenario, size)


def test_one_pane_takes_the_place_of_another(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(feedback_rows(40))
        await settle(app, pilot)
        for key in "ibMSiMb":
            await press(app, pilot, key)
            assert shown(app) == [PANES[key]]
        await press(app, pilot, "f", *"MSb")
        assert shown(app) == [BytesPane]
        assert "MSb" in page(app)

    play(feed, scenario)


@pytest.mark.parametrize("key", PANES)
@pytest.mark.parametrize("size", [(40, 12), (80, 24), (20, 6)])
def test_every_pane_opens_on_nothing_and_on_everything_odd(
    feed: Any, odd_rows: list[Row], key: str, size: tuple[int, int]
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, key)
        await settle(app, pilot)
        assert len(shown(app)) == 1
        feed.give(odd_rows)
        for _ in odd_rows:
            await settle(app, pilot)
            await press(app, pilot, "k", "J", "z")
        assert app.is_running

    play(feed, scenario, size)


def test_the_motors_are_those_at_the_cursor_and_the_newest_while_the_end_is_followed(
    feed: Any,
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(feedback_rows(400))
        await press(app, pilot, "M")
        await settle(app, pilot)
        app._panes.look()
        await settle(app, pilot)
        assert "392 RPM" in page(app)
        await press(app, pilot, "g", "j", "j", "j")
        app._panes.look()
        await settle(app, pilot)
        text = page(app)
        assert "now    0 RPM" in text
        assert "now    2 RPM" in text
        assert text.count("– RPM") == 2
        await press(app, pilot, "G")
        app._panes.look()
        await settle(app, pilot)
        assert "392 RPM" in page(app)

    play(feed, scenario)


def test_the_window_of_time_is_made_longer_and_shorter(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(feedback_rows(40))
        await press(app, pilot, "M")
        await settle(app, pilot)
        assert "motors, 10 s:" in page(app)
        await press(app, pilot, "Z", "Z")
        await settle(app, pilot)
        assert "motors, 60 s:" in page(app)
        await press(app, pilot, *"zzzzzzzz")
        await settle(app, pilot)
        assert "motors, 1 s:" in page(app)
        await press(app, pilot, *"ZZZZZZZZZZZZZZ")
        await settle(app, pilot)
        assert "motors, 4 h:" in page(app)

    play(feed, scenario)


def test_turns_stand_beside_pulses_in_the_detail_and_the_motors(feed: Any) -> None:
    raw = encode(KIND_BY_NAME["position_feedback"], {"motor": 2, "pulses": 5000})
    feed.give([Frame("p", 0, raw, NOON_NS)])
    app = SniffApp(feed, StartOptions(bench=LineSetup(resolution=500, gear_ratio=20)))

    async def scenario(pilot: Pilot[None]) -> None:
        await settle(app, pilot)
        await press(app, pilot, "i")
        await settle(app, pilot)
        assert "0.500 turns" in page(app)
        await press(app, pilot, "M")
        await settle(app, pilot)
        assert "5000 pulses 0.500 turns" in page(app)

    async def run() -> None:
        async with app.run_test(size=(80, 40)) as pilot:
            await scenario(pilot)

    asyncio.run(run())


def test_the_pane_scrolls_by_keys_and_every_bit_can_be_read_on_the_smallest_screen(
    feed: Any,
) -> None:
    raw = encode(KIND_BY_NAME["speed_feedback"], {"motor": 2, "rpm": 5, "error": 2, "online": 11})
    feed.give([Frame("p", 0, raw, NOON_NS)])

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "i")
        await settle(app, pilot)
        seen = page(app)
        for _ in range(30):
            await press(app, pilot, "J")
            seen += page(app)
        assert "bits 7-0: undefined 0000, unknown 0010" in seen
        assert "motor 4 1, motor 3 0" in seen
        assert "tail" in page(app)
        await press(app, pilot, *["K"] * 30)
        assert "speed_feedback  2026" in page(app)

    play(feed, scenario)


def test_line_errors_of_the_port_are_counted(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(feedback_rows(40))
        for number in range(3):
            feed.tell(PortEvent(NOON_NS + number, "/dev/ttyUSB0", PortEventKind.LINE_ERROR, "x"))
        await settle(app, pilot)
        await press(app, pilot, "escape", "S")
        await settle(app, pilot)
        assert "port events: line error 3 (last" in page(app)

    play(feed, scenario)


def test_the_bytes_pane_follows_the_cursor(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(feedback_rows(400))
        await settle(app, pilot)
        await press(app, pilot, "b")
        await settle(app, pilot)
        assert "bytes around offset 3,990" in page(app)
        await press(app, pilot, "g")
        await settle(app, pilot)
        assert "bytes around offset 0" in page(app)

    play(feed, scenario)


def test_rows_go_on_to_be_counted_while_no_pane_is_open(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        for start in range(0, 40_000, 10_000):
            feed.give(speed_rows(10_000, start=start))
            await settle(app, pilot)
        await press(app, pilot, "S")
        for _ in range(20):
            await settle(app, pilot)
            app._panes.look()
        assert "40,000 rows, 400,000 bytes" in page(app)

    play(feed, scenario)
