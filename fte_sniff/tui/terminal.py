"""Terminal ownership and asynchronous output."""

from __future__ import annotations

import os
import select
import selectors
import signal
import sys
from codecs import getincrementaldecoder
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from enum import Enum, auto
from threading import Condition, Thread
from typing import Any, cast

from textual._xterm_parser import XTermParser
from textual.app import App
from textual.drivers.linux_driver import LinuxDriver

MOST_WAITING = 256 * 1024
"""Characters that wait at most: some screens full. What is older than that nobody wants to see."""


class AsyncTerminalWriter:
    """A file to write to, as Textual wants one, between a screen and its terminal."""

    def __init__(
        self, descriptor: int, encoding: str, gone: Callable[[], None], torn: Callable[[], None]
    ) -> None:
        """An outflow that has begun.

        Args:
            descriptor: the terminal's, open for writing; blocking or not.
            encoding: the terminal's; what it lacks is written with backslashes.
            gone: called once, from a thread, when the terminal refuses to be written to.
            torn: called from a thread when the terminal has caught up, after text was dropped.
        """
        self._descriptor, self._encoding = descriptor, encoding
        self._tell_gone, self._tell_torn = gone, torn
        self._texts: deque[str] = deque()
        self._waiting = 0
        self._busy = self._torn = self._closed = False
        self._changed = Condition()
        # A write that waits for a stuck terminal cannot be ended; it must not hold up the program.
        Thread(target=self._run, name="terminal output", daemon=True).start()

    def write(self, text: str) -> int:
        """Take text, or drop it where too much waits; returns at once."""
        with self._changed:
            if self._waiting > MOST_WAITING:
                self._torn = True
            if not (self._torn or self._closed):
                self._texts.append(text)
                self._waiting += len(text)
                self._changed.notify_all()
        return len(text)

    def flush(self) -> None:
        """Nothing: all goes on as soon as it can."""

    def fileno(self) -> int:
        """The terminal's descriptor."""
        return self._descriptor

    def forget(self) -> bool:
        """Drop what waits, but for a text that is half written; whether there was something."""
        with self._changed:
            dropped = self._torn or bool(self._texts)
            self._texts.clear()
            self._waiting, self._torn = 0, False
        return dropped

    def close(self, within_s: float) -> None:
        """Take no more, and wait until all is written, but no longer than some seconds."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
            self._changed.wait_for(lambda: not (self._texts or self._busy), within_s)

    def _run(self) -> None:
        try:
            while (text := self._next()) is not None:
                self._put(text.encode(self._encoding, "backslashreplace"))
        except OSError:
            with self._changed:
                self._closed, self._busy = True, False
                self._texts.clear()
                self._changed.notify_all()
            self._tell_gone()

    def _next(self) -> str | None:
        """What is to be written next, once there is something; None at the end."""
        with self._changed:
            self._busy = False
            self._changed.notify_all()
            if self._torn and not self._texts:
                self._torn = False
                self._tell_torn()
            self._changed.wait_for(lambda: self._texts or self._closed)
            if not self._texts:
                return None
            text = self._texts.popleft()
            self._waiting -= len(text)
            self._busy = True
            return text

    def _put(self, data: bytes) -> None:
        while data:
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:
                # Some other program has set the terminal, which all share, to nonblocking.
                select.select([], [self._descriptor], [])


PATIENCE_S = 2.0
"""How long what the terminal is still to take may hold up leaving it, seconds."""

_SETTLE_S = 0.1
"""How long other signals that came during a stop have to be obeyed first, seconds."""

_LOOK_S = 0.1
"""How often the thread that reads keys thinks of the end, seconds."""

_END_OF_DRAWING = "\x1b[?2026l"
"""Synchronized output ends: its beginning may be written already, its end is dropped."""


class _State(Enum):
    """What the terminal is to the screen."""

    OFF = auto()
    ON = auto()
    SUSPENDED = auto()
    """It belongs to the shell, until this program comes to the foreground again."""


class Terminal(LinuxDriver):
    """Textual's driver, for terminals that stop, go and come back.

    The screen goes to standard output, of which the command line knows that it is a terminal.
    """

    def __init__(
        self,
        app: App[object],
        *,
        debug: bool = False,
        mouse: bool = True,
        size: tuple[int, int] | None = None,
    ) -> None:
        """A terminal that is still left alone; the arguments are Textual's."""
        super().__init__(app, debug=debug, mouse=mouse, size=size)
        self._state = _State.OFF
        self._gone = False
        self._outflow: AsyncTerminalWriter | None = None
        self._obey_job_control()

    def write(self, data: str) -> None:
        """Draw, where the terminal is ours."""
        if self._writer_thread is not None:
            super().write(data)

    def start_application_mode(self) -> None:
        """Take the terminal; waits for the foreground."""
        if self._in_background():
            self._state = _State.SUSPENDED
            self._sleep()
            return
        self._state = _State.ON
        assert sys.__stdout__ is not None
        self._outflow = AsyncTerminalWriter(
            sys.__stdout__.fileno(), sys.__stdout__.encoding, self._lose, self._draw_anew
        )
        self._file = cast(Any, self._outflow)
        super().start_application_mode()  # type: ignore[no-untyped-call]
        # Giving the terminal back in the background would else stop the program, half ended.
        signal.signal(signal.SIGTTOU, signal.SIG_IGN)
        if self._key_thread is None or not self._key_thread.is_alive():
            self._lose()

    def stop_application_mode(self) -> None:
        """Give the terminal back as it was, where it is not the shell's already."""
        if self._state is not _State.ON:
            return
        self._state = _State.OFF
        assert self._outflow is not None
        if self._outflow.forget():
            self.write(_END_OF_DRAWING)
        if self._in_background():
            self.attrs_before = None
        super().stop_application_mode()

    def close(self) -> None:
        """Wait until the terminal has taken what it was sent, but not for ever."""
        super().close()
        self._writer_thread = None
        if self._outflow is not None:
            self._outflow.close(PATIENCE_S)
            self._outflow = None

    def run_input_thread(self) -> None:
        """Read keys until told to end, or until the terminal is gone."""
        parser = XTermParser(self._debug)
        decode = getincrementaldecoder("utf-8")(errors="replace").decode
        with selectors.SelectSelector() as selector:
            selector.register(self.fileno, selectors.EVENT_READ)
            while not self.exit_event.is_set():
                if selector.select(_LOOK_S):
                    data = self._read()
                    if not data:
                        self._lose()
                        return
                    for message in parser.feed(decode(data)):
                        self.process_message(message)
                for message in parser.tick():
                    self.process_message(message)

    def _read(self) -> bytes:
        try:
            return os.read(self.fileno, 4096)
        except OSError:
            return b""

    def _lose(self) -> None:
        """The terminal is gone; may be called from any thread, and repeatedly."""
        with suppress(RuntimeError):  # the loop has ended already
            self._loop.call_soon_threadsafe(self._hang_up)

    def _hang_up(self) -> None:
        if self._gone or self._state is _State.OFF:
            return
        self._gone = True
        if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
            # Whoever wants a program to outlive its terminal cannot mean the screen on it.
            signal.signal(signal.SIGHUP, signal.SIG_DFL)
        signal.raise_signal(signal.SIGHUP)

    def _draw_anew(self) -> None:
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._app.refresh)

    def _obey_job_control(self) -> None:
        # Textual's own handlers run amid anything, also amid a write, and then wait for it.
        self._loop.add_signal_handler(signal.SIGTSTP, self._suspend)
        self._loop.add_signal_handler(signal.SIGCONT, self._come_back)

    def _in_background(self) -> bool:
        """Whether the terminal is another job's; where it rules no jobs, it is ours."""
        try:
            return os.tcgetpgrp(self.fileno) not in (0, os.getpgrp())
        except OSError:
            return False

    def _suspend(self) -> None:
        if self._state is _State.ON:
            self.suspend_application_mode()
            self._state = _State.SUSPENDED
            self._sleep()

    def _sleep(self) -> None:
        """Stop as Ctrl-Z stops a job; where nobody could continue it, the system does nothing."""
        for number in (signal.SIGTSTP, signal.SIGCONT):
            self._loop.remove_signal_handler(number)
        # All of the job, also a shell script around it; a capture is deaf to this.
        os.killpg(os.getpgrp(), signal.SIGTSTP)
        self._obey_job_control()
        self._loop.call_later(_SETTLE_S, self._resume)

    def _come_back(self) -> None:
        """Something continued the program; whatever stopped it, the shell was here meanwhile."""
        if self._state is not _State.OFF:
            self._loop.call_later(_SETTLE_S, self._resume)

    def _resume(self) -> None:
        if self._state is _State.OFF or self._app._exit:
            return
        if self._in_background():
            self._sleep()
            return
        if self._state is _State.ON:
            self.suspend_application_mode()
        self.start_application_mode()
        self._app.refresh(layout=True)
