"""Rows, a feed, and what drives the screen: keys, the mouse, and reading what is drawn."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import replace
from datetime import UTC
from pathlib import Path
from typing import Any

import pytest
from textual import events
from textual._compositor import LayoutUpdate
from textual.pilot import Pilot
from textual.screen import Screen

from docs.picture import PictureApp, idle
from fte_sniff.analysis.feed import FeedState, FeedUpdate
from fte_sniff.analysis.model import StreamChange
from fte_sniff.analysis.row_store import BlockSource
from fte_sniff.protocol import KIND_BY_NAME, Fault, PortEvent, Row, encode
from fte_sniff.protocol import rows as columns
from fte_sniff.tui import find, status_bar
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.options import StartOptions
from fte_sniff.tui.table import RowTable
from tests.support.faults import frame_faults
from tests.waiting import BOUND_S

NOON_NS = 1_769_860_800_000_000_000
"""2026-01-31T12:00:00Z."""

STEP_NS = 1_000_000


class ListFeed:
    """A feed of what a test gives it."""

    def __init__(self) -> None:
        self.state = FeedState("/dev/ttyUSB0", "/tmp/a.mcap")
        self.stops = 0
        self._rows: list[Row] = []
        self._events: list[PortEvent] = []
        self.changes: list[StreamChange] = []

    def give(self, rows: Sequence[Row]) -> None:
        self._rows += rows
        self.state = replace(self.state, rows=self.state.rows + len(rows))

    def emit(self, event: PortEvent) -> None:
        self._events.append(event)

    def end(self, why: str) -> None:
        self.state = replace(self.state, running=False, ended=why)

    def poll(self) -> FeedUpdate:
        update = FeedUpdate(self.state, columns.Rows.of(self._rows), self._events, self.changes)
        self._rows, self._events, self.changes = [], [], []
        return update

    def stop(self) -> None:
        self.stops += 1


def _speed_rows(count: int, start: int = 0, port: str = "/dev/ttyUSB0") -> list[Row]:
    """Rows that a millisecond parts: speed commands whose RPM is the number of the row."""
    return [
        Row(port, 10 * number, _speed_frame(number), NOON_NS + number * STEP_NS)
        for number in range(start, start + count)
    ]


@functools.cache
def _speed_frame(number: int) -> bytes:
    return encode(KIND_BY_NAME["speed"], {"motor": 1 + number % 4, "rpm": number % 30_000})


def _odd_rows() -> list[Row]:
    """One row of every sort that is not in order."""
    bad_motor = bytes.fromhex("AA0109000100000000EE")
    reserved = bytes.fromhex("AA010100010000070000EE")[:9] + b"\xee"
    unknown = bytes.fromhex("AA7701000100000000EE")
    rows: list[Row] = [
        Row("p", 0, raw, NOON_NS, frame_faults(raw)) for raw in (bad_motor, reserved, unknown)
    ]
    return [
        *rows,
        Row(
            "p", 30, bytes.fromhex("AA0101000100000000EF"), NOON_NS, (Fault.BAD_TAIL,), framed=False
        ),
        Row("p", 40, b"\x01\x02\x03", None, (Fault.NOISE,), framed=False),
        Row("p", 43, bytes(range(256)) * 4, NOON_NS, (Fault.NOISE, Fault.LINE_ERROR), framed=False),
        Row("p", 1067, bytes.fromhex("AA01010001EE"), NOON_NS, (Fault.TRUNCATED,), framed=False),
        Row(
            "p",
            1073,
            bytes.fromhex("AA0101000100000000000000EE"),
            0,
            (Fault.OVERLONG,),
            framed=False,
        ),
    ]


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's cache folder, where copies are kept."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return folder


@pytest.fixture(autouse=True)
def notices_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """Notices do not vanish while a slow machine runs a test."""
    monkeypatch.setattr(status_bar, "INFO_S", 3600.0)
    monkeypatch.setattr(status_bar, "WARNING_S", 3600.0)


@pytest.fixture(autouse=True)
def searches_end_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search is not continued beside the next keys because a slow machine took long for it."""
    monkeypatch.setattr(find, "SEARCH_BLOCK_S", 3600.0)


class UndrawnApp(SniffApp):
    """The screen without the frames that nobody reads, which are half of what a test costs.

    It is laid out after every key, and drawn by `lines`, and by `play` at the start and at the end.
    """


