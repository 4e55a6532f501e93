"""Textual's driver for Linux and macOS, adapted: standard output, lost and slow terminals.

This is the only module that uses what Textual does not document.
"""

from __future__ import annotations

import io
import sys
from contextlib import suppress
from time import monotonic
from typing import Any, Final, TextIO, cast

from textual.app import App
from textual.drivers.linux_driver import LinuxDriver

CLOSE_WITHIN_S: Final = 2.0
"""How long the end waits for a terminal that accepts nothing, seconds."""


class TimedOutput:
    """A text file that knows how long its last write took."""

    def __init__(self, file: TextIO) -> None:
        """Write to a terminal; what its encoding lacks is written as `?`."""
        if isinstance(file, io.TextIOWrapper):
            file.reconfigure(errors="replace")
        self._file = file
        self._began_s: float | None = None
        self._ready_s = 0.0

    def write(self, text: str) -> int:
        """Write a text; may block."""
        if self._began_s is None:
            self._began_s = monotonic()
        return self._file.write(text)

    def flush(self) -> None:
        """Write the rest: a frame ends."""
        self._file.flush()
        now_s = monotonic()
        if self._began_s is not None:
            self._ready_s = now_s + now_s - self._began_s
        self._began_s = None

    def fileno(self) -> int:
        """The file descriptor."""
        return self._file.fileno()

    @property
    def is_slow(self) -> bool:
        """Whether a frame is being written, or the last one ended less long ago than it took."""
        return self._began_s is not None or monotonic() < self._ready_s


class Terminal(LinuxDriver):
    """Writes to standard output, and ends the screen when the terminal is gone."""

    def __init__(self, app: App[object], **options: Any) -> None:
        """`options` are those of Textual's driver."""
        super().__init__(app, **options)
        assert sys.__stdout__ is not None
        self.output = TimedOutput(sys.__stdout__)
        self._file = cast(Any, self.output)

    def run_input_thread(self) -> None:
        """Read keys until the exit event is set, or the terminal is gone."""
        with suppress(OSError):
            super().run_input_thread()
        if not self.exit_event.is_set():
            self._loop.call_soon_threadsafe(self._app.exit)

    def close(self) -> None:
        """Wait until the terminal has accepted the rest, but not forever."""
        writer = self._writer_thread
        if writer is not None:
            writer._queue.put(None)
            writer.join(CLOSE_WITHIN_S)
