"""The table: what is in the window, the cursor, pauses, searches, marks, events, columns."""

from __future__ import annotations

import asyncio
import random

import pytest
from textual.geometry import Region

from fte_sniff.protocol.items import Change, Gap, GapKind, PortEvent, PortEventKind
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.cells import event_text
from fte_sniff.tui.view import View
from tests.tui.conftest import (
    NOON_NS,
    PORT,
    ListFeed,
    frame,
    lines,
    noise,
    page,
    play,
    press,
    resize,
    settle,
    speed_rows,
)


def rpms(app: SniffApp) -> list[int]:
    """The RPM of each row in the window."""
    return [int(line.split("rpm=")[1].split()[0]) for line in lines(app) if "rpm=" in line]


def test_the_end_is_followed_until_the_cursor_moves(feed: ListFeed) -> None:
    feed.give(speed_rows(100))

    async def scenario(app: SniffApp) -> None:
        assert rpms(app)[-1] == 99
        assert "LIVE" in page(app)
        await press(app, "up")
        feed.give(speed_rows(50, 100))
        await settle(app)
        assert 99 in rpms(app)
        assert "SCROLLED +50" in page(app)
        await press(app, "G")
        assert rpms(app)[-1] == 149

    play(feed, scenario)


def test_a_pause_freezes_the_view(feed: ListFeed) -> None:
    feed.give(speed_rows(100))

    async def scenario(app: SniffApp) -> None:
        await press(app, "space")
        before = rpms(app)
        feed.give(speed_rows(1234, 100))
        await settle(app)
        assert rpms(app) == before
        assert "SCROLLED +1,234" in page(app)
        await press(app, "space")
        assert rpms(app)[-1] == 1333

    play(feed, scenario)


def test_go_to_a_row(feed: ListFeed) -> None:
    feed.give(speed_rows(2001))

    async def scenario(app: SniffApp) -> None:
        for goal, cursor in (
            ("1200", 1199),
            ("50%", 1000),
            ("12:00:00.5", 500),
            ("+100ms", 600),
            ("2026-01-31T12:00:01Z", 1000),
        ):
            await press(app, f"colon '{goal}' enter")
            assert app.table.viewport.cursor == cursor, goal

    play(feed, scenario)


def test_where_there_is_nothing_to_go_to_is_said(feed: ListFeed) -> None:
    feed.give(speed_rows(9))

    async def scenario(app: SniffApp) -> None:
        for goal, says in (
            ("9999", "row 9,999 does not exist"),
            ("13:00", "is after the last row (12:00:00.008)"),
            ("11:00", "is before the first row"),
            ("soon", "soon is not a row (1200), a share (50%)"),
        ):
            await press(app, f"g colon '{goal}' enter")
            assert says in " ".join(page(app).split())
            await press(app, "escape")

    play(feed, scenario, (140, 24))


def test_a_search_goes_from_match_to_match_and_round(feed: ListFeed) -> None:
    feed.give([*speed_rows(50), noise(50, 500), *speed_rows(50, 51), noise(101, 1010)])

    async def scenario(app: SniffApp) -> None:
        await press(app, "g slash 'hex:C1 ?2' enter")
        found = []
        for _ in range(3):
            found.append(app.table.last_index)
            await press(app, "n")
        assert found == [50, 101, 50]
        assert "match 2 of 2" in page(app)
        await press(app, "slash 'rpm=7' enter")
        assert app.table.last_index == 7
        await press(app, "slash 'nowhere' enter")
        assert "no row that is shown has nowhere" in page(app)
        await press(app, "escape escape")
        assert "match" not in page(app)

    play(feed, scenario)


def test_keys_go_to_faults_flags_and_unanswered_commands(feed: ListFeed) -> None:
    rows = speed_rows(30)
    rows[10] = noise(10, 100)
    rows[20] = frame("speed_feedback", 20, 200, motor=1, rpm=1, error=4, online=15)
    feed.give(rows)

    async def scenario(app: SniffApp) -> None:
        await press(app, "g e")
        assert app.table.last_index == 10
        await press(app, "e")
        assert "no row with a fault below" in page(app)
        await press(app, "a")
        assert app.table.last_index == 20
        await press(app, "f 'rpm > 25' enter E")
        assert "no row with a fault above" in page(app)

    play(feed, scenario)


def test_from_a_command_to_its_answer_and_back(feed: ListFeed) -> None:
    feed.give(
        [
            frame("speed", 0, 0, motor=1, rpm=5),
            frame("speed", 1, 10, motor=2, rpm=6),
            frame("speed_feedback", 3, 20, motor=1, rpm=4, error=0, online=15),
        ]
    )

    async def scenario(app: SniffApp) -> None:
        await press(app, "g R")
        assert app.table.last_index == 2
        await press(app, "i")
        assert "answers the command in row 1, 3 ms later" in page(app)
        await press(app, "R")
        assert app.table.last_index == 0

    play(feed, scenario)


