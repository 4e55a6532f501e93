"""Owns which moment a time in a log is: its day, where only a time of day is written, and its zone.

It must not know how a line is laid out, nor how the order of day and month shows.
"""

from __future__ import annotations

import re
from contextlib import suppress
from datetime import UTC, date, datetime, timedelta, timezone, tzinfo

from fte_sniff.errors import InputTextError, quoted
from fte_sniff.formats.logs.day_order import DayOrder
from fte_sniff.formats.logs.line_time import Stamp

_DAY_S = 24 * 3600
_DAY_NS = _DAY_S * 10**9
_YEARS = range(1970, 2263)
LATEST_NS = 2**63 - 1
"""In 2262: a table's times are 64 bits, nanoseconds since 1970."""
_OUTSIDE = f"its time is not from {_YEARS.start} to {_YEARS[-1]}"
_OFFSET = re.compile(r"([+-])([01]?[0-9]|2[0-3])(?::?([0-5][0-9]))?", re.ASCII)


class LogClock:
    """Turns the stamps of one log, in their order, into nanoseconds since 1970 UTC."""

    def __init__(self, day: date | None = None, zone: tzinfo | None = None) -> None:
        """A clock for a log.

        Args:
            day: of times of day before the first midnight; None where that is not known.
            zone: of times that name none; None for UTC, which is then told.
        """
        self._day = self._first_day = day
        self._zone = zone
        self._last_ns: int | None = None
        self.order = DayOrder(day)
        """Of day and month."""
        self.undated = False
        """Whether a time was left out because nothing says its day."""
        self.zoneless = False
        """Whether a time was taken as UTC because nothing says its zone."""
        self._first_wrong = ""
        self._wrong_line = 0
        self._wrong_lines = 0

    def anew(self) -> LogClock:
        """Another one, for the same log from its beginning."""
        return LogClock(self._first_day, self._zone)

    def t_ns(self, stamp: Stamp, line: int = 0) -> int | None:
        """When that was; None where it cannot be told.

        Args:
            stamp: the time as it is written.
            line: where it holds, to be told where it is none.
        """
        t_ns = self._told(stamp, line)
        if t_ns is None or 0 <= t_ns <= LATEST_NS:
            return t_ns
        self._refuse(_OUTSIDE, line)
        return None

    def _told(self, stamp: Stamp, line: int) -> int | None:
        if stamp.epoch_ns is not None or stamp.clock_ns is None:
            return stamp.epoch_ns
        # 24:00:00 is the end of a day; nothing else is behind it.
        if stamp.clock_ns > _DAY_NS:
            self._refuse(f"{_clock_text(stamp.clock_ns)} is no time of day", line)
            return None
        written = stamp.date
        if stamp.day_or_month is not None:
            written = self.order.date_of(stamp.day_or_month)
        if written is not None and not _is_day(written):
            year, month, day_of_month = written
            self._refuse(f"{year:04}-{month:02}-{day_of_month:02} is no day", line)
            return None
        day = self._day_at(stamp.clock_ns) if written is None else date(*written)
        if day is None:
            self.undated = True
            return None
        if day.year not in _YEARS:
            self._refuse(_OUTSIDE, line)
            return None
        if stamp.zone_s is not None and abs(stamp.zone_s) >= _DAY_S:
            self._refuse("its zone is none, for it is a day or more from UTC", line)
            return None
        return self._moment(day, stamp)

    @property
    def wrong(self) -> list[str]:
        """Of times that are none, the first, and how many more there are; one line or none."""
        if not self._wrong_lines:
            return []
        more = f" (nor are {self._wrong_lines - 1:,} more)" if self._wrong_lines > 1 else ""
        return [f"line {self._wrong_line}: {self._first_wrong}; rows there have no time{more}"]

    def _refuse(self, why: str, line: int) -> None:
        if not self._wrong_lines:
            self._first_wrong, self._wrong_line = why, line
        self._wrong_lines += 1

    def _day_at(self, clock_ns: int) -> date | None:
        """The day of a time of day that stands without one."""
        if self._day is not None and self._last_ns is not None:
            # A clock that falls by more than half a day has passed midnight.
            with suppress(OverflowError):
                self._day += timedelta(days=clock_ns < self._last_ns - _DAY_NS // 2)
        self._last_ns = clock_ns
        return self._day

    def _moment(self, day: date, stamp: Stamp) -> int:
        zone: tzinfo | None = self._zone
        if stamp.zone_s is not None:
            zone = timezone(timedelta(seconds=stamp.zone_s))
        self.zoneless = self.zoneless or zone is None
        clock_s, rest_ns = divmod(stamp.clock_ns or 0, 10**9)
        midnight = datetime(day.year, day.month, day.day)
        when = (midnight + timedelta(seconds=clock_s)).replace(tzinfo=zone or UTC)
        since_1970 = when - datetime(1970, 1, 1, tzinfo=UTC)
        return since_1970 // timedelta(seconds=1) * 10**9 + rest_ns


def _is_day(written: tuple[int, int, int]) -> bool:
    try:
        date(*written)
    except ValueError:
        return False
    return True


def _clock_text(clock_ns: int) -> str:
    minutes, seconds = divmod(clock_ns // 10**9, 60)
    return f"{minutes // 60:02}:{minutes % 60:02}:{seconds:02}"


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
