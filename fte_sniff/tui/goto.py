"""Go-to line: parses a goal (row number, time, byte offset) and finds the row that it names."""

from __future__ import annotations

import re
from bisect import bisect_left
from dataclasses import dataclass
from datetime import UTC, tzinfo

from fte_sniff.analysis.row_store import RowStore
from fte_sniff.analysis.search import find_byte
from fte_sniff.analysis.time_text import ClockTime, clock_time, duration_ns, time_ns
from fte_sniff.errors import InputTextError
from fte_sniff.tui.i18n import _, later
from fte_sniff.tui.prompt import PromptField


@dataclass(frozen=True, slots=True)
class Goal:
    """Where to go; one of the fields is set."""

    row: int | None = None
    """The shown row of this number, from 1."""
    percent: float | None = None
    """The row at a percentage (0 to 100) of the shown rows."""
    offset: int | None = None
    """The row that holds a byte of the stream of the cursor's row, from 0."""
    t_ns: int | None = None
    """The first row at or after a time, nanoseconds since 1970 UTC."""
    clock: ClockTime | None = None
    """The first row at or after a time of day, on the day of the cursor's row."""
    distance_ns: int | None = None
    """The first row at or after a distance from the cursor's row; negative is earlier."""


NO_TIME = -(2**63)
"""Stands for the time of a row without one, before all others."""

_ROW = re.compile(r"[0-9][0-9_,]*")
_NO_UNIT = re.compile(r"[+-][0-9]+(?:\.[0-9]*)?", re.ASCII)
_SHARE = re.compile(r"([0-9]{1,3}(?:\.[0-9]*)?) ?%", re.ASCII)
_OFFSET = re.compile(r"@ ?(0[xX][0-9a-fA-F]{1,16}|[0-9][0-9_,]{0,20})", re.ASCII)


def parse_goal(text: str, zone: tzinfo = UTC) -> Goal:
    """Parse a goal; a date and time without a zone are in `zone`.

    Raises InputTextError; it shows a goal of each kind, or asks for the unit of a distance.
    """
    text = text.strip()
    if _ROW.fullmatch(text):
        return Goal(row=int(text.replace(",", "").replace("_", "")))
    if match := _SHARE.fullmatch(text):
        return Goal(percent=min(100.0, float(match[1])))
    if match := _OFFSET.fullmatch(text):
        return Goal(offset=int(match[1].replace(",", "").replace("_", ""), 0))
    if (t_ns := time_ns(text, zone)) is not None:
        return Goal(t_ns=t_ns)
    if (clock := clock_time(text)) is not None:
        return Goal(clock=clock)
    if text[:1] in ("+", "-") and (ns := duration_ns(text[1:])) is not None:
        return Goal(distance_ns=-ns if text[0] == "-" else ns)
    if _NO_UNIT.fullmatch(text):
        raise InputTextError(_("{text} has no unit; write {text}s, {text}ms, {text}us", text=text))
    raise InputTextError(
        _(
            "a row (1200), 50%, a time (12:00:03.5, 20:00+08:00), a distance (+2s, -50ms)"
            " or a byte (@8190)"
        )
    )


def time_of(goal: Goal, store: RowStore, cursor: int, zone: tzinfo) -> int | None:
    """Time that a goal names, nanoseconds since 1970 UTC; `zone` is the default.

    `cursor` is the position of the cursor's row among those shown. Returns None for goals that
    name no time, and where the cursor's row has none.
    """
    cursor_ns = time_at(store, cursor)
    if cursor_ns is None:
        return None
    if goal.distance_ns is not None:
        return cursor_ns + goal.distance_ns
    return goal.t_ns if goal.clock is None else goal.clock.on_day_of(cursor_ns, zone)


def row_of(goal: Goal, store: RowStore, cursor: int, zone: tzinfo) -> int | None:
    """Position of the row that a goal names among those shown; the arguments are `time_of`'s.

    Returns None where no shown row has the byte, or a time is needed and there are none. A position
    may be past the last row.
    """
    last = max(0, store.view.count - 1)
    if goal.row is not None:
        return goal.row - 1
    if goal.percent is not None:
        return round(goal.percent / 100 * last)
    if goal.offset is not None:
        return _row_with_byte(store, cursor, goal.offset)
    t_ns = time_of(goal, store, cursor, zone)
    return None if t_ns is None else min(_first_from(store, t_ns), last)


def _row_with_byte(store: RowStore, cursor: int, offset: int) -> int | None:
    if cursor >= store.view.count:
        return None
    index = find_byte(store, store.view.row(cursor).port, offset)
    return None if index is None else store.view.position_of(index)


def _first_from(store: RowStore, t_ns: int) -> int:
    """First shown row at or after a time, as if times never fell."""

    def time(position: int) -> int:
        found = time_at(store, position)
        return NO_TIME if found is None else found

    return bisect_left(range(store.view.count), t_ns, key=time)


def time_at(store: RowStore, position: int) -> int | None:
    """Time of a shown row; None where there is no such row, or it has no time."""
    return store.view.row(position).t_ns if position < store.view.count else None


class GotoField(PromptField):
    """Asks where to go."""

    LABEL = later("go to")
    EXAMPLE = "1200, 50%, 12:00:03.5, +2s, -50ms, @8190"
    HINT = later("enter goes there, esc stays here")