def test_an_event_is_placed_by_its_time_among_all_rows(feed: ListFeed) -> None:
    feed.give(speed_rows(10_000))

    async def scenario(app: SniffApp) -> None:
        feed.emit(PortEvent(NOON_NS + 100_500_000, PORT, PortEventKind.LOST, ""))
        await settle(app)
        await press(app, "g o")
        assert app.table.last_index == 101
        assert "12:00:00.100  /dev/ttyUSB0 lost" in page(app)

    play(feed, scenario)


def test_rate_of_frames_is_right_where_two_seconds_have_more_rows_than_are_counted(
    feed: ListFeed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fte_sniff.tui.view.MOST_WINDOW", 500)
    view = View(feed, None, None)
    feed.give(speed_rows(3000))
    view.poll(0)
    assert view.frames_per_s(0) == pytest.approx(1000)


def test_missing_rows_are_a_line(feed: ListFeed) -> None:
    feed.give(speed_rows(5))

    async def scenario(app: SniffApp) -> None:
        feed.changes = [Change(0, Gap(GapKind.NOT_SHOWN, 12))]
        feed.give(speed_rows(5, 17))
        await settle(app)
        assert "12 rows are missing here" in page(app)

    play(feed, scenario)


def test_malformed_rows_are_counted_with_their_share(feed: ListFeed) -> None:
    feed.give([*speed_rows(999), noise(999, 9990)])

    async def scenario(app: SniffApp) -> None:
        assert "1 malformed (0.1%)" in page(app)
        feed.give(speed_rows(1, 1000))
        await settle(app)
        assert "1 malformed (<0.1%)" in page(app)

    play(feed, scenario)


def test_rows_that_are_like_this_one_are_shown_or_hidden(feed: ListFeed) -> None:
    feed.give(speed_rows(40))

    async def scenario(app: SniffApp) -> None:
        await press(app, "g x ctrl+u 'motor = 1' enter")
        assert app.view.shown.count == 10
        await press(app, "X")
        wanted = [one for one in app.line.question.choices if one.startswith("rpm")]  # type: ignore[union-attr]
        await press(app, f"ctrl+u '{wanted[0]}' enter")
        assert app.view.shown.count == 9
        await press(app, "backspace backspace")
        assert app.view.shown.count == 40

    play(feed, scenario)


def test_changed_bytes_are_off_at_the_start_and_shown_by_d(feed: ListFeed) -> None:
    feed.give([frame("speed", at * 1500, 10 * at, motor=1, rpm=at % 2) for at in range(6)])

    async def scenario(app: SniffApp) -> None:
        changed = app.table.palette.changed

        def has_changed() -> bool:
            strips = app.table.render_lines(Region(0, 0, 80, 6))
            return any(
                part.style and part.style.reverse and part.style.color == changed.color
                for s in strips
                for part in s
            )

        assert not has_changed()
        await press(app, "d")
        assert has_changed()

    play(feed, scenario)


def test_the_least_window_has_the_mode(feed: ListFeed) -> None:
    feed.give(speed_rows(5))
    feed.state = feed.state._replace(recording=None)

    async def scenario(app: SniffApp) -> None:
        assert lines(app)[0].endswith(" LIVE")
        await press(app, "g")
        assert lines(app)[0].endswith(" SCROLLED +2")

    play(feed, scenario, (20, 5))


def test_lines_fill_the_window_and_show_what_is_cut(feed: ListFeed) -> None:
    feed.give([frame("speed", 0, motor=1, rpm=30001)])
    feed.emit(PortEvent(NOON_NS, PORT, PortEventKind.LOST, "unplugged"))

    async def scenario(app: SniffApp) -> None:
        for width in range(20, 80, 3):
            await resize(app, width, 12)
            while app.table.size.width != width:
                await asyncio.sleep(0)
            await settle(app)
            event, row = (one for one in lines(app) if one[:2] in ("= ", "  ") and "00:00" in one)
            assert row.endswith(("speed", "30001", "EE", "…")), row
            assert len(event) == width - 1 or event.endswith("unplugged"), event

    play(feed, scenario)


def test_random_sizes_leave_the_cursor_in_the_window(feed: ListFeed) -> None:
    feed.give(speed_rows(500))
    dice = random.Random(7)

    async def scenario(app: SniffApp) -> None:
        await press(app, "colon '250' enter")
        for number in range(10):
            await press(app, ("M", "i", "T", "escape", "space")[number % 5])
            size = dice.randrange(20, 210), dice.randrange(5, 70)
            await resize(app, *size)
            viewport = app.table.viewport
            assert viewport.top <= viewport.cursor < viewport.top + max(1, viewport.height)

    play(feed, scenario)


@pytest.mark.parametrize(
    ("kind", "detail", "text"),
    [
        ("silent", "silent for 2.0 s", "a silent for 2.0 s"),
        ("bytes_again", "frames again after 3.0 s", "a bytes again: frames again after 3.0 s"),
        ("opened", "", "a opened"),
    ],
)
def test_event_has_its_word_once(kind: str, detail: str, text: str) -> None:
    event = PortEvent(0, "a", PortEventKind(kind), detail)
    assert event_text(event) == f"00:00:00.000  {text}"
