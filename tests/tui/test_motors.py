"""The strip and the pages: which motor is in trouble, in words, and the span that is looked at."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from time import monotonic_ns
from typing import Any

import numpy as np
import pytest
from rich.text import Text

from fte_sniff.analysis.plots import Envelope
from fte_sniff.protocol.rows import Row
from fte_sniff.session.merge import EVER
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.curves import SCALE_CELLS, Curves, plot
from fte_sniff.tui.options import StartOptions
from fte_sniff.tui.pages import text_of
from fte_sniff.tui.painter import DARK
from fte_sniff.tui.strip import strip_text
from tests.tui.conftest import (
    NOON_NS,
    ListFeed,
    after,
    lines,
    noise,
    page,
    play,
    press,
    settle,
    speed_rows,
    talk,
    until,
)


def strip(app: SniffApp) -> list[str]:
    """The lines of the motors."""
    return lines(app)[1:5]


def in_one_read(rows: list[Row], read_ms: int = 16) -> list[Row]:
    """The rows as an adapter delivers them that is read every some milliseconds."""
    step = read_ms * 1_000_000
    times = [-((NOON_NS - (row.t_ns or 0)) // step) * step + NOON_NS for row in rows]
    return [replace(row, t_ns=t_ns) for row, t_ns in zip(rows, times, strict=True)]


@pytest.mark.parametrize(
    ("rows", "states"),
    [
        (talk(11), ["ok"] * 4),
        (talk(11, lost=3), ["ok", "ok", "unanswered", "ok"]),
        (talk(11, silent=2), ["ok", "silent", "ok", "ok"]),
        (talk(11, error=4), ["ok", "ok", "ok", "ERROR 04"]),
        (in_one_read(talk(11)), ["ok"] * 4),
        (speed_rows(4), ["–"] * 4),
    ],
    ids=["healthy", "unanswered", "silent", "error", "healthy behind 16 ms", "one wire"],
)
def test_the_strip_names_the_motor_and_what_is_wrong(rows: list[Row], states: list[str]) -> None:
    feed = ListFeed()
    feed.give(rows)

    async def scenario(app: SniffApp) -> None:
        found = [line[3:].split("  ")[0].strip() for line in strip(app)]
        assert found == states

    play(feed, scenario)


def test_a_line_has_target_feedback_answers_and_since_when(feed: ListFeed) -> None:
    feed.give(talk(11, lost=3))

    async def scenario(app: SniffApp) -> None:
        await until(app, "motor 3 answered")
        await settle(app)
        text = " ".join(strip(app)[2].split())
        assert text.startswith("3 unanswered speed 1000 → 998 RPM answers 67 % since 12:00:00")
        assert "p99 3.0 ms" in strip(app)[0]

    play(feed, scenario)


def test_trouble_after_a_quiet_phase_is_since_the_start_of_its_finding(feed: ListFeed) -> None:
    feed.give([*talk(10, error=4), *after(10, talk(10)), *after(20, talk(5, error=4))])

    async def scenario(app: SniffApp) -> None:
        await until(app, "motor 4 reported ERROR 04")
        await settle(app)
        assert "4 ERROR 04" in strip(app)[3]
        assert "since 12:00:00" in strip(app)[3]

    play(feed, scenario)


def test_a_late_motor_has_the_time_of_its_answers(feed: ListFeed) -> None:
    feed.give([*talk(21), *after(21, talk(4, delay_ms=14))])

    async def scenario(app: SniffApp) -> None:
        text = " ".join(strip(app)[2].split())
        assert text.startswith("3 late speed 1000 → 998 RPM answers 100 % p99 14.0 ms")

    play(feed, scenario)


def test_the_line_of_a_finding_grows_with_it_and_goes_after_its_end(feed: ListFeed) -> None:
    def give(app: SniffApp, rows: list[Row]) -> None:
        feed.give(rows)
        app._search_due_ns = 0

    async def scenario(app: SniffApp) -> None:
        give(app, talk(20, lost=3))
        await until(app, "! 12:00:00  motor 3 answered 666 of 999 commands")
        give(app, after(20, talk(10, lost=3)))
        await until(app, "! 12:00:00  motor 3 answered 999 of 1,500 commands")
        give(app, after(30, talk(30)))
        await until(app, "motor 3 answered", gone=True)

    play(feed, scenario)


def test_a_drawing_that_takes_long_does_not_hold_up_the_next_for_long(
    feed: ListFeed, monkeypatch: pytest.MonkeyPatch
) -> None:
    late_ns = 0

    def drawn_in_a_second(*values: Any) -> Text:
        nonlocal late_ns
        late_ns += 1_000_000_000
        return strip_text(*values)

    monkeypatch.setattr("fte_sniff.tui.app.strip_text", drawn_in_a_second)
    monkeypatch.setattr(SniffApp, "now_ns", lambda _app: monotonic_ns() + late_ns)
    feed.give(talk(11))

    async def scenario(app: SniffApp) -> None:
        app._search_due_ns = EVER  # findings draw the motors too
        feed.give(after(11, talk(11, lost=3)))
        while "3 unanswered" not in page(app):
            await asyncio.sleep(0.05)

    play(feed, scenario)


def test_a_low_terminal_has_one_line_for_all_motors(feed: ListFeed) -> None:
    feed.give(talk(11, lost=3))

    async def scenario(app: SniffApp) -> None:
        await settle(app)
        assert lines(app)[1].split() == ["1", "ok", "2", "ok", "3", "unanswered", "4", "ok"]

    play(feed, scenario, (80, 12))


def file_with_trouble() -> ListFeed:
    """A minute, in which motor 3 leaves commands unanswered from second 20 to 30."""
    feed = ListFeed(live=False)
    feed.give([*talk(20), *after(20, talk(10, lost=3)), *after(30, talk(30))])
    feed.end()
    return feed


def test_a_file_opens_with_its_findings_and_enter_leads_there() -> None:
    async def scenario(app: SniffApp) -> None:
        await until(app, "findings: 1")
        await settle(app)
        assert "3 unanswered" in strip(app)[2]
        assert "since 12:00:2" in strip(app)[2]
        await press(app, "enter")
        row = app.table.cursor_row
        assert row is not None
        assert row.t_ns is not None
        assert 20 <= (row.t_ns - NOON_NS) / 1e9 < 21
        await press(app, "M 3")
        assert "motor 3  unanswered" in page(app)
        assert "3 unanswered" in strip(app)[2]
        await press(app, "escape escape backspace")
        assert app.filters.current == ""

    play(file_with_trouble(), scenario, (100, 40))


def test_the_strip_shows_the_time_before_the_cursor() -> None:
    async def scenario(app: SniffApp) -> None:
        await until(app, "findings: 1")
        await press(app, "escape colon '12:00:29' enter")
        assert "3 unanswered" in strip(app)[2]
        assert "since 12:00:2" in strip(app)[2]
        await press(app, "colon '12:00:45' enter")
        assert "3 ok" in strip(app)[2]
        assert "since" not in strip(app)[2]

    play(file_with_trouble(), scenario)


def test_streams_are_counted_and_lead_to_their_rows(feed: ListFeed) -> None:
    feed.give(talk(11))

    async def scenario(app: SniffApp) -> None:
        await press(app, "T")
        assert "50.0/s" in page(app)
        assert "20 ms" in page(app)
        await press(app, "J J J J J enter")
        assert app.filters.current == (
            "kind = 'speed_feedback' AND motor = 2 AND port = '/dev/ttyUSB0'"
        )

    play(feed, scenario, (120, 40))


def test_detail_explains_damage_and_shows_the_bytes_around(feed: ListFeed) -> None:
    feed.give([*speed_rows(20), noise(20, 200)])

    async def scenario(app: SniffApp) -> None:
        await press(app, "e i")
        text = page(app)
        assert "noise: bytes that belong to no frame" in text
        assert "<C1 C2>" in text
        await press(app, "up right_square_bracket right_square_bracket")
        assert app.table.field == 1

    play(feed, scenario, (100, 50))


def test_a_page_shows_texts_as_they_are() -> None:
    assert text_of("[b]x[/b] :smile:", width=40).plain == "[b]x[/b] :smile:"


def test_curves_have_a_scale_and_an_axis(feed: ListFeed) -> None:
    feed.give(talk(11))

    async def scenario(app: SniffApp) -> None:
        await press(app, "M")
        text = page(app)
        assert "1000" in text
        assert "╵-10 s" in text
        await press(app, "Z")
        assert "╵-30 s" in page(app)

    play(feed, scenario, (200, 60))


def test_a_curve_is_drawn_in_dots_between_the_ends_of_its_scale() -> None:
    rising = np.arange(8.0)
    nothing = np.full(8, np.nan)
    curves = Curves(Envelope(*[nothing] * 3), Envelope(*[rising] * 3))
    lines = [line.plain for line in plot(curves, DARK, (SCALE_CELLS + 4, 2), "")]
    assert lines == ["      7   ⣠⠞", "      0 ⣠⠞⠁ "]


def test_the_screen_is_chinese_where_it_is_asked_for(feed: ListFeed) -> None:
    feed.give(talk(11, lost=3))

    async def scenario(app: SniffApp) -> None:
        assert "3 未应答" in strip(app)[2]
        assert "UTC 时刻" in lines(app)[5]
        await press(app, "T")
        assert "数据流" in page(app)

    play(feed, scenario, (120, 40), StartOptions(language="zh"))
