"""Standard streams and signals: closed pipes, blocked output, Ctrl-C, SIGTERM and SIGHUP."""

from __future__ import annotations

import atexit
import io
import mmap
import os
import select
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

import click

from fte_sniff.errors import FileError, printable, reason_of
from fte_sniff.i18n import translated
from fte_sniff.platform import ENDING_SIGNALS, HANG_UP, POSIX

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer as Buffer


_LEAST_MEMORY = 400 << 20
_LEAST_MEMORY_PER_CORE = 40 << 20
"""For a buffer and the stack of a thread."""

EXIT_INTERRUPTED = 130
"""The exit code after Ctrl-C, except for commands that normally end that way."""


NOT_BEGUN = "interrupted before the capture began; nothing was recorded"
"""The line of a capture whose end was requested before its ports were open; it exits with 0."""

STDOUT = "standard output"
"""The file name of errors of standard output."""


class _Output(io.FileIO):
    """Standard output, whose errors name it, so that they differ from those of files."""

    def write(self, data: Buffer, /) -> int:
        """Write; raises BrokenPipeError without a reader, and FileError."""
        try:
            return super().write(data)
        except BrokenPipeError:
            raise
        except OSError as error:  # not every command has `-o`
            raise FileError(
                f"{STDOUT} cannot be written: {reason_of(error)}; redirect it to another place"
            ) from error


def prepare_streams() -> None:
    """Make the standard streams usable even if some were closed at start."""
    for descriptor, flags in enumerate((os.O_RDONLY, os.O_RDONLY, os.O_WRONLY)):
        try:
            os.fstat(descriptor)
        except OSError:
            # Otherwise the next file would get this descriptor. Writing to standard output fails.
            os.open(os.devnull, flags)
    sys.stdin = sys.stdin or open(0, encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stdout = sys.stdout or open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stderr = sys.stderr or open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    if POSIX and isinstance(sys.stdout, io.TextIOWrapper):  # a console of Windows is not a file
        sys.stdout = io.TextIOWrapper(
            io.BufferedWriter(_Output(sys.stdout.fileno(), "w", closefd=False)),
            encoding=sys.stdout.encoding,
            errors="backslashreplace",
            line_buffering=sys.stdout.line_buffering,
            write_through=sys.stdout.write_through,
        )


def check_memory() -> None:
    """Raise OSError if the limit of memory is so low that libraries end the program themselves.

    OpenBLAS, which numpy loads, then exits with code 1, which means that `check` says no. Only
    addresses are tried, no memory is used.
    """
    if sys.platform != "win32":
        size = _LEAST_MEMORY + (os.cpu_count() or 1) * _LEAST_MEMORY_PER_CORE
        mmap.mmap(-1, size, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS, prot=0).close()


def abandon_stdout() -> None:
    """Discard what is still buffered for standard output, so that exit stays quiet."""
    abandon(sys.stdout.fileno())


def abandon(descriptor: int) -> None:
    """Redirect a descriptor to /dev/null; a write that blocks on it ends."""
    with suppress(OSError):  # too many files are open
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, descriptor)
        os.close(nowhere)


def print_err(line: str) -> None:
    """Print one line on standard error, translated; if that fails, drop it and all later ones."""
    try:
        click.echo(printable(translated(line)), err=True)
    except OSError:
        abandon(sys.stderr.fileno())


def abandon_blocked() -> None:
    """Abandon standard output and standard error if a write to them would block.

    Call it from a signal handler: the interrupted write is retried and goes to /dev/null.
    """
    stdout, stderr = 1, 2
    _, ready, _ = select.select([], [stdout, stderr], [], 0)
    for descriptor in {stdout, stderr}.difference(ready):
        abandon(descriptor)
    if stdout not in ready:
        with suppress(OSError):
            os.write(stderr, b"nothing reads the output; the rest of it is not printed\n")


OUTPUT_PATIENCE_S = 3.0
"""Seconds that a blocked output may delay the exit."""

_REPEAT_S = 1.0


@contextmanager
def interruptible(numbers: Sequence[signal.Signals] = (signal.SIGINT,)) -> Iterator[None]:
    """Context in which the first of some signals raises KeyboardInterrupt, to remove partial files.

    Other signals than SIGINT then end the program as they do without this context. A second signal,
    which may be the bounce of a key, does nothing; a third one ends the program at once and
    silently. A signal that has a handler, or is ignored, is left alone.
    """
    own = [one for one in numbers if signal.getsignal(one) is signal.SIG_DFL]
    received = list[int]()

    def interrupt(number: int, _frame: object) -> None:
        received.append(number)
        if len(received) == 1:
            raise KeyboardInterrupt
        signal.signal(number, signal.SIG_DFL)

    for one in own:
        signal.signal(one, interrupt)
    try:
        yield
    finally:
        for one in own:
            if signal.getsignal(one) is interrupt:
                signal.signal(one, signal.SIG_DFL)
        if received and received[0] != signal.SIGINT:
            os.kill(os.getpid(), received[0])


@contextmanager
def ending_signals(
    stop: Callable[[], None],
    numbers: Sequence[signal.Signals] = ENDING_SIGNALS,
) -> Iterator[Callable[[], None]]:
    """Context in which Ctrl-C, SIGTERM and a closed terminal request a clean end.

    Each signal calls `stop`, which must be safe in a signal handler. After the first one nothing
    may block the end: `OUTPUT_PATIENCE_S` later blocked outputs are abandoned, and signals after
    this context are ignored. The context's value is called where the end comes without a signal. A
    SIGHUP that is ignored, as with nohup, stays ignored.
    """
    requested = False

    def begin_end() -> None:
        nonlocal requested
        if POSIX and not requested:
            signal.signal(signal.SIGALRM, lambda *_: abandon_blocked())
            signal.setitimer(signal.ITIMER_REAL, OUTPUT_PATIENCE_S, _REPEAT_S)
            # During interpreter shutdown no Python handler runs; SIGALRM would kill.
            atexit.register(signal.setitimer, signal.ITIMER_REAL, 0)
        requested = True

    def on_signal(*_: object) -> None:
        begin_end()
        stop()

    ignored = [number for number in HANG_UP if signal.getsignal(number) is signal.SIG_IGN]
    before = {one: signal.signal(one, on_signal) for one in numbers if one not in ignored}
    try:
        yield begin_end
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_IGN if requested else handler)
