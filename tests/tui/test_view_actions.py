"""Times, columns, themes, the list of commands and the scroll bar."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import timedelta, timezone
from itertools import product
from typing import Any
from zoneinfo import ZoneInfo

import pytest
from textual import events
from textual.pilot import Pilot

from fte_sniff.protocol import Fault, PortEvent, PortEventKind, Row
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.cells import TableView, TimeStyle, layout_for
from fte_sniff.tui.commands import PALETTE
from fte_sniff.tui.i18n import THEMES
from fte_sniff.tui.modals import ColumnChooser, Picker
from fte_sniff.tui.options import StartOptions
from fte_sniff.tui.panes.row import DetailPane
from fte_sniff.tui.table import RowTable
from tests.tui.conftest import (
    NOON_NS,
    Rows,
    enter_line,
    lines,
    page,
    play,
    press,
    row_texts,
    rpms,
    rush,
    settle,
    table,
    type_line,
    wheel,
)


def test_leaves_the_end_and_stays_where_one_reads(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(
            [Row(feed.state.title, 0, b"\x00", 0, (Fault.NOISE,), framed=False), *speed_rows(100)]
        )
        await settle(app, pilot)
        for count, key in zip(range(100, 2100, 500), ("up", "pageup", "g", "E"), strict=True):
            await press(app, pilot, key)
            where, shown = table(app).viewport.cursor, table(app).viewport.top
            assert where < count
            feed.give(speed_rows(500, start=count))
            await settle(app, pilot)
            view = table(app).viewport
            assert (view.following, view.cursor, view.top) == (False, where, shown)
            assert f"SCROLLED +{count + 501 - shown - view.height:,}" in page(app)
            await press(app, pilot, "G")
            assert table(app).viewport.following
            assert rpms(app)[-1] == count + 499
            assert "LIVE" in page(app)

    play(feed, scenario)


def test_the_wheel_and_a_click_leave_the_end_and_the_wheel_takes_it_up_again(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await wheel(app, pilot, events.MouseScrollUp)
        assert not table(app).viewport.following
        assert rpms(app) == list(range(77, 97))
        await wheel(app, pilot, events.MouseScrollDown)
        assert table(app).viewport.following
        await pilot.click(RowTable, offset=(20, 3))
        assert table(app).viewport.cursor == 83
        assert not table(app).viewport.following

    play(feed, scenario, rows=100)


def test_columns_move_sideways_as_far_as_there_are_any(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, *["right"] * 40)
        await settle(app, pilot)
        assert lines(app)[1].rstrip().endswith("cmd")
        assert "12:00:00.004" in page(app)
        await press(app, pilot, *["left"] * 40)
        await settle(app, pilot)
        assert lines(app)[1].strip().startswith("time UTC     kind")

    play(feed, scenario, rows=5)


def test_pause_freezes_the_view_and_counts_what_is_new(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        for count, key, back in ((100, "space", "space"), (1334, "p", "end")):
            await press(app, pilot, key)
            feed.give(speed_rows(1234, start=count))
            await settle(app, pilot)
            assert rpms(app) == list(range(count - 20, count))
            assert "PAUSED, 1,234 new" in page(app)
            assert f"{count + 1234:,} rows" in page(app)
            await press(app, pilot, back)
            assert rpms(app)[-1] == count + 1233
            assert "LIVE" in page(app)
        await press(app, pilot, "space")
        await enter_line(app, pilot, "f", "motor = 1")
        feed.give(speed_rows(100, start=2568))
        await settle(app, pilot)
        assert rpms(app)[-1] == 2564
        assert "PAUSED, 25 new" in page(app)

    play(feed, scenario, rows=100)


def test_times_are_first_in_a_given_zone_and_so_is_a_time_that_is_typed(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "g")
        await settle(app, pilot)
        assert "time +05:30" in page(app)
        assert table(app).render_line(0).text[2:].startswith("17:30:00.000")
        await enter_line(app, pilot, "colon", "17:30:00.5")
        assert table(app).viewport.cursor == 500
        await enter_line(app, pilot, "colon", "2026-01-31 17:31")
        await pilot.pause()
        assert "2026-01-31 17:31 is after the last row (17:30:00.999)" in page(app)
        await press(app, pilot, "t", "t")
        await settle(app, pilot)
        assert "time UTC" in page(app)

    play(feed, scenario, options=StartOptions(zone=ZoneInfo("Asia/Kolkata")), rows=1000)


def test_local_times_hold_for_panes_and_notices_too(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        for pane in ("enter", "M", "S"):
            await press(app, pilot, pane)
            assert "17:30:00" in page(app)
            assert "12:00:00" not in page(app)
            await press(app, pilot, "t", "t")
            assert "12:00:00" in page(app)
            await press(app, pilot, "t", pane)
        await press(app, pilot, "enter")
        assert "2026-01-31T17:30:00.002000000+05:30" in page(app)
        feed.emit(PortEvent(NOON_NS, "/dev/ttyUSB0", PortEventKind.LOST, ""))
        await settle(app, pilot)
        assert "17:30:00.000  /dev/ttyUSB0 lost" in page(app)

    play(
        feed, scenario, size=(120, 50), options=StartOptions(zone=ZoneInfo("Asia/Kolkata")), rows=3
    )


def test_a_narrow_head_still_names_the_zone() -> None:
    look = TableView(times=TimeStyle.LOCAL, zone=timezone(timedelta(hours=8)))
    assert layout_for(40, look).columns[0].head_cell.split() == ["+08:00"]


def times(app: SniffApp) -> list[str]:
    """What stands in the column of times of the rows in view."""
    return [text[2:14].strip() for text in row_texts(app) if text.strip()]


def test_times_count_from_the_start_the_row_before_and_a_mark(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "G", "t")
        assert times(app)[-1] == "+0.099000"
        assert lines(app)[1].strip().startswith("+ start")
        await press(app, pilot, "t")
        assert times(app)[-1] == "12:00:00.099"
        table(app).jump(90)
        await press(app, pilot, "m", "t", "t")
        assert re.search("times count from the last mark", page(app))
        await press(app, pilot, "end")
        assert times(app)[-1] == "+0.009000"
        assert "-0.001000" in times(app)
        await press(app, pilot, "g")
        assert times(app)[1] == "-0.089000"

    play(feed, scenario, rows=100)


def test_columns_are_chosen_and_ordered(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "C")
        assert isinstance(app.screen, ColumnChooser)
        await settle(app, pilot)
        assert "[x] kind" in page(app)
        await press(app, pilot, "space", "down", "K", "enter")
        await settle(app, pilot)
        assert lines(app)[1].split()[:2] == ["kind", "values"]
        await press(app, pilot, "C", "down", "space", "escape")
        await settle(app, pilot)
        assert lines(app)[1].split()[0] == "kind"
        await press(app, pilot, "C", "r")
        await settle(app, pilot)
        assert lines(app)[1].split()[:3] == ["time", "UTC", "kind"]

    play(feed, scenario, rows=5)


def test_no_column_at_all_is_not_a_choice_and_a_single_one_is(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        count = len(table(app).columns)
        await press(app, pilot, "C", *(["space", "down"] * count), "enter")
        await settle(app, pilot)
        assert len(table(app).columns) == count
        await press(app, pilot, "C", *(["space", "down"] * (count - 1)), "enter", "right", "left")
        await settle(app, pilot)
        assert len(table(app).columns) == 1

    play(feed, scenario, rows=5)


def test_the_mouse_opens_rows_and_the_chooser(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await pilot.click(RowTable, offset=(20, 3), times=2)
        await settle(app, pilot)
        assert app.query_one(DetailPane).display
        await pilot.click("TableHeader", offset=(20, 0))
        await settle(app, pilot)
        assert isinstance(app.screen, ColumnChooser)
        y = next(y for y, line in enumerate(lines(app)) if "[x] kind" in line)
        await pilot.click(offset=(20, y))
        await press(app, pilot, "enter")
        await settle(app, pilot)
        assert "kind" not in lines(app)[1]

    play(feed, scenario, rows=50)


def test_the_scroll_bar_reaches_every_row_and_stays_while_it_looks_the_same(
    feed: Any, speed_rows: Rows
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        here = table(app)
        before = (here.virtual_size, here.scroll_y)
        for start in range(30_000, 31_000, 100):
            feed.give(speed_rows(100, start=start))
            await settle(app, pilot)
        assert (here.virtual_size, here.scroll_y) == before
        assert here.max_scroll_y == round(here.scroll_y)
        await press(app, pilot, "g")
        assert here.scroll_y == 0
        bar = here.vertical_scrollbar
        await pilot.click(bar, offset=(0, bar.size.height - 1))
        await settle(app, pilot)
        assert here.viewport.top == here.viewport.height

    play(feed, scenario, rows=30_000)


def test_rows_without_times_have_none_to_count_from_and_are_not_played(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        for key in ("t", "space"):
            await press(app, pilot, key)
            assert "no row here has a time" in page(app)
            assert "time UTC" in page(app)
            assert "PAUSED" not in page(app)
        await press(app, pilot, "greater_than_sign")
        assert "nothing is played" in page(app)

    file_of([Row("p", 0, b"\x01", None, (Fault.NOISE,), framed=False)], feed)
    play(feed, scenario)


def test_themes_are_switched_around(feed: Any, speed_rows: Rows, odd_rows: list[Row]) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give([*speed_rows(10), *odd_rows])
        seen = []
        for _ in THEMES:
            await press(app, pilot, "ctrl+t")
            await settle(app, pilot)
            seen.append(app.theme)
            assert f"theme {app.theme}" in page(app)
        assert sorted(seen) == sorted(THEMES)

    play(feed, scenario)


TYPED = [
    *(("quit", "app.leave"), ("exit", "app.leave"), ("theme", "app.theme"), ("dark", "app.theme")),
    *(("save", "export.ask"), ("export", "export.ask"), ("csv", "export.ask")),
    *(("screenshot", "export.picture"), ("svg", "export.picture")),
    *(("language", "app.language"), ("chinese", "app.language"), ("jump", "goto.ask")),
    *(("hex dump", "panes.switch('bytes')"), ("plot", "panes.switch('motors')")),
    *((name, key.run) for key in PALETTE for name in (key.key_display or "").split() if key.key),
]


@pytest.mark.parametrize("language", ["en", "zh"])
def test_commands_are_found_by_the_words_that_people_type(feed: Any, language: str) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "ctrl+p")
        picker = app.screen
        assert isinstance(picker, Picker)
        for typed, action in TYPED:
            picker._type(typed)
            assert action in [entry.value for entry in picker.shown[:3]], typed

    play(feed, scenario, options=StartOptions(language=language))


def test_the_language_is_switched_while_the_screen_is_open(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await rush(app, pilot, "ctrl+p", *"language", "enter")
        await settle(app, pilot)
        assert "退出" in page(app)
        await press(app, pilot, "f")
        assert "过滤 " in page(app)
        await press(app, pilot, "escape")
        assert app.choices.language == "zh"
        await rush(app, pilot, "ctrl+p", *"language", "enter")
        assert "Quit" in page(app)
        assert app.choices.language is None

    play(feed, scenario, rows=10)


def test_everything_can_be_picked_from_a_list(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await rush(app, pilot, "ctrl+p", *"first", "enter")
        assert table(app).viewport.cursor == 0
        await rush(app, pilot, "ctrl+p", *"filter", "space", *"rows", "enter", *"rpm", "escape")
        assert app.focused is table(app)
        await press(app, pilot, "ctrl+p")
        assert isinstance(app.screen, Picker)
        await press(app, pilot, *["down"] * 60, "pageup", "home", "end", "backspace", "escape")
        assert len(app.screen_stack) == 1
        await rush(app, pilot, "ctrl+p", *"freeze", "enter")
        assert table(app).viewport.paused

    play(feed, scenario, rows=100)


def test_what_is_typed_into_a_list_is_shown_and_not_obeyed(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        for list_key, typed in product(("ctrl+p", "x"), ("[/", '[a="', "[/x]", "[b]")):
            await press(app, pilot, list_key, *typed)
            box = app.screen.query_one("#picker")
            assert box._border_subtitle is not None
            assert f"{typed}_" in box._border_subtitle.plain
            assert page(app)
            await press(app, pilot, "escape")
        assert len(app.screen_stack) == 1

    play(feed, scenario, rows=10)


def test_lists_draw_on_the_smallest_terminals(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        for size, key in product(((1, 1), (3, 2), (20, 5), (40, 10)), ("ctrl+p", "x", "C")):
            await pilot.resize_terminal(*size)
            await press(app, pilot, key, "down", "down")
            await settle(app, pilot)
            assert len(app.screen_stack) == 2
            page(app)
            await pilot.resize_terminal(50, 8)
            await settle(app, pilot)
            await pilot.resize_terminal(*size)
            await press(app, pilot, "escape")
            assert len(app.screen_stack) == 1

    play(feed, scenario, (1, 1), rows=100)


def test_forty_cells_show_time_kind_and_values_side_by_side(feed: Any, speed_rows: Rows) -> None:
    from fte_sniff.protocol import KIND_BY_NAME, encode

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        fast = encode(KIND_BY_NAME["speed_feedback"], {"motor": 4, "rpm": -30_000})
        far = encode(KIND_BY_NAME["position_feedback"], {"motor": 4, "pulses": -(2**31)})
        feed.give([Row("a", 0, raw, 1_000_000_000) for raw in (fast, far)])
        await settle(app, pilot)
        assert [text.rstrip() for text in row_texts(app)[:2]] == [
            "  00:01.000 speed fb motor=4 rpm=-30000",
            "  00:01.000 posit fb M4 p=-2147483648",
        ]
        feed.give(speed_rows(2, port="/dev/ttyUSB0") + speed_rows(2, port="/dev/ttyUSB1"))
        await settle(app, pilot)
        drawn = [text.rstrip() for text in row_texts(app)[:6]]
        assert len({line[12:16] for line in drawn[2:]}) == 2
        assert drawn[-1].endswith(" motor=2 rpm=1")

    play(feed, scenario, (40, 12))


def file_of(rows: list[Row], feed: Any) -> None:
    feed.give(rows)
    feed.state = replace(feed.state, live=False, running=False, recording=None)


def test_a_file_is_played_with_all_panes_as_live(
    feed: Any, speed_rows: Rows, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [0]

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        monkeypatch.setattr(app, "now_ns", lambda: now[0])
        monkeypatch.setattr("fte_sniff.tui.playback.monotonic_ns", lambda: now[0])

        async def after(ms: float) -> None:
            now[0] += round(ms * 1e6)
            await settle(app, pilot)

        await press(app, pilot, "S", "colon")
        await type_line(app, pilot, "101")
        await press(app, pilot, "enter", "space")
        assert "PLAYING 1×" in page(app)
        await after(50)
        assert rpms(app)[-1] == 150
        assert "151 rows" in page(app)
        await press(app, pilot, "greater_than_sign")
        await after(50)
        assert "PLAYING 2×" in page(app)
        assert not app._model.at_rest
        assert rpms(app)[-1] == 250
        await press(app, pilot, "space")
        await after(50)
        assert "PAUSED AT 2×" in page(app)
        assert app._model.at_rest
        assert rpms(app)[-1] == 250
        await after(2000)
        assert "speed 1" in page(app)
        await press(app, pilot, "escape", "escape", "escape")
        assert " FILE " in page(app)
        assert "1,000 rows" in page(app)
        await press(app, pilot, "g", "space")
        await after(10_000)
        assert " FILE " in page(app)
        assert rpms(app)[-1] == 999

    file_of(speed_rows(1000), feed)
    play(feed, scenario, size=(100, 40))


def test_times_count_from_a_mark_once_it_is_played(
    feed: Any, speed_rows: Rows, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [0]

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        monkeypatch.setattr(app, "now_ns", lambda: now[0])
        monkeypatch.setattr("fte_sniff.tui.playback.monotonic_ns", lambda: now[0])
        await press(app, pilot, "G", "m", "t", "t")
        assert "times count from the last mark" in page(app)
        await press(app, pilot, "home", "space")
        assert "PLAYING" in page(app)
        now[0] += 50_000_000
        await settle(app, pilot)
        assert rpms(app)[-1] == 50
        assert "-0.0" not in page(app)
        now[0] += 50_000_000
        await settle(app, pilot)
        assert "-0.001000" in page(app)

    file_of(speed_rows(100), feed)
    play(feed, scenario)


def test_rows_have_the_colours_of_the_users_rules(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        assert "nonsense" in page(app)
        here = table(app)
        backgrounds = []
        for y in range(8):
            styles = [segment.style for segment in here.render_line(y)]
            names = {s.bgcolor.name for s in styles if s is not None and s.bgcolor is not None}
            backgrounds.append([name for name in ("dark_red", "blue") if name in names])
        assert backgrounds == [["dark_red"], ["blue"], [], [], ["blue"], ["blue"], [], []]

    colors = {"rpm = 0": "on dark_red", "motor IN (1, 2)": "on blue", "nonsense = 1": "red"}
    play(feed, scenario, options=StartOptions(colors=colors), rows=9)
