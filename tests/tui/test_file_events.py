"""What a file tells of its ports beside their rows."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from textual.pilot import Pilot

from fte_sniff.analysis.feed import BaudChange, StreamChange
from fte_sniff.protocol import Gap, GapKind, PortEvent, PortEventKind
from fte_sniff.tui import view_model as rhythm
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.options import StartOptions
from tests.tui.conftest import NOON_NS
from tests.tui.playing import Rows, page, play, press, settle, type_line


def test_port_events_of_a_file_are_told_once_and_calmly(feed: Any, speed_rows: Rows) -> None:
    feed.state = replace(feed.state, live=False)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(100))
        for at in range(300):
            feed.tell(PortEvent(NOON_NS + at, "/dev/ttyUSB0", PortEventKind.LINE_ERROR, "", 1))
        feed.tell(PortEvent(NOON_NS, "/dev/ttyUSB0", PortEventKind.LOST, "gone"))
        feed.tell(PortEvent(NOON_NS, "/dev/ttyUSB0", PortEventKind.CLOSED, ""))
        await settle(app, pilot)
        assert "lost" not in page(app)
        feed.end("")
        await settle(app, pilot)
        words = page(app)
        assert "i port events while it was recorded: line error 300, lost 1" in words
        await press(app, pilot, "S")
        await settle(app, pilot)
        assert "line error 300" in page(app)

    play(feed, scenario, size=(120, 40))


def test_what_every_recording_has_is_worth_no_word(feed: Any, speed_rows: Rows) -> None:
    feed.state = replace(feed.state, live=False)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(10))
        feed.tell(PortEvent(NOON_NS, "/dev/ttyUSB0", PortEventKind.OPENED, ""))
        feed.tell(PortEvent(NOON_NS, "/dev/ttyUSB0", PortEventKind.CLOSED, ""))
        feed.end("")
        await settle(app, pilot)
        assert "port events" not in page(app)

    play(feed, scenario, size=(120, 40))


def test_keys_come_before_the_rows_of_a_file(
    feed: Any, speed_rows: Rows, monkeypatch: pytest.MonkeyPatch
) -> None:
    rests: list[bool] = []
    feed.rest = lambda: rests.append(True)
    feed.state = replace(feed.state, live=False)
    monkeypatch.setattr(rhythm, "KEYS_NS", 3_600_000_000_000)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(10))
        await settle(app, pilot)
        assert rests == []
        await press(app, pilot, "slash")
        assert rests == [True]
        feed.give(speed_rows(10, start=10))
        await settle(app, pilot)
        assert len(app._watched.store) == 10
        await type_line(app, pilot, "rpm")
        assert "rpm" in page(app)
        monkeypatch.setattr(rhythm, "KEYS_NS", 0)
        await settle(app, pilot)
        assert len(app._watched.store) == 20

    play(feed, scenario)


def test_keys_do_not_keep_a_wire_waiting(feed: Any, speed_rows: Rows) -> None:
    feed.rest = pytest.fail

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "k")
        feed.give(speed_rows(10))
        await settle(app, pilot)
        assert len(app._watched.store) == 10

    play(feed, scenario)


def test_what_a_file_tells_of_its_ports_is_told_in_chinese(feed: Any, speed_rows: Rows) -> None:
    feed.state = replace(feed.state, live=False)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(10))
        feed.tell(PortEvent(NOON_NS, "/dev/ttyUSB0", PortEventKind.LOST, "gone"))
        feed.end("")
        await settle(app, pilot)
        assert "lost" not in page(app)

    play(feed, scenario, size=(120, 40), opening=StartOptions(language="zh"))


def test_a_gap_in_a_file_is_no_silence(feed: Any, speed_rows: Rows) -> None:
    """What stands between rows gets to the numbers, whatever came before."""
    feed.state = replace(feed.state, live=False)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        feed.give(speed_rows(10))
        await settle(app, pilot)
        feed.give([*speed_rows(10, start=10), *speed_rows(10, start=5000)])
        baud = BaudChange("/dev/ttyUSB0", 57_600)
        feed.changes = [StreamChange(10, Gap(GapKind.DAMAGE)), StreamChange(10, baud)]
        feed.end("")
        await settle(app, pilot)
        await press(app, pilot, "S")
        for _round in range(200):
            await settle(app, pilot)
            if "57,600 baud" in (words := page(app)):
                break
        assert "57,600 baud" in words
        assert "longest silence 132 µs" in words

    play(feed, scenario, size=(120, 40))
