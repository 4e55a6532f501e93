"""The screen without a terminal: keys in, what is on it out. Scripts are in `screens/*.md`.

    ## Every damaged row is found

    ```screen
    $ fte-sniff view damaged.mcap
    > e
    see truncated | 55 01 02 00
    > f 'motor = 1' enter
    not motor=2
    ```

`first` is a command that runs before; `$` is that of the screen, in a folder with the samples and
`rows.raw`, 1,000 speed commands whose RPM is their number; `size 120x40` sets another size than
80x24. `>` presses keys at once, as typed ahead: their names in Textual, `3*down`, and 'text' that
is typed.
`see` waits until texts are on the screen, `not` until they are not; `send` writes hex bytes to the
socket that the command opens as PORT, and `hang up` closes it.
"""

from __future__ import annotations

import asyncio
import os
import re
import shlex
import socket
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from textual import events
from textual._compositor import LayoutUpdate
from textual.app import App
from textual.pilot import Pilot

from tests.beside import Work, server_socket
from tests.console import NEEDS, copy_samples
from tests.in_process import exit_code, place, streams
from tests.waiting import BOUND_S

KEYS = {
    " ": "space",
    ":": "colon",
    "?": "question_mark",
    "=": "equals_sign",
    "/": "slash",
    "'": "apostrophe",
    "#": "number_sign",
    "<": "less_than_sign",
    ">": "greater_than_sign",
    "[": "left_square_bracket",
    "]": "right_square_bracket",
}
"""Names of keys that are not what they type."""
TYPED = {name: character for character, name in KEYS.items()}
STEP_S = 0.02


@dataclass
class Script:
    """A command that shows a screen, and steps on it."""

    name: str
    command: str = ""
    first: str = ""
    size: tuple[int, int] = (80, 24)
    steps: list[tuple[str, str]] = field(default_factory=list)
    needs: tuple[str, ...] = ()


def scripts_of(path: Path) -> Iterator[Script]:
    """The scripts of a file."""
    text = path.read_text("utf-8")
    needed = NEEDS.search(text)
    for part in text.split("\n## ")[1:]:
        name, _, rest = part.partition("\n")
        script = Script(name, needs=tuple(needed[1].split()) if needed else ())
        for line in re.findall(r"```screen\n(.*?)```", rest, re.DOTALL)[0].splitlines():
            word, _, words = line.partition(" ")
            if word == "$":
                script.command = words
            elif word == "first":
                script.first = words
            elif word == "size":
                columns, lines = map(int, words.split("x"))
                script.size = columns, lines
            else:
                script.steps.append((word, words))
        yield script


def keys_of(text: str) -> Iterator[str]:
    """The keys of a line."""
    for typed, count, key in re.findall(r"'([^']*)'|(?:(\d+)\*)?(\S+)", text):
        yield from (KEYS.get(one, one) for one in typed)
        yield from [key] * (int(count or 1) if key else 0)


def play(script: Script, folder: Path, environment: Mapping[str, str]) -> None:
    """Run the command of a script in this process, and the steps on its screen.

    Raises:
        AssertionError: The screen is not as expected, or the command has failed.
    """
    copy_samples(folder)
    (folder / "rows.raw").write_bytes(b"".join(map(_speed_frame, range(1000))))
    with ExitStack() as stack:
        peer = stack.enter_context(_Peer())
        words = [word.replace("PORT", peer.address) for word in shlex.split(script.command)[1:]]
        errors: list[BaseException] = []
        stack.enter_context(_screens(script, peer, errors))
        terminal = stack.enter_context(_terminal())
        with streams([terminal.near] * 3), place(folder, environment):
            assert not script.first or exit_code(shlex.split(script.first)[1:]) == 0
            code = exit_code(words)
    if errors:
        raise errors[0]
    assert code == 0, f"{script.command} ends with {code}: {terminal.drawn!r}"


def _speed_frame(number: int) -> bytes:
    return b"\xaa\x01" + bytes([1 + number % 4]) + number.to_bytes(2) + bytes(4) + b"\xee"


@contextmanager
def _screens(script: Script, peer: _Peer, errors: list[BaseException]) -> Iterator[None]:
    """Screens have no terminal, and do the steps."""
    run = App.run

    async def steps(pilot: Pilot[Any]) -> None:
        try:
            for word, words in script.steps:
                await _step(pilot, peer, word, words)
        except Exception as error:
            errors.append(error)
            raise
        finally:
            pilot.app.exit()

    def without_terminal(app: App[Any], **options: Any) -> object:
        return run(app, **{**options, "headless": True, "size": script.size, "auto_pilot": steps})

    App.run = without_terminal  # type: ignore[method-assign, assignment]
    try:
        yield
    finally:
        App.run = run  # type: ignore[method-assign]


async def _step(pilot: Pilot[Any], peer: _Peer, word: str, words: str) -> None:
    app = pilot.app
    match word:
        case ">":
            for key in keys_of(words):
                app.post_message(events.Key(key, TYPED.get(key, key if len(key) == 1 else None)))
            await pilot.pause()
        case "see":
            await _until(pilot, words, lambda page: all(one in page for one in words.split(" | ")))
        case "not":
            await _until(
                pilot, words, lambda page: not any(one in page for one in words.split(" | "))
            )
        case "hang":
            await asyncio.to_thread(peer.hang_up)
        case "send":
            await asyncio.to_thread(peer.send, bytes.fromhex(words))
        case _:
            raise AssertionError(f"{word!r} is not a step")


async def _until(pilot: Pilot[Any], waited_for: str, holds: Callable[[str], bool]) -> None:
    with suppress(TimeoutError):
        async with asyncio.timeout(BOUND_S):
            while not holds(page_of(pilot.app)):
                await pilot.pause(STEP_S)
    page = page_of(pilot.app)
    assert holds(page), f"waited for {waited_for!r}:\n{page}"


def page_of(app: App[Any]) -> str:
    """What is on the screen, line by line."""
    update = app.screen._compositor.render_update(full=True, screen_stack=app._background_screens)
    assert isinstance(update, LayoutUpdate)
    parts = ([part.text for strip in line for part in strip] for line in update.strips)
    return "\n".join("".join(texts).rstrip() for texts in parts)


class _Peer:
    """A server of this machine, to which the command may connect: `socket://`."""

    def __enter__(self) -> _Peer:
        self._server = server_socket()
        self._peer: socket.socket | None = None
        self.address = "socket://{}:{}".format(*self._server.getsockname())
        return self

    def __exit__(self, *_: object) -> None:
        for one in (self._server, self._peer):
            if one is not None:
                one.close()

    def send(self, data: bytes) -> None:
        """Bytes to the program."""
        if self._peer is None:
            self._peer, _ = self._server.accept()
        self._peer.sendall(data)

    def hang_up(self) -> None:
        """Close the connection; the next bytes go to the next one."""
        if self._peer is not None:
            self._peer.close()
            self._peer = None


@dataclass
class _Terminal:
    near: int
    drawn: bytes = b""


@contextmanager
def _terminal() -> Iterator[_Terminal]:
    """A terminal that the program asks whether it is one; what it writes there is read."""
    far, near = os.openpty()
    terminal = _Terminal(near)

    def read() -> None:
        with suppress(OSError):  # its other side is closed
            while more := os.read(far, 1 << 16):
                terminal.drawn += more

    work = Work(read)
    try:
        yield terminal
    finally:
        os.close(near)
        work.ended()
        os.close(far)
