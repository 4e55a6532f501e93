"""Filter, search, marks, cell filters and the go-to line on the screen."""

from __future__ import annotations

import re
from datetime import UTC
from pathlib import Path
from typing import Any

import pytest
from textual.pilot import Pilot

from fte_sniff.analysis.row_store import RowStore
from fte_sniff.protocol import KIND_BY_NAME, Fault, Row, encode
from fte_sniff.protocol import rows as columns
from fte_sniff.recording.metadata import PortFacts
from fte_sniff.recording.reader import Recording
from fte_sniff.session.framing import raw_chunks
from fte_sniff.session.inputs import ChunkInput, Input, RecordingInput
from fte_sniff.session.notes import Notes
from fte_sniff.tui import find
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.find import parse_goal, row_of
from fte_sniff.tui.modals import Picker
from fte_sniff.tui.options import StartOptions
from fte_sniff.tui.painter import DARK
from fte_sniff.tui.table import RowTable
from tests.support.recorded_rows import write_recording
from tests.tui.conftest import (
    NOON_NS,
    ListFeed,
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


def test_faults_are_found_below_and_above(feed: Any, speed_rows: Rows, odd_rows: list[Row]) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give([*speed_rows(100), odd_rows[3], *speed_rows(100), odd_rows[1], *speed_rows(100)])
        await settle(app, pilot)
        places = []
        for key in ("E", "E", "E", "e", "e"):
            await press(app, pilot, key)
            places.append(table(app).viewport.cursor)
        assert places == [201, 100, 100, 201, 201]
        assert "no row with a fault below this one; E goes to the previous one" in page(app)
        await press(app, pilot, "g", "E")
        assert "no row with a fault above this one; e goes to the next one" in page(app)

    play(feed, scenario)


def test_rows_with_raised_flags_are_found_and_e_points_to_them(feed: Any, speed_rows: Rows) -> None:
    offline = Row("/dev/ttyUSB0", 0, bytes.fromhex("550104000000000807EE"), NOON_NS)

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
        assert "no row with a fault below this one; a goes to a row whose" in page(app)
        assert table(app).viewport.cursor == 0
        await press(app, pilot, "S")
        await until(app, pilot, lambda: "(taken as motor 4) was 0 in 2 frames" in page(app))

    play(feed, scenario, (80, 40))


GOALS = {
    "1": 0,
    "700": 699,
    "999999": 999_998,
    "12:00:00.250": 250,
    "12:00:00.999": 999,
    "12:00:00": 0,
    "20:00:00.5+08:00": 500,
    "-100ms": 399,
    "+50ms": 549,
    "+2s": 999,
    "23:59:59": 999,
    "2027-01-01": 999,
    "11:59": 0,
    "20:03:05+08:00": 999,
    "2026-01-31 12:00:00.250": 250,
    "+1min": 999,
    "-1h": 0,
    "0%": 0,
    "50%": 500,
    "100 %": 999,
    "@5009": 500,
    "@0x1388": 500,
    "@10000": None,
}
"""The row that each names from row 500 of a thousand."""


@pytest.mark.parametrize("goal", GOALS)
def test_a_goal_names_a_row(goal: str, speed_rows: Rows) -> None:
    store = RowStore()
    store.append(columns.Rows.of(speed_rows(1000)))
    assert row_of(parse_goal(goal), store, 499, UTC) == GOALS[goal]


REPORTED = {
    "50%": (500, "row 501 "),
    "999999": (999, "row 999,999 does not exist; this is the last"),
    "+2s": (999, "+2s is after the last row (12:00:00.999)"),
    "11:59": (0, "11:59 is before the first row (12:00:00.000)"),
    "@10000": (499, "no row that is shown has byte 10,000 of its stream"),
}
"""The cursor that each leads to from row 500, and what is shown."""


def test_the_cursor_goes_to_a_goal_or_the_reason_is_shown(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        for goal, (cursor, shown) in REPORTED.items():
            table(app).jump(499)
            await enter_line(app, pilot, "colon", goal)
            assert table(app).viewport.cursor == cursor, goal
            await settle(app, pilot)
            assert shown in page(app)
        await enter_line(app, pilot, "colon", "x")
        assert "✗ a row (1200)" in page(app)
        assert app.focused is not table(app)

    play(feed, scenario, rows=1000)


async def look_for(app: SniffApp, pilot: Pilot[None], text: str) -> None:
    await press(app, pilot, "slash", "ctrl+u")
    await type_line(app, pilot, text)
    await press(app, pilot, "enter")
    await settle(app, pilot)
    # On a busy machine a search continues in the background.
    await until(app, pilot, lambda: not app.search.is_searching)


def test_the_search_goes_from_hit_to_hit_and_around(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "n")
        assert "no search yet; / starts one" in page(app)
        await press(app, pilot, "g")
        await look_for(app, pilot, "rpm=50")
        places = [table(app).viewport.cursor]
        for key in ("n", "n", "N", "N", "N"):
            await press(app, pilot, key)
            places.append(table(app).viewport.cursor)
        assert places == [50, 500, 501, 500, 50, 509]
        await settle(app, pilot)
        assert "continued from the other end" in page(app)
        assert not table(app).viewport.following
        # Typed ahead, the keys of the search wait for it.
        await rush(app, pilot, "g", "slash", "ctrl+u", *"rpm", "equals_sign", *"50", "enter", *"nn")
        assert table(app).viewport.cursor == 501

    play(feed, scenario, rows=1000)


def test_the_search_begins_at_the_cursor_and_finds_what_is_above_too(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await look_for(app, pilot, "nowhere")
        assert "no row has nowhere" in page(app)
        assert table(app).viewport.following
        await look_for(app, pilot, "rpm=123")
        assert table(app).viewport.cursor == 123
        assert not table(app).viewport.following
        await look_for(app, pilot, "hex:01 ?? 00 00 00 00 EE")
        assert table(app).viewport.cursor == 256
        await look_for(app, pilot, "nowhere")
        assert table(app).viewport.cursor == 256
        assert "no row has nowhere" in page(app)

    play(feed, scenario, rows=400)


def test_every_way_around_the_end_is_reported(feed: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the hit has a note, which is shown when the cursor has moved there."""

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        table(app).jump(123)
        await enter_line(app, pilot, "number_sign", "odd")
        for start, keys, block_s, row_filter in (
            (500, "", -1.0, "rpm < 900"),
            (500, "nN", 0.05, ""),
            (123, "n", -1.0, ""),
        ):
            monkeypatch.setattr(find, "SEARCH_BLOCK_S", block_s)
            app.filters.accept(row_filter)
            table(app).jump(start)
            await press(app, pilot, "escape", "k", "j")
            assert "the search continued" not in page(app)
            await look_for(app, pilot, "rpm=123")
            for key in keys:
                await press(app, pilot, key)
                await until(app, pilot, lambda: not app.search.is_searching)
            assert table(app).viewport.cursor == 123, keys
            assert "the search continued from the other end" in page(app)

    play(feed, scenario, rows=1000)


def test_the_line_of_numbers_shows_the_number_of_the_hit(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "g")
        await look_for(app, pilot, "rpm=50")
        await until(app, pilot, lambda: "hit 1 of 11" in page(app))
        await press(app, pilot, "n", "n")
        await settle(app, pilot)
        assert "hit 3 of 11" in page(app)
        await press(app, pilot, "down", "down")
        await settle(app, pilot)
        assert "hit 5 of 11" in page(app)
        await press(app, pilot, "g")
        await settle(app, pilot)
        assert "11 hits" in page(app)
        await enter_line(app, pilot, "f", "rpm > 503")
        await until(app, pilot, lambda: "hit 1 of 6" in page(app))
        await press(app, pilot, "F", "n")
        feed.give(speed_rows(1, start=5000))
        await settle(app, pilot)
        await until(app, pilot, lambda: "of 12" in page(app))
        await press(app, pilot, "slash", "ctrl+u", "enter")
        await settle(app, pilot)
        assert "hit " not in page(app)
        assert "hits" not in page(app)

    play(feed, scenario, rows=1000)


def test_what_is_found_is_set_off(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await look_for(app, pilot, "RPM=7")
        await press(app, pilot, "g")
        assert "rpm=7" in page(app)
        here = table(app)
        found = [
            segment.text
            for y in range(10)
            for segment in here.render_line(y)
            if segment.style and segment.style.bgcolor == DARK.found.bgcolor
        ]
        assert found == ["rpm=7"]
        await press(app, pilot, "escape", "escape")
        await settle(app, pilot)
        assert here.search is None

    play(feed, scenario, rows=10)


def test_a_port_is_searched_only_where_a_column_shows_it(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(20, port="sim://?noise=0.02"))
        await settle(app, pilot)
        await look_for(app, pilot, "noise")
        assert "no row has noise" in page(app)
        feed.give(speed_rows(20, start=20, port="sim://?drop=0.02"))
        await settle(app, pilot)
        await press(app, pilot, "G")
        await look_for(app, pilot, "noise")
        assert table(app).viewport.cursor == 19
        assert "no row has noise" not in page(app)

    play(feed, scenario)


def test_the_search_looks_only_at_rows_that_the_filter_shows(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(400))
        await enter_line(app, pilot, "f", "motor = 1")
        await settle(app, pilot)
        await look_for(app, pilot, "rpm=10")
        row = table(app).cursor_row
        assert row is not None
        assert row.offset == 1080
        await press(app, pilot, "g")
        await look_for(app, pilot, "rpm=10")
        row = table(app).cursor_row
        assert row is not None
        assert row.offset == 1000
        await look_for(app, pilot, "motor=2")
        assert "no row that the filter shows has motor=2" in page(app)

    play(feed, scenario)


def test_a_long_search_shows_its_progress_and_is_ended_by_esc(
    feed: Any, speed_rows: Rows, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(find, "SEARCH_BLOCK_S", -1.0)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        some = speed_rows(30_000)
        for _ in range(3):
            feed.give(some)
            await settle(app, pilot)
        feed.give([Row("p", 0, b"\x01\x02", None, (Fault.NOISE,), framed=False)])
        await settle(app, pilot)
        await press(app, pilot, "g", "slash")
        await type_line(app, pilot, "noise")
        await press(app, pilot, "enter")
        await until(app, pilot, lambda: table(app).viewport.cursor == 90_000)
        await press(app, pilot, "g", "slash", "ctrl+u")
        await type_line(app, pilot, "rpm=77777")
        await rush(app, pilot, "enter", "escape")
        assert not app.search.is_searching
        assert "esc ends it" not in page(app)
        assert "no row has" not in page(app)
        assert table(app).viewport.cursor == 0

    play(feed, scenario)


def test_marks_are_set_shown_and_gone_to(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "u")
        await settle(app, pilot)
        assert "no row is marked; m marks one" in page(app)
        for row in (10, 400, 200):
            table(app).jump(row)
            await press(app, pilot, "m")
        await press(app, pilot, "g")
        places = []
        for key in ("u", "u", "u", "u", "U", "U"):
            await press(app, pilot, key)
            places.append(table(app).viewport.cursor)
        assert places == [10, 200, 400, 400, 200, 10]
        assert table(app).render_line(10 - table(app).viewport.top).text.startswith(" *12:00")
        await press(app, pilot, "m", "u", "U", "U")
        assert table(app).viewport.cursor == 200

    play(feed, scenario, rows=500)


def test_marks_that_the_filter_hides_are_passed_over_and_come_again(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        for row in (101, 200):
            table(app).jump(row)
            await press(app, pilot, "m")
        await press(app, pilot, "g", "f")
        await type_line(app, pilot, "motor = 1")
        await press(app, pilot, "enter")
        await settle(app, pilot)
        await press(app, pilot, "u", "u")
        row = table(app).cursor_row
        assert row is not None
        assert row.offset == 2000
        await press(app, pilot, "F", "U")
        assert table(app).viewport.cursor == 101

    play(feed, scenario, rows=500)


def test_marks_leave_with_their_rows(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        table(app).jump(50)
        await press(app, pilot, "m", "t", "t", "t")
        feed.give(speed_rows(100, start=100))
        await settle(app, pilot)
        assert not table(app).marks
        await press(app, pilot, "u", "m", "u", "t", "t")
        assert app.is_running

    play(feed, scenario, options=StartOptions(keep_rows=100), rows=100)


def test_quick_filters_add_to_the_filter_and_are_gone_back_from(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        table(app).jump(101)
        await press(app, pilot, "x")
        assert isinstance(app.screen, Picker)
        await settle(app, pilot)
        assert "motor = 2" in page(app)
        await press(app, pilot, *"motor", "enter")
        await settle(app, pilot)
        assert "100 of 400 rows" in page(app)
        assert {rpm % 4 for rpm in rpms(app)} == {1}
        await press(app, pilot, "X", *"rpm", "enter")
        await settle(app, pilot)
        assert "99 of 400 rows" in page(app)
        assert "motor = 2 AND rpm IS DISTINCT" in page(app)
        await press(app, pilot, "backspace")
        await settle(app, pilot)
        assert "100 of 400 rows" in page(app)
        await press(app, pilot, "backspace")
        await settle(app, pilot)
        assert "of 400 rows" not in page(app)
        await press(app, pilot, "backspace")
        await settle(app, pilot)
        assert "there was no other filter before" in page(app)
        await press(app, pilot, "f", "up", "up", "enter")
        await settle(app, pilot)
        assert "motor = 2 AND rpm IS DISTINCT" in page(app)

    play(feed, scenario, (100, 30), rows=400)


def test_a_menu_is_left_with_nothing_done_and_typed_ahead_keys_reach_it(
    feed: Any, speed_rows: Rows, odd_rows: list[Row]
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give([*speed_rows(400), *odd_rows])
        await settle(app, pilot)
        await rush(app, pilot, "x", "down", "escape", "g")
        assert len(app.screen_stack) == 1
        assert table(app).viewport.cursor == 0
        await rush(app, pilot, "x", *"mot", "enter", "G")
        await settle(app, pilot)
        assert "filter motor = 1" in re.sub(" +", " ", page(app))
        await rush(app, pilot, "x", *"zzz", "enter")
        await settle(app, pilot)
        assert len(app.screen_stack) == 1

    play(feed, scenario)


def test_a_click_picks_the_column_and_the_entry_and_a_click_beside_goes_back(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await pilot.click(RowTable, offset=(55, 3))
        await press(app, pilot, "x", "enter")
        await settle(app, pilot)
        assert "raw = 'AA01" in page(app)
        await pilot.click(RowTable, offset=(2, 3))
        await press(app, pilot, "F", "x")
        await settle(app, pilot)
        await pilot.click(offset=(1, 1))
        await settle(app, pilot)
        assert len(app.screen_stack) == 1
        await press(app, pilot, "x")
        await settle(app, pilot)
        y = next(y for y, line in enumerate(lines(app)) if "motor = 4" in line)
        await pilot.click(offset=(20, y))
        await settle(app, pilot)
        assert "100 of 400 rows" in page(app)

    play(feed, scenario, rows=400)


def test_marks_and_notes_are_kept_beside_the_recording_and_shown_again(
    speed_rows: Rows, tmp_path: Path
) -> None:
    recording = tmp_path / "run.mcap"
    recording_notes = recording.with_name("run.mcap.notes.jsonl")

    async def write(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "m", "up", "number_sign")
        await type_line(app, pilot, "[red]stall")
        await press(app, pilot, "enter")
        await until(app, pilot, lambda: "note: [red]stall" in page(app))
        await press(app, pilot, "m")
        assert "# changes it" in page(app)

    async def first(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "m")
        await until(app, pilot, lambda: "marks and notes are saved in" in page(app))
        await until(app, pilot, recording_notes.exists)
        await press(app, pilot, "escape", "m")
        await until(app, pilot, lambda: '"text": null' in recording_notes.read_text())
        assert "are saved in" not in page(app)

    async def read(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "U")
        await until(app, pilot, lambda: "note: [red]stall" in page(app))
        assert table(app).viewport.cursor == 38
        await press(app, pilot, "ctrl+p", *"notes", "enter")
        await press(app, pilot, "down", "enter")
        await settle(app, pilot)
        assert table(app).viewport.cursor == 39
        assert "note:" not in page(app)
        await press(app, pilot, "up", "number_sign", "ctrl+u", "enter", "U")
        assert "no marked row is shown above" in page(app)

    for scenario in (first, write, read):
        feed = ListFeed()
        feed.give(speed_rows(40))
        play(feed, scenario, options=StartOptions(notes=Notes({recording: None})))
    (key,) = Notes({recording: None}).notes
    assert key.offset == 390


def test_notes_that_cannot_be_saved_are_reported_and_the_view_goes_on(
    feed: Any, speed_rows: Rows, tmp_path: Path
) -> None:
    recording = tmp_path / "run.mcap"
    (tmp_path / "run.mcap.notes.jsonl").mkdir()
    (tmp_path / "state").write_text("no folder")

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "m")
        await until(app, pilot, lambda: "the notes are not saved" in page(app))
        feed.give(speed_rows(5, start=40))
        await settle(app, pilot)
        await press(app, pilot, "G")
        assert rpms(app)[-1] == 44

    play(feed, scenario, options=StartOptions(notes=Notes({recording: None})), rows=40)


def _opened_capture(path: Path, number: int, *, timed: bool) -> Input:
    """A capture of ten rows whose RPM begin at a hundred times its number; all have port `p`."""
    rows = [
        encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 100 * number + at}) for at in range(10)
    ]
    if not timed:
        path.write_bytes(b"".join(rows))
        return ChunkInput(raw_chunks(path, "p"), "p")
    if not path.exists():
        frames = [
            Row("p", 10 * at, raw, NOON_NS + 2 * at + number, ()) for at, raw in enumerate(rows)
        ]
        write_recording(path, [PortFacts("p")], [columns.Rows.of(frames)])
    return RecordingInput(Recording(path))
