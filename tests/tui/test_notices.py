"""Notices and the line of keys: told as long as they hold, and read whole in few cells."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len
from textual.binding import Binding
from textual.pilot import Pilot

from fte_sniff.protocol import PortEvent, PortEventKind
from fte_sniff.tui import notices
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.keys import FINDING, HANDLING, LEAVING, MOVING, SHOWN_FIRST, UNDERSTANDING
from fte_sniff.tui.notices import NoticeLine, in_lines
from fte_sniff.tui.status_bar import KeyLine, fitting

from .playing import Rows, lines, page, play, press, settle, type_line


async def _until_gone(notice: NoticeLine, pilot: Pilot[None]) -> None:
    async with asyncio.timeout(60):
        while notice.display:
            await pilot.pause(0.01)


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        (("u",), "no row is marked"),
        (("n",), "nothing was looked for yet"),
        (("colon", "9", "9", "9", "enter"), "there is no row 999"),
        (("colon", "at", "9", "9", "9", "9", "enter"), "has byte 9,999"),
        (("slash", "z", "z", "enter"), "no row has zz"),
        (("w", "escape"), ""),
        (("v",), "selecting"),
        (("t",), "row"),
    ],
)
def test_what_a_key_told_goes_with_the_next_key(
    feed: Any, speed_rows: Rows, keys: Sequence[str], told: str
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(50))
        await settle(app, pilot)
        notice = app.query_one(NoticeLine)
        await press(app, pilot, *(key.replace("at", "@") if key == "at" else key for key in keys))
        assert notice.display == bool(told)
        assert told in page(app)
        await press(app, pilot, "k")
        assert not notice.display

    play(feed, scenario)


def test_it_goes_after_a_while_too_and_a_warning_later(
    feed: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(notices, "SHOWN_S", 0.05)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        notice = app.query_one(NoticeLine)
        await press(app, pilot, "u")
        await _until_gone(notice, pilot)
        feed.tell(PortEvent(0, "p", PortEventKind.LINE_ERROR, "2 framing", 2))
        await settle(app, pilot)
        await press(app, pilot, "k", "j")
        await pilot.pause(0.1)
        assert "2 framing" in page(app)
        monkeypatch.setattr(notices, "WARNED_S", 0.05)
        feed.tell(PortEvent(0, "p", PortEventKind.LINE_ERROR, "3 framing", 3))
        await settle(app, pilot)
        await _until_gone(notice, pilot)

    play(feed, scenario)


def test_what_still_holds_comes_back_and_goes_when_it_holds_no_more(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        for port in ("one", "two"):
            feed.tell(PortEvent(0, port, PortEventKind.LOST, "pulled out"))
        await settle(app, pilot)
        await press(app, pilot, "u")
        assert "no row is marked" in page(app)
        await press(app, pilot, "k")
        assert "two lost: pulled out" in page(app)
        feed.tell(PortEvent(0, "two", PortEventKind.FOUND_AGAIN, "after 2.0 s"))
        await settle(app, pilot)
        assert "two found again" in page(app)
        await press(app, pilot, "k")
        assert "one lost: pulled out" in page(app)
        await press(app, pilot, "escape")
        assert not app.query_one(NoticeLine).display

    play(feed, scenario)


@pytest.mark.parametrize(
    "passing",
    [
        PortEvent(0, "one", PortEventKind.OPENED, "at 115200"),
        PortEvent(0, "one", PortEventKind.LINE_ERROR, "2 framing", 2),
    ],
)
def test_a_graver_notice_is_told_at_once_and_then_what_a_key_did(
    feed: Any, passing: PortEvent
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.tell(passing)
        await settle(app, pilot)
        assert passing.detail in page(app)
        feed.tell(PortEvent(0, "one", PortEventKind.LOST, "pulled out"))
        await settle(app, pilot)
        assert "one lost: pulled out" in page(app)
        assert passing.detail not in page(app)
        await press(app, pilot, "u")
        assert "no row is marked" in page(app)

    play(feed, scenario)


def test_what_is_under_way_takes_the_place_of_the_hint_before_it_but_of_no_worry(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        notice = app.query_one(NoticeLine)
        notice.tell("9 rows would be saved")
        notice.hold("save", "saving: 0%", worry=False)
        await settle(app, pilot)
        assert "saving: 0%" in page(app)
        notice.tell("no row is marked")
        notice.hold("save", "saving: 9%", worry=False)
        await settle(app, pilot)
        assert "no row is marked" in page(app)
        notice.release("save")
        notice.warn("the disk is full")
        notice.hold("save", "saving: 0%", worry=False)
        await settle(app, pilot)
        assert "the disk is full" in page(app)

    play(feed, scenario)


@pytest.mark.parametrize(
    ("opener", "told", "words"),
    [
        ("question_mark", ("esc Back", "down Down", "G End"), "Keys and signs"),
        ("ctrl+p", ("enter Pick", "esc Back", "up Up"), "type to find"),
        ("x", ("enter Pick", "esc Back"), "type to find"),
        ("C", ("enter Apply", "esc Back", "space Show"), "columns"),
    ],
)
def test_the_bottom_line_tells_the_keys_of_what_is_open(
    feed: Any, speed_rows: Rows, opener: str, told: Sequence[str], words: str
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(50))
        await settle(app, pilot)
        await press(app, pilot, opener)
        await settle(app, pilot)
        assert words in page(app)
        bottom = lines(app)[-1]
        assert all(key in bottom for key in told)
        assert "Follow" not in bottom
        await pilot.click(KeyLine, offset=(bottom.index("esc"), 0))
        await settle(app, pilot)
        assert words not in page(app)
        assert "G Follow" in lines(app)[-1]

    play(feed, scenario)


def test_trouble_with_the_recording_goes_when_it_is_over(feed: Any) -> None:
    from dataclasses import replace

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.state = replace(feed.state, trouble="writing what has arrived: 9 bytes wait")
        await settle(app, pilot)
        assert "9 bytes wait" in page(app)
        feed.state = replace(feed.state, trouble=None)
        await settle(app, pilot)
        assert not app.query_one(NoticeLine).display

    play(feed, scenario)


LONG = (
    "/home/somebody/recordings/a-robot-with-a-long-name/2026-01-31/fte-sniff-20260131T120000Z.mcap"
    " cannot be written: the disk is full; name another place with -o"
)


@pytest.mark.parametrize("size", [(80, 24), (40, 20), (40, 12), (200, 60)])
def test_a_long_notice_says_what_is_wrong_and_the_way_out(feed: Any, size: tuple[int, int]) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        app.query_one(NoticeLine).warn(LONG)
        await settle(app, pilot)
        told = " ".join(" ".join(lines(app)).split())
        assert told.count("-o") == 1
        if size != (40, 12):
            assert "20260131T120000Z.mcap cannot be written" in told
        assert "the disk is full; name another place with -o" in told
        assert max(map(cell_len, lines(app))) <= size[0]

    play(feed, scenario, size)


@pytest.mark.parametrize("size", [(80, 24), (40, 20), (40, 12)])
def test_what_is_wrong_with_a_filter_ends_with_the_way_out(
    feed: Any, size: tuple[int, int]
) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "f")
        await type_line(app, pilot, "motor = 1 AND moter = 1")
        assert "did you mean motor?" in " ".join(page(app).split())

    play(feed, scenario, size)


@given(
    st.text(st.sampled_from("ab /…，路径cd"), max_size=200), st.integers(8, 60), st.integers(1, 3)
)
def test_any_sentence_fits_with_its_start_and_end(text: str, width: int, most: int) -> None:
    found = in_lines(text, width, most)
    assert len(found) <= most
    assert all(cell_len(line) <= width for line in found)
    if found and "/" not in text:
        assert found[0][0] == text.strip()[0]
        assert found[-1][-1] == text.strip()[-1]


SHOWN = [key for key in (*LEAVING, *FINDING, *HANDLING, *UNDERSTANDING, *MOVING) if key.show]


def test_every_key_of_the_line_has_a_rank() -> None:
    assert sorted(key.action for key in SHOWN) == sorted(SHOWN_FIRST)


@pytest.mark.parametrize("width", range(6, 140))
def test_keys_stand_whole_and_help_always(width: int) -> None:
    found = fitting(SHOWN, width)
    assert found[0].action == "help"
    assert sum(len(f"{key.key_display} {key.description} ") for key in found) - 1 <= width
    more = fitting(SHOWN, width + 1)
    assert {key.action for key in found[:1]} <= {key.action for key in more}


@pytest.mark.parametrize("size", [(20, 10), (40, 20), (80, 24), (200, 60)])
def test_the_line_of_keys_ends_with_a_whole_one(feed: Any, size: tuple[int, int]) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        last = lines(app)[-1]
        assert last.startswith("? Help q Quit")
        assert last.split()[-1] in {key.description for key in SHOWN}
        await press(app, pilot, "f")
        assert lines(app)[-1].strip() == "enter Apply esc Back"

    play(feed, scenario, size)


def test_a_key_that_is_clicked_is_pressed(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await pilot.click(KeyLine, offset=(15, 0))
        await pilot.pause()
        assert app._filter_field.asking

    play(feed, scenario)


def test_a_field_has_its_own_keys_first() -> None:
    enter = Binding("enter", "submit", "Apply", key_display="enter")
    assert fitting([*SHOWN, enter], 40)[0] is enter
