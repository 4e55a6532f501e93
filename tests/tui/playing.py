"""What tests of the screen share: running it, pressing keys, and reading what is drawn."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Awaitable, Callable
from datetime import UTC
from html import unescape
from typing import Any

from textual import events
from textual.pilot import Pilot

from fte_sniff.protocol import Row
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.options import AtEnd, StartOptions
from fte_sniff.tui.table.widget import RowTable

CHARACTERS = {
    "space": " ",
    "colon": ":",
    "question_mark": "?",
    "equals_sign": "=",
    "slash": "/",
    "apostrophe": "'",
}
"""Keys whose names are not what they type."""

ROUNDS = 4
"""A key goes from the app to a widget, from there to an action, from there to a message."""

Rows = Callable[..., list[Row]]
Scenario = Callable[[SniffApp, Pilot[None]], Awaitable[None]]


def play(
    feed: Any,
    scenario: Scenario,
    size: tuple[int, int] = (80, 24),
    at_end: AtEnd = AtEnd.STAY,
    opening: StartOptions | None = None,
) -> SniffApp:
    """Run the screen without a terminal, and the scenario on it."""
    app = SniffApp(feed, opening or StartOptions(at_end, zone=UTC))

    async def run() -> None:
        async with app.run_test(size=size) as pilot:
            await settle(app, pilot)
            await scenario(app, pilot)

    asyncio.run(run())
    return app


async def settle(app: SniffApp, pilot: Pilot[None]) -> None:
    """Let the screen take in what there is, and draw it."""
    app.tick()
    await pilot.pause()


async def press(app: SniffApp, pilot: Pilot[None], *keys: str) -> None:
    """Press keys as fast as the screen takes them; `Pilot.press` sleeps after each."""
    for key in keys:
        app.post_message(events.Key(key, CHARACTERS.get(key, key if len(key) == 1 else None)))
        for _ in range(ROUNDS):
            await pilot.pause(0)


async def type_line(app: SniffApp, pilot: Pilot[None], line: str) -> None:
    names = {character: name for name, character in CHARACTERS.items()}
    await press(app, pilot, *(names.get(character, character) for character in line))


def lines(app: SniffApp) -> list[str]:
    """What stands on the screen, line by line, out of its picture."""
    found: dict[float, list[tuple[float, str]]] = {}
    picture = app.export_screenshot()
    for attributes, text in re.findall(r"<text ([^>]*clip-path[^>]*)>([^<]*)</text>", picture):
        place = dict(re.findall(r'(\w+)="([\d.]+)"', attributes))
        x, y = float(place["x"]), float(place["y"])
        found.setdefault(y, []).append((x, unescape(text).replace("\xa0", " ")))
    return ["".join(text for _, text in sorted(found[y])) for y in sorted(found)]


def page(app: SniffApp) -> str:
    return "\n".join(lines(app))


def table(app: SniffApp) -> RowTable:
    return app.query_one(RowTable)


def rpms(app: SniffApp) -> list[int]:
    """The RPM of each row in the window, as drawn."""
    here = table(app)
    texts = [here.render_line(y).text for y in range(here.viewport.height)]
    return [int(re.split("rpm=", text)[1].split()[0]) for text in texts if "rpm=" in text]


async def wheel(app: SniffApp, pilot: Pilot[None], notch: type[events.MouseEvent]) -> None:
    here = table(app)
    at = dict.fromkeys(("x", "y", "delta_x", "delta_y", "button"), 0)
    here.post_message(notch(here, **at, shift=False, meta=False, ctrl=False))
    await pilot.pause()


async def rush(app: SniffApp, pilot: Pilot[None], *keys: str) -> None:
    """Keys that all wait before the first is looked at, as over a slow line or out of a paste."""
    for key in keys:
        app.post_message(events.Key(key, CHARACTERS.get(key, key if len(key) == 1 else None)))
    for _ in range(10 * ROUNDS):
        await pilot.pause(0)


async def until(app: SniffApp, pilot: Pilot[None], holds: Callable[[], bool]) -> None:
    """Let the screen go on until something holds that is worked on beside it."""
    async with asyncio.timeout(60):
        while not holds():
            await pilot.pause(0.05)
    await settle(app, pilot)
