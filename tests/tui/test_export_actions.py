"""Copy and save."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from textual.pilot import Pilot

from fte_sniff.analysis.filter.row_filter import RowFilter
from fte_sniff.protocol import Gap, GapKind, Row
from fte_sniff.recording.reader import RecordingReader
from fte_sniff.session.save import ExportSource, SaveJob
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.options import StartOptions
from tests.tui.conftest import (
    NOON_NS,
    STEP_NS,
    Rows,
    page,
    play,
    press,
    settle,
    table,
    type_line,
    until,
)


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
    app.query_one("SaveField PromptLine").value = str(path)  # type: ignore[attr-defined]
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

    options = StartOptions(row_filter=RowFilter.parse("motor = 1"), export_source=origin)
    play(feed, scenario, options=options)
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
        await until(app, pilot, lambda: app._save_job is None)
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
            await until(app, pilot, lambda: app._save_job is None)
        assert "saving to" in told[0]
        assert "would be saved" not in told[0]

    play(feed, scenario, (140, 24))


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
        await until(app, pilot, lambda: app._save_job is None)
        assert "has no time since 1970" in page(app)
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
