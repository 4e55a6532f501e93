"""The program in a terminal: tests type, read the screen, resize and close the terminal."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import signal
import struct
import termios
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from threading import Event
from time import monotonic

from tests.beside import Work, running, state_of
from tests.cli.processes import BOUND_S, Process
from tests.cli.program import Program


class Terminal:
    """The program in a terminal, and everything it has drawn so far."""

    def __init__(self, far: int, process: Process, attributes: list[object]) -> None:
        """`attributes` are those from before the program, as `termios.tcgetattr` returns them."""
        self.process = process
        self._far, self._attributes = far, attributes
        self.drawn = b""

    @property
    def is_as_it_was(self) -> bool:
        """Whether the terminal has the settings from before the program."""
        return termios.tcgetattr(self._far) == self._attributes

    def resize(self, columns: int, lines: int) -> None:
        fcntl.ioctl(self._far, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))

    @property
    def open(self) -> bool:
        return self._far >= 0

    def close(self) -> None:
        """Close the terminal's other side, as a terminal window that is closed."""
        os.close(self._far)
        self._far = -1

    def type(self, keys: str) -> None:
        os.write(self._far, keys.encode())

    def until(self, *wanted: str) -> None:
        """Wait until the program draws all of `wanted`, in any order.

        What it drew before does not count, also with what an earlier `until` waited for: name all
        that is drawn at one event.
        """
        start, deadline = len(self.drawn), monotonic() + BOUND_S
        while not all(text.encode() in self.drawn[start:] for text in wanted):
            drawn = self._draw(deadline - monotonic())
            assert drawn, f"waited for {wanted} after {self.drawn[-2000:]!r}"

    def ended(self) -> int:
        """Wait for the end; returns the exit code."""
        deadline = monotonic() + BOUND_S
        while self._draw(deadline - monotonic()):
            pass
        return self.process.wait(BOUND_S)

    def draw(self, most: int) -> bool:
        """Draw at most so many bytes of what the program has written."""
        return self._draw(BOUND_S, most)

    @contextmanager
    def drawing(self) -> Iterator[None]:
        """Draw in another thread: a program whose terminal is full waits for it."""
        stop = Event()

        def draw() -> None:
            while not stop.is_set():
                self._draw(0.05)

        work = Work(draw)
        try:
            yield
        finally:
            stop.set()
            work.ended()

    def _draw(self, timeout_s: float, most: int = 1 << 16) -> bool:
        if timeout_s <= 0 or not select.select([self._far], [], [], timeout_s)[0]:
            return False
        try:
            more = os.read(self._far, most)
        except OSError:  # the terminal's other side is closed: the program has ended
            return False
        self.drawn += more
        return bool(more)


def controlling_terminal() -> None:
    """Make it the controlling terminal: it then sends SIGTSTP on Ctrl-Z and SIGHUP when closed."""
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


def plain_terminal() -> None:
    """Leave it a terminal that sends no signals: only reads and writes fail when it is closed."""


@contextmanager
def terminal(
    environment: dict[str, str],
    folder: Path,
    *arguments: str,
    size: tuple[int, int] = (80, 24),
    session: Callable[[], None] = plain_terminal,
    program: Sequence[str] | None = None,
    errors: Path | None = None,
) -> Iterator[Terminal]:
    """The program, or another one, in a terminal.

    Its standard error is in the terminal too, or in the file `errors`.
    """
    far, near = pty.openpty()
    fcntl.ioctl(near, termios.TIOCSWINSZ, struct.pack("HHHH", size[1], size[0], 0, 0))
    attributes = termios.tcgetattr(near)
    command = [*program, *arguments] if program else Program().command(arguments)
    with ExitStack() as stack:
        opened = near if errors is None else stack.enter_context(errors.open("wb")).fileno()
        process: Process = stack.enter_context(
            running(
                command,
                stdin=near,
                stdout=near,
                stderr=opened,
                env=environment,
                cwd=folder,
                start_new_session=True,
                preexec_fn=session,
            )
        )
        os.close(near)
        screen = Terminal(far, process, attributes)
        try:
            yield screen
        finally:
            for left in in_session(process.pid):
                with suppress(ProcessLookupError):
                    os.kill(left, signal.SIGKILL)
            if screen.open:
                screen.close()


def in_session(leader: int) -> list[int]:
    """Ids of the running processes of a session."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        pid = int(folder.name)
        with suppress(ProcessLookupError):
            if os.getsid(pid) == leader and state_of(pid) not in "ZX":
                found.append(pid)
    return found
