"""Owns how the table is to look, as the user chose: columns, widths, and what times count from.

It must not know rows or the window.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from enum import StrEnum


class TimeStyle(StrEnum):
    """What the times of rows are told from; the text stands over the column."""

    CLOCK = "time UTC"
    LOCAL = "time local"
    START = "+ start"
    BEFORE = "+ before"
    MARK = "+ mark"

    @property
    def meaning(self) -> str:
        """In words."""
        return _MEANINGS[self]

    @property
    def counts(self) -> bool:
        """Whether they are distances in time from something."""
        return self not in (TimeStyle.CLOCK, TimeStyle.LOCAL)


_MEANINGS = {
    TimeStyle.CLOCK: "times are the time of day, UTC",
    TimeStyle.LOCAL: "times are the time of day in the zone of --zone, or else of this machine",
    TimeStyle.START: "times count from the first row",
    TimeStyle.BEFORE: "times count from the row before",
    TimeStyle.MARK: "times count from the last mark that was set",
}


@dataclass(frozen=True, slots=True)
class ColumnChoice:
    """The columns that the user wants, and how wide."""

    names: tuple[str, ...]
    """Shown from left to right; at least one."""
    widths: tuple[tuple[str, int], ...] = ()
    """Cells of the columns that have another width than their own."""


@dataclass(frozen=True, slots=True)
class Look:
    """All of it."""

    ports: tuple[str, ...] = ()
    """Ports seen so far; from two on, each row says its own."""
    times: TimeStyle = TimeStyle.CLOCK
    choice: ColumnChoice | None = None
    """None where the width of the window decides."""
    zone: timezone = UTC
    """That of local times."""

    @property
    def shown_zone(self) -> timezone:
        """The zone of the times of day that are shown."""
        return self.zone if self.times is TimeStyle.LOCAL else UTC


def ahead_of_utc_ns(zone: timezone) -> int:
    """Nanoseconds that clocks of a zone are ahead of UTC."""
    return zone.utcoffset(None) // timedelta(microseconds=1) * 1000


def zone_at(t_ns: int, zone: tzinfo | None) -> timezone:
    """How far a zone is from UTC at a time; None is this machine's.

    One distance holds for a whole table, whose head names it: also where clocks are changed later.
    """
    moment = datetime.fromtimestamp(t_ns // 1_000_000_000, UTC).astimezone(zone)
    return timezone(moment.utcoffset() or timedelta(0))
