"""Frame pacer: at most one frame is on its way to the terminal, so that the latest one wins."""

from __future__ import annotations

from asyncio import AbstractEventLoop, TimerHandle
from collections.abc import Callable
from contextlib import suppress
from threading import Condition
from typing import Final

QUERY: Final = "\x1b[5n"
"""Device status report: the terminal answers it after all that was written before."""

ANSWER: Final = "\x1b[0n"

PATIENCE_S: Final = 2.0
"""How long a frame waits for the answer to the one before, seconds."""

FIRST_PATIENCE_S: Final = 0.2
"""As `PATIENCE_S`, until the terminal has answered for the first time."""

MOST_SILENT: Final = 5
"""Queries without an answer after which the terminal is not asked any more."""


class FramePacer:
    """Lets a frame through if the terminal has drawn the one before.

    On a slow link a queue of frames shows old rows, and a key takes effect behind them. So a frame
    that comes too early is not written; when the terminal is ready, the screen is drawn as it is
    then. A terminal that has never answered is always ready.

    `answered` and `idle` may be called from any thread, the others from that of the event loop.
    """

    def __init__(self, loop: AbstractEventLoop, redraw: Callable[[], object]) -> None:
        """A pacer that calls `redraw` in the loop after frames that were not written."""
        self._loop, self._redraw = loop, redraw
        self._changed = Condition()
        self._write: Callable[[str], object] = lambda text: None
        self._is_busy: Callable[[], bool] = lambda: False
        self._asked = self._silent = 0
        self._knows_answers = self._waiting = self._late = False
        self._timer: TimerHandle | None = None

    def start(self, write: Callable[[str], object], is_busy: Callable[[], bool]) -> None:
        """Begin with a terminal: how to write to it, and whether output waits for it."""
        with self._changed:
            self._write, self._is_busy = write, is_busy
            self._asked, self._waiting, self._late = 0, False, False

    def begins(self) -> bool:
        """Whether a frame may be written now; if not, the screen is drawn again later."""
        with self._changed:
            is_early = self._knows_answers and (self._waiting or self._is_busy())
            self._late |= is_early
            return not is_early

    def ended(self) -> None:
        """Ask the terminal, since a frame was written."""
        if self._silent >= MOST_SILENT:
            return
        with self._changed:
            self._asked += 1
            self._waiting = True
        self._write(QUERY)
        if self._timer is not None:
            self._timer.cancel()
        patience_s = PATIENCE_S if self._knows_answers else FIRST_PATIENCE_S
        self._timer = self._loop.call_later(patience_s, self._give_up)

    def answered(self, count: int = 1) -> None:
        """Note answers of the terminal."""
        with self._changed:
            self._asked = max(0, self._asked - count)
            self._waiting &= self._asked > 0
            self._silent, self._knows_answers = 0, True
            self._changed.notify_all()
        self.idle()

    def idle(self) -> None:
        """Draw the screen if a frame was not written and the terminal is ready now."""
        with self._changed:
            if not self._late or self._waiting or self._is_busy():
                return
            self._late = False
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(self._redraw)

    def _give_up(self) -> None:
        with self._changed:
            if not self._waiting:
                return
            self._waiting = False
            self._silent += 1
        self.idle()

    @property
    def expects_answer(self) -> bool:
        """Whether an answer of the terminal is still to come."""
        return self._asked > 0

    def end(self, cleared: str, timeout_s: float) -> None:
        """Wait for the last answers, which the shell must not get.

        `cleared` is output that was not written; its queries are not answered.
        """
        if self._timer is not None:
            self._timer.cancel()
        with self._changed:
            self._asked -= cleared.count(QUERY)
            if self._knows_answers:
                self._changed.wait_for(lambda: self._asked <= 0, timeout_s)
            self._asked, self._waiting = 0, False
