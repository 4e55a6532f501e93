"""Reading ahead: a thread makes the next items while one is used."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Final, TypeVar

T = TypeVar("T")

_MOST: Final = 2
"""Items that wait for their turn."""


def ahead(items: Iterator[T]) -> Iterator[T]:
    """The items, none of which may be None.

    Most of reading and of writing is in numpy, polars and zstd, which do not hold the interpreter's
    lock. For a few rows a thread costs more than it gains.
    """
    with ThreadPoolExecutor(1) as thread:
        jobs = deque(thread.submit(next, items, None) for _ in range(_MOST))
        while (item := jobs.popleft().result()) is not None:
            jobs.append(thread.submit(next, items, None))
            yield item
