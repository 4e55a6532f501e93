"""Owns text on its way to a terminal that may be slow, stuck or gone.

It must not know what is drawn. Whoever writes never waits: a thread does. What a terminal cannot
take in time is dropped, and told, so that the whole screen can be drawn anew.
"""

from __future__ import annotations

import os
import select
from collections import deque
from collections.abc import Callable
from threading import Condition, Thread

MOST_WAITING = 256 * 1024
"""Characters that wait at most: some screens full. What is older than that nobody wants to see."""


class Outflow:
    """A file to write to, as Textual wants one, between a screen and its terminal."""

    def __init__(
        self, descriptor: int, encoding: str, gone: Callable[[], None], torn: Callable[[], None]
    ) -> None:
        """An outflow that has begun.

        Args:
            descriptor: the terminal's, open for writing; blocking or not.
            encoding: the terminal's; what it lacks is written with backslashes.
            gone: called once, from a thread, when the terminal refuses to be written to.
            torn: called from a thread when the terminal has caught up, after text was dropped.
        """
        self._descriptor, self._encoding = descriptor, encoding
        self._tell_gone, self._tell_torn = gone, torn
        self._texts: deque[str] = deque()
        self._waiting = 0
        self._busy = self._torn = self._closed = False
        self._changed = Condition()
        # A write that waits for a stuck terminal cannot be ended; it must not hold up the program.
        Thread(target=self._run, name="terminal output", daemon=True).start()

    def write(self, text: str) -> int:
        """Take text, or drop it where too much waits; returns at once."""
        with self._changed:
            if self._waiting > MOST_WAITING:
                self._torn = True
            if not (self._torn or self._closed):
                self._texts.append(text)
                self._waiting += len(text)
                self._changed.notify_all()
        return len(text)

    def flush(self) -> None:
        """Nothing: all goes on as soon as it can."""

    def fileno(self) -> int:
        """The terminal's descriptor."""
        return self._descriptor

    def forget(self) -> bool:
        """Drop what waits, but for a text that is half written; whether there was something."""
        with self._changed:
            dropped = self._torn or bool(self._texts)
            self._texts.clear()
            self._waiting, self._torn = 0, False
        return dropped

    def close(self, within_s: float) -> None:
        """Take no more, and wait until all is written, but no longer than some seconds."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
            self._changed.wait_for(lambda: not (self._texts or self._busy), within_s)

    def _run(self) -> None:
        try:
            while (text := self._next()) is not None:
                self._put(text.encode(self._encoding, "backslashreplace"))
        except OSError:
            with self._changed:
                self._closed, self._busy = True, False
                self._texts.clear()
                self._changed.notify_all()
            self._tell_gone()

    def _next(self) -> str | None:
        """What is to be written next, once there is something; None at the end."""
        with self._changed:
            self._busy = False
            self._changed.notify_all()
            if self._torn and not self._texts:
                self._torn = False
                self._tell_torn()
            self._changed.wait_for(lambda: self._texts or self._closed)
            if not self._texts:
                return None
            text = self._texts.popleft()
            self._waiting -= len(text)
            self._busy = True
            return text

    def _put(self, data: bytes) -> None:
        while data:
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:
                # Some other program has set the terminal, which all share, to nonblocking.
                select.select([], [self._descriptor], [])
