"""Make the pictures of the screen: `python docs/picture.py [NAME ...]`.

They show the real screen on a capture of `sim://` with a fixed seed and a simulated clock, so that
a picture changes only when the screen does. Wide characters have two cells here too, in any font.
"""

from __future__ import annotations

import asyncio
import os
import re
import sys
import tempfile
from collections.abc import Mapping, Sequence, Sized
from dataclasses import dataclass
from functools import cache
from html import escape, unescape
from pathlib import Path

from rich.cells import cell_len
from textual.pilot import Pilot

from fte_sniff.analysis.feed import FeedState, FeedUpdate
from fte_sniff.capture.simulation import Simulation, parse_parameters
from fte_sniff.protocol.framer import Framer
from fte_sniff.protocol.items import Chunk
from fte_sniff.protocol.rows import Rows
from fte_sniff.protocol.spec import DEFAULT_BAUD
from fte_sniff.tui import status
from fte_sniff.tui.app import SniffApp
from fte_sniff.tui.options import StartOptions

FOLDER = Path(__file__).with_name("pictures")
"""Folder of the pictures."""

PORT = "/dev/ttyUSB0"
RATE = 200
QUERY = f"seed=6&rate={RATE}&weak_motor=3&drop=0.005&flip=0.005&noise=0.01"
START_NS = 1_769_860_800_000_000_000  # 2026-01-31T12:00:00Z
ROW_BYTES = 90
POLLS = 80
POLL_NS = 50_000_000
MORE_POLLS = 5
"""Polls after the last row, until the panes show it."""
POLLS_PER_DRAWING = 20
"""What nobody sees is not drawn; the keys are pressed after a drawing."""
MOST_ROUNDS = 200
IDLE_WITHIN_S = 60.0

_TEXT = re.compile(
    r'<text(?P<before> [^>]*?)x="(?P<x>[\d.]+)"(?P<between>[^>]*?)textLength="(?P<length>[\d.]+)"'
    r"(?P<after>[^>]*)>(?P<content>[^<]*)</text>"
)
_WIDE = "\u2e80-\u9fff\uff00-\uff60"
_RUNS = re.compile(f"[{_WIDE}]|[^{_WIDE}]+")
"""A wide character, or a run of narrow ones."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A screen, and the keys that lead to it."""

    size: tuple[int, int]
    """Columns and lines."""
    keys: Sequence[str] = ()
    """Keys by Textual's names; text in quotes is typed."""
    shows: str = ""
    """Text on the finished screen."""
    frames: int = 3400
    """Simulated frames."""
    environment: Mapping[str, str] | None = None
    language: str = "en"


PICTURES: Mapping[str, Picture] = {
    "screen": Picture((120, 32), ("E", "enter"), "byte by byte"),
    "screen-zh": Picture((120, 32), ("E", "enter"), "逐字节", language="zh"),
    "motors": Picture((120, 32), ("M",), "feedback", frames=2650),
    "motors-zh": Picture((120, 32), ("M",), "实线", frames=2650, language="zh"),
    "streams": Picture((120, 32), ("T",), "unanswered", frames=2650),
    "small": Picture((80, 24), (), "LIVE"),
    "small-zh": Picture((80, 24), (), "实时", language="zh"),
    "small-light": Picture((80, 24), ("ctrl+t", "exclamation_mark"), "findings", frames=2650),
    "narrow": Picture((40, 16), (), "LIVE"),
    "wide": Picture((200, 60), ("M",), "feedback", frames=2650),
    "wide-zh": Picture((200, 60), ("ctrl+t", "T"), "未应答", frames=2650, language="zh"),
    "wide-light": Picture((200, 60), ("ctrl+t", "E", "enter"), "byte by byte"),
    "wide-dark-zh": Picture((200, 60), ("M",), "实线", frames=2650, language="zh"),
    "filter-wrong": Picture((80, 24), ("f", "'moter = 1'", "enter"), "moter"),
    "filter-empty": Picture((80, 24), ("f", "'rpm > 9000'", "enter"), "hides all"),
    "search": Picture(
        (100, 24), ("escape", "slash", "'hex:AA 01 ?? 00'", "enter", "m", "n", "n"), "match 2 of"
    ),
    "help": Picture((100, 40), ("question_mark",), "Keys and signs"),
    "columns": Picture((100, 30), ("C",), "enter applies"),
    "light": Picture((120, 32), ("space", "v", "up", "up", "m", "ctrl+t"), "SCROLLED"),
    "light-zh": Picture((120, 32), ("ctrl+t", "T"), "未应答", frames=2650, language="zh"),
    "light-motors-zh": Picture((80, 24), ("ctrl+t", "M"), "电机", language="zh"),
    "colourless": Picture((100, 30), ("E", "enter"), "byte by byte", environment={"NO_COLOR": "1"}),
}
"""Pictures by file name."""


