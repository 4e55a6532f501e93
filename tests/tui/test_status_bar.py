"""Title line, status line, key line and notices, and the help."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from datetime import UTC
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len
from textual.binding import Binding
from textual.pilot import Pilot

from fte_sniff.analysis.feed import FeedState, FeedUpdate
from fte_sniff.analysis.row_store import RowStore
from fte_sniff.protocol import FAULT_MEANINGS, MOTORS, PortEvent, PortEventKind
from fte_sniff.protocol.spec import online_bit_text
from fte_sniff.tui import status_bar
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.cells import event_text
from fte_sniff.tui.commands import (
    COMMANDS,
    FINDING,
    HANDLING,
    LEAVING,
    MOVING,
    SECTIONS,
    UNDERSTANDING,
    Mode,
    action_of,
    short_text,
)
from fte_sniff.tui.modals import help_text
from fte_sniff.tui.options import Choices, StartOptions
from fte_sniff.tui.painter import DARK
from fte_sniff.tui.panes.switcher import HEALTH
from fte_sniff.tui.status_bar import (
    KeyLine,
    NoticeLine,
    StatusCounters,
    fitting_keys,
    in_lines,
    mode_of,
    recording_text,
    status_text,
    title_text,
)
from fte_sniff.tui.table import Viewport
from fte_sniff.tui.view_model import ViewModel
from tests.tui.conftest import (
    enter_line,
    lines,
    page,
    play,
    press,
    settle,
    until,
)
from tests.waiting import BOUND_S

PAGES = {
    "question_mark": ("Keys and signs", "esc Back", "down Down", "G End"),
    "ctrl+p": ("type to find", "enter Pick", "esc Back", "up Up"),
    "x": ("type to find", "enter Pick", "esc Back"),
    "C": ("columns", "enter Apply", "esc Back", "space Show"),
}
"""Keys that open a page, what the page has, and the keys in the bottom line."""


def test_the_bottom_line_shows_the_keys_of_the_open_page(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        for opener, (words, *keys) in PAGES.items():
            await press(app, pilot, opener)
            await settle(app, pilot)
            assert words in page(app)
            bottom = lines(app)[-1]
            assert all(key in bottom for key in keys)
            assert "Follow" not in bottom
            await pilot.click(KeyLine, offset=(bottom.index("esc"), 0))
            await settle(app, pilot)
            assert words not in page(app)
            assert "G Follow" in lines(app)[-1]

    play(feed, scenario, rows=50)


SHOWN = [key for key in (*LEAVING, *FINDING, *HANDLING, *UNDERSTANDING, *MOVING) if key.show]


def test_every_key_of_the_line_has_a_rank() -> None:
    assert sorted(key.rank for key in SHOWN) == list(range(1, len(SHOWN) + 1))


def test_keys_stand_whole_and_help_always() -> None:
    for width in range(6, 140):
        found = fitting_keys(SHOWN, width)
        assert found[0].action == action_of("app.help")
        texts = [f"{key.key_display} {key.description}" for key in found]
        assert len("  ".join(texts)) <= width


def test_the_line_of_keys_ends_with_a_whole_one(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        for size in ((24, 10), (200, 60)):
            await pilot.resize_terminal(*size)
            await settle(app, pilot)
            last = lines(app)[-1]
            assert last.startswith("? Help  q Quit")
            assert last.split()[-1] in {key.description for key in SHOWN}
            await press(app, pilot, "f")
            assert lines(app)[-1].startswith("enter Apply  esc Back")
            await press(app, pilot, "escape")

    play(feed, scenario)


def test_the_key_line_of_a_file_has_the_keys_of_a_file(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await until(app, pilot, lambda: "space Pause  G Follow" in lines(app)[-1])
        feed.state = replace(feed.state, live=False)
        await settle(app, pilot)
        assert "space Play  G End" in lines(app)[-1]

    play(feed, scenario)


def test_a_key_that_is_clicked_is_pressed(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await pilot.click(KeyLine, offset=(17, 0))
        await pilot.pause()
        assert app.filters.is_open

    play(feed, scenario)


def test_a_field_has_its_own_keys_first() -> None:
    enter = Binding("enter", "submit", "Apply", key_display="enter")
    assert fitting_keys([*SHOWN, enter], 40)[0] is enter


LIVE = FeedState("/dev/ttyUSB0", "/home/ana/captures/fte-sniff-20260131T120000Z.mcap")
NUMBERS = StatusCounters(
    rows=1_234_567,
    frames_per_s=1151.7,
    malformed=12,
    malformed_share=12 / 1_234_567,
    not_shown=0,
    row_number=1_234_567,
    following=True,
    below=0,
)


@pytest.mark.parametrize("width", [60, 80, 120, 200])
def test_the_time_of_the_top_view_is_always_in_the_status_line(width: int) -> None:
    health = "1● 2● 3◐ 4●  p99 9.13 ms"
    numbers = replace(NUMBERS, time="as of 02:17:59.989", health=health, following=False, below=9)
    line = status_text(numbers, width)
    assert "as of 02:17:59.989" in line
    assert "row 1" not in line


def test_nothing_below_is_not_counted() -> None:
    assert "below" not in status_text(replace(NUMBERS, following=False), 200)
    assert "9 below" in status_text(replace(NUMBERS, following=False, below=9), 200)


@pytest.mark.parametrize(
    ("mode", "shown"),
    [
        *((mode, ("Pause", "Follow")) for mode in (Mode.LIVE, Mode.SCROLLED, Mode.WAITING)),
        (Mode.PAUSED, ("Continue", "Follow")),
        *((mode, ("Play", "End")) for mode in (Mode.FILE, Mode.LOADING)),
        (Mode.PLAYING, ("Pause", "End")),
        (Mode.HELD, ("Continue", "End")),
    ],
)
def test_a_key_is_named_by_what_it_does_in_the_mode(mode: Mode, shown: tuple[str, str]) -> None:
    keys = [COMMANDS[run] for run in ("playback.pause", "table.follow")]
    assert tuple(short_text(key, mode) for key in keys) == shown


@pytest.mark.parametrize(
    ("state", "paused", "following", "mode"),
    [
        (LIVE, False, True, Mode.LIVE),
        (LIVE, False, False, Mode.SCROLLED),
        (LIVE, True, False, Mode.PAUSED),
        (replace(LIVE, waiting=True), False, True, Mode.WAITING),
        (replace(LIVE, waiting=True), False, False, Mode.SCROLLED),
        (replace(LIVE, running=False), False, False, Mode.ENDED),
        (replace(LIVE, live=False), False, False, Mode.LOADING),
        (replace(LIVE, live=False, running=False), False, False, Mode.FILE),
    ],
)
def test_the_mode_of_the_view(state: FeedState, paused: bool, following: bool, mode: Mode) -> None:
    assert mode_of(state, paused, following) is mode


@given(
    st.sampled_from(Mode),
    st.text(st.sampled_from("p/串口-0\x1b[31m]"), min_size=1, max_size=60),
    st.sampled_from([0, 1, 10]) | st.integers(24, 200),
)
def test_the_title_fills_its_width(mode: Mode, title: str, width: int) -> None:
    line = title_text(replace(LIVE, title=title, progress=0.42), mode, 12_345, width)
    assert line.isprintable()
    assert width < 24 or (cell_len(line) == width and mode in line)


def test_the_title_keeps_the_end_of_the_recordings_name() -> None:
    line = title_text(LIVE, Mode.LIVE, 0, 80)
    assert line.startswith(" /dev/ttyUSB0  ● REC 0:00:00 0 bytes …")
    assert line.rstrip().endswith("120000Z.mcap LIVE")


RECORDED = replace(LIVE, recorded_bytes=4_200_000)


@pytest.mark.parametrize(
    ("state", "shown"),
    [
        (RECORDED, " ● REC 0:12:03 4.2 MB  "),
        (replace(LIVE, recording=None), " ○ not recording "),
        (replace(LIVE, recording=None, running=False), " ○ not recorded "),
        (replace(LIVE, recording=None, files=("a.mcap",)), " ✗ NOT RECORDING "),
        (replace(RECORDED, running=False), " ■ recorded 0:12:03 4.2 MB  "),
        (replace(LIVE, live=False, recording=None), ""),
    ],
)
def test_whether_rows_are_recorded_is_unmistakable(state: FeedState, shown: str) -> None:
    assert recording_text(state, 723.9) == shown
    assert shown in title_text(state, Mode.LIVE, 0, 80, 723.9)
    sign = shown[:6]
    assert sign in title_text(state, Mode.SCROLLED, 48_160, 40, 723.9)


def test_after_the_end_no_rate_is_shown_as_current() -> None:
    for width, shown in ((60, "ø 1,152/s"), (80, "1,152 frames/s mean")):
        assert shown in status_text(replace(NUMBERS, is_mean=True), width)
        assert shown not in status_text(NUMBERS, width)


def test_the_title_counts_the_waiting_rows() -> None:
    assert title_text(LIVE, Mode.PAUSED, 1234, 80).endswith(" PAUSED, 1,234 new ")


def test_every_width_shows_that_the_end_is_not_followed() -> None:
    for width in range(40, 201):
        assert title_text(LIVE, Mode.SCROLLED, 48_160, width).endswith(" SCROLLED +48,160 ")


@pytest.mark.parametrize(("share", "shown"), [(1e-6, "<0."), (0.0512, "5.1"), (1.0, "100%")])
def test_every_width_shows_the_malformed(share: float, shown: str) -> None:
    for width in range(40, 201):
        assert shown in status_text(replace(NUMBERS, malformed_share=share), width)


@pytest.mark.parametrize(
    ("width", "line"),
    [
        (40, "1,234,567 rows     12 bad <0.1%  1,152/s"),
        (80, "1,234,567 rows   1,152 frames/s      12 malformed <0.01%  row 1,234,567"),
    ],
)
def test_the_numbers_of_a_width(width: int, line: str) -> None:
    assert status_text(NUMBERS, width).rstrip() == line


def test_where_there_are_no_times_there_is_no_rate() -> None:
    for width in (40, 80):
        assert "/s" not in status_text(replace(NUMBERS, frames_per_s=None), width)


def test_the_numbers_fill_their_width() -> None:
    for width in range(201):
        assert len(status_text(replace(NUMBERS, not_shown=7), width)) == width


def test_the_numbers_stand_still_while_they_grow() -> None:
    lines = [
        status_text(replace(NUMBERS, rows=rows, frames_per_s=f), 80)
        for rows, f in [(0, 0.0), (999, 99.6), (1_000_000, 2304.0)]
    ]
    assert len({line.index("malformed") for line in lines}) == 1


def test_rows_that_came_too_fast_are_reported() -> None:
    assert "7 line errors" in status_text(replace(NUMBERS, line_errors=7), 120)
    assert "7 too fast to show" in status_text(replace(NUMBERS, not_shown=7), 120)


@pytest.mark.parametrize("width", [30, 60, 80])
def test_the_help_has_every_key_and_every_fault(width: int) -> None:
    text = help_text(width, DARK).plain
    assert all(len(line) <= width for line in text.split("\n"))
    flat = " ".join(text.split())
    for _, keys in SECTIONS:
        for key in keys:
            assert f"{key.key_display} {' '.join(key.tooltip.split())}" in flat
    for fault in FAULT_MEANINGS:
        assert fault in flat
    for motor in MOTORS:
        assert online_bit_text(motor) in flat
    for word in (*HEALTH.values(), "p99", "OFFLINE"):
        assert help_text(width, DARK, word).plain != "no match"


def test_a_wide_help_has_two_columns_and_finds_words(feed: Any) -> None:
    for width in (105, 200):
        text = help_text(width, DARK)
        assert all(line.cell_len <= width for line in text.split())
        assert len(text.split()) < 0.8 * len(help_text(80, DARK).split())
        assert all(fault in text.plain for fault in FAULT_MEANINGS)
    assert len(help_text(80, DARK, "gap lost").split()) < 10

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await press(app, pilot, "question_mark")
        await until(app, pilot, lambda: "Find" in page(app) and "Move" in page(app))
        assert any("Move" in line and "Fields and" in line for line in lines(app))
        await press(app, pilot, "slash", *"qzj")
        assert "no match" in page(app)
        assert "/qzj_" in page(app)
        await press(app, pilot, "backspace", "backspace", "backspace", *"previous filter", "enter")
        assert "return to the previous filter" in page(app)
        assert "Faults" not in page(app)
        await press(app, pilot, "escape")
        assert "Move" in page(app)
        await press(app, pilot, "escape")
        assert "Move" not in page(app)

    play(feed, scenario, (120, 32))


class Telling:
    """A feed of port events alone."""

    def __init__(self, *polls: list[PortEvent]) -> None:
        self._polls = list(polls)

    def poll(self) -> FeedUpdate:
        return FeedUpdate(LIVE, events=self._polls.pop(0))

    def stop(self) -> None:
        """Nothing goes on."""


def test_line_errors_are_summed_from_port_events() -> None:
    first = PortEvent(1, "a", PortEventKind.LINE_ERROR, "2 framing", 2)
    second = PortEvent(2, "b", PortEventKind.LINE_ERROR, "3 break", 3)
    lost = PortEvent(3, "b", PortEventKind.OVERRUN, "900 bytes", 900)
    watched = ViewModel(Telling([first], [second, lost]), None, RowStore())
    watched.poll(0)
    watched.poll(1)
    assert watched.status_counters(Viewport()).line_errors == 5


WITHOUT_EVENT_LINES = StartOptions(choices=Choices(events=False), zone=UTC)


async def _until_gone(notice: NoticeLine, pilot: Pilot[None]) -> None:
    async with asyncio.timeout(BOUND_S):
        while notice.display:
            await pilot.pause(0.01)


ANSWERS = {
    ("u",): "no row is marked",
    ("n",): "no search yet",
    ("colon", *"999", "enter"): "row 999 does not exist",
    ("colon", *"@9999", "enter"): "has byte 9,999",
    ("slash", *"zz", "enter"): "no row has zz",
    ("w", "escape"): "",
    ("v",): "selecting",
    ("t",): "row",
}
"""Keys, and the notice that answers them."""


def test_the_notice_of_a_key_ends_with_the_next_key(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        notice = app.query_one(NoticeLine)
        for keys, reported in ANSWERS.items():
            await press(app, pilot, *keys)
            assert notice.display == bool(reported), keys
            assert reported in page(app)
            await press(app, pilot, "k")
            assert not notice.display

    play(feed, scenario, rows=50)


def test_it_goes_after_a_while_too_and_a_warning_later(
    feed: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(status_bar, "INFO_S", 0.05)

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        notice = app.query_one(NoticeLine)
        await press(app, pilot, "u")
        await _until_gone(notice, pilot)
        feed.emit(PortEvent(0, "p", PortEventKind.LINE_ERROR, "2 framing", 2))
        await settle(app, pilot)
        await press(app, pilot, "k", "j")
        await pilot.pause(0.1)
        assert "2 framing" in page(app)
        monkeypatch.setattr(status_bar, "WARNING_S", 0.05)
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
        assert "one lost: pulled out" in page(app)
        await press(app, pilot, "escape", "escape")
        assert not app.query_one(NoticeLine).display

    play(feed, scenario)


def test_a_graver_notice_is_shown_before_the_answer_to_a_key(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        for port, passing in (
            ("one", PortEvent(0, "one", PortEventKind.OPENED, "at 115200")),
            ("two", PortEvent(0, "two", PortEventKind.LINE_ERROR, "2 framing", 2)),
        ):
            feed.emit(passing)
            await settle(app, pilot)
            assert passing.detail in page(app)
            feed.emit(PortEvent(0, port, PortEventKind.LOST, "pulled out"))
            await settle(app, pilot)
            assert f"{port} lost: pulled out" in page(app)
            await press(app, pilot, "u")
            assert "no row is marked" in page(app)
            await press(app, pilot, *["escape"] * 4)

    play(feed, scenario, options=WITHOUT_EVENT_LINES)


ANSWER, STATE, EVENT = "no row is marked", "saving: 0%", "one found again"
WORRIES = ("the disk is full", "one line error: 2 framing", "two lost: pulled out")


@pytest.mark.parametrize("answer_first", [True, False])
def test_no_notice_replaces_another_that_still_holds(feed: Any, answer_first: bool) -> None:
    """An answer, the worst event and the newest warning are seen however they come together."""

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        notice = app.query_one(NoticeLine)
        if answer_first:
            await press(app, pilot, "u")
        notice.warn(WORRIES[0])
        notice.pin("save", STATE, warning=False)
        feed.emit(PortEvent(0, "one", PortEventKind.FOUND_AGAIN, "after 2 s"))
        feed.emit(PortEvent(0, "one", PortEventKind.LINE_ERROR, "2 framing", 2))
        feed.emit(PortEvent(0, "two", PortEventKind.LOST, "pulled out"))
        feed.emit(PortEvent(0, "one", PortEventKind.LINE_ERROR, "9 framing", 9))
        await settle(app, pilot)
        if not answer_first:
            await press(app, pilot, "u")
        shown = [ANSWER, WORRIES[2]]
        for key, follows in [("k", EVENT), ("escape", WORRIES[1]), ("escape", WORRIES[0])]:
            assert all(text in page(app) for text in shown)
            await press(app, pilot, key)
            shown = [shown[0] if key == "escape" else follows, shown[1]]
            if key == "escape":
                shown[1] = follows.replace("2 framing", "9 framing")
        assert all(text in page(app) for text in shown)
        await press(app, pilot, "escape", "escape")
        assert STATE in page(app)
        await press(app, pilot, "escape")
        assert not notice.display

    play(feed, scenario, options=WITHOUT_EVENT_LINES)


def test_the_first_warning_is_seen_although_a_port_opens_at_once(feed: Any) -> None:
    feed.emit(PortEvent(0, "/dev/ttyUSB0", PortEventKind.OPENED, "at 115200"))

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        assert "! the settings are wrong" in page(app)
        assert "at 115200" in page(app)

    options = replace(WITHOUT_EVENT_LINES, warnings=("the settings are wrong",))
    play(feed, scenario, options=options)


def test_on_a_low_terminal_the_answer_comes_first(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        app.query_one(NoticeLine).warn(WORRIES[0])
        await press(app, pilot, "u")
        assert ANSWER in page(app)
        assert WORRIES[0] not in page(app)
        await press(app, pilot, "k")
        assert WORRIES[0] in page(app)

    play(feed, scenario, (80, 12))


LONG = (
    "/home/somebody/recordings/a-robot-with-a-long-name/2026-01-31/fte-sniff-20260131T120000Z.mcap"
    " cannot be written: the disk is full; name another place with -o"
)


def test_a_long_notice_keeps_the_mistake_and_the_fix(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        app.query_one(NoticeLine).warn(LONG)
        for size in ((80, 24), (40, 20), (40, 12), (200, 60)):
            await pilot.resize_terminal(*size)
            await settle(app, pilot)
            reported = " ".join(" ".join(lines(app)).split())
            assert reported.count("-o") == 1
            if size != (40, 12):
                assert "20260131T120000Z.mcap cannot be written" in reported
            assert "the disk is full; name another place with -o" in reported
            assert max(map(cell_len, lines(app))) <= size[0]

    play(feed, scenario)


def test_what_is_wrong_with_a_filter_ends_with_the_way_out(feed: Any) -> None:
    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        await enter_line(app, pilot, "f", "motor = 1 AND moter = 1")
        for size in ((80, 24), (40, 20), (40, 12)):
            await pilot.resize_terminal(*size)
            await settle(app, pilot)
            assert "did you mean motor?" in " ".join(page(app).split())

    play(feed, scenario)


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
