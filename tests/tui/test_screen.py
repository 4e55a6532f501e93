"""The whole screen, driven by keys and mouse, on a feed that the tests fill."""

from __future__ import annotations

import asyncio
import random
import re
from dataclasses import replace
from datetime import timedelta, timezone
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import pytest
from textual import events
from textual.pilot import Pilot

from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.errors import PortError
from fte_sniff.protocol import Frame, PortEvent, PortEventKind, Row
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.keys import SECTIONS
from fte_sniff.tui.options import AtEnd, StartOptions
from fte_sniff.tui.panes.detail import DetailPane
from fte_sniff.tui.prompt import PromptField
from fte_sniff.tui.table.columns import TableView, TimeStyle, layout_for
from fte_sniff.tui.table.widget import RowTable
from tests.tui.conftest import NOON_NS
from tests.tui.playing import (
    ROUNDS,
    Rows,
    lines,
    page,
    play,
    press,
    rpms,
    rush,
    settle,
    table,
    type_line,
    until,
    wheel,
)


def test_shows_the_newest_rows_and_follows(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(100))
        await settle(app, pilot)
        assert rpms(app) == list(range(80, 100))
        feed.give(speed_rows(50, start=100))
        await settle(app, pilot)
        assert rpms(app) == list(range(130, 150))
        text = page(app)
        assert "/dev/ttyUSB0" in text
        assert "rec /tmp/a.mcap" in text
        assert "LIVE" in text
        assert "150 rows" in text

    play(feed, scenario)


@pytest.mark.parametrize("key", ["up", "pageup", "g", "E"])
def test_leaves_the_end_and_stays_where_one_reads(feed: Any, speed_rows: Rows, key: str) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give([*_odd(feed), *speed_rows(100)])
        await settle(app, pilot)
        await press(app, pilot, key)
        where, shown = table(app).viewport.cursor, table(app).viewport.top
        feed.give(speed_rows(500, start=100))
        await settle(app, pilot)
        view = table(app).viewport
        assert (view.following, view.cursor, view.top) == (False, where, shown)
        assert view.cursor < 100
        assert f"SCROLLED +{601 - shown - view.height:,}" in page(app)
        await press(app, pilot, "G")
        await pilot.pause()
        assert table(app).viewport.following
        assert rpms(app)[-1] == 599
        assert "LIVE" in page(app)

    play(feed, scenario)


def _odd(feed: Any) -> list[Row]:
    from fte_sniff.protocol import Damage, Fault

    return [Damage(feed.state.title, 0, b"\x00", 0, (Fault.NOISE,))]


def test_the_wheel_leaves_the_end_and_takes_it_up_again(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(100))
        await settle(app, pilot)
        await wheel(app, pilot, events.MouseScrollUp)
        assert not table(app).viewport.following
        assert rpms(app) == list(range(77, 97))
        await wheel(app, pilot, events.MouseScrollDown)
        assert table(app).viewport.following

    play(feed, scenario)


def test_columns_move_sideways_as_far_as_there_are_any(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(5))
        await settle(app, pilot)
        await press(app, pilot, *["right"] * 40)
        await settle(app, pilot)
        assert lines(app)[1].rstrip().endswith("cmd")
        assert "12:00:00.004" in page(app)
        await press(app, pilot, *["left"] * 40)
        await settle(app, pilot)
        assert lines(app)[1].strip().startswith("time UTC     kind")

    play(feed, scenario)


def test_a_click_puts_the_cursor_there(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(100))
        await settle(app, pilot)
        await pilot.click(RowTable, offset=(20, 3))
        assert table(app).viewport.cursor == 83
        assert not table(app).viewport.following

    play(feed, scenario)