class SimulatedFeed:
    """A capture that has run for a while, with its own clock."""

    def __init__(self, rows: Rows) -> None:
        self._rows = rows
        self._given = 0
        self._polls = 0

    @property
    def now_ns(self) -> int:
        """The time of the clock."""
        return self._polls * POLL_NS

    def advance(self) -> None:
        """Let the time between two polls pass."""
        self._polls += 1

    def poll(self) -> FeedUpdate:
        """Most rows at the first poll, the rest at their own rate."""
        due = len(self._rows) - max(0, POLLS - self._polls) * RATE * POLL_NS // 10**9
        rows = self._rows[self._given : due]
        self._given += len(rows)
        recording, size = "fte-sniff-20260131T120000Z.mcap", self._given * ROW_BYTES
        state = FeedState(PORT, recording, recorded_bytes=size)
        return FeedUpdate(state, rows)

    def stop(self) -> None:
        """Do nothing."""


class PictureApp(SniffApp):
    """The screen with the clock of its feed."""

    def __init__(self, capture: SimulatedFeed, language: str) -> None:
        self._capture = capture
        super().__init__(capture, StartOptions(language=language))

    def now_ns(self) -> int:
        """The time of the feed."""
        return self._capture.now_ns


@cache
def rows(frames: int) -> Rows:
    """The bytes of this many simulated frames."""
    framer, found = Framer(PORT, DEFAULT_BAUD), list[Rows]()
    for timed in Simulation(parse_parameters(f"{QUERY}&frames={frames}")):
        framer.push(Chunk(PORT, START_NS + timed.t_ns, timed.data))
        found.append(framer.drain())
    return Rows.concat([*found, framer.finish()])


async def idle(app: SniffApp) -> None:
    """Let the screen work and draw until it waits for a key, a timer or a thread.

    `Pilot.pause` sends each widget a message, and then waits until the processor seems idle.
    """
    ready: Sized = asyncio.get_running_loop()._ready  # type: ignore[attr-defined]
    async with asyncio.timeout(IDLE_WITHIN_S):
        while True:
            await asyncio.sleep(0)
            if not ready and app.screen_stack:
                app.screen._on_timer_update()
            if not ready:
                return


async def _screenshot(picture: Picture, capture: SimulatedFeed) -> str:
    app = PictureApp(capture, picture.language)
    async with app.run_test(size=picture.size) as pilot:
        for poll in range(POLLS + MORE_POLLS):
            capture.advance()
            app.tick()
            await _caught_up(app)
            if poll % POLLS_PER_DRAWING == 0 or poll >= POLLS:
                await idle(app)
            if poll == POLLS // 2:
                for keys in picture.keys:
                    await pilot.press(*(keys[1:-1] if keys.startswith("'") else [keys]))
                    await app.typed.done()
        return await _settled(app, pilot, picture.shows)


async def _caught_up(app: PictureApp) -> None:
    """Let a search for findings end, whatever time it takes."""
    searches = [worker for worker in app.workers if worker.group == "findings"]
    if searches:
        await app.workers.wait_for_complete(searches)


async def _settled(app: PictureApp, pilot: Pilot[None], shows: str) -> str:
    """The screen once it shows a text and changes no more."""
    before, wanted = "", shows.replace(" ", "&#160;")
    for _ in range(MOST_ROUNDS):
        await pilot.pause(0.02)
        app.show_all()
        now = app.export_screenshot(title=f"fte-sniff live {PORT}")
        if now == before and wanted in now:
            return in_cells(now)
        before = now
    raise SystemExit(f"the screen never showed {shows!r}")


def in_cells(picture: str) -> str:
    """The picture with wide characters in two cells.

    Rich places the start of a text at its cell, but gives each character the width of one.
    """
    return _TEXT.sub(_runs, picture)


def _runs(text: re.Match[str]) -> str:
    content = unescape(text["content"])
    if cell_len(content) == len(content):
        return text[0]
    cell = float(text["length"]) / len(content)
    runs, x = [], float(text["x"])
    for run in _RUNS.findall(content):
        length = cell * cell_len(run)
        shown = escape(run).replace(" ", "&#160;").replace("\xa0", "&#160;")
        runs.append(
            f'<text{text["before"]}x="{x:g}"{text["between"]}textLength="{length:g}"'
            f"{text['after']}>{shown}</text>"
        )
        x += length
    return "".join(runs)


def drawn(name: str) -> str:
    """Make the picture of that name, as SVG."""
    picture = PICTURES[name]
    kept = dict(os.environ)
    with tempfile.TemporaryDirectory() as empty:
        # Without the settings and the language of the user.
        os.environ |= {"XDG_CONFIG_HOME": empty, "XDG_CACHE_HOME": empty, "LC_ALL": "C.UTF-8"}
        os.environ |= {"TERM": "xterm-256color", "COLORTERM": "truecolor"}
        os.environ.pop("NO_COLOR", None)
        os.environ |= picture.environment or {}
        try:
            return asyncio.run(_screenshot(picture, SimulatedFeed(rows(picture.frames))))
        finally:
            os.environ.clear()
            os.environ.update(kept)


if __name__ == "__main__":
    status.INFO_S = 3600.0  # a slow machine draws the same
    FOLDER.mkdir(exist_ok=True)
    for each in sys.argv[1:] or PICTURES:
        (FOLDER / f"{each}.svg").write_text(drawn(each), encoding="utf-8")
