"""One frame at a time on its way to the terminal."""

from __future__ import annotations

import asyncio
import os
from threading import Event

import pytest

from fte_sniff.tui import terminal
from fte_sniff.tui.terminal import MOST_SILENT, QUERY, AsyncTerminalWriter, FramePacer
from tests.waiting import BOUND_S, while_waiting


class Drawn:
    """A pacer, what is written, and how often the screen is drawn again."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.written: list[str] = []
        self.busy = False
        self.redrawn = 0
        self.pacer = FramePacer(loop, self._redraw)
        self.pacer.start(self.written.append, lambda: self.busy)

    def _redraw(self) -> None:
        self.redrawn += 1

    def frame(self) -> bool:
        begins = self.pacer.begins()
        if begins:
            self.written.append("frame")
            self.pacer.ended()
        return begins

    async def redrawn_until(self, count: int) -> None:
        for _ in while_waiting(lambda: f"{count} drawings, not {self.redrawn}"):
            if self.redrawn == count:
                return
            await asyncio.sleep(0)


def test_frame_waits_until_the_terminal_has_drawn_the_one_before() -> None:
    async def scenario() -> None:
        drawn = Drawn(asyncio.get_running_loop())
        assert drawn.frame()
        drawn.pacer.answered()
        assert drawn.frame()
        assert not drawn.frame()
        assert not drawn.frame()
        assert drawn.redrawn == 0
        drawn.pacer.answered()
        await drawn.redrawn_until(1)
        assert drawn.frame()
        assert drawn.written == ["frame", QUERY] * 3

    asyncio.run(scenario())


def test_frame_waits_while_output_does() -> None:
    async def scenario() -> None:
        drawn = Drawn(asyncio.get_running_loop())
        drawn.pacer.answered()
        drawn.busy = True
        assert not drawn.frame()
        drawn.pacer.idle()
        drawn.busy = False
        await asyncio.sleep(0)
        assert drawn.redrawn == 0
        drawn.pacer.idle()
        await drawn.redrawn_until(1)
        assert drawn.frame()

    asyncio.run(scenario())


def test_terminal_that_never_answers_is_asked_a_few_times(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(terminal, "FIRST_PATIENCE_S", 0)

    async def scenario() -> None:
        drawn = Drawn(asyncio.get_running_loop())
        for _ in while_waiting(lambda: "the last query"):
            asked = drawn.written.count(QUERY)
            assert drawn.frame()
            if drawn.written.count(QUERY) == asked:
                break
            await asyncio.sleep(0.01)
        assert drawn.redrawn == 0
        assert drawn.written.count(QUERY) >= MOST_SILENT

    asyncio.run(scenario())


def test_a_terminal_that_is_gone_takes_no_more_text() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    gone = Event()
    output = AsyncTerminalWriter(writer, "utf-8", gone.set, gone.clear)
    output.write("first")
    assert gone.wait(BOUND_S)
    output.write("second")
    assert not output.busy
    output.close(BOUND_S)
    os.close(writer)
