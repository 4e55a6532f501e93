"""Owns how a command that runs on until it is told to end hears of it. It knows no command."""

from __future__ import annotations

import atexit
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from fte_sniff.cli.streams.telling import abandon_blocked

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
