"""Owns the earliest time that a polars filter can let pass, as far as its form tells.

It must not know recordings. Expressions are taken apart and put together again to be compared, so
that nothing depends on how polars writes them down; what is not understood sets no bound.
"""

from __future__ import annotations

from typing import Literal

import polars as pl
from polars.exceptions import PolarsError

_TIME = "time"
_CLOSED: tuple[Literal["both", "left", "right", "none"], ...] = ("both", "left", "right", "none")
_NS: dict[Literal["ns", "us", "ms"], int] = {"ns": 1, "us": 10**3, "ms": 10**6}
_TIMES = (pl.col(_TIME), *(pl.col(_TIME).cast(pl.Datetime(unit, "UTC")) for unit in _NS))
"""The column, and as polars rounds it down to compare it with times that are coarser."""


def earliest_ns(wanted: pl.Expr) -> int:
    """Nanoseconds since 1970 UTC: no row of an earlier `time` passes the filter; 0 for no bound."""
    inputs = wanted.meta.pop()[::-1]
    if len(inputs) == 3:
        return _since(inputs[0], inputs[1]) if _is_between(wanted, inputs) else 0
    if len(inputs) != 2:
        return 0
    left, right = inputs
    if wanted.meta.eq(left & right):
        return max(earliest_ns(left), earliest_ns(right))
    if wanted.meta.eq(left | right):
        return min(earliest_ns(left), earliest_ns(right))
    if any(map(wanted.meta.eq, (left > right, left >= right, left == right))):
        return _since(left, right)
    if any(map(wanted.meta.eq, (left < right, left <= right))):
        return _since(right, left)
    return 0


def _is_between(wanted: pl.Expr, inputs: list[pl.Expr]) -> bool:
    column, low, high = inputs
    return any(wanted.meta.eq(column.is_between(low, high, closed)) for closed in _CLOSED)


def _since(column: pl.Expr, bound: pl.Expr) -> int:
    """The bound in nanoseconds, if it is one of the time."""
    if not any(map(column.meta.eq, _TIMES)) or bound.meta.root_names():
        return 0
    try:
        found = pl.select(bound).to_series()
    except PolarsError:
        return 0
    kind = found.dtype
    if not isinstance(kind, pl.Datetime) or kind.time_zone is None or len(found) != 1:
        return 0
    count = found.to_physical().item()
    return 0 if count is None else max(0, count * _NS[kind.time_unit])
