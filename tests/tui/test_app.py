"""The application: tick, notices of the feed, help, shutdown, sizes, pictures."""

from __future__ import annotations

import random
import re
import signal
from contextlib import AbstractContextManager
from dataclasses import replace
from datetime import UTC
from html import unescape
from pathlib import Path
from typing import Any

import pytest
from textual.pilot import Pilot

from docs.picture import FOLDER, PICTURES, drawn
from fte_sniff.analysis.filter.row_filter import Alert, RowFilter
from fte_sniff.errors import PortError
from fte_sniff.protocol import PortEvent, PortEventKind, Row
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.commands import SECTIONS
from fte_sniff.tui.options import StartOptions
from fte_sniff.tui.panes.motors import MotorsPane
from fte_sniff.tui.prompt import PromptField
from fte_sniff.tui.table import RowTable
from tests.cli.forked import plain_environment
from tests.cli.terminals import Terminal, controlling_terminal, terminal
from tests.slow import first
from tests.tui.conftest import (
    STEP_NS,
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
)
from tests.waiting import BOUND_S


def test_shows_the_newest_rows_and_follows(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        assert rpms(app) == list(range(80, 100))
        feed.give(speed_rows(50, start=100))
        await settle(app, pilot)
        assert rpms(app) == list(range(130, 150))
        text = page(app)
        assert "/dev/ttyUSB0" in text
        assert re.search(r"● REC 0:\d\d:\d\d 0 bytes  /tmp/a.mcap", text)
        assert "LIVE" in text
        assert "150 rows" in text

    play(feed, scenario, rows=100)


def test_rows_beyond_the_bound_leave_and_the_cursors_row_stays(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        table(app).jump(700)
        for start in (1000, 1600):
            feed.give(speed_rows(600, start=start))
            await settle(app, pilot)
            row = table(app).cursor_row
            assert row is not None
            assert row.offset == 10 * max(700, start + 600 - 1000)
            assert table(app).viewport.count == 1000
        assert "2,200 rows" in page(app)

    play(feed, scenario, options=StartOptions(keep_rows=1000), rows=1000)


def test_keys_typed_behind_the_end_do_nothing(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        app.exit()
        for command in ("filters.ask", "goto.ask", "panes.switch('findings')", "panes.motor(1)"):
            await app.action_command(command)
        app.filters.accept("motor = 1")

    assert play(feed, scenario, rows=10).return_code == 0


def test_the_help_moves_to_its_ends_and_is_put_away_once(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "question_mark")
        assert "one row up; leaves the end" in page(app)
        await press(app, pilot, "pagedown", "j", "q")
        assert app.is_running
        assert app.focused is table(app)
        await rush(app, pilot, "question_mark", "end")
        await pilot.pause()
        assert "abs(rpm) > 500" in page(app)
        assert "more lines" not in page(app)
        await press(app, pilot, "home")
        await pilot.pause()
        assert "one row up; leaves the end" in page(app)
        before = int(re.findall(r"(\d+) more lines", page(app))[0])
        await press(app, pilot, "pagedown")
        await pilot.pause()
        assert int(re.findall(r"(\d+) more lines", page(app))[0]) < before - 10
        assert len(app.screen_stack) == 2
        await rush(app, pilot, *["escape"] * 5)
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
        with_table = actions(app)
        await press(app, pilot, "T")
        assert promised <= with_table | actions(app)

    play(feed, scenario)


def test_an_ended_feed_shows_the_reason_and_can_still_be_read(feed: Any, speed_rows: Rows) -> None:
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


def test_a_recording_that_stops_is_reported_while_the_rows_go_on(
    feed: Any, speed_rows: Rows
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(10))
        feed.state = replace(feed.state, trouble="writing received data: 9 bytes left")
        await settle(app, pilot)
        assert "9 bytes left" in page(app)
        feed.state = replace(feed.state, trouble=None)
        await settle(app, pilot)
        assert "9 bytes left" not in page(app)
        feed.state = replace(feed.state, trouble="writing received data: 8 bytes left")
        await settle(app, pilot)
        feed.emit(PortEvent(0, "p", PortEventKind.LINE_ERROR, "2 framing", 2))
        await settle(app, pilot)
        assert "8 bytes left" not in page(app)  # under the newer warning
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

    play(feed, scenario, leave_at_end=True)


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


def test_ctrl_c_asks_as_q_does_wherever_it_is_pressed(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        for opener in ((), ("question_mark",), ("ctrl+p",), ("f", "m")):
            await press(app, pilot, "k")
            assert "press q or ^c again" not in page(app)
            await press(app, pilot, *opener, "ctrl+c")
            assert "press q or ^c again to stop recording" in page(app)
            assert not app._exit
        await press(app, pilot, "ctrl+c")
        assert app._exit

    play(feed, scenario, rows=40)


def test_follow_comes_back_when_the_pane_that_ended_it_closes(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        for count, key, follows in ((40, "", True), (80, "b", True), (120, "up", False)):
            await press(app, pilot, "i", *filter(None, [key]))
            feed.give(speed_rows(40, start=count))
            await settle(app, pilot)
            assert not table(app).viewport.following
            assert table(app).last_index == count - 1 - (key == "up")
            await press(app, pilot, "escape")
            assert table(app).viewport.following == follows

    play(feed, scenario, rows=40)


@pytest.mark.parametrize("ends", [False, True])
def test_q_closes_a_pane_then_asks_once_while_it_is_recorded(feed: Any, ends: bool) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "M", "q")
        assert not app.query_one(MotorsPane).display
        assert not app._exit
        for key in ("q", "k", "q"):
            await press(app, pilot, key)
            assert ("press q or ^c again to stop" in page(app)) == (key == "q")
            assert not app._exit
        if ends:
            feed.end("unplugged")
            await settle(app, pilot)
        assert ("press q or ^c again" in page(app)) != ends
        await press(app, pilot, "q")
        assert app._exit

    play(feed, scenario, rows=40)


def test_q_quits_at_once_where_nothing_is_recorded_and_two_keys_always(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        exits: list[str] = []
        recording = feed.state
        for key, state in (
            ("q", replace(recording, recording=None)),
            ("q", replace(recording, running=False)),
            ("Q", recording),
        ):
            feed.state = state
            await settle(app, pilot)
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(app, "exit", lambda *_arguments, key=key: exits.append(key))
                await press(app, pilot, key)
        assert exits == ["q", "q", "Q"]
        await press(app, pilot, "ctrl+q")
        assert app._exit

    assert play(feed, scenario).return_code == 0


def test_text_from_outside_is_shown_and_never_obeyed(feed: Any, speed_rows: Rows) -> None:
    evil = "[bold red]\x1b]0;owned\x07/dev/串口[/]"
    harmless = r"[bold red]\x1b]0;owned\x07/dev/串口[/]"

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.state = replace(feed.state, title=evil, recording=f"/tmp/{evil}\udcff.mcap")
        feed.give([*speed_rows(3, port=evil), *speed_rows(3, port="b")])
        feed.emit(PortEvent(0, evil, PortEventKind.LOST, evil))
        await settle(app, pilot)
        await press(app, pilot, "up", "up", "up", "enter")
        await settle(app, pilot)
        assert page(app).count(harmless) >= 4
        feed.end(evil)
        await settle(app, pilot)
        assert f"ended: {harmless}" in page(app)
        assert "\x1b" not in page(app)

    play(feed, scenario, (200, 60))


def test_each_row_shows_its_port_where_there_are_two(feed: Any, speed_rows: Rows) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        assert "port" not in lines(app)[1]
        feed.give(speed_rows(3, port="/dev/ttyUSB1"))
        await settle(app, pilot)
        assert "port" in lines(app)[1]
        assert "ttyUSB0" in lines(app)[2]
        assert "ttyUSB1" in lines(app)[5]

    play(feed, scenario, rows=3)


@pytest.mark.parametrize(
    ("size", "colour"),
    first(
        4,
        [
            ((3, 2), "colour"),
            ((200, 60), "colour"),
            ((80, 24), "no colour"),
            ((80, 24), "light"),
            ((20, 5), "colour"),
            ((40, 10), "colour"),
            ((80, 24), "colour"),
            ((40, 10), "no colour"),
        ],
    ),
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
        text = page(app)
        if size[1] >= 24:
            edges = "│motor.*│" if colour == "no colour" else " motor.* "
            assert re.search(edges, text), "the rows behind it must not run into it"
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


def test_resizing_keeps_the_cursor_in_view(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        table(app).jump(250)
        for size in ((40, 10), (200, 60), (80, 24), (10, 3)):
            await pilot.resize_terminal(*size)
            await pilot.pause()
            view = table(app).viewport
            assert view.cursor == 250
            assert view.top <= 250 < view.top + max(1, view.height)

    play(feed, scenario, rows=500)


KEYS = (
    *("up", "down", "pageup", "pagedown", "home", "end", "left", "right", "g", "G", "j", "k"),
    *("f", "F", "e", "E", "colon", "space", "p", "enter", "enter", "c", "escape", "escape"),
    *("question_mark", "tab", "shift+tab", "1", "2", "m", "equals_sign", "backspace", "ctrl+u"),
    *("h", "l", "n", "slash", "ctrl+d", "delete", "insert", "f5", "a", "ctrl+a", "apostrophe"),
    *("N", "x", "X", "u", "U", "v", "y", "Y", "w", "t", "T", "C", "K", "J", "ctrl+t", "ctrl+p"),
    *("less_than_sign", "greater_than_sign", "percent_sign", "at", "minus", "r", "enter", "up"),
)

PLAYBACK_KEYS = ("m", "t", "home", "space", "M", "S", "escape") * 6
"""Further keys where the rows are those of a file."""


@pytest.mark.parametrize(
    ("seed", "size", "rounds", "live"),
    first(
        2,
        [
            (5, (40, 10), 12, False),
            (3, (200, 60), 5, True),
            (6, (40, 10), 30, False),
            (1, (80, 24), 40, True),
            (4, (9, 4), 20, False),
        ],
    ),
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
    live: bool,
) -> None:
    monkeypatch.chdir(tmp_path)
    chance, now = random.Random(seed), [0]
    keys = KEYS if live else KEYS + PLAYBACK_KEYS
    feed.state = replace(feed.state, live=live)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        if not live:
            monkeypatch.setattr(app, "now_ns", lambda: now[0])
            monkeypatch.setattr("fte_sniff.tui.playback.monotonic_ns", lambda: now[0])
        came = 0
        for _ in range(rounds):
            now[0] += 5 * STEP_NS
            count = chance.randrange(60)
            feed.give([*speed_rows(count, start=came), *odd_rows])
            came += count
            app.tick()
            await press(app, pilot, *chance.choices(keys, k=8))
            view = app.screen_stack[0].query_one(RowTable).viewport
            assert 0 <= view.cursor <= max(0, view.count - 1)
        assert app.is_running
        await press(app, pilot, *["escape"] * 8, "F", "G")
        assert not any(field.is_open for field in app.query(PromptField))
        await settle(app, pilot)
        assert table(app).viewport.following

    play(feed, scenario, size, frames=True)


def texts_of(picture: str) -> list[tuple[float, float, str]]:
    """Every text on a picture, and where it stands: what other fonts and colours leave as it is."""
    found = []
    for attributes, text in re.findall(r"<text ([^>]*clip-path[^>]*)>([^<]*)</text>", picture):
        place = dict(re.findall(r'(\w+)="([\d.]+)"', attributes))
        found.append((float(place["y"]), float(place["x"]), unescape(text)))
    return sorted(found)


ALIKE = {"small", "narrow", "filter-empty", "colourless", "light"}
"""Pictures whose texts are much like those of others."""


@pytest.mark.parametrize(
    "name", first(len(PICTURES) - len(ALIKE), sorted(PICTURES, key=ALIKE.__contains__))
)
def test_the_screen_is_as_on_its_picture(name: str) -> None:
    kept = (FOLDER / f"{name}.svg").read_text("utf-8")
    assert texts_of(drawn(name)) == texts_of(kept)


def test_there_is_no_picture_of_what_is_gone() -> None:
    assert {path.stem for path in FOLDER.iterdir()} == set(PICTURES)


PROGRAM = """
from fte_sniff.analysis.feed import FeedState, FeedUpdate
from fte_sniff.tui.app import run_screen

class Idle:
    def poll(self):
        return FeedUpdate(FeedState("idle wire"))
    def stop(self):
        open("stopped", "w").close()

run_screen(Idle())
print("the program goes on")
"""
ALTERNATE_SCREEN, NORMAL_SCREEN = "\x1b[?1049h", b"\x1b[?1049l"


def idle(folder: Path, **asked: str) -> AbstractContextManager[Terminal]:
    """The screen of an idle wire in a terminal, with these variables in its environment.

    A file `stopped` in the folder says that its feed was stopped.
    """
    environment = plain_environment() | asked
    return terminal(environment, folder, code=PROGRAM, session=controlling_terminal)


WAYS = ["Q", signal.SIGTERM, signal.SIGHUP, signal.SIGINT, "\x11", "\x03"]
COLOUR = re.compile(rb"\x1b\[(?:[0-9:;]*[;:])?(?:[34][0-8]|9[0-7]|10[0-7])[;:m]")


@pytest.mark.parametrize("way", first(2, WAYS))
def test_the_terminal_is_left_as_it_was(tmp_path: Path, way: str | signal.Signals) -> None:
    with idle(tmp_path) as here:
        here.until(ALTERNATE_SCREEN, "idle wire", "Quit")
        if isinstance(way, str):
            here.type(way)
        else:
            here.process.send_signal(way)
        assert here.ended() == 0
    assert here.drawn.index(NORMAL_SCREEN) < here.drawn.index(b"the program goes on")
    assert b"Traceback" not in here.drawn
    assert COLOUR.search(here.drawn)
    assert (tmp_path / "stopped").exists()


@pytest.mark.parametrize("asked", first(1, [{"NO_COLOR": "1"}, {}]))
def test_no_colour_is_sent_where_none_is_wanted(tmp_path: Path, asked: dict[str, str]) -> None:
    with idle(tmp_path, **asked) as here:
        here.until("Quit")
        here.type("fmotr")
        here.type("\r")
        here.until("✗")
        here.type("\x15\r?")
        here.until("Keys and signs")
        here.type("qq")
        assert here.ended() == 0
    assert bool(COLOUR.search(here.drawn)) == (not asked)
    assert re.search(rb"\x1b\[[17][;m]", here.drawn)


def test_it_ends_where_the_terminal_goes_away(tmp_path: Path) -> None:
    with idle(tmp_path) as here:
        here.until("Quit")
        here.close()
        here.process.wait(BOUND_S)
    assert (tmp_path / "stopped").exists()


def test_rows_that_match_the_alert_ring_and_are_counted(feed: Any, speed_rows: Rows) -> None:
    rings: list[None] = []

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        app.bell = lambda: rings.append(None)  # type: ignore[method-assign]
        app.now_ns = lambda: 0  # type: ignore[method-assign]
        feed.give(speed_rows(7))
        await settle(app, pilot)
        assert rings == [None]
        assert "2 rows match the alert, the last at 12:00:00.004" in page(app)
        feed.give(speed_rows(9, start=7))
        await settle(app, pilot)
        assert len(rings) == 1
        assert "4 rows match the alert" in page(app)
        await press(app, pilot, "u")
        feed.give(speed_rows(9, start=16))
        await settle(app, pilot)
        assert "no row is marked" in page(app), "an alert that counts on hides the answer to a key"
        await press(app, pilot, "escape", "escape")
        assert "alert" not in page(app)

    alert = Alert(RowFilter.parse("motor = 1"))
    play(feed, scenario, options=StartOptions(alert=alert, zone=UTC))
