"""Findings on the screen: the list of a file, the way to their rows and back, a line while live."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import UTC
from functools import cache
from typing import Any

import pytest
from textual.pilot import Pilot
from textual.widgets import Static

from fte_sniff.protocol import KIND_BY_NAME, Fault, PortEvent, PortEventKind, Row, encode
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.commands import action_of
from fte_sniff.tui.options import StartOptions
from fte_sniff.tui.panes import switcher
from fte_sniff.tui.panes.statistics import POINTER, StatisticsPane
from tests.slow import first
from tests.tui.conftest import NOON_NS, page, play, press, settle, table, type_line, until

SECOND_NS = 1_000_000_000
LOST = range(120, 180)
"""The seconds in which motor 3 answers only every second command."""


@cache
def session(*lost: tuple[int, range]) -> list[Row]:
    """Five minutes of commands to four motors; half of a motor's answers in its span are lost."""
    rows: list[Row] = []
    spans = dict(lost)
    for number in range(300 * 20):
        at_ns, motor = NOON_NS + number * SECOND_NS // 20, 1 + number % 4
        values = {"motor": motor, "rpm": 100}
        rows.append(Row("p", 0, encode(KIND_BY_NAME["speed"], values), at_ns))
        if number // 20 not in spans.get(motor, ()) or number // 4 % 2:
            raw = encode(KIND_BY_NAME["speed_feedback"], values)
            rows.append(Row("p", 0, raw, at_ns + 3_000_000))
    return [replace(row, offset=10 * at) for at, row in enumerate(rows)]


THIRD = (3, LOST)
"""Motor 3, and when its answers are lost."""


@pytest.mark.parametrize("size", first(1, [((80, 24),), ((200, 60),)]))
def test_a_file_opens_with_its_findings_and_enter_leads_to_their_rows(
    feed: Any, size: tuple[int, int]
) -> None:
    feed.state = replace(feed.state, live=False, running=False, recording=None)
    feed.give(session(THIRD))

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await until(app, pilot, lambda: "findings: 1" in page(app))
        assert "motor 3 answered" in page(app)
        assert re.search(r"12:0(1:5[89]|2:0[012])", page(app))
        assert table(app).viewport.top == 0
        await press(app, pilot, "enter")
        await settle(app, pilot)
        assert app.filters.current == "unanswered AND motor = 3"
        row = table(app).cursor_row
        assert row is not None
        assert row.unanswered
        assert (row.t_ns or 0) >= NOON_NS + LOST.start * SECOND_NS
        assert "findings: 1" not in page(app)
        assert app.place.filter == "", "opening the file again would hide rows without a word"
        await press(app, pilot, "backspace")
        await settle(app, pilot)
        assert app.filters.current == ""
        assert table(app).viewport.cursor == 0
        assert "findings: 1" in page(app)
        await go_to_unanswered_commands(app, pilot)
        await enter_from_the_top_view(app, pilot)
        await press(app, pilot, "exclamation_mark")
        assert "motor 3 answered" in page(app)
        await app.run_action(action_of("app.language"))
        assert "电机3应答了" in page(app).replace(" ", "")
        assert "motor 3 answered" not in page(app)
        await press(app, pilot, "exclamation_mark")
        assert "电机3应答了" not in page(app).replace(" ", "")

    play(feed, scenario, size)


async def go_to_unanswered_commands(app: SniffApp, pilot: Pilot[None]) -> None:
    """Walk through the unanswered commands of the first finding, and its list stays closed."""
    await press(app, pilot, "escape", "g", "right_curly_bracket")
    row = table(app).cursor_row
    assert row is not None
    assert row.unanswered
    assert row.t_ns == NOON_NS + LOST.start * SECOND_NS + SECOND_NS // 10
    await press(app, pilot, "R")
    assert "unanswered: the motor's next command, or the deadline, came first" in page(app)
    first = table(app).viewport.cursor
    await press(app, pilot, "right_curly_bracket")
    assert table(app).viewport.cursor > first
    await press(app, pilot, "left_curly_bracket")
    assert table(app).viewport.cursor == first
    await press(app, pilot, "left_curly_bracket")
    assert "no command without an answer above this row" in page(app)


async def enter_from_the_top_view(app: SniffApp, pilot: Pilot[None]) -> None:
    """Enter is about the finding while its list is open, else about the line of the top view."""
    await press(app, pilot, "exclamation_mark", "T", "enter")
    await settle(app, pilot)
    assert app.filters.current == "unanswered AND motor = 3"
    assert table(app).display
    await press(app, pilot, "T", "enter")
    await settle(app, pilot)
    assert app.filters.current.endswith("kind = 'speed' AND motor = 3")


