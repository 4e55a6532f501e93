"""The screen on a pseudo-terminal: how it ends, by keys and by signals."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pytest

BOUND_S = 60.0
PROGRAM = """
from fte_sniff.analysis.feed import FeedState, FeedUpdate
from fte_sniff.tui.app import run_screen

class Idle:
    def poll(self):
        return FeedUpdate(FeedState("idle wire"))
    def stop(self):
        open({stopped!r}, "w").close()

run_screen(Idle())
print("the program goes on")
"""
ALTERNATE_SCREEN, NORMAL_SCREEN = b"\x1b[?1049h", b"\x1b[?1049l"


def take_terminal() -> None:
    """Make stdin the terminal that rules the session, so that its end is told by SIGHUP."""
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


class Terminal:
    """A program on a pseudo-terminal."""

    def __init__(self, program: str, asked: Mapping[str, str]) -> None:
        self.master, slave = pty.openpty()
        environment = {**os.environ, "TERM": "xterm-256color", "COLUMNS": "80", "LINES": "24"}
        environment.pop("NO_COLOR", None)
        environment |= asked
        self.process = subprocess.Popen(
            [sys.executable, "-c", program],
            stdin=slave,
            stdout=slave,
            stderr=slave,
            env=environment,
            start_new_session=True,
            preexec_fn=take_terminal,
        )
        os.close(slave)
        self.seen = b""

    def wait_for(self, words: bytes) -> None:
        """Read until the words came."""
        ends = time.monotonic() + BOUND_S
        while words not in self.seen:
            left = ends - time.monotonic()
            assert left > 0, self.seen[-2000:]
            if select.select([self.master], [], [], left)[0]:
                self.seen += self._read()

    def _read(self) -> bytes:
        try:
            return os.read(self.master, 65536)
        except OSError:
            # Linux says so where the last program has left the terminal.
            pytest.fail(f"the program ended: {self.seen[-2000:]!r}")


@contextmanager
def terminal(program: str, asked: Mapping[str, str]) -> Iterator[Terminal]:
    """The program on a terminal, with these variables in its environment."""
    here = Terminal(program, asked)
    try:
        yield here
    finally:
        here.process.kill()
        here.process.wait()
        os.close(here.master)


@pytest.mark.parametrize(
    "way", [b"q", b"\x11", b"\x03", signal.SIGTERM, signal.SIGHUP, signal.SIGINT]
)
def test_the_terminal_is_left_as_it_was(tmp_path: Path, way: bytes | signal.Signals) -> None:
    stopped = tmp_path / "stopped"
    with terminal(PROGRAM.format(stopped=str(stopped)), {}) as here:
        here.wait_for(ALTERNATE_SCREEN)
        here.wait_for(b"idle wire")
        here.wait_for(b"Quit")
        if isinstance(way, bytes):
            os.write(here.master, way)
        else:
            here.process.send_signal(way)
        here.wait_for(b"the program goes on")
        assert here.process.wait(BOUND_S) == 0
        assert here.seen.index(NORMAL_SCREEN) < here.seen.index(b"the program goes on")
        assert b"Traceback" not in here.seen
    assert stopped.exists()


COLOUR = re.compile(rb"\x1b\[(?:[0-9:;]*[;:])?(?:[34][0-8]|9[0-7]|10[0-7])[;:m]")


@pytest.mark.parametrize("asked", [{}, {"NO_COLOR": "1"}])
def test_no_colour_is_sent_where_none_is_wanted(tmp_path: Path, asked: dict[str, str]) -> None:
    program = PROGRAM.format(stopped=str(tmp_path / "stopped"))
    with terminal(program, asked) as here:
        here.wait_for(b"Quit")
        os.write(here.master, b"fmotr")
        here.wait_for("✗".encode())
        os.write(here.master, b"\x15\r?")
        here.wait_for(b"Keys and signs")
        os.write(here.master, b"qq")
        here.wait_for(b"the program goes on")
        assert bool(COLOUR.search(here.seen)) == (not asked)
        assert re.search(rb"\x1b\[[17][;m]", here.seen)


def test_it_ends_where_the_terminal_goes_away(tmp_path: Path) -> None:
    stopped = tmp_path / "stopped"
    here = Terminal(PROGRAM.format(stopped=str(stopped)), {})
    try:
        here.wait_for(b"Quit")
        os.close(here.master)
        here.process.wait(BOUND_S)
    finally:
        here.process.kill()
        here.process.wait()
    assert stopped.exists()
