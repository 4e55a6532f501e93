"""Terminal driver: output that never blocks, one frame at a time, job control, lost terminals."""

from __future__ import annotations

import os
import select
import selectors
import signal
import sys
from asyncio import AbstractEventLoop, TimerHandle
from codecs import getincrementaldecoder
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from enum import Enum, auto
from functools import partial
from threading import Condition, Thread
from typing import Any, Final, cast

from textual._xterm_parser import XTermParser
from textual.app import App
from textual.drivers.linux_driver import LinuxDriver

QUERY: Final = "\x1b[5n"
"""Device status report: the terminal answers it after all that was written before."""

ANSWER: Final = "\x1b[0n"

PATIENCE_S: Final = 2.0
"""How long a frame waits for the answer to the one before, seconds."""

FIRST_PATIENCE_S: Final = 0.2
"""As `PATIENCE_S`, until the terminal has answered for the first time."""

MOST_SILENT: Final = 5
"""Queries without an answer after which the terminal is not asked any more."""


class FramePacer:
    """Lets a frame through if the terminal has drawn the one before.

    On a slow link a queue of frames shows old rows, and a key takes effect behind them. So a frame
    that comes too early is not written; when the terminal is ready, the screen is drawn as it is
    then. A terminal that has never answered is always ready.

    `answered` and `idle` may be called from any thread, the others from that of the event loop.
    """

    def __init__(self, loop: AbstractEventLoop, redraw: Callable[[], object]) -> None:
        """A pacer that calls `redraw` in the loop after frames that were not written."""
        self._loop, self._redraw = loop, redraw
        self._changed = Condition()
        self._write: Callable[[str], object] = lambda text: None
        self._is_busy: Callable[[], bool] = lambda: False
        self._asked = self._silent = 0
        self._knows_answers = self._waiting = self._late = False
        self._timer: TimerHandle | None = None

    def start(self, write: Callable[[str], object], is_busy: Callable[[], bool]) -> None:
        """Begin with a terminal: how to write to it, and whether output waits for it."""
        with self._changed:
            self._write, self._is_busy = write, is_busy
            self._asked, self._waiting, self._late = 0, False, False

    def begins(self) -> bool:
        """Whether a frame may be written now; if not, the screen is drawn again later."""
        with self._changed:
            is_early = self._knows_answers and (self._waiting or self._is_busy())
            self._late |= is_early
            return not is_early

    def ended(self) -> None:
        """Ask the terminal, since a frame was written."""
        if self._silent >= MOST_SILENT:
            return
        with self._changed:
            self._asked += 1
            self._waiting = True
        self._write(QUERY)
        if self._timer is not None:
            self._timer.cancel()
        patience_s = PATIENCE_S if self._knows_answers else FIRST_PATIENCE_S
        self._timer = self._loop.call_later(patience_s, self._give_up)

    def answered(self, count: int = 1) -> None:
        """Note answers of the terminal."""
        with self._changed:
            self._asked = max(0, self._asked - count)
            self._waiting &= self._asked > 0
            self._silent, self._knows_answers = 0, True
            self._changed.notify_all()
        self.idle()

    def idle(self) -> None:
        """Draw the screen if a frame was not written and the terminal is ready now."""
        with self._changed:
            if not self._late or self._waiting or self._is_busy():
                return
            self._late = False
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(self._redraw)

    def _give_up(self) -> None:
        with self._changed:
            if not self._waiting:
                return
            self._waiting = False
            self._silent += 1
        self.idle()

    @property
    def expects_answer(self) -> bool:
        """Whether an answer of the terminal is still to come."""
        return self._asked > 0

    def end(self, cleared: str, timeout_s: float) -> None:
        """Wait for the last answers, which the shell must not get.

        `cleared` is output that was not written; its queries are not answered.
        """
        if self._timer is not None:
            self._timer.cancel()
        with self._changed:
            self._asked -= cleared.count(QUERY)
            if self._knows_answers:
                self._changed.wait_for(lambda: self._asked <= 0, timeout_s)
            self._asked, self._waiting = 0, False


