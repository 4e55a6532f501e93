"""Notices: when they come and go, and how long ones are cut."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len
from textual.pilot import Pilot

from fte_sniff.protocol import PortEvent, PortEventKind
from fte_sniff.tui import notices
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.notices import NoticeLine, event_text, in_lines
from tests.tui.conftest import (
    Rows,
    lines,
    page,
    play,
    press,
    settle,
    type_line,
)


def test_port_events_are_told_and_put_away(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.emit(PortEvent(0, "/dev/ttyUSB0", PortEventKind.LOST, "it was pulled out"))
        await settle(app, pilot)
        assert "! 00:00:00.000  /dev/ttyUSB0 lost: it was pulled out" in page(app)
        await press(app, pilot, "escape")
        await pilot.pause()
        assert "pulled out" not in page(app)

    play(feed, scenario)


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
    monkeypatch.setattr(notices, "INFO_S", 0.05)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        notice = app.query_one(NoticeLine)
        await press(app, pilot, "u")
        await _until_gone(notice, pilot)
        feed.emit(PortEvent(0, "p", PortEventKind.LINE_ERROR, "2 framing", 2))
        await settle(app, pilot)
        await press(app, pilot, "k", "j")
        await pilot.pause(0.1)
        assert "2 framing" in page(app)
        monkeypatch.setattr(notices, "WARNING_S", 0.05)
        feed.emit(PortEvent(0, "p", PortEventKind.LINE_ERROR, "3 framing", 3))
        await settle(app, pilot)
        await _until_gone(notice, pilot)

    play(feed, scenario)


def test_what_still_holds_comes_back_and_goes_when_it_holds_no_more(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        for port in ("one", "two"):
            feed.emit(PortEvent(0, port, PortEventKind.LOST, "pulled out"))
        await settle(app, pilot)
        await press(app, pilot, "u")
        assert "no row is marked" in page(app)
        await press(app, pilot, "k")
        assert "two lost: pulled out" in page(app)
        feed.emit(PortEvent(0, "two", PortEventKind.FOUND_AGAIN, "after 2.0 s"))
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
        feed.emit(passing)
        await settle(app, pilot)
        assert passing.detail in page(app)
        feed.emit(PortEvent(0, "one", PortEventKind.LOST, "pulled out"))
        await settle(app, pilot)
        assert "one lost: pulled out" in page(app)
        assert passing.detail not in page(app)
        await press(app, pilot, "u")
        assert "no row is marked" in page(app)

    play(feed, scenario)


def test_what_is_under_way_takes_the_place_of_the_hint_before_it_but_of_no_worry(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        notice = app.query_one(NoticeLine)
        notice.inform("9 rows would be saved")
        notice.pin("save", "saving: 0%", warning=False)
        await settle(app, pilot)
        assert "saving: 0%" in page(app)
        notice.inform("no row is marked")
        notice.pin("save", "saving: 9%", warning=False)
        await settle(app, pilot)
        assert "no row is marked" in page(app)
        notice.unpin("save")
        notice.warn("the disk is full")
        notice.pin("save", "saving: 0%", warning=False)
        await settle(app, pilot)
        assert "the disk is full" in page(app)

    play(feed, scenario)


def test_trouble_with_the_recording_goes_when_it_is_over(feed: Any) -> None:

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


def test_an_event_is_one_line_and_is_not_obeyed() -> None:
    event = PortEvent(1_769_860_800_000_000_000, "p\n", PortEventKind.FOUND_AGAIN, "\x1b[2J[b]x")
    assert event_text(event) == "12:00:00.000  p\\n found again: \\x1b[2J[b]x"
