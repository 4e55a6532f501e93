"""Tables that the gate tests in part: the marker `slow` keeps the other rows for `.ci/full`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product
from typing import Any

import pytest


def first(count: int, rows: Iterable[object]) -> list[Any]:
    """The rows of a table for `parametrize`: all after the first `count` are slow.

    A tuple is a row with several arguments.
    """
    as_tuples = [row if isinstance(row, tuple) else (row,) for row in rows]
    fast = [pytest.param(*row) for row in as_tuples[:count]]
    return fast + [pytest.param(*row, marks=pytest.mark.slow) for row in as_tuples[count:]]


def crossed(*tables: Sequence[object]) -> list[Any]:
    """All combinations of the tables' values: slow but for a few in which each value occurs."""
    longest = max(map(len, tables))
    fast = [tuple(table[at % len(table)] for table in tables) for at in range(longest)]
    return first(longest, fast + [row for row in product(*tables) if row not in fast])
