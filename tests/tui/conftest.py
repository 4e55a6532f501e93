"""Rows, a feed, and what drives the screen: keys in, what is on it out."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import replace
from datetime import UTC
from pathlib import Path

import pytest
from textual import events
from textual._compositor import LayoutUpdate
from textual.geometry import Size

from fte_sniff.analysis.feed import FeedState, FeedUpdate
from fte_sniff.protocol.items import Change, PortEvent
from fte_sniff.protocol.rows import Row
from fte_sniff.protocol.spec import KIND_BY_NAME, Fault, encode
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.options import StartOptions
from tests.support.columns import rows_from
from tests.waiting import BOUND_S

NOON_NS = 1_769_860_800_000_000_000
"""2026-01-31T12:00:00Z."""

PORT = "/dev/ttyUSB0"


class ListFeed:
    """A feed of what a test gives it."""

    def __init__(self, *, live: bool = True) -> None:
        self.state = FeedState(PORT, "/tmp/a.mcap" if live else None, live=live)
        self._rows: list[Row] = []
        self._events: list[PortEvent] = []
        self.changes: list[Change] = []

    def give(self, rows: Sequence[Row]) -> None:
        self._rows += rows

    def emit(self, event: PortEvent) -> None:
        self._events.append(event)

    def end(self, why: str | None = None) -> None:
        self.state = self.state._replace(running=False, ended=why)

    def poll(self) -> FeedUpdate:
        update = FeedUpdate(self.state, rows_from(self._rows), self._events, self.changes)
        self._rows, self._events, self.changes = [], [], []
        return update

    def stop(self) -> None:
        pass


def frame(name: str, t_ms: float, offset: int = 0, port: str = PORT, **values: int) -> Row:
    """A frame, some milliseconds after noon."""
    raw = encode(KIND_BY_NAME[name], values)
    return Row(port, offset, raw, NOON_NS + int(t_ms * 1e6))


def speed_rows(count: int, start: int = 0, port: str = PORT) -> list[Row]:
    """Speed commands, a millisecond apart, whose RPM is the number of the row."""
    return [
        frame("speed", number, 10 * number, port, motor=1 + number % 4, rpm=number)
        for number in range(start, start + count)
    ]


def noise(t_ms: float, offset: int = 0, port: str = PORT) -> Row:
    return Row(port, offset, b"\xc1\xc2", NOON_NS + int(t_ms * 1e6), (Fault.NOISE,), framed=False)


def talk(
    seconds: float,
    *,
    silent: int | None = None,
    lost: int | None = None,
    delay_ms: float = 3,
    error: int = 0,
) -> list[Row]:
    """Commands to all motors 50 times a second, and their answers, of which some are missing."""
    rows = []
    for number in range(int(seconds * 50)):
        for motor in range(1, 5):
            t_ms = 20 * number + 5 * (motor - 1)
            rows.append(frame("speed", t_ms, motor=motor, rpm=1000))
            is_lost = motor == silent or (motor == lost and number % 3 == 0)
            if not is_lost:
                flag = error if motor == 4 else 0
                values = {"motor": motor, "rpm": 998, "error": flag, "online": 15}
                rows.append(frame("speed_feedback", t_ms + delay_ms, **values))
    rows.sort(key=lambda row: row.t_ns or 0)
    return [replace(row, offset=10 * number) for number, row in enumerate(rows)]


def after(seconds: float, rows: Sequence[Row]) -> list[Row]:
    """The rows, some time later on their port."""
    return [
        replace(
            row, t_ns=(row.t_ns or 0) + int(seconds * 1e9), offset=row.offset + int(seconds * 1e6)
        )
        for row in rows
    ]


@pytest.fixture(autouse=True)
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folders of the user in a temporary one; returns the cache."""
    for name in ("CACHE", "STATE", "CONFIG"):
        monkeypatch.setenv(f"XDG_{name}_HOME", str(tmp_path / name.lower()))
    monkeypatch.delenv("TMUX", raising=False)
    monkeypatch.chdir(tmp_path)
    return tmp_path / "cache"


@pytest.fixture
def feed() -> ListFeed:
    return ListFeed()


CHARACTERS = {
    "space": " ",
    "colon": ":",
    "question_mark": "?",
    "exclamation_mark": "!",
    "equals_sign": "=",
    "greater_than_sign": ">",
    "slash": "/",
    "number_sign": "#",
    "apostrophe": "'",
    "percent_sign": "%",
    "full_stop": ".",
    "at": "@",
    "plus": "+",
    "minus": "-",
    "left_square_bracket": "[",
    "right_square_bracket": "]",
    "left_curly_bracket": "{",
    "right_curly_bracket": "}",
}
"""Keys whose names are not what they type."""

NAMES = {character: name for name, character in CHARACTERS.items()}

Scenario = Callable[[SniffApp], Awaitable[None]]


def play(
    feed: ListFeed,
    scenario: Scenario,
    size: tuple[int, int] = (80, 24),
    options: StartOptions | None = None,
) -> SniffApp:
    """Run the screen without a terminal, and the scenario on it."""
    app = SniffApp(feed, options or StartOptions(zone=UTC))

    async def run() -> None:
        async with asyncio.timeout(BOUND_S), app.run_test(size=size):
            await settle(app)
            await scenario(app)

    asyncio.run(run())
    return app


async def settle(app: SniffApp) -> None:
    """Let the screen take in what there is."""
    app.tick()
    app.show_all()
    await app.typed.quiet()
    await app.typed.done()


def keys_of(text: str) -> list[str]:
    """The names of keys of a line: names, and 'text' that is typed."""
    parts = text.split("'")
    found: list[str] = []
    for number, part in enumerate(parts):
        found += [NAMES.get(one, one) for one in part] if number % 2 else part.split()
    return found


async def press(app: SniffApp, keys: str) -> None:
    """Type keys at once, and let them act."""
    for key in keys_of(keys):
        app.post_message(events.Key(key, CHARACTERS.get(key, key if len(key) == 1 else None)))
    await asyncio.sleep(0)
    await app.typed.done()
    if app.is_running:
        await settle(app)


async def resize(app: SniffApp, width: int, height: int) -> None:
    """Give the terminal another size."""
    assert app._driver is not None
    app._driver._size = (width, height)
    app.post_message(events.Resize(Size(width, height), Size(width, height)))
    await settle(app)


def lines(app: SniffApp) -> list[str]:
    """What is on the screen, line by line."""
    update = app.screen._compositor.render_update(full=True, screen_stack=app._background_screens)
    assert isinstance(update, LayoutUpdate)
    parts = ([part.text for strip in line for part in strip] for line in update.strips)
    return ["".join(texts).rstrip() for texts in parts]


def page(app: SniffApp) -> str:
    return "\n".join(lines(app))


async def until(app: SniffApp, text: str, *, gone: bool = False) -> None:
    """Wait until a text is on the screen, or gone from it."""
    async with asyncio.timeout(BOUND_S):
        while (text in page(app)) == gone:
            await asyncio.sleep(0.02)
