"""Handling rows on the screen: times, columns, colours, copies, saving, the list of all keys."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from textual.pilot import Pilot

from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.protocol import Damage, Fault, Gap, GapKind, Row
from fte_sniff.recording.reader import RecordingReader
from fte_sniff.session.save import ExportSource, SaveJob
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.i18n import THEMES
from fte_sniff.tui.options import StartOptions
from fte_sniff.tui.panes.detail import DetailPane
from fte_sniff.tui.pickers import ColumnChooser, Picker
from fte_sniff.tui.table.widget import RowTable
from tests.tui.conftest import NOON_NS, STEP_NS
from tests.tui.playing import (
    Rows,
    lines,
    page,
    play,
    press,
    rush,
    settle,
    table,
    type_line,
    until,
)


def times(app: SniffApp) -> list[str]:
    """What stands in the column of times of the rows in view."""
    here = table(app)
    texts = [here.render_line(y).text for y in range(here.viewport.height)]
    return [text[2:14].strip() for text in texts if text.strip()]


def test_times_count_from_the_start_the_row_before_and_a_mark(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(100))
        await settle(app, pilot)
        await press(app, pilot, "G", "t")
        assert times(app)[-1] == "+0.099000"
        assert lines(app)[1].strip().startswith("+ start")
        await press(app, pilot, "t")
        assert set(times(app)) == {"+0.001000"}
        await press(app, pilot, "t")
        assert times(app)[-1] == "12:00:00.099"
        table(app).jump(90)
        await press(app, pilot, "m", "T", "end")
        assert times(app)[-1] == "+0.009000"
        assert "-0.001000" in times(app)
        await press(app, pilot, "T")
        assert re.search("times count from the row before", page(app))
        await press(app, pilot, "g")
        assert times(app)[1] == "+0.001000"

    play(feed, scenario)


def test_columns_are_chosen_ordered_and_sized(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(5))
        await settle(app, pilot)
        await press(app, pilot, "C")
        assert isinstance(app.screen, ColumnChooser)
        await settle(app, pilot)
        assert "[x] kind" in page(app)
        await press(app, pilot, "space", "down", "K", "less_than_sign", "less_than_sign", "enter")
        await settle(app, pilot)
        assert lines(app)[1].split()[:2] == ["kind", "values"]
        assert table(app).columns[0].width == 9
        await press(app, pilot, "C", "down", "space", "escape")
        await settle(app, pilot)
        assert lines(app)[1].split()[0] == "kind"
        await press(app, pilot, "C", "r")
        await settle(app, pilot)
        assert lines(app)[1].split()[:3] == ["time", "UTC", "kind"]

    play(feed, scenario)


def test_no_column_at_all_is_no_choice_and_a_single_one_is(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(5))
        await settle(app, pilot)
        count = len(table(app).columns)
        await press(app, pilot, "C", *(["space", "down"] * count), "enter")
        await settle(app, pilot)
        assert len(table(app).columns) == count
        await press(app, pilot, "C", *(["space", "down"] * (count - 1)), "enter", "right", "left")
        await settle(app, pilot)
        assert len(table(app).columns) == 1

    play(feed, scenario)


def test_the_mouse_opens_rows_and_the_chooser(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(50))
        await settle(app, pilot)
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

    play(feed, scenario)


def test_the_scroll_bar_reaches_every_row(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(30_000))
        await settle(app, pilot)
        here = table(app)
        assert here.max_scroll_y == round(here.scroll_y)
        await press(app, pilot, "g")
        assert here.scroll_y == 0
        bar = here.vertical_scrollbar
        await pilot.click(bar, offset=(0, bar.size.height - 1))
        await settle(app, pilot)
        assert here.viewport.top == here.viewport.height

    play(feed, scenario)


def test_the_scroll_bar_is_left_alone_while_it_looks_the_same(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(30_000))
        await settle(app, pilot)
        here = table(app)
        before = (here.virtual_size, here.scroll_y)
        for start in range(30_000, 31_000, 100):
            feed.give(speed_rows(100, start=start))
            await settle(app, pilot)
        assert (here.virtual_size, here.scroll_y) == before

    play(feed, scenario)


@pytest.mark.parametrize(("key", "copied"), [("Y", "AA 01 03 00 62"), ("y", "motor=3 rpm=98")])
def test_a_row_is_copied_to_the_terminal_and_to_a_file(
    feed: Any, speed_rows: Rows, cache: Path, key: str, copied: str
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(99))
        await settle(app, pilot)
        await press(app, pilot, key)
        await settle(app, pilot)
        assert copied in app.clipboard
        assert "\n" not in app.clipboard
        assert "   " not in app.clipboard
        kept = cache / "fte-sniff" / "copied.txt"
        assert kept.read_text() == app.clipboard
        assert kept.stat().st_mode & 0o777 == 0o600
        assert "(also in" in page(app)

    play(feed, scenario, (200, 30))


def test_a_selection_is_shown_copied_and_ended(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(99))
        await settle(app, pilot)
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

    play(feed, scenario)


def test_a_copy_where_no_file_can_be_kept_goes_to_the_terminal_alone(
    feed: Any, speed_rows: Rows, cache: Path
) -> None:
    cache.write_text("in the way")

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(1))
        await settle(app, pilot)
        await press(app, pilot, "Y")
        await settle(app, pilot)
        assert app.clipboard.startswith("AA 01")
        assert "copied AA 01" in page(app)
        assert "also in" not in page(app)

    play(feed, scenario)


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
    app.query_one("SaveField Line").value = str(path)  # type: ignore[attr-defined]
    await press(app, pilot, "enter")


@pytest.mark.parametrize("selecting", [False, True])
def test_a_saved_recording_tells_what_is_not_in_it(
    feed: Any, speed_rows: Rows, tmp_path: Path, selecting: bool
) -> None:
    """What was left out among the rows that are saved, and which of them the filter chose."""
    first, last = (
        Gap(GapKind.LEFT_OUT, 5, NOON_NS + at, NOON_NS + at, "why") for at in (1, 50 * STEP_NS + 1)
    )
    origin = ExportSource((), {"/dev/ttyUSB0": 9600}, [first, last])

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(100))
        await settle(app, pilot)
        if selecting:
            await press(app, pilot, "g", "v", *["down"] * 8)
        path = tmp_path / "rows.mcap"
        await save_to(app, pilot, path)
        await until(app, pilot, path.exists)

    opening = StartOptions(row_filter=RowFilter.parse("motor = 1"), origin=origin)
    play(feed, scenario, opening=opening)
    reader = RecordingReader(tmp_path / "rows.mcap")
    assert [port.baud for port in reader.ports] == [9600]
    (selection,) = reader.selections()
    assert selection.filter_text == "motor = 1"
    assert reader.gaps() == ([first] if selecting else [first, last])
    assert selection.rows == (33 if selecting else 100)


def test_the_filtered_rows_are_saved(feed: Any, speed_rows: Rows, tmp_path: Path) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(10_000))
        await press(app, pilot, "f")
        await type_line(app, pilot, "motor = 1")
        await press(app, pilot, "enter")
        await settle(app, pilot)
        path = tmp_path / "rows.csv"
        await save_to(app, pilot, path)
        await until(app, pilot, path.exists)
        text = path.read_text().splitlines()
        assert len(text) == 2501
        assert [int(line.split(",")[8]) for line in text[1:]] == list(range(0, 10_000, 4))
        assert "saved 2,500 rows to" in page(app)
        await save_to(app, pilot, path)
        await settle(app, pilot)
        assert "exists already; name another" in page(app)

    play(feed, scenario, (140, 24))


def test_what_is_recorded_to_is_not_saved_to(feed: Any, speed_rows: Rows, tmp_path: Path) -> None:
    path = tmp_path / "running.mcap"
    path.write_text("mine")

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.state = replace(feed.state, files=[str(path)])
        feed.give(speed_rows(10))
        await settle(app, pilot)
        for name in (path, f"{path}!"):
            await save_to(app, pilot, name)
            await settle(app, pilot)
            assert "would be lost; name another" in page(app)
            assert "replace it" not in page(app)
            await press(app, pilot, "escape")
        assert path.read_text() == "mine"

    play(feed, scenario, (200, 24))


def test_the_selected_rows_are_saved_and_nothing_else(
    feed: Any, speed_rows: Rows, tmp_path: Path
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(1000))
        await settle(app, pilot)
        table(app).jump(100)
        await press(app, pilot, "v", "down", "down")
        path = tmp_path / "rows.hex"
        await save_to(app, pilot, path)
        await until(app, pilot, path.exists)
        assert [line[12:14] for line in path.read_text().splitlines()] == ["64", "65", "66"]

    play(feed, scenario)


def test_a_save_is_ended_by_esc_and_leaves_nothing(
    feed: Any, speed_rows: Rows, tmp_path: Path
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        rows = speed_rows(50_000)
        for _again in range(8):
            feed.give(rows)
            await settle(app, pilot)
        await save_to(app, pilot, tmp_path / "rows.jsonl")
        await press(app, pilot, "w")
        await settle(app, pilot)
        assert not (tmp_path / "rows.jsonl").exists()
        await press(app, pilot, "escape")
        await until(app, pilot, lambda: app._saving is None)
        assert not list(tmp_path.glob("rows*"))
        assert "was not saved" in page(app).replace("\n", "")

    play(feed, scenario, (140, 24))


def test_it_is_told_at_once_that_a_save_has_begun(
    feed: Any, speed_rows: Rows, tmp_path: Path
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(100_000))
        await settle(app, pilot)
        told = []
        write = SaveJob.write

        def seen(saving: SaveJob, rows: Sequence[Row]) -> None:
            told.append(page(app))
            write(saving, rows)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(SaveJob, "write", seen)
            await save_to(app, pilot, tmp_path / "rows.csv")
            await until(app, pilot, lambda: app._saving is None)
        assert "saving to" in told[0]
        assert "would be saved" not in told[0]

    play(feed, scenario, (140, 24))


def test_rows_without_times_have_none_to_count_from(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give([Damage("p", 0, b"\x01", None, (Fault.NOISE,))])
        await settle(app, pilot)
        for key in ("t", "T"):
            await press(app, pilot, key)
            assert "no row here has a time to go by" in page(app)
            assert "time UTC" in page(app)
            assert "+ start" not in page(app)

    play(feed, scenario)


def test_a_save_that_runs_while_the_screen_closes_leaves_nothing(
    feed: Any, speed_rows: Rows, tmp_path: Path
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(60_000))
        await settle(app, pilot)
        await save_to(app, pilot, tmp_path / "rows.jsonl")
        await press(app, pilot, "q")

    play(feed, scenario)
    assert not list(tmp_path.glob("rows*.part"))


def test_rows_without_times_make_no_recording(
    feed: Any, odd_rows: list[Row], tmp_path: Path
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(odd_rows)
        await settle(app, pilot)
        await save_to(app, pilot, tmp_path / "rows.mcap")
        await until(app, pilot, lambda: app._saving is None)
        assert "it has no time since 1970" in page(app)
        assert not list(tmp_path.glob("rows*"))

    play(feed, scenario, (200, 24))


def test_the_name_of_a_file_is_judged_while_it_is_typed(
    feed: Any, speed_rows: Rows, tmp_path: Path
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(10))
        await settle(app, pilot)
        await press(app, pilot, "w", *"rows")
        await settle(app, pilot)
        assert "the name's end says what is written: .csv .jsonl" in page(app)
        await press(app, pilot, "escape")
        await settle(app, pilot)
        assert "save to" not in page(app)

    play(feed, scenario)


def test_nothing_is_there_to_take(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "y", "Y", "v", "m", "x", "X", "w", "t", "T")
        await settle(app, pilot)
        assert app.clipboard == ""
        assert len(app.screen_stack) == 1

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


def test_everything_can_be_picked_from_a_list(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(100))
        await settle(app, pilot)
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

    play(feed, scenario)


@pytest.mark.parametrize("typed", ["[/", '[a="', "[/x]", "[b]"])
def test_what_is_typed_into_a_list_is_shown_and_not_obeyed(
    feed: Any, speed_rows: Rows, typed: str
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(10))
        await settle(app, pilot)
        for list_key in ("ctrl+p", "x"):
            await press(app, pilot, list_key)
            await press(app, pilot, *typed)
            box = app.screen.query_one("#picker")
            assert box._border_subtitle is not None
            assert f"{typed}_" in box._border_subtitle.plain
            await press(app, pilot, "escape")
        assert len(app.screen_stack) == 1

    play(feed, scenario)


@pytest.mark.parametrize("size", [(1, 1), (3, 2), (20, 5), (40, 10)])
def test_lists_draw_on_the_smallest_terminals(
    feed: Any, speed_rows: Rows, size: tuple[int, int]
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(100))
        await settle(app, pilot)
        for key in ("ctrl+p", "x", "C"):
            await press(app, pilot, key, "down", "down")
            await settle(app, pilot)
            assert len(app.screen_stack) == 2
            page(app)
            await pilot.resize_terminal(50, 8)
            await settle(app, pilot)
            await pilot.resize_terminal(*size)
            await press(app, pilot, "escape")
            assert len(app.screen_stack) == 1

    play(feed, scenario, size)


def test_forty_cells_show_time_kind_and_values_side_by_side(feed: Any, speed_rows: Rows) -> None:
    from fte_sniff.protocol import KIND_BY_NAME, Frame, encode

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        fast = encode(KIND_BY_NAME["speed_feedback"], {"motor": 4, "rpm": -30_000})
        far = encode(KIND_BY_NAME["position_feedback"], {"motor": 4, "pulses": -(2**31)})
        feed.give([Frame("a", 0, raw, 1_000_000_000) for raw in (fast, far)])
        await settle(app, pilot)
        drawn = [table(app).render_line(y).text.rstrip() for y in range(2)]
        assert drawn == [
            "  00:01.000 speed fb motor=4 rpm=-30000",
            "  00:01.000 posit fb M4 p=-2147483648",
        ]
        feed.give(speed_rows(2, port="/dev/ttyUSB0") + speed_rows(2, port="/dev/ttyUSB1"))
        await settle(app, pilot)
        drawn = [table(app).render_line(y).text.rstrip() for y in range(6)]
        assert len({line[12:16] for line in drawn[2:]}) == 2
        assert drawn[-1].endswith(" motor=2 rpm=1")

    play(feed, scenario, (40, 12))
