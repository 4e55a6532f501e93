"""Owns the pictures of the screen in the README: the real screen on a real capture of sim://.

    python docs/picture.py

The rows come from the simulator with a fixed seed: a picture changes only when the screen does.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path
from time import monotonic

from fte_sniff.analysis.feed import FeedState, FeedUpdate
from fte_sniff.capture.simulator import parse_parameters, simulate
from fte_sniff.protocol import DEFAULT_BAUD, Chunk, Framer, Row
from fte_sniff.tui.app import SniffApp

PICTURES = {
    "screen.svg": ((118, 30), 3400, ("E", "enter")),
    "motors.svg": ((118, 40), 2650, ("M",)),
}
"""Each picture's size in cells, the frames before it, and the keys that lead to it."""

RATE = 200
QUERY = f"seed=6&rate={RATE}&drop=0.01&flip=0.01&noise=0.01"
START_NS = 1_769_860_800_000_000_000  # 2026-01-31T12:00:00Z


class Capture:
    """A capture that has run for a while and goes on at its own rate, as a feed."""

    def __init__(self, rows: list[Row], coming: int) -> None:
        self._rows = rows
        self._given = 0
        self._due = len(rows) - coming
        self._begun = monotonic()

    def poll(self) -> FeedUpdate:
        """The rows that have come since the poll before."""
        due = self._due + int((monotonic() - self._begun) * RATE)
        rows = self._rows[self._given : due]
        self._given += len(rows)
        recording = "fte-sniff-20260131T120000Z.mcap"
        state = FeedState(title="/dev/ttyUSB0", recording=recording, rows=self._given)
        return FeedUpdate(state, rows)

    def stop(self) -> None:
        """There is nothing to stop."""


def rows(frames: int) -> list[Row]:
    """What the simulated wire brings with so many frames."""
    framer = Framer("/dev/ttyUSB0", DEFAULT_BAUD)
    found: list[Row] = []
    for timed in simulate(parse_parameters(f"{QUERY}&frames={frames}")):
        found += framer.feed(Chunk("/dev/ttyUSB0", START_NS + timed.t_ns, timed.data))
    return found


async def take(size: tuple[int, int], frames: int, keys: Sequence[str]) -> str:
    """The screen as SVG, after these keys."""
    app = SniffApp(Capture(rows(frames), coming=8 * RATE))
    async with app.run_test(size=size) as pilot:
        # The rate is told over two seconds, which the first rows must have left behind.
        await pilot.pause(2.6)
        await pilot.press(*keys)
        await pilot.pause(0.4)
        return app.export_screenshot(title="fte-sniff live /dev/ttyUSB0")


if __name__ == "__main__":
    for name, (size, frames, keys) in PICTURES.items():
        picture = asyncio.run(take(size, frames, keys))
        Path(__file__).with_name(name).write_text(picture, encoding="utf-8")
