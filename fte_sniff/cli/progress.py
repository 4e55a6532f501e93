"""Progress of reading files, as a line on standard error while it takes long.

The line appears after `PATIENCE_S`, and only on a terminal. It is a single line without cursor
movement, so that a program that is killed leaves the terminal as it was.
"""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from threading import Event, Lock, Thread
from time import monotonic
from typing import Final, TextIO

from fte_sniff.cli.streams import abandon
from fte_sniff.errors import printable
from fte_sniff.session.inputs import Progress

PATIENCE_S: Final = 2.0
"""How long reading, or a terminal without a new row, is silent before the line appears."""

_INTERVAL_S: Final = 0.2
_LONGEST_WAIT_S: Final = 1.0
"""How long a terminal that takes nothing may delay the end."""

_USUAL_COLUMNS: Final = 80

_ERASE: Final = "\r\x1b[K"


class ProgressLine:
    """Shows a `Progress` while it takes long; rows that go to the same terminal hide it."""

    def __init__(self, progress: Progress, *, shown: bool) -> None:
        """Show nothing yet, and nothing at all without `shown`."""
        self.progress = progress
        self._lock, self._ended = Lock(), Event()
        self._start = self._quiet_since = monotonic()
        self._is_drawn = False
        self._thread = Thread(target=self._run, name="shows progress", daemon=True)
        if shown:
            self._thread.start()

    @contextmanager
    def hidden_by_stdout(self) -> Iterator[None]:
        """Context that hides the line while rows are written to a terminal, or to a pipe.

        A pipe may lead to a pager, which has the terminal for itself.
        """
        if not self._thread.is_alive() or _is_file(sys.stdout):
            yield
            return
        with self._lock:
            self._erase()
            yield
            self._quiet_since = monotonic()

    def _erase(self) -> None:
        if self._is_drawn:
            self._is_drawn = False
            _write(_ERASE)

    def end(self) -> None:
        """Erase the line for good."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join(_LONGEST_WAIT_S)
        if not self._thread.is_alive():
            self._erase()

    def _run(self) -> None:
        wait_s = PATIENCE_S
        while not self._ended.wait(wait_s):
            wait_s = _INTERVAL_S
            with self._lock:
                if monotonic() - self._quiet_since >= PATIENCE_S and not self._ended.is_set():
                    self._is_drawn = True
                    text = progress_text(self.progress, monotonic() - self._start)
                    _write(f"{_ERASE}{text[: _columns() - 1]}")


@contextmanager
def progress_line(*, reads_stdin: bool = False) -> Iterator[ProgressLine]:
    """Context that shows a new `Progress` while the commands in it read files.

    It shows nothing unless standard error is a terminal, or if the user types what is read.
    """
    typed = reads_stdin and sys.stdin.isatty()
    line = ProgressLine(Progress(), shown=sys.stderr.isatty() and not typed)
    try:
        yield line
    finally:
        line.end()


def _is_file(stream: TextIO) -> bool:
    try:
        return stat.S_ISREG(os.fstat(stream.fileno()).st_mode)
    except OSError:  # it is closed
        return True


def _write(text: str) -> None:
    try:
        sys.stderr.write(text)
        sys.stderr.flush()
    except OSError:
        abandon(sys.stderr.fileno())


def _columns() -> int:
    """The columns of the terminal."""
    try:
        return os.get_terminal_size(sys.stderr.fileno()).columns or _USUAL_COLUMNS
    except OSError:
        return _USUAL_COLUMNS


def progress_text(progress: Progress, seconds: float) -> str:
    """The line after some seconds: `file 3 of 12  40%  1,200 rows, 120 rows/s  0:00:15 left`."""
    parts, share = [_description(progress)], 0.0
    if progress.size and not progress.step:
        share = min(1.0, progress.position / progress.size)
        parts.append(f"{share:.0%}")
    if progress.rows:
        parts.append(f"{progress.rows:,} rows, {progress.rows / seconds:,.0f} rows/s")
    if share >= 0.001:  # before that, the speed is not known
        parts.append(f"{timedelta(seconds=round(seconds / share - seconds))} left")
    return "  ".join(parts)


def _description(progress: Progress) -> str:
    if progress.step or not progress.files:
        return printable(progress.step or "reading")
    if progress.files == 1:
        return "reading"
    return f"file {min(progress.files_done + 1, progress.files):,} of {progress.files:,}"
