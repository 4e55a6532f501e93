"""The clock of a log: stamps, in their order, to nanoseconds since 1970 UTC."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, date, datetime, timedelta, timezone, tzinfo
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from fte_sniff.errors import InputTextError, quoted
from fte_sniff.formats.logs.streams import LATEST_NS
from fte_sniff.formats.logs.times import DAY_NS, SECOND, Stamp, days_of

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Column = npt.NDArray[np.int64]

_YEARS: Final = range(1970, 2263)
_LAST_OF_FEBRUARY: Final = 59
_OFFSET: Final = re.compile(r"([+-])([01]?[0-9]|2[0-3])(?::?([0-5][0-9]))?", re.ASCII)
_UNITS: Final = (
    (DAY_NS, "day"), (3600 * SECOND, "h"), (60 * SECOND, "min"), (SECOND, "s"), (10**6, "ms"),
    (10**3, "µs"), (1, "ns"),
)  # fmt: skip


class LogClock:
    """Turns the stamps of one log, in their order, into nanoseconds since 1970 UTC."""

    def __init__(
        self, day: date | None = None, zone: tzinfo | None = None, start_ns: int | None = None
    ) -> None:
        """A clock for a log.

        Args:
            day: of the first time that has none.
            zone: of times that name none; None for UTC, which is then reported.
            start_ns: when the seconds of a log, or the bytes of a stream, began.
        """
        self.start_ns = start_ns
        self._given, self._zone = day, zone
        self._days = 0
        """From 1970, of the present time of day."""
        self._base_ns = 0
        self._last_clock_ns: int | None = None
        self._last_ns: int | None = None
        self._zoneless = False
        self._settled = ""
        self._back: list[tuple[int, int]] = []
        self._backs = 0
        self._outside: list[int] = []

    def settle(self, stamps: Sequence[Stamp], name: str, written_ns: int | None) -> None:
        """Decide what the times count from.

        Args:
            stamps: those of a sample, the first and the last of the log among them.
            name: the file's; it may hold a date.
            written_ns: when the file was modified; None for a pipe, which is read now.
        """
        kind = stamps[0].kind
        named = time_in_name(name)
        modified = "the file's modification time"
        if written_ns is None:
            written_ns, modified = int(datetime.now(tz=UTC).timestamp() * SECOND), "now"
        if kind == "since":
            if self.start_ns is not None:
                self._base_ns = self.start_ns
                return
            source = "the file's name"
            if named is not None and named[1]:
                self._base_ns = self._from_local(named[0])
            else:
                last = max((stamp.ns for stamp in stamps), default=0)
                source = f"{modified} minus the last time" if modified != "now" else modified
                self._base_ns = written_ns - (last if modified != "now" else 0)
            self._settled = (
                f"its times count seconds from a start, which is {_iso(self._base_ns)} by {source};"
                " --start 2026-01-31T12:00:00Z sets another"
            )
        elif kind in ("clock", "year-less"):
            days, source = written_ns // DAY_NS, modified
            if self._given is not None:
                days, source = (self._given - date(1970, 1, 1)).days, ""
            elif named is not None:
                days, source = named[0] // DAY_NS, "the file's name"
            elif kind == "clock":
                days -= sum(b.ns < a.ns - DAY_NS // 2 for a, b in pairwise(stamps))
            self._days = days
            if source:
                what = f"{_day(days)} is" if kind == "clock" else f"{_day(days)[:4]} is"
                part = "date" if kind == "clock" else "year"
                self._settled = (
                    f"its times have no date: the {part} {what} by {source};"
                    " --date 2026-01-31 sets another"
                )

    def t_ns(self, stamp: Stamp, line: int) -> int | None:
        """The time of a stamp; None if it is outside 1970 to 2262."""
        days, t_ns = stamp.days, 0
        if stamp.kind in ("since", "epoch"):
            t_ns = stamp.ns + (self._base_ns if stamp.kind == "since" else 0)
        else:
            if stamp.kind == "clock":
                if self._last_clock_ns is not None and stamp.ns < self._last_clock_ns - DAY_NS // 2:
                    self._days += 1
                self._last_clock_ns = stamp.ns
                days = self._days
            elif stamp.kind == "year-less":
                days = self._of_year(days)
            t_ns = self._from_local(days * DAY_NS + stamp.ns, stamp.zone_s)
        if not 0 <= t_ns <= LATEST_NS:
            self._outside.append(line)
            return None
        if self._last_ns is not None and t_ns < self._last_ns:
            self._note_back(line, self._last_ns - t_ns)
        self._last_ns = t_ns
        return t_ns

    def column(self, stamp: Stamp, lines: Column) -> Column:
        """The times of many lines, whose stamps are columns."""
        import numpy as np

        if stamp.kind in ("since", "epoch"):
            found = stamp.ns + (self._base_ns if stamp.kind == "since" else 0)
        else:
            days = stamp.days
            if stamp.kind == "clock":
                before = stamp.ns[0] if self._last_clock_ns is None else self._last_clock_ns
                falls = np.diff(stamp.ns, prepend=before) < -(DAY_NS // 2)
                days = self._days + np.cumsum(falls)
                self._days, self._last_clock_ns = int(days[-1]), int(stamp.ns[-1])
            elif stamp.kind == "year-less":
                days = self._of_year(days)
            local = days * DAY_NS + stamp.ns
            hours, which = np.unique(local // (3600 * SECOND), return_inverse=True)
            shift = [
                h * 3600 * SECOND - self._from_local(h * 3600 * SECOND, stamp.zone_s)
                for h in hours.tolist()
            ]
            found = local - np.array(shift, np.int64)[which]
        falls = np.diff(found, prepend=found[0] if self._last_ns is None else self._last_ns)
        for at in np.flatnonzero(falls < 0).tolist():
            self._note_back(int(lines[at]), int(-falls[at]))
        self._last_ns = int(found[-1])
        return np.asarray(found, np.int64)

    def _of_year(self, days: Any) -> Any:
        """Days from 1970 of a day in 1972, in the year of `_days` instead."""
        year = date.fromordinal(self._days + date(1970, 1, 1).toordinal()).year
        since = days - days_of(1972, 1, 1)
        leap = days_of(year, 3, 1) - days_of(year, 1, 1) - _LAST_OF_FEBRUARY
        return days_of(year, 1, 1) + since - (since > _LAST_OF_FEBRUARY) * (1 - leap)

    def _from_local(self, ns: int, zone_s: int | None = None) -> int:
        if zone_s is not None:
            return ns - zone_s * SECOND
        if self._zone is None:
            self._zoneless = True
            return ns
        seconds, rest = divmod(ns, SECOND)
        try:
            local = datetime(1970, 1, 1, tzinfo=self._zone) + timedelta(seconds=seconds)
            return int(local.timestamp()) * SECOND + rest
        except (OverflowError, ValueError):
            return -1

    def _note_back(self, line: int, by_ns: int) -> None:
        self._backs += 1
        if not self._back:
            self._back.append((line, by_ns))

    @property
    def notes(self) -> list[str]:
        """How the times were read, one line each."""
        notes = [self._settled] if self._settled else []
        if self._outside:
            more = f" (nor have {len(self._outside) - 1:,} more)" if self._outside[1:] else ""
            notes.append(
                f"line {self._outside[0]}: its time is not from {_YEARS.start} to {_YEARS[-1]};"
                f" rows there have no time{more}"
            )
        for line, by_ns in self._back:
            again = "" if self._backs == 1 else f", and {self._backs - 1:,} times more"
            notes.append(f"line {line}: the time goes back by {_length(by_ns)}{again}")
        if self._zoneless:
            notes.append("its times name no zone, and are taken as UTC; --zone +08:00 says another")
        return notes


def _iso(t_ns: int) -> str:
    when = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=t_ns // SECOND)
    return when.strftime("%Y-%m-%dT%H:%M:%SZ")


def _day(days: int) -> str:
    return _iso(days * DAY_NS)[:10]


def _length(ns: int) -> str:
    """A length of time in its largest unit, with the rest in the next."""
    for (size, unit), (smaller, small) in pairwise(_UNITS):
        if ns >= size:
            count, rest = divmod(ns, size)
            rest //= smaller
            text = f"{count:,} {unit}{'s' if unit == 'day' and count > 1 else ''}"
            return f"{text} {rest} {small}" if rest else text
    return f"{ns} ns"


_NAMED: Final = re.compile(
    r"(?<!\d)(20\d\d)[-_.]?(0[1-9]|1[0-2])[-_.]?(0[1-9]|[12]\d|3[01])"
    r"(?:[-_ T.]+([01]\d|2[0-3])[-_.h]?([0-5]\d)[-_.m]?([0-5]\d))?(?!\d)"
)


def time_in_name(name: str) -> tuple[int, bool] | None:
    """The time in a file name, nanoseconds since 1970, and whether it has a time of day."""
    for found in _NAMED.finditer(Path(name).name):
        year, month, day, hour, minute, second = (int(text or 0) for text in found.groups())
        try:
            when = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
        except ValueError:
            continue
        return int(when.timestamp()) * SECOND, found[4] is not None
    return None


def day_of(text: str) -> date:
    """The day that `--date` names.

    Raises:
        InputTextError: it is none.
    """
    try:
        day = date.fromisoformat(text.strip())
    except ValueError:
        raise InputTextError(f"--date: {quoted(text)} is no day; write it as 2026-01-31") from None
    if day.year not in _YEARS:
        raise InputTextError(
            f"--date: {day} cannot be kept; times go from {_YEARS.start} to {_YEARS[-1]}"
        )
    return day


def zone_of(text: str) -> tzinfo:
    """The zone that `--zone` names: `+08:00`, `+8`, `UTC`, or as `Asia/Shanghai`.

    Raises:
        InputTextError: it is none.
    """
    name = text.strip()
    if offset := _OFFSET.fullmatch(name):
        sign, hours, minutes = offset.groups()
        east = timedelta(hours=int(hours), minutes=int(minutes or 0))
        return timezone(-east if sign == "-" else east)
    try:
        from zoneinfo import ZoneInfo

        return UTC if name.upper() in ("UTC", "Z") else ZoneInfo(name)
    except (ValueError, OSError, KeyError):
        raise InputTextError(
            f"--zone: {quoted(text)} is no zone; write +08:00, UTC, or a name as Asia/Shanghai"
        ) from None
