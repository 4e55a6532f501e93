"""Owns how a command that runs on until it is told to end hears of it. It knows no command."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def signals_call(stop: Callable[[], None]) -> Iterator[None]:
    """While in this context, Ctrl-C, SIGTERM and a closed terminal ask for the end."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [signal.signal(number, lambda *_: stop()) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