@pytest.fixture(autouse=True)
def frames_are_drawn_where_they_are_read(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A frame is drawn for a test that reads it, not after every key; slow tests draw all."""
    if request.node.get_closest_marker("slow"):
        return
    draw = Screen._compositor_refresh

    def draw_unless_undrawn(screen: Screen[Any]) -> None:
        app: object = screen.app
        if not isinstance(app, UndrawnApp | PictureApp) or screen is not app.screen:
            draw(screen)

    monkeypatch.setattr(Screen, "_compositor_refresh", draw_unless_undrawn)


@pytest.fixture
def samples() -> Path:
    return Path(__file__).parents[2] / "samples"


@pytest.fixture
def feed() -> ListFeed:
    return ListFeed()


@pytest.fixture
def speed_rows() -> Callable[..., list[Row]]:
    return _speed_rows


@pytest.fixture
def odd_rows() -> list[Row]:
    return _odd_rows()


CHARACTERS = {
    "space": " ",
    "colon": ":",
    "question_mark": "?",
    "equals_sign": "=",
    "slash": "/",
    "apostrophe": "'",
    "number_sign": "#",
    "less_than_sign": "<",
    "greater_than_sign": ">",
    "left_square_bracket": "[",
    "right_square_bracket": "]",
}
"""Keys whose names are not what they type."""

Rows = Callable[..., list[Row]]
Scenario = Callable[[SniffApp, Pilot[None]], Awaitable[None]]


def play(
    feed: Any,
    scenario: Scenario,
    size: tuple[int, int] = (80, 24),
    leave_at_end: bool = False,
    options: StartOptions | None = None,
    rows: int = 0,
    source: BlockSource | None = None,
    frames: bool = False,
) -> SniffApp:
    """Run the screen without a terminal, with rows of speed commands, and the scenario on it.

    With `frames`, the screen is drawn after every key, as for a user.
    """
    if rows:
        feed.give(_speed_rows(rows))
    kind = SniffApp if frames else UndrawnApp
    app = kind(feed, options or StartOptions(leave_at_end, zone=UTC), source)

    async def run() -> None:
        async with app.run_test(size=size) as pilot:
            await settle(app, pilot)
            page(app)
            await scenario(app, pilot)
            page(app)

    asyncio.run(run())
    return app


async def settle(app: SniffApp, pilot: Pilot[None]) -> None:
    """Let the screen take in what there is, and draw it."""
    app.tick()
    await idle(app)


async def press(app: SniffApp, pilot: Pilot[None], *keys: str) -> None:
    """Press keys as fast as the screen takes them; `Pilot.press` sleeps after each."""
    for key in keys:
        app.post_message(events.Key(key, CHARACTERS.get(key, key if len(key) == 1 else None)))
        await idle(app)


async def type_line(app: SniffApp, pilot: Pilot[None], line: str) -> None:
    """Type a line into the open field; it is drawn once."""
    names = {character: name for name, character in CHARACTERS.items()}
    await rush(app, pilot, *(names.get(character, character) for character in line))


async def enter_line(app: SniffApp, pilot: Pilot[None], key: str, line: str) -> None:
    """Open a field with a key, type a line, and press enter."""
    await press(app, pilot, key)
    await type_line(app, pilot, line)
    await press(app, pilot, "enter")


def lines(app: SniffApp) -> list[str]:
    """What stands on the screen, line by line, without blank parts.

    A picture of it, which the program saves, has the same text, and takes ten times as long.
    """
    update = app.screen._compositor.render_update(full=True, screen_stack=app._background_screens)
    assert isinstance(update, LayoutUpdate)
    parts = [[part.text for strip in line for part in strip] for line in update.strips]
    return ["".join(text for text in line if text.strip(" ")) for line in parts]


def page(app: SniffApp) -> str:
    return "\n".join(lines(app))


def table(app: SniffApp) -> RowTable:
    return app.query_one(RowTable)


def row_texts(app: SniffApp) -> list[str]:
    """The lines of the table in the window, as drawn."""
    page(app)  # a table that is not drawn has the columns of before
    here = table(app)
    return [here.render_line(y).text for y in range(here.viewport.height)]


def rpms(app: SniffApp) -> list[int]:
    """The RPM of each row in the window, as drawn."""
    return [int(text.split("rpm=")[1].split()[0]) for text in row_texts(app) if "rpm=" in text]


async def wheel(app: SniffApp, pilot: Pilot[None], notch: type[events.MouseEvent]) -> None:
    here = table(app)
    at = dict.fromkeys(("x", "y", "delta_x", "delta_y", "button"), 0)
    here.post_message(notch(here, **at, shift=False, meta=False, ctrl=False))
    await pilot.pause()


async def rush(app: SniffApp, pilot: Pilot[None], *keys: str) -> None:
    """Keys that all wait before the first is looked at, as over a slow line or out of a paste."""
    for key in keys:
        app.post_message(events.Key(key, CHARACTERS.get(key, key if len(key) == 1 else None)))
    await idle(app)


async def until(app: SniffApp, pilot: Pilot[None], holds: Callable[[], bool]) -> None:
    """Let the screen go on until something holds that is worked on beside it."""
    async with asyncio.timeout(BOUND_S):
        while not holds():
            await pilot.pause(0.05)
    await settle(app, pilot)
