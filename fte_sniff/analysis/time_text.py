"""Times and durations that a user types.

2026-01-31T12:00:05.25Z      a time, UTC or with a zone as +08:00
2026-01-31 12:00, 2026-01-31 shorter forms: a date alone is its midnight
12:00:05.25, 12:00+08:00     a time of day, UTC or with a zone
10s, 1m30s, 250ms, 1.5 h     a duration: d, h, m or min, s, ms, us, ns
+08:00, +8, Asia/Shanghai    a zone; also UTC, and local for that of this machine
"""

from __future__ import annotations

import re
from datetime import UTC, date, datetime, time, timedelta, tzinfo
from decimal import Decimal
from typing import Final, NamedTuple

from fte_sniff.errors import InputTextError, quoted

SECOND_NS: Final = 1_000_000_000
DAY_NS: Final = 86_400 * SECOND_NS

_YEARS: Final = range(1970, 2263)
"""Of times that 64 bits hold, nanoseconds since 1970."""
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_TIME: Final = re.compile(r"([0-9-]*[T ]?[0-9:]*)(?:\.([0-9]{1,9}))?\ ?(Z|[+-][0-9]{2}:?[0-9]{2})?")
"""Date and time, the fraction of a second, and the zone."""
_UNITS: Final = {
    "ms": SECOND_NS // 1000,
    "us": 1000,
    "ns": 1,
    "d": DAY_NS,
    "h": 3600 * SECOND_NS,
    "min": 60 * SECOND_NS,
    "m": 60 * SECOND_NS,
    "s": SECOND_NS,
}
_PART: Final = rf"([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\ ?({'|'.join(_UNITS)})"
_PARTS: Final = re.compile(_PART, re.IGNORECASE)
_DURATION: Final = re.compile(f"(?:{_PART})+", re.IGNORECASE)


class ClockTime(NamedTuple):
    """A time of day, without a date."""

    of_day: time
    """To the second, with its zone if it has one."""
    fraction_ns: int = 0
    """Added to it, 0 to 999,999,999 ns."""

    def since_midnight_ns(self, zone: tzinfo = UTC) -> int | None:
        """Nanoseconds since midnight UTC; None if the offset of its zone depends on the season.

        `zone` is the default zone.
        """
        year = datetime.now(UTC).year
        found = {self._on(date(year, month, 1), zone) % DAY_NS for month in range(1, 13)}
        return found.pop() if len(found) == 1 else None

    def on_day_of(self, t_ns: int, zone: tzinfo) -> int:
        """This time on the day of `t_ns`, nanoseconds since 1970 UTC, by default in `zone`."""
        moment = _EPOCH + timedelta(seconds=t_ns // SECOND_NS)
        return self._on(moment.astimezone(self.of_day.tzinfo or zone).date(), zone)

    def _on(self, day: date, zone: tzinfo) -> int:
        moment = datetime.combine(day, self.of_day, self.of_day.tzinfo or zone)
        return _ns_of(moment) + self.fraction_ns


def time_ns(text: str, zone: tzinfo = UTC) -> int | None:
    """A time with a date, nanoseconds since 1970 UTC; None if the text is not one.

    A fraction of a second has up to nine digits; `zone` is the default zone.
    """
    try:
        second, fraction_ns = _parsed(text)
    except ValueError:
        return None
    return _ns_of(second if second.tzinfo else second.replace(tzinfo=zone)) + fraction_ns


def clock_time(text: str) -> ClockTime | None:
    """A time of day; None if the text is not one."""
    clock = text.strip()
    clock = f"0{clock}" if clock[1:2] == ":" else clock
    try:
        moment, fraction_ns = _parsed(f"{_EPOCH.date()}T{clock}")
    except ValueError:
        return None
    return ClockTime(moment.timetz(), fraction_ns) if ":" in clock else None


def _parsed(text: str) -> tuple[datetime, int]:
    """The second, and the nanoseconds after it; raises ValueError for another text."""
    match = _TIME.fullmatch(text.strip())
    if match is None:
        raise ValueError(text)
    second, fraction, zone = match.groups("")
    return datetime.fromisoformat(second + zone), int(fraction.ljust(9, "0"))


def duration_ns(text: str) -> int | None:
    """A duration in nanoseconds; None if the text is not one."""
    if not _DURATION.fullmatch(text):
        return None
    parts = _PARTS.findall(text)
    return sum(int(Decimal(number) * _UNITS[unit.lower()]) for number, unit in parts)


def day_of(text: str) -> date:
    """The day that `--date` names; raises InputTextError for other texts."""
    try:
        if (day := date.fromisoformat(text.strip())).year in _YEARS:
            return day
    except ValueError:
        pass
    raise InputTextError(
        f"--date: {quoted(text)} is not a day from {_YEARS.start} to {_YEARS[-1]};"
        " write it as 2026-01-31"
    )


class _Local(tzinfo):
    """The zone of this machine, as the system knows it: it need not have a name."""

    def utcoffset(self, moment: datetime | None) -> timedelta | None:
        """The offset at a local time; None without one."""
        return None if moment is None else moment.replace(tzinfo=None).astimezone().utcoffset()

    def dst(self, moment: datetime | None) -> None:
        """None: the system does not name it."""

    def tzname(self, moment: datetime | None) -> None:
        """None, as for `dst`."""

    def fromutc(self, moment: datetime) -> datetime:
        """The local time of a UTC time; `fold` marks the second of two equal ones."""
        local = moment.replace(tzinfo=UTC).astimezone()
        naive = local.replace(tzinfo=None)
        is_second = naive.astimezone().utcoffset() != local.utcoffset()
        return naive.replace(tzinfo=self, fold=int(is_second))


LOCAL: Final = _Local()
_NAMED: Final = {"local": LOCAL, "utc": UTC, "z": UTC}


def zone_of(text: str) -> tzinfo:
    """The zone that `--zone` names: `+8`, `+08:00`, `UTC`, `local`, `Asia/Shanghai`.

    Raises InputTextError for other texts.
    """
    from zoneinfo import ZoneInfo

    name = text.strip()
    if named := _NAMED.get(name.lower()):
        return named
    try:
        if name[:1] in ("+", "-") and "." not in name:
            padded = re.sub(r"^(.)(\d)(?!\d)", r"\g<1>0\2", name)
            return time.fromisoformat(f"00:00{padded}").tzinfo or UTC
        return ZoneInfo(name)
    except (ValueError, OSError, KeyError):
        raise InputTextError(
            f"--zone: {quoted(text)} is not a time zone; write +08:00, UTC, local or Asia/Shanghai"
        ) from None


def _ns_of(moment: datetime) -> int:
    return (moment - _EPOCH) // timedelta(seconds=1) * SECOND_NS
