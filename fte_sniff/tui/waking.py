"""Owns being woken by a feed that has something: at once after a rest, and never without one.

It must not know what is done then, nor what came. Where rows would wait for a clock of the screen
after the one that batches them, they would be late for nothing.

    feed        x           x x x x x x x x x
    wakes       x           x     x     x     x
                            |-----| REST_S
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Final

REST_S: Final = 1 / 25
"""Between two wakes at least, seconds: less than a live feed leaves between two batches."""


class Waking:
    """Calls back whenever a descriptor can be read from."""

    def __init__(self, descriptor: int, wake: Callable[[], object]) -> None:
        """Begin; to be called where an event loop runs, which calls `wake`."""
        self._descriptor, self._wake = descriptor, wake
        self._loop = asyncio.get_running_loop()
        self._rest: asyncio.TimerHandle | None = None
        self._listen()

    def end(self) -> None:
        """Wake nobody any more; may be called again."""
        self._loop.remove_reader(self._descriptor)
        if self._rest is not None:
            self._rest.cancel()

    def _listen(self) -> None:
        self._loop.add_reader(self._descriptor, self._woken)

    def _woken(self) -> None:
        # It stays readable until it is read, and that the feed does in its own time.
        self._loop.remove_reader(self._descriptor)
        self._rest = self._loop.call_later(REST_S, self._listen)
        self._wake()