@pytest.mark.parametrize("key", ["space", "p"])
def test_pause_freezes_the_view_and_counts_what_is_new(
    feed: Any, speed_rows: Rows, key: str
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(100))
        await settle(app, pilot)
        await press(app, pilot, key)
        feed.give(speed_rows(1234, start=100))
        await settle(app, pilot)
        assert rpms(app) == list(range(80, 100))
        assert "PAUSED, 1,234 new" in page(app)
        assert "1,334 rows" in page(app)
        await press(app, pilot, "end" if key == "p" else key)
        assert rpms(app)[-1] == 1333
        assert "LIVE" in page(app)

    play(feed, scenario)


def test_pause_keeps_its_rows_under_a_filter_too(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(100))
        await settle(app, pilot)
        await press(app, pilot, "space", "f")
        await type_line(app, pilot, "motor = 1")
        await press(app, pilot, "enter")
        feed.give(speed_rows(100, start=100))
        await settle(app, pilot)
        assert rpms(app)[-1] == 96
        assert "PAUSED, 25 new" in page(app)

    play(feed, scenario)


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


def test_rows_beyond_the_bound_leave_and_the_cursors_row_stays(feed: Any, speed_rows: Rows) -> None:
    app = SniffApp(feed, StartOptions(keep_rows=1000))
    feed.give(speed_rows(1000))

    async def run() -> None:
        async with app.run_test(size=(80, 24)) as pilot:
            await settle(app, pilot)
            table(app).jump(700)
            for start in (1000, 1600):
                feed.give(speed_rows(600, start=start))
                await settle(app, pilot)
                row = table(app).cursor_row
                assert row is not None
                assert row.offset == 10 * max(700, start + 600 - 1000)
                assert table(app).viewport.count == 1000
            assert "2,200 rows" in page(app)

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


def test_faults_are_found_below_and_above(feed: Any, speed_rows: Rows, odd_rows: list[Row]) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give([*speed_rows(100), odd_rows[3], *speed_rows(100), odd_rows[1], *speed_rows(100)])
        await settle(app, pilot)
        places = []
        for key in ("E", "E", "E", "e", "e"):
            await press(app, pilot, key)
            places.append(table(app).viewport.cursor)
        assert places == [201, 100, 100, 201, 201]
        assert "no row with a fault below this one" in page(app)

    play(feed, scenario)


def test_rows_that_tell_of_a_motor_out_of_order_are_found_and_e_points_to_them(
    feed: Any, speed_rows: Rows
) -> None:
    offline = Frame("/dev/ttyUSB0", 0, bytes.fromhex("550104000000000807EE"), NOON_NS)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give([*speed_rows(100), offline, *speed_rows(100), offline, *speed_rows(100)])
        await settle(app, pilot)
        places = []
        for key in ("A", "A", "A", "a", "a"):
            await press(app, pilot, key)
            places.append(table(app).viewport.cursor)
        assert places == [201, 100, 100, 201, 201]
        assert "no row below this one whose ERROR or ONLINE is not in order" in page(app)
        view = table(app).viewport
        assert table(app).render_line(view.cursor - view.top).text.startswith("^ 12:00:00.000")
        await press(app, pilot, "g", "e")
        await settle(app, pilot)
        assert "no row with a fault below this one; a goes to one whose ERROR or" in page(app)
        assert table(app).viewport.cursor == 0
        await press(app, pilot, "S")
        await until(app, pilot, lambda: "motor 4: not ONLINE in 2 frames" in page(app))

    play(feed, scenario, (80, 40))


@pytest.mark.parametrize(
    ("goal", "said"),
    [
        ("12:03:05", "12:03:05 lies after the last row (12:00:00.999)"),
        ("+2s", "+2s lies after the last row (12:00:00.999)"),
        ("2027-01-01", "2027-01-01 lies after the last row (12:00:00.999)"),
        ("11:59", "11:59 lies before the first row (12:00:00.000)"),
        ("20:03:05+08:00", "20:03:05+08:00 lies after the last row (12:00:00.999)"),
        ("20:00:00.5+08:00", ""),
        ("12:00:00.999", ""),
        ("12:00:00", ""),
    ],
)
def test_a_time_outside_the_rows_is_said_to_be_outside(
    feed: Any, speed_rows: Rows, goal: str, said: str
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(1000))
        await settle(app, pilot)
        table(app).jump(499)
        await press(app, pilot, "colon")
        await type_line(app, pilot, goal)
        await press(app, pilot, "enter")
        await pilot.pause()
        assert said in page(app)
        assert ("lies" in page(app)) == bool(said)

    play(feed, scenario)


