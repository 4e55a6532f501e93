"""The screen on the rows of raw bytes, for the program of a copy."""

from __future__ import annotations

from pathlib import Path

from textual.pilot import Pilot

from fte_sniff.protocol import Chunk, Framer
from fte_sniff.tui.app import SniffApp
from tests.tui.conftest import NOON_NS, ListFeed, lines, play, press, settle

SIZE = (200, 60)


def show(file: str, *keys: str) -> None:
    """Print what is on the screen, at first and after each key."""
    framer, feed = Framer("p"), ListFeed()
    feed.give([*framer.feed(Chunk("p", NOON_NS, Path(file).read_bytes())), *framer.flush()])

    async def scenario(app: SniffApp, pilot: Pilot[None]) -> None:
        for key in ("", *keys):
            await press(app, pilot, *filter(None, [key]))
            await settle(app, pilot)
            print(*filter(None, map(str.rstrip, lines(app))), sep="\n")

    play(feed, scenario, SIZE)
