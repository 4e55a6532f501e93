"""Waits of all tests: they end with the event, or fail with what they waited for.

The speed and the load of a machine do not concern a test, so `BOUND_S` is the one limit: far
above what any step takes.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from contextlib import suppress
from time import monotonic, sleep

BOUND_S = 60.0
"""Seconds that a wait may take at most."""
STEP_S = 0.005


def while_waiting(waited_for: Callable[[], object]) -> Iterator[None]:
    """Steps of a loop that waits; BOUND_S after the first it fails with what `waited_for` gives."""
    deadline = monotonic() + BOUND_S
    while monotonic() < deadline:
        yield
    raise AssertionError(f"waited {BOUND_S:.0f} s for {waited_for()}")


def wait_until(holds: Callable[[], object]) -> None:
    """Wait until a condition holds; a failure shows its source and the values that it uses."""
    for _ in while_waiting(lambda: condition_text(holds)):
        if holds():
            return
        sleep(STEP_S)


def condition_text(condition: Callable[[], object]) -> str:
    """The source of a condition, and the variables around it."""
    text = repr(condition)
    with suppress(OSError, TypeError):
        text = inspect.getsource(condition).strip()
    with suppress(TypeError, ValueError):
        known = inspect.getclosurevars(condition).nonlocals
        text += "".join(f"\n  {name} = {value!r:.300}" for name, value in known.items())
    return text