def test_times_are_local_where_asked_and_a_time_that_is_typed_then_is(
    feed: Any, speed_rows: Rows
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(1000))
        await settle(app, pilot)
        await press(app, pilot, "g", "t")
        await settle(app, pilot)
        assert "time +05:30" in page(app)
        assert table(app).render_line(0).text.startswith("  17:30:00.000")
        await press(app, pilot, "colon")
        await type_line(app, pilot, "17:30:00.5")
        await press(app, pilot, "enter")
        assert table(app).viewport.cursor == 500
        await press(app, pilot, "colon")
        await type_line(app, pilot, "2026-01-31 17:31")
        await press(app, pilot, "enter")
        await pilot.pause()
        assert "2026-01-31 17:31 lies after the last row (17:30:00.999)" in page(app)
        await press(app, pilot, "t", "t", "t")
        await settle(app, pilot)
        assert "time UTC" in page(app)

    play(feed, scenario, opening=StartOptions(zone=ZoneInfo("Asia/Kolkata")))


def test_local_times_hold_for_panes_and_notices_too(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(3))
        await settle(app, pilot)
        for pane in ("enter", "M", "S"):
            await press(app, pilot, pane)
            assert "12:00:00" in page(app)
            await press(app, pilot, "t")
            assert "17:30:00" in page(app)
            assert "12:00:00" not in page(app)
            await press(app, pilot, "T", pane)
        await press(app, pilot, "enter", "t")
        assert "2026-01-31T17:30:00.002000000+05:30" in page(app)
        feed.tell(PortEvent(NOON_NS, "/dev/ttyUSB0", PortEventKind.LOST, ""))
        await settle(app, pilot)
        assert "17:30:00.000  /dev/ttyUSB0 lost" in page(app)

    play(feed, scenario, size=(120, 50), opening=StartOptions(zone=ZoneInfo("Asia/Kolkata")))


def test_a_narrow_head_still_names_the_zone() -> None:
    look = TableView(times=TimeStyle.LOCAL, zone=timezone(timedelta(hours=8)))
    assert layout_for(40, look).columns[0].head_cell.split() == ["+08:00"]


@pytest.mark.parametrize(
    ("goal", "cursor"),
    [
        ("1", 0),
        ("700", 699),
        ("999999", 999),
        ("12:00:00.250", 250),
        ("-100ms", 399),
        ("+50ms", 549),
        ("23:59:59", 999),
    ],
)
def test_goes_to_rows_times_and_distances(
    feed: Any, speed_rows: Rows, goal: str, cursor: int
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(1000))
        await settle(app, pilot)
        table(app).jump(499)
        await press(app, pilot, "colon")
        await type_line(app, pilot, goal)
        await press(app, pilot, "enter")
        assert table(app).viewport.cursor == cursor
        await pilot.pause()
        assert ("there is no row 999,999; this is the last" in page(app)) == (goal == "999999")

    play(feed, scenario)


def test_a_goal_that_is_none_is_told(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "colon", "x", "enter")
        await pilot.pause()
        assert "✗ a row (1200)" in page(app)
        assert app.focused is not table(app)

    play(feed, scenario)


