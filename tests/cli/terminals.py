"""The program in a terminal, for tests to type, look, resize, and pull the terminal away."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import signal
import struct
import subprocess
import termios
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from itertools import cycle
from pathlib import Path
from time import monotonic

from tests.cli.processes import BOUND_S, PROGRAM


class Terminal:
    """The program in a terminal of a given size, and all it has drawn so far."""

    def __init__(self, far: int, process: subprocess.Popen[bytes]) -> None:
        self.process = process
        self._far = far
        self.drawn = b""

    @property
    def attributes(self) -> list[object]:
        """What `stty` would say."""
        return termios.tcgetattr(self._far)

    def resize(self, columns: int, lines: int) -> None:
        fcntl.ioctl(self._far, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))

    @property
    def open(self) -> bool:
        return self._far >= 0

    def close(self) -> None:
        """Pull it away."""
        os.close(self._far)
        self._far = -1

    def type(self, keys: str) -> None:
        os.write(self._far, keys.encode())

    def until(self, wanted: str) -> None:
        """Wait until something is drawn."""
        start, deadline = len(self.drawn), monotonic() + BOUND_S
        while wanted.encode() not in self.drawn[start:]:
            assert self._draw(deadline - monotonic()), self.drawn[-2000:]

    def ended_by(self, *keys: str) -> int:
        """Type these in turn, each behind what the one before has drawn, until the program ends."""
        deadline = monotonic() + BOUND_S
        with suppress(OSError):  # it may end before what is typed
            for again in cycle(keys):
                if self.process.poll() is not None or monotonic() > deadline:
                    break
                self.type(again)
                self._draw(1)
        return self.ended()

    def ended(self) -> int:
        """Wait for the end; the exit code."""
        deadline = monotonic() + BOUND_S
        while self._draw(deadline - monotonic()):
            pass
        return self.process.wait(BOUND_S)

    def _draw(self, timeout_s: float) -> bool:
        if timeout_s <= 0 or not select.select([self._far], [], [], timeout_s)[0]:
            return False
        try:
            more = os.read(self._far, 1 << 16)
        except OSError:  # the terminal's other side is closed: the program has ended
            return False
        self.drawn += more
        return bool(more)


def ruling() -> None:
    """Make the terminal rule the program's session: it then tells of Ctrl-Z, and of its own end."""
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


def silent() -> None:
    """Leave the terminal one that tells nothing: its end shows when it is read or written."""


@contextmanager
def terminal(
    environment: dict[str, str],
    folder: Path,
    *arguments: str,
    size: tuple[int, int] = (80, 24),
    manner: Callable[[], None] = silent,
    program: Sequence[str] = PROGRAM,
    errors: Path | None = None,
) -> Iterator[Terminal]:
    """The program in a terminal, but for its standard error where that goes to a file."""
    far, near = pty.openpty()
    fcntl.ioctl(near, termios.TIOCSWINSZ, struct.pack("HHHH", size[1], size[0], 0, 0))
    with (
        nullcontext(near) if errors is None else errors.open("wb") as told,
        subprocess.Popen(
            [*program, *arguments],
            stdin=near,
            stdout=near,
            stderr=told,
            env=environment,
            cwd=folder,
            start_new_session=True,
            preexec_fn=manner,
        ) as process,
    ):
        os.close(near)
        screen = Terminal(far, process)
        try:
            yield screen
        finally:
            for left in in_session(process.pid):
                with suppress(ProcessLookupError):
                    os.kill(left, signal.SIGKILL)
            if screen.open:
                screen.close()


def in_session(leader: int) -> list[int]:
    """The processes of a session."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        pid = int(folder.name)
        with suppress(ProcessLookupError):
            if os.getsid(pid) == leader and not is_dead(folder):
                found.append(pid)
    return found


def is_dead(process: Path) -> bool:
    """Whether all that is left of a process is its exit code."""
    try:
        return (process / "stat").read_text().rpartition(")")[2].split()[0] in "ZX"
    except OSError:
        return True
