"""The fields at the bottom, and what is copied and saved."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from datetime import time, timedelta, timezone
from html import unescape
from pathlib import Path
from typing import Any

import pytest
from textual import events
from textual.pilot import Pilot
from textual.widgets import Input

from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.analysis.time_text import ClockTime
from fte_sniff.errors import FilterError, InputTextError
from fte_sniff.protocol import Fault, Gap, GapKind, Row
from fte_sniff.recording.reader import Recording
from fte_sniff.session.save import ExportSource, SaveJob
from fte_sniff.tui import filters
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.filters import Dropdown, FilterField
from fte_sniff.tui.find import Goal, parse_goal
from fte_sniff.tui.options import Choices, StartOptions
from fte_sniff.tui.panes.row import DetailPane
from fte_sniff.tui.prompt import History
from fte_sniff.tui.table import RowTable
from tests.tui.conftest import (
    NOON_NS,
    STEP_NS,
    Rows,
    enter_line,
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
)


def test_a_filter_is_checked_while_one_types_and_applied_by_enter(
    feed: Any, speed_rows: Rows
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await enter_line(app, pilot, "f", "motr = 2")
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

    play(feed, scenario, rows=400)


def test_the_cursor_stays_on_its_row_when_a_filter_comes_and_goes(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
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

    play(feed, scenario, rows=1000)


def test_a_filter_that_hides_everything_is_named(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await settle(app, pilot)
        assert "nothing came yet" in page(app)
        feed.give(speed_rows(40))
        await settle(app, pilot)
        await enter_line(app, pilot, "f", "rpm > 9000")
        await settle(app, pilot)
        assert "the filter hides all 40 rows; F shows them again" in page(app)
        await press(app, pilot, "enter", "e", "E", "down", "up", "c", "G", "g")
        assert "no row" in page(app)

    play(feed, scenario)


def test_begins_with_a_filter_that_was_asked_for(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        assert rpms(app)[-1] == 397
        assert "motor = 2" in page(app)
        assert "100 of 400 rows" in page(app)
        await press(app, pilot, "F")
        await settle(app, pilot)
        assert rpms(app)[-1] == 399

    play(feed, scenario, options=StartOptions(row_filter=RowFilter.parse("motor = 2")), rows=400)


def test_esc_leaves_the_filter_as_it_was_and_arrows_bring_back_lines(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
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

    play(feed, scenario, rows=40)


def test_keys_typed_ahead_go_to_the_field_that_they_open(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await rush(app, pilot, *"gf", *"motor", "equals_sign", *"9", "backspace", "2", "enter", "p")
        await settle(app, pilot)
        assert "filter motor=2" in re.sub(" +", " ", page(app))
        assert "PAUSED" in page(app)
        assert rpms(app)[0] == 1
        await rush(app, pilot, "f", "ctrl+u", *"mo", "escape", "colon", *"50", "enter", "j", "j")
        await settle(app, pilot)
        assert table(app).viewport.cursor == 51
        assert "filter motor=2" in re.sub(" +", " ", page(app))

    play(feed, scenario, rows=400)


def test_a_rush_of_keys_for_the_pane_the_help_and_a_field(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await rush(app, pilot, "enter", "f", "q", "enter", "escape")
        assert app.focused is table(app)
        assert app.query_one(DetailPane).display
        await rush(app, pilot, "question_mark", "q", "escape", "p")
        assert not app._exit
        assert len(app.screen_stack) == 1
        assert table(app).viewport.paused

    play(feed, scenario, rows=400)


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


def test_tab_completes_and_never_leaves_a_field(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "f", *"mot")
        await settle(app, pilot)
        assert "enter Apply" in page(app)
        await press(app, pilot, "tab", "shift+tab", "tab")
        assert app.query_one(FilterField).line.value == "motor "
        await type_line(app, pilot, " = 1")
        await press(app, pilot, "enter")
        await settle(app, pilot)
        assert "100 of 400 rows" in page(app)
        assert app.focused is table(app)

    play(feed, scenario, rows=400)


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


def test_the_count_beside_the_filter_is_that_of_the_one_that_is_on_and_does_not_cut_it(
    feed: Any,
) -> None:
    long = "unanswered AND kind = 'speed' AND motor = 1 AND offset > 2"

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await enter_line(app, pilot, "f", "motor = 1")
        await settle(app, pilot)
        assert "100 of 400 rows" in page(app)
        await press(app, pilot, "f", "x")
        await settle(app, pilot)
        assert "of 400 rows" not in page(app)
        await press(app, pilot, "ctrl+u", "enter", "f")
        await settle(app, pilot)
        assert "of 400 rows" not in page(app)
        await type_line(app, pilot, long)
        await press(app, pilot, "enter")
        await settle(app, pilot)
        (shown,) = (one for one in lines(app) if "offset" in one)
        assert long in shown
        assert "0/400" in shown

    play(feed, scenario, rows=400)


@pytest.mark.parametrize(
    ("text", "goal"),
    [
        ("1", Goal(row=1)),
        (" 1,200 ", Goal(row=1200)),
        ("12:00", Goal(clock=ClockTime(time(12)))),
        ("00:00:03.5", Goal(clock=ClockTime(time(0, 0, 3), 500_000_000))),
        ("23:59:59.999999999", Goal(clock=ClockTime(time(23, 59, 59), 999_999_999))),
        ("20:00+08:00", Goal(clock=ClockTime(time(20, tzinfo=timezone(timedelta(hours=8)))))),
        ("+2s", Goal(distance_ns=2 * 10**9)),
        ("-50ms", Goal(distance_ns=-50_000_000)),
        ("+0.25s", Goal(distance_ns=250_000_000)),
        ("-1.5us", Goal(distance_ns=-1_500)),
        ("+7ns", Goal(distance_ns=7)),
        ("+1m30s", Goal(distance_ns=90 * 10**9)),
        ("-2min", Goal(distance_ns=-120 * 10**9)),
    ],
)
def test_a_goal_is_understood(text: str, goal: Goal) -> None:
    assert parse_goal(text) == goal


@pytest.mark.parametrize(
    "text", ["", "x", "24:00", "12:60", "12:00:61", "2s", "--1s", "1.5", "٣", "+1y"]
)
def test_an_invalid_goal_is_reported_with_examples(text: str) -> None:
    with pytest.raises(InputTextError, match=r"1200.*12:00:03\.5.*-50ms"):
        parse_goal(text)


@pytest.mark.parametrize("text", ["+5", "-50", "+0.5"])
def test_a_distance_without_a_unit_is_reported_with_units(text: str) -> None:
    with pytest.raises(InputTextError, match=re.escape(f"{text}s, {text}ms")):
        parse_goal(text)


def dropdown(app: SniffApp) -> list[tuple[str, str]]:
    """The candidates that are shown."""
    here = app.query_one(Dropdown)
    return [(one.text, one.right) for one in here.candidates] if here.display else []


@pytest.mark.parametrize("step_s", [3600.0, 0.0])
def test_fields_operators_and_observed_values_are_suggested_with_counts(
    feed: Any, monkeypatch: pytest.MonkeyPatch, step_s: float
) -> None:
    """Also where the time of each step of counting is over at once, as on a busy machine."""
    monkeypatch.setattr(filters, "STEP_S", step_s)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "f", *"mo")
        assert dropdown(app)[0] == ("motor", "motor (driver) number")
        assert [name for name, _ in dropdown(app)] == ["motor", "motor_hint"]
        await press(app, pilot, "tab")
        assert [text for text, _ in dropdown(app)][:3] == ["=", ">", "<"]
        await press(app, pilot, "down", "enter")
        await until(app, pilot, lambda: ("1", "101 rows") in dropdown(app))
        assert dropdown(app)[:4] == [
            *(("1", "101 rows"), ("2", "100 rows"), ("3", "100 rows"), ("4", "100 rows"))
        ]
        await press(app, pilot, "down", "down", "up", "up")
        assert app.query_one(Dropdown).chosen is None
        await press(app, pilot, "down", "down", "enter")
        await until(app, pilot, lambda: "100 of 401 rows" in page(app))
        assert rpms(app)[-1] == 400, "not applied yet"
        await press(app, pilot, "enter")
        await settle(app, pilot)
        assert rpms(app)[-1] == 397

    play(feed, scenario, rows=401)


def test_faults_are_counted_one_by_one(feed: Any, odd_rows: list[Row]) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(odd_rows)
        await settle(app, pilot)
        await press(app, pilot, "f")
        await type_line(app, pilot, "faults = ")
        await until(app, pilot, lambda: ("'noise'", "2 rows") in dropdown(app))
        assert ("'line_error'", "1 row") in dropdown(app)

    play(feed, scenario)


def test_matches_are_counted_while_one_types_and_a_mistake_is_shown_by_enter(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "f")
        await type_line(app, pilot, "rpm >= 390")
        await until(app, pilot, lambda: "10 of 400 rows" in page(app))
        await press(app, pilot, "ctrl+u", *"rpnn")
        assert "✗" not in page(app)
        assert "of 400 rows" not in page(app)
        await press(app, pilot, "enter")
        assert "✗" in page(app)
        assert app.query_one(FilterField).has_class("-bad")
        await press(app, pilot, "backspace")
        assert "✗" not in page(app)
        assert not app.query_one(FilterField).has_class("-bad")

    play(feed, scenario, rows=400)


def test_a_mistake_stays_where_its_last_letter_is_reported_after_enter(feed: Any) -> None:
    """Keys that are typed ahead arrive before the input reports what they changed."""

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "f", *"rpnn", "enter")
        line = app.query_one(FilterField).line
        line.post_message(Input.Changed(line, line.value))
        await settle(app, pilot)
        assert "✗" in page(app)

    play(feed, scenario)


def test_a_filter_is_continued_behind_the_present_one_or_pasted_whole(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await enter_line(app, pilot, "f", "motor = 1")
        await enter_line(app, pilot, "f", " AND rpm > 390")
        assert app.filters.current == "motor = 1 AND rpm > 390"
        await press(app, pilot, "F", "f")
        app.post_message(events.Paste("motor = 1\r\n  AND rpm > 390\n"))
        await settle(app, pilot)
        assert app.filters.current == ""
        await press(app, pilot, "enter")
        await settle(app, pilot)
        assert app.filters.current == "motor = 1 AND rpm > 390"

    play(feed, scenario, rows=400)


def test_a_filter_is_saved_by_name_and_listed(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(400))
        await press(app, pilot, "f")
        await type_line(app, pilot, "motor = 1")
        await press(app, pilot, "ctrl+s")
        await type_line(app, pilot, "[red]first")
        await press(app, pilot, "enter")
        assert app.choices.filters == (("old", "malformed"), ("[red]first", "motor = 1"))
        await press(app, pilot, "F", "f")
        assert dropdown(app)[:2] == [("malformed", "old"), ("motor = 1", "[red]first")]
        assert "[red]first" in page(app)
        await press(app, pilot, "down", "down", "enter", "enter")
        await settle(app, pilot)
        assert rpms(app)[-1] == 396

    options = StartOptions(choices=Choices(filters=(("old", "malformed"),)))
    play(feed, scenario, options=options)


@pytest.mark.parametrize(("short", "name"), [("vx", "vx_cm_s"), ("wz", "wz_mrad_s")])
def test_the_short_names_of_the_table_lead_to_those_of_a_filter(short: str, name: str) -> None:
    with pytest.raises(FilterError, match=f"did you mean {name}"):
        RowFilter.parse(f"{short} > 10")


def test_history_goes_back_and_returns_to_what_was_typed() -> None:
    history = History()
    assert history.go(-1, "half") == history.go(1, "half") == "half"
    for line in ("a", "b", "a", ""):
        history.append(line)
    assert [history.go(-1, "half") for _ in range(3)] == ["a", "b", "b"]
    assert [history.go(1, "half") for _ in range(3)] == ["a", "half", "half"]


def test_keys_typed_into_a_field_are_text_and_ctrl_c_copies_what_is_selected(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "f", "q", "question_mark", "G", "space", "p", "colon", "e")
        assert app.is_running
        assert "q?G p:e" in page(app)
        await press(app, pilot, "ctrl+u", "m", "o", "shift+home", "ctrl+c")
        assert app.clipboard == "mo"
        assert not app._exit
        await press(app, pilot, "end", "ctrl+c")
        assert not app._exit, "it asks while a recording runs"
        await press(app, pilot, "ctrl+c")
        assert app._exit

    play(feed, scenario)


def test_a_row_is_copied_to_the_terminal_and_to_a_file(feed: Any, cache: Path) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "c")
        assert app.clipboard == "AA 01 03 00 62 00 00 00 00 EE"
        for key, copied in (("Y", "AA 01 03 00 62"), ("y", "motor=3 rpm=98")):
            await press(app, pilot, key)
            await settle(app, pilot)
            assert copied in app.clipboard
            assert "\n" not in app.clipboard
            assert "   " not in app.clipboard
            kept = cache / "fte-sniff" / "copied.txt"
            assert kept.read_text() == app.clipboard
            assert kept.stat().st_mode & 0o777 == 0o600
            assert "(also in" in page(app)
            await press(app, pilot, "escape")

    play(feed, scenario, (200, 30), rows=99)


def test_a_selection_is_shown_copied_and_ended(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "v", "up", "up")
        feed.give(speed_rows(99, start=99))
        await settle(app, pilot)
        assert sum(table(app).render_line(y).text[1] == "|" for y in range(20)) == 3
        await press(app, pilot, "Y")
        await settle(app, pilot)
        assert [line[12:14] for line in app.clipboard.split("\n")] == ["60", "61", "62"]
        await press(app, pilot, "up", "y")
        assert app.clipboard.split()[0] == "time"
        assert app.clipboard.count("rpm=") == 4
        await press(app, pilot, "w")
        await settle(app, pilot)
        assert "4 selected rows would be saved" in page(app)
        await press(app, pilot, "escape", "escape")
        assert not table(app).selected
        assert app.is_running

    play(feed, scenario, rows=99)


def test_a_copy_where_no_file_can_be_kept_goes_to_the_terminal_alone(
    feed: Any, cache: Path
) -> None:
    cache.write_text("in the way")

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "Y")
        await settle(app, pilot)
        assert app.clipboard.startswith("AA 01")
        assert "copied AA 01" in page(app)
        assert "also in" not in page(app)

    play(feed, scenario, rows=1)


def test_too_many_rows_are_not_copied(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(20_000))
        await settle(app, pilot)
        await press(app, pilot, "v", "g", "y")
        await settle(app, pilot)
        assert "20,000 rows are too many to copy (at most 10,000); w saves them" in page(app)
        assert app.clipboard == ""

    play(feed, scenario, (100, 24))


async def save_to(app: SniffApp, pilot: Pilot[None], path: Path | str) -> None:
    await press(app, pilot, "w")
    app.export.line.value = str(path)
    await press(app, pilot, "enter")


def test_a_saved_recording_names_its_gaps(feed: Any, tmp_path: Path) -> None:
    """What was left out among the rows that are saved, and which of them the filter chose."""
    first, last = (
        Gap(GapKind.LEFT_OUT, 5, NOON_NS + at, NOON_NS + at, "why") for at in (1, 50 * STEP_NS + 1)
    )
    origin = ExportSource((), {"/dev/ttyUSB0": 9600}, [first, last])
    every, selected = tmp_path / "every.mcap", tmp_path / "selected.mcap"

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await save_to(app, pilot, every)
        await until(app, pilot, every.exists)
        await press(app, pilot, "g", "v", *["down"] * 8)
        await save_to(app, pilot, selected)
        await until(app, pilot, selected.exists)

    options = StartOptions(row_filter=RowFilter.parse("motor = 1"), export_source=origin)
    play(feed, scenario, options=options, rows=100)
    for path, gaps, rows in ((every, [first, last], 100), (selected, [first], 33)):
        reader = Recording(path)
        assert [port.baud for port in reader.ports] == [9600]
        (selection,) = reader.selections()
        assert selection.filter_text == "motor = 1"
        assert reader.gaps() == gaps
        assert selection.rows == rows


def test_the_rows_that_are_shown_or_selected_are_saved(feed: Any, tmp_path: Path) -> None:
    pages, write = [], SaveJob.write

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        def written(job: SaveJob, rows: Sequence[Row]) -> None:
            pages.append(page(app))
            write(job, rows)

        await enter_line(app, pilot, "f", "motor = 1")
        await settle(app, pilot)
        path = tmp_path / "rows.csv"
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(SaveJob, "write", written)
            await save_to(app, pilot, path)
            await until(app, pilot, path.exists)
        assert "saving to" in pages[0]
        assert "would be saved" not in pages[0]
        text = path.read_text().splitlines()
        assert len(text) == 2501
        assert [int(line.split(",")[8]) for line in text[1:]] == list(range(0, 10_000, 4))
        assert "saved 2,500 rows to" in page(app)
        await save_to(app, pilot, path)
        await until(app, pilot, lambda: "exists already; name another" in page(app))
        await press(app, pilot, "escape", "g", "v", "down", "down")
        await save_to(app, pilot, tmp_path / "few.hex")
        await until(app, pilot, (tmp_path / "few.hex").exists)
        few = (tmp_path / "few.hex").read_text().splitlines()
        assert [line[12:14] for line in few] == ["00", "04", "08"]
        feed.give([Row("p", 0, b"\x01", None, (Fault.NOISE,), framed=False)])
        await settle(app, pilot)
        await press(app, pilot, "F")
        await save_to(app, pilot, tmp_path / "rows.mcap")
        await until(app, pilot, lambda: app.export.job is None)
        assert "has no time since 1970" in " ".join(page(app).split())
        assert sorted(one.name for one in tmp_path.glob("*.*")) == ["few.hex", "rows.csv"]

    play(feed, scenario, (140, 24), rows=10_000)


def test_what_is_recorded_to_is_not_saved_to(feed: Any, speed_rows: Rows, tmp_path: Path) -> None:
    path = tmp_path / "running.mcap"
    path.write_text("mine")

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.state = replace(feed.state, files=[str(path)])
        feed.give(speed_rows(10))
        await settle(app, pilot)
        for name in (path, f"{path}!"):
            await save_to(app, pilot, name)
            await until(app, pilot, lambda: "is the file shown here; name another" in page(app))
            assert "replace it" not in page(app)
            await press(app, pilot, "escape")
        assert path.read_text() == "mine"

    play(feed, scenario, (200, 24))


def test_a_picture_of_the_screen_is_saved(
    feed: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "P")
        text = Path("fte-sniff-screen.svg").read_text("utf-8")
        assert text.startswith("<svg")
        assert "motor=2" in unescape(text).replace("\xa0", " ")
        assert "saved the screen to fte-sniff-screen.svg" in page(app)
        await press(app, pilot, "P")
        assert "saved the screen to fte-sniff-screen-2.svg" in page(app)
        assert Path("fte-sniff-screen.svg").read_text("utf-8") == text
        monkeypatch.chdir("/proc")
        await press(app, pilot, "P")
        assert "fte-sniff-screen.svg was not saved: " in page(app)

    play(feed, scenario, rows=10)


async def save_and_press(app: SniffApp, pilot: Pilot[None], path: Path, *keys: str) -> list[int]:
    """Save, and press keys after the first rows are written; the lengths of all pieces written."""
    pieces: list[int] = []
    write = SaveJob.write

    def written(job: SaveJob, rows: Sequence[Row]) -> None:
        write(job, rows)
        if not pieces:
            for key in keys:
                app.post_message(events.Key(key, key))
        pieces.append(len(rows))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SaveJob, "write", written)
        await save_to(app, pilot, path)
    return pieces


def test_a_save_is_ended_by_esc_and_with_the_screen_and_leaves_nothing(
    feed: Any, tmp_path: Path
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        pieces = await save_and_press(app, pilot, tmp_path / "rows.jsonl", "w", "escape")
        assert 0 < sum(pieces) < 50_000
        assert app.export.job is None
        assert not list(tmp_path.glob("rows*"))
        assert "was not saved" in page(app).replace("\n", "")
        pieces = await save_and_press(app, pilot, tmp_path / "rows.jsonl", "Q")
        assert 0 < sum(pieces) < 50_000

    play(feed, scenario, (140, 24), rows=50_000)
    assert not list(tmp_path.glob("rows*"))


def test_the_name_of_a_file_is_judged_when_enter_ends_it(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        wrong = "the extension selects the format; use one of .csv .jsonl"
        await press(app, pilot, "w", *"rows")
        await settle(app, pilot)
        assert "the extension selects the format: .csv .jsonl" in page(app)
        assert wrong not in page(app)
        await press(app, pilot, "enter")
        await until(app, pilot, lambda: wrong in page(app))
        await press(app, pilot, "escape")
        await settle(app, pilot)
        assert "save to" not in page(app)

    play(feed, scenario, rows=10)


def test_enter_without_a_name_saves_under_the_suggested_name(
    feed: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The suggested name is free, so that no file is in the way."""
    monkeypatch.chdir(tmp_path)
    Path("rows.csv").write_text("kept")

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        for name, keys in (("rows-2.csv", ["enter"]), ("rows-3.csv", ["tab", "enter"])):
            await press(app, pilot, "w")
            await settle(app, pilot)
            assert name in page(app)
            await press(app, pilot, *keys)
            await until(app, pilot, lambda name=name: f"saved 10 rows to {name}" in page(app))
            assert len(Path(name).read_text().splitlines()) == 11

    play(feed, scenario, rows=10)
    assert Path("rows.csv").read_text() == "kept"


def test_nothing_is_there_to_take(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "y", "Y", "v", "m", "x", "X", "w", "t")
        await settle(app, pilot)
        assert app.clipboard == ""
        assert len(app.screen_stack) == 1

    play(feed, scenario)


def test_a_filter_that_hides_what_is_probably_wanted_is_explained(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await enter_line(app, pilot, "f", "motor = 3 AND malformed")
        await settle(app, pilot)
        assert "motor_hint is the motor that they probably belonged to" in " ".join(
            " ".join(lines(app)).split()
        )

    play(feed, scenario, rows=40)