class AsyncTerminalWriter:
    """File object that writes to the terminal in a thread, for Textual."""

    def __init__(
        self,
        descriptor: int,
        encoding: str,
        on_gone: Callable[[], None],
        on_idle: Callable[[], None],
    ) -> None:
        """Start the thread.

        Args:
            descriptor: the terminal's, open for writing; blocking or not.
            encoding: the terminal's; other characters are written with backslashes.
            on_gone: called once, in the thread, when writing fails.
            on_idle: called in the thread when all is written.
        """
        self._descriptor, self._encoding = descriptor, encoding
        self._on_gone, self._on_idle = on_gone, on_idle
        self._texts: deque[str] = deque()
        self._writes = self._closed = False
        self._changed = Condition()
        # A write to a stopped terminal cannot be cancelled; it must not block the exit.
        Thread(target=self._run, name="terminal output", daemon=True).start()

    def write(self, text: str) -> int:
        """Queue text; never blocks."""
        with self._changed:
            if not self._closed:
                self._texts.append(text)
                self._changed.notify_all()
        return len(text)

    @property
    def busy(self) -> bool:
        """Whether text waits until the terminal accepts it."""
        return self._writes or bool(self._texts)

    def flush(self) -> None:
        """Do nothing: the thread writes as soon as it can."""

    def fileno(self) -> int:
        """File descriptor of the terminal."""
        return self._descriptor

    def clear(self) -> str:
        """Drop the queue, but not a partly written text; returns what was dropped."""
        with self._changed:
            dropped = "".join(self._texts)
            self._texts.clear()
        return dropped

    def close(self, timeout_s: float) -> None:
        """Accept no more text, and wait until the queue is written or the time is over."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
            self._changed.wait_for(lambda: not self.busy, timeout_s)

    def _run(self) -> None:
        try:
            while (text := self._next()) is not None:
                self._write_all(text.encode(self._encoding, "backslashreplace"))
                with self._changed:
                    self._writes = False
                    self._changed.notify_all()
                if not self.busy:
                    self._on_idle()
        except OSError:
            with self._changed:
                self._closed, self._writes = True, False
                self._texts.clear()
                self._changed.notify_all()
            self._on_gone()

    def _next(self) -> str | None:
        with self._changed:
            self._changed.wait_for(lambda: self._texts or self._closed)
            self._writes = bool(self._texts)
            return self._texts.popleft() if self._texts else None

    def _write_all(self, data: bytes) -> None:
        while data:
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:
                # Another program has set the shared terminal to non-blocking.
                select.select([], [self._descriptor], [])


CLOSE_TIMEOUT_S = 2.0
"""How long closing waits for the terminal to accept the rest, seconds."""

ANSWER_TIMEOUT_S = 1.0
"""How long the end waits for answers of the terminal, seconds."""

_RESUME_DELAY_S = 0.1
"""How long other signals that came during a stop are handled first, seconds."""

_POLL_S = 0.1
"""How often the input thread checks whether it has to end, seconds."""

_END_SYNC = "\x1b[?2026l"
"""End of synchronized output, for a start whose end was dropped."""


class _State(Enum):
    OFF = auto()
    ON = auto()
    SUSPENDED = auto()
    """The shell, until this program is in the foreground again."""


class Terminal(LinuxDriver):
    """Textual's driver, for terminals that stop, disappear and come back.

    It writes to standard output, which the command line has checked to be a terminal.
    """

    def __init__(self, app: App[object], **options: Any) -> None:
        """`options` are those of Textual's driver."""
        super().__init__(app, **options)
        self._state = _State.OFF
        self._gone = False
        self._output: AsyncTerminalWriter | None = None
        self._held = ""
        """The end of the input, which may be the beginning of an answer."""
        self._pacer = FramePacer(self._loop, app.refresh)
        cast(Any, app).pacer = self._pacer
        self._handle_job_control()

    def write(self, data: str) -> None:
        """Write, while the screen has the terminal."""
        if self._writer_thread is not None:
            super().write(data)

    def start_application_mode(self) -> None:
        """Set the terminal up; in the background, stop first until `fg`."""
        if self._is_background():
            self._state = _State.SUSPENDED
            self._stop_job()
            return
        self._state = _State.ON
        assert sys.__stdout__ is not None
        self._output = AsyncTerminalWriter(
            sys.__stdout__.fileno(), sys.__stdout__.encoding, self._on_gone, self._pacer.idle
        )
        output = self._output
        self._file = cast(Any, output)
        self._pacer.start(self.write, lambda: output.busy)
        super().start_application_mode()  # type: ignore[no-untyped-call]
        # Restoring the terminal in the background would otherwise stop the program at its end.
        signal.signal(signal.SIGTTOU, signal.SIG_IGN)
        if self._key_thread is None or not self._key_thread.is_alive():
            self._on_gone()

    def stop_application_mode(self) -> None:
        """Restore the terminal, where the shell does not have it already."""
        if self._state is not _State.ON:
            return
        self._state = _State.OFF
        assert self._output is not None
        cleared = self._output.clear()
        if cleared:
            self.write(_END_SYNC)
        if self._is_background():
            self.attrs_before = None
        elif not self._gone:
            self._pacer.end(cleared, ANSWER_TIMEOUT_S)
        super().stop_application_mode()

    def close(self) -> None:
        """Wait until the terminal has accepted the output, for `CLOSE_TIMEOUT_S` at most."""
        super().close()
        self._writer_thread = None
        if self._output is not None:
            self._output.close(CLOSE_TIMEOUT_S)
            self._output = None

    def run_input_thread(self) -> None:
        """Read keys until the exit event is set, or the terminal is gone."""
        parser = XTermParser(self._debug)
        decode = getincrementaldecoder("utf-8")(errors="replace").decode
        with selectors.SelectSelector() as selector:
            selector.register(self.fileno, selectors.EVENT_READ)
            while not self.exit_event.is_set():
                if selector.select(_POLL_S):
                    data = self._read()
                    if not data:
                        self._on_gone()
                        return
                    text = self._without_answers(decode(data))
                else:
                    text, self._held = self._held, ""
                for message in (*(parser.feed(text) if text else ()), *parser.tick()):
                    self.process_message(message)

    def _without_answers(self, text: str) -> str:
        """The input without the answers to the pacer's queries; its end may be held."""
        parts = (self._held + text).split(ANSWER)
        if len(parts) > 1:
            self._pacer.answered(len(parts) - 1)
        rest, self._held = "".join(parts), ""
        for size in range(len(ANSWER) - 1, 0, -1) if self._pacer.expects_answer else ():
            if rest.endswith(ANSWER[:size]):
                self._held = ANSWER[:size]
                return rest.removesuffix(self._held)
        return rest

    def _read(self) -> bytes:
        try:
            return os.read(self.fileno, 4096)
        except OSError:
            return b""

    def _on_gone(self) -> None:
        """Hang up; may be called from any thread, and repeatedly."""
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(self._hang_up)

    def _hang_up(self) -> None:
        if self._gone or self._state is _State.OFF:
            return
        self._gone = True
        if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
            # nohup is for programs without a screen.
            signal.signal(signal.SIGHUP, signal.SIG_DFL)
        signal.raise_signal(signal.SIGHUP)

    def _handle_job_control(self) -> None:
        # Textual's own handlers may interrupt a write, and then wait for it.
        self._loop.add_signal_handler(signal.SIGTSTP, self._suspend)
        # The shell has used the terminal before SIGCONT.
        self._loop.add_signal_handler(signal.SIGCONT, self._resume_later)

    def _is_background(self) -> bool:
        """Whether another job has the terminal; False without job control."""
        try:
            return os.tcgetpgrp(self.fileno) not in (0, os.getpgrp())
        except OSError:
            return False

    def _suspend(self) -> None:
        if self._state is _State.ON:
            self.suspend_application_mode()
            self._state = _State.SUSPENDED
            self._stop_job()

    def _stop_job(self) -> None:
        """Stop the job as Ctrl-Z does; the system ignores this where nothing could continue it."""
        for number in (signal.SIGTSTP, signal.SIGCONT):
            self._loop.remove_signal_handler(number)
        # The whole job, with a shell script around it; the capture process ignores the signal.
        os.killpg(os.getpgrp(), signal.SIGTSTP)
        self._handle_job_control()
        self._resume_later()

    def _resume_later(self) -> None:
        # `kill` of a stopped job sends SIGTERM and SIGCONT. SIGTERM comes first, also if the pause
        # is over at the same time: else the program would stop again, and not end.
        resume = partial(self._loop.call_later, 0, self._loop.call_soon, self._resume)
        self._loop.call_later(_RESUME_DELAY_S, resume)

    def _resume(self) -> None:
        if self._state is _State.OFF or self._app._exit:
            return
        if self._is_background():
            self._stop_job()
            return
        if self._state is _State.ON:
            self.suspend_application_mode()
        self.start_application_mode()
        self._app.refresh(layout=True)