def test_backspace_returns_to_the_chosen_finding(feed: Any) -> None:
    feed.state = replace(feed.state, live=False, running=False, recording=None)
    feed.give(session((2, range(30, 80)), (3, range(200, 260))))

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await until(app, pilot, lambda: "findings: 2" in page(app))
        await press(app, pilot, "f")
        await type_line(app, pilot, "motor >= 2")
        await press(app, pilot, "enter", "exclamation_mark", "exclamation_mark")
        first = re.findall(r"> .*motor (\d) answered", page(app))
        await press(app, pilot, "J")
        await settle(app, pilot)
        second = re.findall(r"> .*motor (\d) answered", page(app))
        assert sorted(first + second) == ["2", "3"]
        await press(app, pilot, "enter")
        assert app.filters.current == f"unanswered AND motor = {second[0]}"
        await press(app, pilot, "exclamation_mark", "enter", "backspace", "backspace")
        await settle(app, pilot)
        assert re.findall(r"> .*motor (\d) answered", page(app)) == second
        assert app.filters.current == app.place.filter == "motor >= 2"

    play(feed, scenario)


@pytest.mark.parametrize(
    ("language", "texts"),
    [
        ("en", ("no findings in", "not examined: unanswered, late", "only one wire was recorded")),
        ("zh", ("行中没有诊断结果", "未检查：unanswered、late", "只录制了一条线路")),
    ],
)
def test_the_list_names_what_could_not_be_examined(
    feed: Any, language: str, texts: tuple[str, ...]
) -> None:
    feed.state = replace(feed.state, live=False, running=False, recording=None)
    feed.give([row for row in session(THIRD) if row.raw[0] == 0xAA])

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "exclamation_mark")
        await until(app, pilot, lambda: texts[0] in page(app))
        shown = " ".join(page(app).split())
        assert all(text in shown for text in texts), shown
        assert "enter" not in shown

    play(feed, scenario, (120, 24), options=StartOptions(language=language, zone=UTC))


@pytest.mark.parametrize("key", first(1, ["h", "l"]))
def test_a_time_of_the_statistics_is_chosen_and_enter_goes_to_its_faults(
    feed: Any, key: str
) -> None:
    feed.state = replace(feed.state, live=False, running=False, recording=None)
    rows = session(THIRD)
    damaged = {len(rows) // 3, 2 * len(rows) // 3 + 3, 2 * len(rows) // 3 + 4}
    feed.give(
        [
            Row("p", row.offset, row.raw[:9], row.t_ns, (Fault.TRUNCATED,), framed=False)
            if at in damaged
            else row
            for at, row in enumerate(rows)
        ]
    )

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await until(app, pilot, lambda: app._panes.models.observed == len(rows))
        await press(app, pilot, "escape", "S")
        await until(app, pilot, lambda: "over time, from" in page(app))
        await press(app, pilot, key)
        await settle(app, pilot)
        assert "enter: its rows" in page(app)
        shown = str(app.query_one(StatisticsPane).query_one(Static).content).splitlines()
        pointer = next(line for line in shown if POINTER in line)
        faults = next(line for line in shown if "truncated" in line)
        assert faults[pointer.index(POINTER)] == "█", "the chosen cell can still be read"
        start, end = (app._panes.open and app._panes.open.chosen_span) or (0, 0)
        assert start <= (rows[max(damaged)].t_ns or 0) < end, "the fullest is first"
        await press(app, pilot, "h", "l", "enter")
        await settle(app, pilot)
        assert app._panes.open is None
        assert table(app).viewport.cursor == sorted(damaged)[1]

    play(feed, scenario)


def test_without_faults_the_statistics_offer_no_times(feed: Any) -> None:
    feed.state = replace(feed.state, live=False, running=False, recording=None)
    rows = session()
    feed.give(rows)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await until(app, pilot, lambda: app._panes.models.observed == len(rows))
        await press(app, pilot, "S")
        await until(app, pilot, lambda: "no faults" in page(app))
        assert "J K: scroll" in page(app)
        assert "h l" not in page(app)
        head = table(app)._header.render_line(0).text
        await press(app, pilot, "l")
        await settle(app, pilot)
        assert table(app)._header.render_line(0).text != head, "the key scrolls the table"

    play(feed, scenario)


def test_a_finding_of_a_capture_is_one_line_once(
    feed: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(switcher, "FINDINGS_EVERY_NS", 0)
    feed.give(session(THIRD))

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await until(app, pilot, lambda: "motor 3 answered" in page(app))
        assert "findings: 1" not in page(app)
        await press(app, pilot, "escape")
        assert "motor 3 answered" not in page(app)
        later = NOON_NS + 301 * SECOND_NS
        raw = encode(KIND_BY_NAME["speed"], {"motor": 1, "rpm": 5})
        feed.give([Row("p", 0, raw, later + n * SECOND_NS) for n in range(3)])
        known = app._panes.models.known
        await until(app, pilot, lambda: app._panes._searched > known)
        assert "motor 3 answered" not in page(app)

    play(feed, scenario)


def test_what_a_port_reports_is_shown_once_and_not_as_a_finding_too(
    feed: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(switcher, "FINDINGS_EVERY_NS", 0)
    feed.give(session())
    feed.emit(PortEvent(NOON_NS + SECOND_NS, "p", PortEventKind.LOST, "pulled out"))

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await until(app, pilot, lambda: app._panes.models.found)
        await settle(app, pilot)
        assert "pulled out" in page(app)
        assert "lists the findings" not in page(app)

    play(feed, scenario)
