"""Prompt fields: goals, completion, history, and typing on the screen."""

from __future__ import annotations

import asyncio
import re
from datetime import time, timedelta, timezone
from typing import Any

import pytest
from textual import events
from textual.pilot import Pilot

from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.time_text import ClockTime
from fte_sniff.errors import FilterError, InputTextError
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.goto import Goal, ToDistance, ToRow, ToTimeOfDay, parse_goal
from fte_sniff.tui.options import StartOptions
from fte_sniff.tui.panes.detail import DetailPane
from fte_sniff.tui.prompt import History, completed
from fte_sniff.tui.table.widget import RowTable
from tests.tui.conftest import (
    Rows,
    page,
    play,
    press,
    rpms,
    rush,
    settle,
    table,
    type_line,
)


def test_a_filter_is_checked_while_one_types_and_applied_by_enter(
    feed: Any, speed_rows: Rows
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(400))
        await settle(app, pilot)
        await press(app, pilot, "f")
        await type_line(app, pilot, "motr = 2")
        await pilot.pause()
        assert "✗" in page(app)
        assert "motor" in page(app)
        await press(app, pilot, "enter")
        assert rpms(app)[-1] == 399
        await press(app, pilot, *["backspace"] * 5)
        await type_line(app, pilot, "or = 2")
        await pilot.pause()
        assert "✓" in page(app)
        await press(app, pilot, "enter")
        await settle(app, pilot)
        assert rpms(app)[-1] == 397
        assert "100 of 400 rows" in page(app)
        feed.give(speed_rows(400, start=400))
        await settle(app, pilot)
        assert "200 of 800 rows" in page(app)
        await press(app, pilot, "F")
        await settle(app, pilot)
        assert rpms(app)[-1] == 799
        assert "of 800 rows" not in page(app)

    play(feed, scenario)


def test_the_cursor_stays_on_its_row_when_a_filter_comes_and_goes(
    feed: Any, speed_rows: Rows
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(1000))
        await settle(app, pilot)
        await press(app, pilot, "colon")
        await type_line(app, pilot, "501")
        await press(app, pilot, "enter", "f")
        await type_line(app, pilot, "motor = 1")
        await press(app, pilot, "enter")
        await settle(app, pilot)
        cursor = table(app).cursor_row
        assert cursor is not None
        assert cursor.offset == 5000
        await press(app, pilot, "F")
        await settle(app, pilot)
        assert table(app).viewport.cursor == 500

    play(feed, scenario)


