"""Textual's driver for Linux and macOS, adapted: standard output, lost and slow terminals.

This is the only module that uses what Textual does not document.
"""

from __future__ import annotations

import os
import re
import select
import signal
import sys
from asyncio import get_running_loop
from contextlib import suppress
from functools import lru_cache
from time import monotonic
from typing import Any, Final, TextIO, cast

from textual.app import App
from textual.drivers.linux_driver import LinuxDriver

CLOSE_WITHIN_S: Final = 2.0
"""How long the end waits for a terminal that accepts nothing, seconds."""


_STYLE: Final = re.compile(r"(\x1b\[0m(?:\n|\x1b\[\d+;\d+H)*)?\x1b\[([1-9][\d;]*)m( +(?=\x1b))?")
"""The end of a style and moves of the cursor, the next style, and blanks that are all of it."""

_PART: Final = re.compile(r"[34]8;(?:2(?:;\d+){3}|5;\d+)|\d+")
"""A colour, or an attribute."""

_ON_BLANKS: Final = {"4", "7", "9", "21", "53"}
"""The attributes that blanks show: lines, and reversed colours."""


def condensed(frame: str) -> str:
    """The frame without what a style has in common with the style before it.

    Each style ends with one reset, as rich writes it, and the frame begins outside of a style.
    """
    style = ""

    def change(found: re.Match[str]) -> str:
        nonlocal style
        moves, after, blanks = (one or "" for one in found.groups())
        changed, style = _change(style if moves else "", after, is_blank=bool(blanks))
        return f"{moves[4:]}{changed}{blanks}"

    return _STYLE.sub(change, frame)


@lru_cache(1 << 12)
def _change(before: str, after: str, *, is_blank: bool) -> tuple[str, str]:
    """What changes one style into another, and what it then is; blanks need only their ground."""
    old, new = ({one[:2]: one for one in _PART.findall(style)} for style in (before, after))
    if is_blank and "48" in new and not _ON_BLANKS & (old.keys() | new.keys()):
        new = old | {"48": new["48"]}
    style = ";".join(new.values())
    if not old.keys() <= new.keys():
        return f"\x1b[0;{style}m", style  # an attribute ends
    parts = [one for one in new.values() if one not in old.values()]
    return f"\x1b[{';'.join(parts)}m" if parts else "", style


class TimedOutput:
    """A text file for a terminal that knows how long its last write took.

    It writes past Python's buffers: a thread that is stuck there would hold up the exit.
    """

    def __init__(self, file: TextIO) -> None:
        """Write to a terminal; what its encoding lacks is written as `?`."""
        self._descriptor, self._encoding = file.fileno(), file.encoding
        self._texts: list[str] = []
        self._began_s: float | None = None
        self._ready_s = 0.0

    def write(self, text: str) -> int:
        """Add a text to the frame."""
        self._texts.append(text)
        return len(text)

    def flush(self) -> None:
        """Write the frame; may block."""
        data = condensed("".join(self._texts)).encode(self._encoding, "replace")
        self._texts.clear()
        self._began_s = began_s = monotonic()
        while data:
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:  # another program has set the shared terminal to that
                select.select([], [self._descriptor], [])
            except OSError:  # gone
                break
        now_s = monotonic()
        self._ready_s = now_s + now_s - began_s
        self._began_s = None

    def fileno(self) -> int:
        """The file descriptor."""
        return self._descriptor

    @property
    def is_slow(self) -> bool:
        """Whether a frame is being written, or the last one ended less long ago than it took."""
        return self._began_s is not None or monotonic() < self._ready_s

    @property
    def is_gone(self) -> bool:
        """Whether the terminal was closed."""
        asked = select.poll()
        asked.register(self._descriptor, 0)
        return any(found & select.POLLHUP for _, found in asked.poll(0))


class Terminal(LinuxDriver):
    """Writes to standard output, and ends the screen when the terminal is gone."""

    def __init__(self, app: App[object], **options: Any) -> None:
        """`options` are those of Textual's driver."""
        super().__init__(app, **options)
        assert sys.__stdout__ is not None
        self.output = TimedOutput(sys.__stdout__)
        self._file = cast(Any, self.output)
        self._hung_up = self._is_continued = False
        self._terminate: Any = signal.getsignal(signal.SIGTERM)

    def start_application_mode(self) -> None:
        """Take the terminal; what is written does not wait for it."""
        start: Any = super().start_application_mode
        start()
        if self._writer_thread is not None:
            self._writer_thread._queue.maxsize = 0

    def run_input_thread(self) -> None:
        """Read keys until the exit event is set, or the terminal is gone."""
        with suppress(OSError):
            super().run_input_thread()
        if not self.exit_event.is_set():
            self.hang_up()

    def _sigtstp_application(self, *_: object) -> None:
        """Stop when the loop is free: a signal may come while a queue of this thread is locked."""
        self._is_continued = False
        get_running_loop().call_soon_threadsafe(self._stop)

    def _stop(self) -> None:
        """Give the terminal to the shell, and stop; go on at once where no shell could continue it.

        The system ignores SIGTSTP there, but not the SIGSTOP of Textual's driver.
        """
        if self._is_continued:  # while the loop was busy
            return
        self._lend()
        own = signal.signal(signal.SIGTSTP, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGTSTP)
        signal.signal(signal.SIGTSTP, own)
        if not self._is_continued:
            self._take_back()

    def _sigcont_application(self, *_: object) -> None:
        """Take the terminal back, also after a stop that did not give it to the shell."""
        self._is_continued = True
        get_running_loop().call_soon_threadsafe(self._take_back)

    def _take_back(self) -> None:
        if not self._must_signal_resume:
            self._lend()
        super()._sigcont_application()  # in the background this stops again
        signal.signal(signal.SIGTERM, self._terminate)

    def _lend(self) -> None:
        """Give the terminal to the shell; SIGTERM, as `kill` sends it, now ends at once.

        A clean end would draw, and the system stops who draws without the terminal. The capture
        closes its file when this process is gone.
        """
        self.suspend_application_mode()
        self._must_signal_resume = True
        self._terminate = signal.signal(signal.SIGTERM, signal.SIG_DFL)

    def hang_up(self) -> None:
        """End as a controlling terminal ends its programs when it is closed, once."""
        if not self._hung_up:
            self._hung_up = True
            os.kill(os.getpid(), signal.SIGHUP)

    def close(self) -> None:
        """Wait until the terminal has accepted the rest, but not forever."""
        writer = self._writer_thread
        if writer is not None:
            writer._queue.put(None)
            writer.join(CLOSE_WITHIN_S)
