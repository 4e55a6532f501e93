"""Owns when the screen looks at its feed: by the clock, when woken, and not while keys come.

It must not know Textual, nor what a look brings.
"""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic_ns
from typing import Final

from fte_sniff.analysis.feed import Feed, RestingFeed, WakingFeed
from fte_sniff.tui.waking import Waking

TICK_S: Final = 1 / 20
"""Between two looks at the feed that the clock brings about: often enough, and yet calm."""

KEYS_NS: Final = 250_000_000
"""How long a file's rows, and the models, wait after a key: reading takes time from those keys."""


class Rhythm:
    """When a look at one feed is due."""

    def __init__(self, feed: Feed) -> None:
        """Nothing wakes the screen yet, and no key has come."""
        self._feed = feed
        self._waking: Waking | None = None
        self._woken = False
        self._key_at_ns = monotonic_ns() - KEYS_NS

    def listen(self, wake: Callable[[], object]) -> None:
        """Call back when the feed has something; to be called where an event loop runs."""
        if isinstance(self._feed, WakingFeed):
            self._waking = Waking(self._feed.descriptor, wake)

    def end(self) -> None:
        """Let the feed wake nobody any more; may be called again."""
        if self._waking is not None:
            self._waking.end()
            self._waking = None

    def woken(self) -> None:
        """The feed makes the screen look."""
        self._woken = True

    def strike(self) -> bool:
        """The clock strikes: whether to look, as the feed has not woken since it last did."""
        woken, self._woken = self._woken, False
        return not woken

    def key(self) -> None:
        """A key comes, and the rows of a file wait for it."""
        self._key_at_ns = monotonic_ns()
        if isinstance(self._feed, RestingFeed):
            self._feed.rest()

    @property
    def keys_come(self) -> bool:
        """Whether a key came just now."""
        return monotonic_ns() - self._key_at_ns < KEYS_NS
