"""Keys act in the order in which they come, however fast they come.

Textual sends a key to the widget that has the focus, each widget has a queue of messages, and what
a key causes may be in several of them when the next key comes: keys that are typed ahead could
overtake each other. So a key waits until all that the key before it caused is done. Any sequence of
keys does what it does when it is typed slowly.
"""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Final

from textual.app import App
from textual.events import Key
from textual.message import Message
from textual.message_pump import MessagePump

PATIENCE_S: Final = 1.0
"""How long a key waits at most, seconds: a widget that is removed never answers."""

_ROUNDS: Final = 8


class Turn(Message, bubble=False):
    """A key whose turn it is."""

    def __init__(self, key: Key) -> None:
        super().__init__()
        self.key = key


class TypedKeys:
    """The keys that wait for their turn."""

    def __init__(self, app: App[None]) -> None:
        self._app = app
        self._waiting = deque[Key]()
        self._task: asyncio.Task[None] | None = None
        self.began = False
        """Whether a key came."""

    def put(self, key: Key) -> None:
        """Let a key wait."""
        self._waiting.append(key)
        self.began = True
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._run())

    async def done(self) -> None:
        """Wait until all keys have acted."""
        if self._task is not None:
            await self._task

    async def _run(self) -> None:
        while self._waiting and self._app.is_running:
            with self._app.batch_update():  # all that a key changes is drawn together
                self._app.post_message(Turn(self._waiting.popleft()))
                await self.quiet()
            await self.quiet()

    async def quiet(self) -> None:
        """Wait until no widget that a key can reach has anything to do, and the screen is drawn."""
        for _round in range(_ROUNDS):
            await _reached(self._app)
            screen = self._app.screen
            for node in (*_chain(self._app), *screen.walk_children(), self._app):
                if node.message_queue_size:
                    await _reached(node)
            await _answered(screen.call_after_refresh)
            if self._app.screen is screen and not _is_busy(self._app):
                break


def _chain(app: App[None]) -> list[MessagePump]:
    """The widgets to which a key goes, one after the other."""
    widget = app.focused
    return [] if widget is None else [*widget.ancestors_with_self]


def _is_busy(app: App[None]) -> bool:
    nodes = (app, app.screen, *app.screen.walk_children())
    own = [one for one in app.workers if one.node is app.screen and one.is_running]
    return bool(own) or any(node.message_queue_size for node in nodes)


async def _reached(node: MessagePump) -> None:
    """Wait until a widget has handled the messages that it has."""
    await _answered(node.call_later)


async def _answered(schedule: object) -> None:
    done = asyncio.Event()
    assert callable(schedule)
    if schedule(done.set):
        try:
            async with asyncio.timeout(PATIENCE_S):
                await done.wait()
        except TimeoutError:
            return