def test_the_pane_explains_the_cursors_row(
    feed: Any, speed_rows: Rows, odd_rows: list[Row]
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give([*speed_rows(40), odd_rows[3]])
        await settle(app, pilot)
        await press(app, pilot, "enter")
        feed.give(speed_rows(40, start=40))
        await settle(app, pilot)
        assert "expected EE, found EF" in page(app)
        assert "SCROLLED" in page(app)
        await press(app, pilot, "up")
        await settle(app, pilot)
        assert "expected EE" not in page(app)
        assert "39 RPM" in page(app)
        await press(app, pilot, "escape")
        await pilot.pause()
        assert "39 RPM" not in page(app)

    play(feed, scenario)


def test_the_help_is_shown_and_put_away(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "question_mark")
        await pilot.pause()
        assert "one row up; leaves the end" in page(app)
        await press(app, pilot, "pagedown", "j", "q")
        assert app.is_running
        assert app.focused is table(app)

    play(feed, scenario, (80, 40))


def test_the_help_moves_to_its_ends_and_says_how_much_more_there_is(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await rush(app, pilot, "question_mark", "end")
        await pilot.pause()
        assert "motor = 1 AND" in page(app)
        assert "more lines" not in page(app)
        await press(app, pilot, "home")
        await pilot.pause()
        assert "one row up; leaves the end" in page(app)
        before = int(re.findall(r"(\d+) more lines", page(app))[0])
        await press(app, pilot, "pagedown")
        await pilot.pause()
        assert int(re.findall(r"(\d+) more lines", page(app))[0]) < before - 10

    play(feed, scenario)


@pytest.mark.parametrize("width", [40, 60, 80])
def test_the_footer_names_the_help_and_the_way_out_at_every_width(feed: Any, width: int) -> None:
    def footer(app: SniffApp) -> str:
        return lines(app)[-1].replace(" ", "")

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        # Textual sets the footer's keys a few rounds after the screen stands.
        for _ in range(ROUNDS * 100):
            if "?HelpqQuit" in footer(app):
                break
            await pilot.pause()
        assert "?HelpqQuit" in footer(app)

    play(feed, scenario, (width, 12))


def test_the_pane_is_as_tall_as_its_words_up_to_half_the_screen(
    feed: Any, speed_rows: Rows, odd_rows: list[Row]
) -> None:
    heights = []

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give([odd_rows[4], *speed_rows(40), odd_rows[5]])
        await settle(app, pilot)
        await press(app, pilot, "enter")
        for key in ("end", "up", "home"):
            await press(app, pilot, key)
            await settle(app, pilot)
            heights.append(app.query_one(DetailPane).outer_size.height)

    play(feed, scenario, (200, 60))
    assert 28 <= heights[0] <= 30
    assert heights[2] < heights[1] < 12


def test_keys_typed_ahead_put_the_help_away_once(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "question_mark")
        await pilot.pause()
        assert len(app.screen_stack) == 2
        for _ in range(5):
            app.post_message(events.Key("escape", None))
        await pilot.pause()
        assert len(app.screen_stack) == 1
        assert app.focused is table(app)

    play(feed, scenario)


def test_every_key_of_the_help_does_something(feed: Any) -> None:
    def actions(app: SniffApp) -> set[str]:
        return {
            f"{active.binding.action}" for active in app.active_bindings.values() if active.enabled
        }

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        promised = {key.action for _, keys in SECTIONS for key in keys}
        assert promised <= actions(app)
        for action in promised:
            name = f"action_{action.split('(')[0]}"
            assert hasattr(app, name) or hasattr(table(app), name)

    play(feed, scenario)


def test_port_events_are_told_and_put_away(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.tell(PortEvent(0, "/dev/ttyUSB0", PortEventKind.LOST, "it was pulled out"))
        await settle(app, pilot)
        assert "! 00:00:00.000  /dev/ttyUSB0 lost: it was pulled out" in page(app)
        await press(app, pilot, "escape")
        await pilot.pause()
        assert "pulled out" not in page(app)

    play(feed, scenario)


def test_an_ended_feed_says_why_and_can_still_be_looked_at(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(1001))
        feed.end("/dev/ttyUSB0 was pulled out")
        await settle(app, pilot)
        assert "ENDED" in page(app)
        assert "ended: /dev/ttyUSB0 was pulled out" in page(app)
        assert "1,001 frames/s" in page(app)
        await press(app, pilot, "g")
        assert rpms(app)[0] == 0

    play(feed, scenario)


def test_a_recording_that_stops_is_told_while_the_rows_go_on(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(10))
        feed.state = replace(feed.state, recording=None, trouble="recording stopped: disk full")
        await settle(app, pilot)
        assert "recording stopped: disk full" in page(app)
        assert "LIVE" in page(app)
        await press(app, pilot, "escape")
        assert "recording stopped" not in page(app)

    play(feed, scenario)


def test_the_screen_closes_with_its_feed_where_it_is_to(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(5))
        feed.end("five rows")
        app.tick()
        assert not app.is_running or app._exit

    play(feed, scenario, at_end=AtEnd.LEAVE)


def test_a_feed_that_fails_closes_the_screen(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        def poll() -> None:
            raise PortError("/dev/ttyUSB0 is gone: plug it in")

        feed.poll = poll
        app.tick()

    app = play(feed, scenario)
    assert isinstance(app.failure, PortError)


def test_a_file_begins_at_its_first_row_and_shows_how_far_it_is_read(
    feed: Any, speed_rows: Rows
) -> None:
    feed.state = replace(feed.state, live=False, progress=0.0, recording=None)
    feed.give(speed_rows(1000))

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.state = replace(feed.state, progress=0.42)
        feed.give(speed_rows(1001, start=1000))
        await settle(app, pilot)
        assert rpms(app)[0] == 0
        assert "LOADING  42%" in page(app)
        assert "1,000 frames/s" in page(app)
        feed.state = replace(feed.state, running=False, progress=None)
        await settle(app, pilot)
        assert "FILE" in page(app)
        assert "ended" not in page(app)

    play(feed, scenario)


@pytest.mark.parametrize("key", ["q", "ctrl+q", "ctrl+c"])
def test_quits(feed: Any, key: str) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, key)
        assert app._exit

    assert play(feed, scenario).return_code == 0


def test_ctrl_c_copies_selected_text_of_a_field_first(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "f", "m", "o", "shift+home", "ctrl+c")
        assert app.clipboard == "mo"
        assert not app._exit
        await press(app, pilot, "end", "ctrl+c")
        assert app._exit

    play(feed, scenario)


def test_copies_the_rows_bytes(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(1))
        await settle(app, pilot)
        await press(app, pilot, "c")
        assert app.clipboard == "AA 01 01 00 00 00 00 00 00 EE"

    play(feed, scenario)


def test_text_from_outside_is_shown_and_never_obeyed(feed: Any, speed_rows: Rows) -> None:
    evil = "[bold red]\x1b]0;owned\x07/dev/串口[/]"
    harmless = r"[bold red]\x1b]0;owned\x07/dev/串口[/]"

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.state = replace(feed.state, title=evil, recording=f"/tmp/{evil}\udcff.mcap")
        feed.give([*speed_rows(3, port=evil), *speed_rows(3, port="b")])
        feed.tell(PortEvent(0, evil, PortEventKind.LOST, evil))
        await settle(app, pilot)
        await press(app, pilot, "up", "up", "up", "enter")
        await settle(app, pilot)
        assert page(app).count(harmless) >= 4
        feed.end(evil)
        await settle(app, pilot)
        assert f"ended: {harmless}" in page(app)
        assert "\x1b" not in page(app)

    play(feed, scenario, (200, 60))


def test_each_row_says_its_port_where_there_are_two(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(3))
        await settle(app, pilot)
        assert "port" not in lines(app)[1]
        feed.give(speed_rows(3, port="/dev/ttyUSB1"))
        await settle(app, pilot)
        assert "port" in lines(app)[1]
        assert "ttyUSB0" in lines(app)[2]
        assert "ttyUSB1" in lines(app)[5]

    play(feed, scenario)


@pytest.mark.parametrize(
    ("size", "colour"),
    [
        ((3, 2), "colour"),
        ((20, 5), "colour"),
        ((40, 10), "colour"),
        ((80, 24), "colour"),
        ((200, 60), "colour"),
        ((40, 10), "no colour"),
        ((80, 24), "no colour"),
        ((80, 24), "light"),
    ],
)
def test_every_size_and_colour_scheme_draws(
    feed: Any,
    speed_rows: Rows,
    odd_rows: list[Row],
    monkeypatch: pytest.MonkeyPatch,
    size: tuple[int, int],
    colour: str,
) -> None:
    if colour == "no colour":
        monkeypatch.setenv("NO_COLOR", "1")

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        if colour == "light":
            app.theme = "textual-light"
        feed.give([*speed_rows(30), *odd_rows])
        await settle(app, pilot)
        await press(app, pilot, "enter", "up", "right", "right", "f")
        await type_line(app, pilot, "mot")
        await press(app, pilot, "escape", "question_mark")
        assert page(app)
        await press(app, pilot, "escape")
        await settle(app, pilot)
        if size[0] >= 40:
            assert "time" in page(app)
            assert "12:00:00" in page(app)
        if colour == "no colour":
            assert not re.search(r"#(?!([0-9a-f]{2})\1\1)[0-9a-f]{6}", _colours_drawn(app))

    play(feed, scenario, size)


def _colours_drawn(app: SniffApp) -> str:
    """The colours of every cell, after the filters that the terminal's lines go through."""
    here = table(app)
    drawn = []
    for y in range(here.viewport.height):
        strip = here.render_line(y).apply_filter(app._filters[-1], here.background_colors[1])
        for segment in strip:
            style = segment.style
            assert style is not None
            drawn += [c.get_truecolor().hex for c in (style.color, style.bgcolor) if c]
    return " ".join(drawn)


def test_resizing_keeps_the_cursor_in_view(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(500))
        await settle(app, pilot)
        table(app).jump(250)
        for size in ((40, 10), (200, 60), (80, 24), (10, 3)):
            await pilot.resize_terminal(*size)
            await pilot.pause()
            view = table(app).viewport
            assert view.cursor == 250
            assert view.top <= 250 < view.top + max(1, view.height)

    play(feed, scenario)


KEYS = (
    *("up", "down", "pageup", "pagedown", "home", "end", "left", "right", "g", "G", "j", "k"),
    *("f", "F", "e", "E", "colon", "space", "p", "enter", "enter", "c", "escape", "escape"),
    *("question_mark", "tab", "shift+tab", "1", "2", "m", "equals_sign", "backspace", "ctrl+u"),
    *("h", "l", "n", "slash", "ctrl+d", "delete", "insert", "f5", "a", "ctrl+a", "apostrophe"),
    *("N", "x", "X", "u", "U", "v", "y", "Y", "w", "t", "T", "C", "K", "J", "ctrl+t", "ctrl+p"),
    *("less_than_sign", "greater_than_sign", "percent_sign", "at", "minus", "r", "enter", "up"),
)


@pytest.mark.parametrize(
    ("seed", "size", "rounds"),
    [(1, (80, 24), 40), (2, (40, 10), 40), (3, (200, 60), 5), (4, (9, 4), 20)],
)
def test_random_keys_never_break_it(
    feed: Any,
    speed_rows: Rows,
    odd_rows: list[Row],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    seed: int,
    size: tuple[int, int],
    rounds: int,
) -> None:
    monkeypatch.chdir(tmp_path)
    chance = random.Random(seed)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        came = 0
        for _ in range(rounds):
            count = chance.randrange(60)
            feed.give([*speed_rows(count, start=came), *odd_rows])
            came += count
            app.tick()
            await press(app, pilot, *chance.choices(KEYS, k=8))
            view = app.screen_stack[0].query_one(RowTable).viewport
            assert 0 <= view.cursor <= max(0, view.count - 1)
        assert app.is_running
        await press(app, pilot, *["escape"] * 8, "F", "G")
        assert not any(field.asking for field in app.query(PromptField))
        await settle(app, pilot)
        assert table(app).viewport.following

    play(feed, scenario, size)
