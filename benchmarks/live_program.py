"""The real program with its screen in a terminal, and the resources of its processes."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import signal
import struct
import sys
import termios
import threading
import time
from dataclasses import dataclass
from pathlib import Path

SIZE = (60, 200)
"""Lines and columns of the screen."""

_BEGUN = (b"LIVE", b"capturing ")
"""What shows that a capture runs: on the screen, and in the first line of `--headless`."""
_BOUND_S = 60.0
_TICKS = os.sysconf("SC_CLK_TCK")
_KEYS = (b"\x1b[6~", b"\x1b[5~", b"g", b"G", b"j", b"k", b" ", b" ")
"""What busy fingers press: pages down and up, the top, the newest, pause and on."""


@dataclass(frozen=True, slots=True)
class Taken:
    """What a process has taken so far."""

    cpu_s: float
    rss_mb: float


class LiveProgram:
    """`fte-sniff ...` on a screen of its own, drawn and thrown away."""

    def __init__(self, arguments: list[str], folder: Path) -> None:
        """Start it, and wait until it shows that it captures."""
        self.pid, self._screen = pty.fork()
        if self.pid == 0:
            os.chdir(folder)
            command = [sys.executable, "-m", "fte_sniff", *arguments]
            root = str(Path(__file__).parents[1])
            os.execve(
                command[0], command, {**os.environ, "TERM": "xterm-256color", "PYTHONPATH": root}
            )
        fcntl.ioctl(self._screen, termios.TIOCSWINSZ, struct.pack("HHHH", *SIZE, 0, 0))
        self.drawn = 0
        self._shown = b""
        self._busy = False
        self._live = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        if not self._live.wait(_BOUND_S):
            raise RuntimeError(f"it does not start: {self._shown!r}")
        self.capture_pid = max(_children(self.pid), key=lambda pid: taken(pid).rss_mb)

    def keep_busy(self) -> None:
        """Press keys from now on, fifty a second."""
        self._busy = True

    def end(self) -> None:
        """Leave the screen, and wait until the program has ended."""
        self._busy = False
        os.kill(self.pid, signal.SIGTERM)
        os.waitpid(self.pid, 0)
        self._thread.join(_BOUND_S)
        os.close(self._screen)

    def _run(self) -> None:
        pressed = 0
        while True:
            if select.select([self._screen], [], [], 0.02)[0]:
                try:
                    drawn = os.read(self._screen, 1 << 16)
                except OSError:
                    return
                self.drawn += len(drawn)
                self._shown += drawn
                if any(one in self._shown for one in _BEGUN):
                    self._live.set()
                self._shown = self._shown[-4096:]
            if self._busy and time.monotonic() > pressed / 50:
                pressed = int(time.monotonic() * 50) + 1
                os.write(self._screen, _KEYS[pressed % len(_KEYS)])


def taken(pid: int) -> Taken:
    """What a process has taken so far, by /proc."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    cpu_s = (int(fields[11]) + int(fields[12])) / _TICKS
    return Taken(cpu_s, int(fields[21]) * os.sysconf("SC_PAGE_SIZE") / 1e6)


def _children(pid: int) -> list[int]:
    tasks = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(child) for task in tasks for child in task.read_text().split()]