def test_a_filter_that_hides_everything_says_so(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await settle(app, pilot)
        assert "nothing came yet" in page(app)
        feed.give(speed_rows(40))
        await settle(app, pilot)
        await press(app, pilot, "f")
        await type_line(app, pilot, "rpm > 9000")
        await press(app, pilot, "enter")
        await settle(app, pilot)
        assert "the filter hides all 40 rows; F shows them again" in page(app)
        await press(app, pilot, "enter", "e", "E", "down", "up", "c", "G", "g")
        assert "no row" in page(app)

    play(feed, scenario)


def test_begins_with_a_filter_that_was_asked_for(feed: Any, speed_rows: Rows) -> None:
    app = SniffApp(feed, StartOptions(row_filter=RowFilter.parse("motor = 2")))
    feed.give(speed_rows(400))

    async def run() -> None:
        async with app.run_test(size=(80, 24)) as pilot:
            await settle(app, pilot)
            assert rpms(app)[-1] == 397
            assert "motor = 2" in page(app)
            assert "100 of 400 rows" in page(app)
            await press(app, pilot, "F")
            await settle(app, pilot)
            assert rpms(app)[-1] == 399

    asyncio.run(run())


def test_esc_leaves_the_filter_as_it_was_and_arrows_bring_back_lines(
    feed: Any, speed_rows: Rows
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(40))
        await settle(app, pilot)
        for line in ("motor = 1", "motor = 2"):
            await press(app, pilot, "f", "ctrl+u")
            await type_line(app, pilot, line)
            await press(app, pilot, "enter")
        await press(app, pilot, "f", "ctrl+u", "x", "escape")
        await settle(app, pilot)
        assert app.focused is table(app)
        assert "filter motor = 2" in re.sub(" +", " ", page(app))
        assert "10 of 40 rows" in page(app)
        await press(app, pilot, "f", "up", "up", "enter")
        await settle(app, pilot)
        assert "filter motor = 1" in re.sub(" +", " ", page(app))
        await press(app, pilot, "escape", "escape", "escape")
        assert app.is_running

    play(feed, scenario)


def test_keys_typed_ahead_go_to_the_field_that_they_open(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(400))
        await settle(app, pilot)
        await rush(app, pilot, *"gf", *"motor", "equals_sign", *"9", "backspace", "2", "enter", "p")
        await settle(app, pilot)
        assert "filter motor=2" in re.sub(" +", " ", page(app))
        assert "PAUSED" in page(app)
        assert rpms(app)[0] == 1
        await rush(app, pilot, "f", "ctrl+u", *"mo", "escape", "colon", *"50", "enter", "j", "j")
        await settle(app, pilot)
        assert table(app).viewport.cursor == 51
        assert "filter motor=2" in re.sub(" +", " ", page(app))

    play(feed, scenario)


def test_a_rush_of_keys_for_the_pane_the_help_and_a_field(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(400))
        await settle(app, pilot)
        await rush(app, pilot, "enter", "f", "q", "enter", "escape")
        assert app.focused is table(app)
        assert app.query_one(DetailPane).display
        await rush(app, pilot, "question_mark", "q", "escape", "p")
        assert not app._exit
        assert len(app.screen_stack) == 1
        assert table(app).viewport.paused

    play(feed, scenario)


def test_a_filter_at_rest_takes_no_keys_and_a_click_wakes_it(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(400))
        await press(app, pilot, "f")
        await type_line(app, pilot, "motor = 1")
        await press(app, pilot, "enter", "tab", "tab", "G")
        assert app.focused is table(app)
        await pilot.click(".asked", offset=(20, 0))
        await press(app, pilot, "end", "1")
        assert "motor = 11" in page(app)

    play(feed, scenario)


def test_tab_completes_and_never_leaves_a_field(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(400))
        await settle(app, pilot)
        await press(app, pilot, "f", *"mot")
        await settle(app, pilot)
        await press(app, pilot, "tab", "shift+tab", "tab")
        await type_line(app, pilot, " = 1")
        await press(app, pilot, "enter")
        await settle(app, pilot)
        assert "100 of 400 rows" in page(app)
        assert app.focused is table(app)

    play(feed, scenario)


def test_a_field_is_left_by_a_click_elsewhere_but_not_with_the_window(
    feed: Any, speed_rows: Rows
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(400))
        await press(app, pilot, "colon", "1")
        app.post_message(events.AppBlur())
        await settle(app, pilot)
        app.post_message(events.AppFocus())
        await press(app, pilot, "2")
        await settle(app, pilot)
        assert "go to 12" in page(app)
        await pilot.click(RowTable, offset=(20, 3))
        await settle(app, pilot)
        assert "go to" not in page(app)
        assert app.focused is table(app)

    play(feed, scenario)


def test_the_count_beside_the_filter_is_that_of_the_filter_that_is_on(
    feed: Any, speed_rows: Rows
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(400))
        await press(app, pilot, "f")
        await type_line(app, pilot, "motor = 1")
        await press(app, pilot, "enter")
        await settle(app, pilot)
        assert "100 of 400 rows" in page(app)
        await press(app, pilot, "f", "x")
        await settle(app, pilot)
        assert "of 400 rows" not in page(app)
        await press(app, pilot, "ctrl+u", "enter", "f")
        await settle(app, pilot)
        assert "of 400 rows" not in page(app)

    play(feed, scenario)


def test_keys_typed_into_the_filter_are_text(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "f", "q", "question_mark", "G", "space", "p", "colon", "e")
        assert app.is_running
        assert "q?G p:e" in page(app)

    play(feed, scenario)


@pytest.mark.parametrize(
    ("text", "goal"),
    [
        ("1", ToRow(1)),
        (" 1,200 ", ToRow(1200)),
        ("12:00", ToTimeOfDay(ClockTime(time(12)))),
        ("00:00:03.5", ToTimeOfDay(ClockTime(time(0, 0, 3), 500_000_000))),
        ("23:59:59.999999999", ToTimeOfDay(ClockTime(time(23, 59, 59), 999_999_999))),
        ("20:00+08:00", ToTimeOfDay(ClockTime(time(20, tzinfo=timezone(timedelta(hours=8)))))),
        ("+2s", ToDistance(2 * 10**9)),
        ("-50ms", ToDistance(-50_000_000)),
        ("+0.25s", ToDistance(250_000_000)),
        ("-1.5us", ToDistance(-1_500)),
        ("+7ns", ToDistance(7)),
        ("+1m30s", ToDistance(90 * 10**9)),
        ("-2min", ToDistance(-120 * 10**9)),
    ],
)
def test_a_goal_is_understood(text: str, goal: Goal) -> None:
    assert parse_goal(text) == goal


@pytest.mark.parametrize(
    "text", ["", "x", "24:00", "12:60", "12:00:61", "2s", "--1s", "1.5", "٣", "+1y"]
)
def test_what_is_no_goal_is_told_with_examples(text: str) -> None:
    with pytest.raises(InputTextError, match=r"1200.*12:00:03\.5.*-50ms"):
        parse_goal(text)


@pytest.mark.parametrize("text", ["+5", "-50", "+0.5"])
def test_a_distance_without_a_unit_is_told_with_units(text: str) -> None:
    with pytest.raises(InputTextError, match=re.escape(f"{text}s, {text}ms")):
        parse_goal(text)


@pytest.mark.parametrize(
    ("typed", "whole"),
    [
        ("mo", "motor"),
        ("motor = 1 AND r", "motor = 1 AND rpm"),
        ("kind = 'speed_", "kind = 'speed_feedback'"),
        ("motor = 1 an", "motor = 1 AND"),
        ("motor ", "motor ="),
        ("zz", None),
        ("vx > ti", None),
        ("vx > ", None),
        ("", None),
    ],
)
def test_the_last_word_is_completed(typed: str, whole: str | None) -> None:
    assert completed(typed) == whole


@pytest.mark.parametrize(("short", "name"), [("vx", "vx_cm_s"), ("wz", "wz_mrad_s")])
def test_the_short_names_of_the_table_lead_to_those_of_a_filter(short: str, name: str) -> None:
    with pytest.raises(FilterError, match=f"did you mean {name}"):
        RowFilter.parse(f"{short} > 10")


def test_history_goes_back_and_returns_to_what_was_typed() -> None:
    history = History()
    for line in ("a", "b", "a", ""):
        history.append(line)
    assert [history.go(-1, "half") for _ in range(3)] == ["a", "b", "b"]
    assert [history.go(1, "half") for _ in range(3)] == ["a", "half", "half"]


def test_history_without_lines_keeps_what_is_typed() -> None:
    history = History()
    assert history.go(-1, "half") == history.go(1, "half") == "half"
