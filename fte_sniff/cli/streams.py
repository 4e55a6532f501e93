"""Signals, stdout, stderr messages."""

from __future__ import annotations

import atexit
import io
import os
import select
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress

import click

from fte_sniff.errors import FileError, printable, reason_of


class ClosedOutput(io.TextIOBase):
    """Stands for a standard output that was closed before the program began."""

    def write(self, text: str, /) -> int:
        """Refuse, in one line."""
        raise FileError("standard output is closed; let it go somewhere, for example > rows.txt")


def settle_streams() -> None:
    """Make the standard streams usable, whatever the program was started with."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            # Taken by nothing, it would be given to the next file that is opened.
            os.open(os.devnull, os.O_RDWR)
    if sys.stdin is None:
        sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115
    if sys.stdout is None:
        sys.stdout = ClosedOutput()
    if sys.stderr is None:
        sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def unwritable_stdout(error: OSError) -> FileError:
    """What to tell the user when standard output takes nothing; not every command has a `-o`."""
    return FileError(
        f"standard output cannot be written: {reason_of(error)}; let it go somewhere else"
    )


def abandon_stdout() -> None:
    """Let what is still buffered for standard output go nowhere, so that the end stays quiet."""
    if not isinstance(sys.stdout, ClosedOutput):
        abandon(sys.stdout.fileno())


def abandon(descriptor: int) -> None:
    """Let all that is and will be written there go nowhere; writes that wait do not wait on."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, descriptor)
    os.close(nowhere)


def tell(line: str) -> None:
    """Say one line on standard error; where that is refused, it and the lines to come are lost."""
    try:
        click.echo(printable(line), err=True)
    except OSError:
        abandon(sys.stderr.fileno())


def abandon_blocked() -> None:
    """Abandon standard output and standard error where a write would wait for their reader.

    To be called from a signal handler: the write that waits is then done over, and goes nowhere.
    """
    stdout, stderr = 1, 2
    if _blocked(stderr):
        abandon(stderr)
    if _blocked(stdout):
        abandon(stdout)
        with suppress(OSError):
            os.write(stderr, b"nobody takes the output; the rest of it is not printed\n")


def _blocked(descriptor: int) -> bool:
    poll = select.poll()
    poll.register(descriptor, select.POLLOUT)
    return not poll.poll(0)


def nobody_reads(descriptor: int) -> bool:
    """Whether a pipe has lost its reader."""
    poll = select.poll()
    poll.register(descriptor, 0)
    return any(event & select.POLLERR for _, event in poll.poll(0))


PATIENCE_S = 3.0
"""How long an output that nobody takes may hold up the end once that was asked for, seconds."""

_AGAIN_S = 1.0
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""The signals that ask for the end, where nobody says otherwise."""


@contextmanager
def interruptible() -> Iterator[None]:
    """While in this context, the first Ctrl-C raises KeyboardInterrupt: what is half made goes.

    Any other ends the program at once and in silence, as it does outside. Where Ctrl-C is ignored
    or somebody else's, it stays so.
    """
    if signal.getsignal(signal.SIGINT) is not signal.SIG_DFL:
        yield
        return

    def hear(*_: object) -> None:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        raise KeyboardInterrupt

    def heed(unraisable: sys.UnraisableHookArgs) -> None:
        # Where nobody can catch it, as when an object goes, it would be printed, and forgotten.
        if isinstance(unraisable.exc_value, KeyboardInterrupt):
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            signal.raise_signal(signal.SIGINT)
        tell_unraisable(unraisable)

    tell_unraisable = sys.unraisablehook
    try:
        sys.unraisablehook = heed
        signal.signal(signal.SIGINT, hear)
        yield
    finally:
        if signal.getsignal(signal.SIGINT) is hear:
            signal.signal(signal.SIGINT, signal.SIG_DFL)
        sys.unraisablehook = tell_unraisable


@contextmanager
def signals_call(
    stop: Callable[[], None],
    numbers: Sequence[signal.Signals] = ENDING,
    hurry: Callable[[], None] | None = None,
) -> Iterator[Callable[[], None]]:
    """While in this context, Ctrl-C, SIGTERM and a closed terminal ask for the end.

    Asking more often is asking once, also behind this context: once asked, the program ends, and
    nothing that hurries it can cut that short. In return nothing holds it up: some seconds later
    blocked outputs are abandoned, and `stop` is called again, every second. What the context gives
    asks for the end too. `hurry` is called behind `stop` for each signal: what it cuts short is its
    own affair.
    """
    asked = False

    def ask(*_: object) -> None:
        nonlocal asked
        if not asked:
            asked = True
            signal.setitimer(signal.ITIMER_REAL, PATIENCE_S, _AGAIN_S)
        stop()

    def hear(*_: object) -> None:
        ask()
        if hurry is not None:
            hurry()

    def press(*_: object) -> None:
        abandon_blocked()
        stop()

    alarm_before = signal.signal(signal.SIGALRM, press)
    before = [signal.signal(number, hear) for number in numbers]
    try:
        yield ask
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, signal.SIG_IGN if asked else handler)
        signal.signal(signal.SIGALRM, _press_on if asked else alarm_before)
        if asked:
            # While Python takes itself apart nobody hears an alarm, and it would kill.
            atexit.register(signal.setitimer, signal.ITIMER_REAL, 0)


def _press_on(*_: object) -> None:
    abandon_blocked()
