"""Lines of the table's window: port events, time differences, changes, pairs and fields."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest
from textual.pilot import Pilot
from textual.widgets import Static

from fte_sniff.analysis.model import StreamChange
from fte_sniff.protocol import KIND_BY_NAME, Gap, GapKind, PortEvent, PortEventKind, Row, encode
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.cells import RAISED_MARK, Delta, TableView, layout_for
from fte_sniff.tui.commands import SECTIONS, action_of
from fte_sniff.tui.options import Choices, StartOptions
from fte_sniff.tui.painter import EVENT_SIGN, SHADES, RowCell, Sign
from fte_sniff.tui.panes.row import DetailPane
from fte_sniff.tui.table import RowTable
from tests.slow import first
from tests.tui.conftest import NOON_NS, Rows, lines, page, play, press, settle, table

MS = 1_000_000


def frame(kind: str, t_ms: int, **values: int) -> Row:
    raw = encode(KIND_BY_NAME[kind], values)
    return Row("/dev/ttyUSB0", 10 * t_ms, raw, NOON_NS + t_ms * MS)


def exchange() -> list[Row]:
    """Commands to motors 1 and 2; only the first is answered."""
    return [
        frame("speed", 0, motor=1, rpm=100),
        frame("speed", 1, motor=2, rpm=100),
        frame("speed_feedback", 5, motor=1, rpm=90),
        frame("speed", 20, motor=1, rpm=300),
        frame("speed_feedback", 26, motor=1, rpm=95),
        frame("speed", 30, motor=2, rpm=100),
    ]


def events_in(app: SniffApp) -> list[tuple[int, str]]:
    shown = enumerate(line.cell for line in table(app)._lines)
    return [(y, cell) for y, cell in shown if isinstance(cell, str)]


def cells(app: SniffApp) -> list[RowCell]:
    return [line.cell for line in table(app)._lines if isinstance(line.cell, RowCell)]


def test_rows_fit_into_the_window_though_textual_sends_no_resize(
    monkeypatch: pytest.MonkeyPatch, feed: Any
) -> None:
    """It sends none if the table is scrolled while the layout changes."""

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        monkeypatch.delattr(RowTable, "on_resize")
        await pilot.press("S")
        await pilot.pause()
        assert table(app).scrollable_size.height < 20
        assert table(app).viewport.height == table(app).scrollable_size.height
        assert table(app)._lines[-1].position == 99

    play(feed, scenario, rows=100, frames=True)


def test_port_events_have_lines_that_are_not_rows(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(5))
        feed.emit(PortEvent(NOON_NS + 2_500_000, "/dev/ttyUSB0", PortEventKind.LOST, "out"))
        await settle(app, pilot)
        [(y, text)] = events_in(app)
        assert (y, "/dev/ttyUSB0 lost: out" in text) == (3, True)
        assert table(app).render_line(3).text.startswith("= 12:00:00.002")
        assert table(app).viewport.count == 5
        await press(app, pilot, "g", "j", "j")
        assert "rpm=2" in table(app).render_line(2).text
        await press(app, pilot, "j")
        assert table(app).viewport.cursor == 3
        await pilot.click(table(app), offset=(20, 3))
        assert table(app).viewport.cursor == 3
        await pilot.click(table(app), offset=(20, 4))
        assert table(app).viewport.cursor == 3
        await app.run_action(action_of("table.events"))
        assert not events_in(app)
        assert not app.choices.events

    play(feed, scenario)


def test_the_last_row_is_in_the_window_below_any_number_of_events(
    feed: Any, speed_rows: Rows
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(100))
        for at in (95, 96, 97):
            event = PortEvent(NOON_NS + at * MS + 1, "/dev/ttyUSB0", PortEventKind.OVERRUN, "")
            feed.emit(event)
        await settle(app, pilot)
        assert len(events_in(app)) == 3
        assert "rpm=99" in table(app).render_line(table(app).viewport.height - 1).text
        await press(app, pilot, "g")
        assert "rpm=0" in table(app).render_line(0).text
        assert not events_in(app)

    play(feed, scenario)


def test_o_goes_to_gaps_and_lost_ports(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(100))
        feed.emit(PortEvent(NOON_NS + 50 * MS + 1, "/dev/ttyUSB0", PortEventKind.LOST, ""))
        feed.changes = [StreamChange(80, Gap(GapKind.NOT_SHOWN, 12))]
        await settle(app, pilot)
        await press(app, pilot, "g", "o")
        assert table(app).viewport.cursor == 51
        await press(app, pilot, "o")
        assert table(app).viewport.cursor == 80
        assert "12 rows are missing here" in page(app)
        await press(app, pilot, "o")
        assert "no port was lost" in page(app)
        await press(app, pilot, "O")
        assert table(app).viewport.cursor == 51

    play(feed, scenario)


def test_the_bar_shows_where_faults_and_marks_are(
    feed: Any, speed_rows: Rows, odd_rows: list[Row]
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give([*speed_rows(500), odd_rows[3], *speed_rows(500, start=501)])
        await settle(app, pilot)
        bar = table(app)._overview
        table(app).marks[0] = ""
        signs = bar.signs(20, table(app).palette)
        assert {cell: sign.text for cell, sign in signs.items()} == {0: "◄", 9: "█"}
        await app.run_action("overview(9)", app)
        assert table(app).last_index == 500

    play(feed, scenario)


@pytest.mark.parametrize("width", first(2, [40, 120, 80, 100, 119, 160, 200]))
def test_only_damaged_rows_have_the_sign_of_damage_in_their_line(
    feed: Any, speed_rows: Rows, odd_rows: list[Row], width: int
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        row_signs = {"!", "?", RAISED_MARK, EVENT_SIGN, *Sign} - {Sign.NONE}
        feed.give([*speed_rows(50), odd_rows[3], *speed_rows(50, start=51)] * 30)
        await settle(app, pilot)
        table(app).end_overview_pause()
        await settle(app, pilot)
        here = table(app)
        shown = [here.render_line(y).text for y in range(here.viewport.height)]
        assert {line[0] for line in shown} == {" ", "!"}
        assert not any("!" in line[1:] for line in shown)
        ends = {line.rstrip("\n")[-1] for line in lines(app)[2:-2]}
        assert ends & set(SHADES)
        assert not ends & row_signs

    play(feed, scenario, size=(width, 60))


@pytest.mark.parametrize(
    ("delta", "ms"),
    [
        (Delta.ROW, [None, 1, 4, 15, 6, 4]),
        (Delta.FRAME, [None, None, None, 20, 21, 29]),
        (Delta.ANSWER, [None, None, 5, None, 6, None]),
    ],
)
def test_time_differences(feed: Any, delta: Delta, ms: list[int | None]) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(exchange())
        await settle(app, pilot)
        found = [cell.delta_ns for cell in cells(app)]
        assert found == [one and one * MS for one in ms]
        assert delta in lines(app)[1]

    options = StartOptions(choices=Choices(delta=delta))
    play(feed, scenario, size=(120, 24), options=options)


def test_the_meaning_of_time_differences_is_chosen_among_the_columns(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(exchange())
        await settle(app, pilot)
        await press(app, pilot, "C")
        await settle(app, pilot)
        assert "the time since the row above (d: another)" in page(app)
        await press(app, pilot, "d", "enter")
        assert table(app).view.delta is Delta.FRAME
        assert app.choices.delta is Delta.FRAME

    play(feed, scenario, size=(120, 30))


def test_changed_bytes_fade(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give([frame("speed", n, motor=1, rpm=5 if n else 4) for n in range(7)])
        await settle(app, pilot)
        assert {cell.ages for cell in cells(app)} == {None}
        await press(app, pilot, "d")
        ages = [cell.ages[4] for cell in cells(app) if cell.ages]
        assert ages == [4, 0, 1, 2, 3, 4, 4]
        assert app.choices.changes

    play(feed, scenario)


def test_a_command_and_its_answer_belong_together(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give([*exchange(), frame("speed", 40, motor=2, rpm=100)])
        await settle(app, pilot)
        await press(app, pilot, "g", "i")
        await settle(app, pilot)
        assert "answered after 5 ms by row 3" in page(app)
        signs = [cell.sign for cell in cells(app)]
        assert signs.index(Sign.PAIRED) == 2
        await press(app, pilot, "R")
        assert table(app).viewport.cursor == 2
        await settle(app, pilot)
        assert "answers the command in row 1, 5 ms later" in page(app)
        await press(app, pilot, "R")
        assert table(app).viewport.cursor == 0
        await press(app, pilot, "G", "k", "R")
        await settle(app, pilot)
        reason = "unanswered: the motor's next command, or the deadline, came first"
        # In the pane, and below as the reason why R leads nowhere.
        assert page(app).count(reason) == 2

    play(feed, scenario, size=(100, 40))


def test_brackets_look_at_the_fields_of_the_row(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(exchange())
        await settle(app, pilot)
        await press(app, pilot, "g")
        for pane in ("i", "b"):
            await press(app, pilot, pane, *["right_square_bracket"] * 4)
            assert cells(app)[0].field == range(3, 5)
            await press(app, pilot, "left_square_bracket")
            assert cells(app)[0].field == range(2, 3)
            await press(app, pilot, *["left_square_bracket"] * 3)
            assert cells(app)[0].field == range(9, 10)
            assert [cell.field for cell in cells(app)[1:]] == [None] * 5

    play(feed, scenario, size=(100, 40))


def test_the_mouse_looks_at_fields_in_the_table_and_in_the_pane(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(exchange())
        await settle(app, pilot)
        here = table(app)
        await press(app, pilot, "g", "i")
        await settle(app, pilot)
        raw = here.render_line(0).text.index("AA 01 01")
        await pilot.hover(here, offset=(raw + 9, 0))
        await pilot.pause()
        assert cells(app)[0].field == range(3, 5)
        page = app.query_one(DetailPane).query_one(Static)
        shown = [page.render_line(y).text for y in range(page.size.height)]
        y = next(y for y, line in enumerate(shown) if "reserve" in line)
        await pilot.hover(page, offset=(5, y))
        await pilot.pause()
        assert cells(app)[0].field == range(5, 9)

    play(feed, scenario, size=(100, 40))


@pytest.mark.parametrize("cells", [60, 79, 119, 199])
def test_chosen_columns_fit_into_the_window(cells: int) -> None:
    layout = layout_for(cells, TableView(choice=("time", "kind", "values", "raw")))
    assert [column.name for column in layout.columns] == ["time", "kind", "values", "raw"]
    assert layout.end_of("raw") <= max(cells, 79)


def test_every_key_has_one_action() -> None:
    every = (one for _heading, keys in SECTIONS for one in keys)
    found = Counter(key for one in every for key in one.key.split(","))
    assert not {key for key, count in found.items() if count > 1 and key}
