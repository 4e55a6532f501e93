r"""Times in the lines of a log, as nanoseconds since 1970.

    2026-01-31 14:03:22.123  31.01.2026 2:03:22 PM  Jan 31 14:03:22  14:03:22,123   a clock
    20260131140322.123  1769868202.123456  1769868202123                            digits
    [43.123456]  0.042909000  5953us                                                seconds

All times of a log have one of these three styles, which its first lines decide. Seconds are times
only if they rise.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from datetime import UTC, date, datetime, time, timedelta, tzinfo
from decimal import Decimal
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

from fte_sniff.protocol.columns import iso_time
from fte_sniff.protocol.spec import DEFAULT_BAUD

_SECOND: Final = 10**9
_DAY: Final = 86_400 * _SECOND
END_NS: Final = 2**63 - _DAY
"""Times of rows end in 2262."""

_MONTH: Final = r"(?i:jan|feb|mar|apr|may|jun|jul|aug|sep|oct|nov|dec)[a-z]*"
_DATE: Final = (
    r"\d{4}[-/.年]\d\d?[-/.月]\d\d?日?|\d\d?[-/.]\d\d?[-/.](?:\d{4}|\d\d)(?!\d)"
    rf"|{_MONTH} +\d\d?(?:,? \d{{4}})?|\d\d?[- ]{_MONTH}(?:[- ]\d{{4}})?|\d\d-\d\d(?= )"
)
_FRACTION: Final = r"(?P<fraction>\d{1,9})\d*"
_CLOCK: Final = re.compile(
    rf"(?<![\w.])(?<!\b[0-9A-Fa-f]{{2}}:)(?:(?P<date>{_DATE})(?:[T ,_;]| at ){{1,2}})?"
    r"(?:(?P<early>[AP]|上午|下午)M? ?)?"
    r"(?P<clock>(?:[01]?\d|2[0-3]):[0-5]\d:[0-6]\d)"
    rf"(?:(?:[.,]|:(?=\d{{3}}(?!\d))){_FRACTION})?"
    r"(?: ?(?P<late>[AaPp])\.?[Mm]\b\.?)?(?: ?(?P<zone>Z|UTC|[+-]\d\d:?\d\d)(?!\w))?"
    r"(?: (?P<year>20\d\d)(?!\w))?(?!\d|:[0-9A-Fa-f]{2}|\.\d)"
)
_STAMP: Final = re.compile(
    rf"(?<![\w.+-])(?:(?P<date>(?:19|20)\d{{6}})[T_ -]?(?P<clock>\d{{6}})(?:[.,]{_FRACTION})?"
    r"|(?P<epoch>1\d{9}\.\d+|1\d{12}(?:\d{3}){0,2}))(?![\w.])"
)
_UNITS: Final = {"s": _SECOND, "ms": 10**6, "us": 1000, "µs": 1000, "ns": 1}
_UNIT: Final = "|".join(_UNITS)
_NUMBER: Final = r"(?P<number>\d{1,18}(?:\.\d{1,20})?)"
_SECONDS: Final = re.compile(
    rf"(?<![\w.-])(?=\d+\.\d{{3,20}}(?![\w.])|[\d.]+ ?(?:{_UNIT})(?!\w))"
    rf"{_NUMBER}(?: ?(?P<unit>{_UNIT})(?!\w))?"
)
"""With three decimals or a unit."""
_BARE_SECONDS: Final = re.compile(rf"^\W*{_NUMBER}\D*$")
"""A number that is nothing but a time."""
_HEADING: Final = re.compile(rf"(?i)^(.*)\btime\w* ?[\[(]({_UNIT})[\])]")
"""Of the column of times, with its unit."""
_LEAST_SHARE: Final = 0.1
"""Of the lines of a log with times."""


class LogOptions(NamedTuple):
    """What the user says of a log."""

    day: date | None = None
    """The date of the first time that has none; None for that of the file."""
    zone: tzinfo | None = None
    """Of times without one; None for UTC."""
    start_ns: int | None = None
    """When the seconds of the log began; None for 1970."""
    pattern: re.Pattern[str] | None = None
    """A regular expression with the groups `data`, and perhaps `time` and `dir`."""
    baud: int = DEFAULT_BAUD


class LogClock:
    """The times of a log, in the order of its lines."""

    def __init__(self, lines: Sequence[str], name: str, options: LogOptions) -> None:
        """A clock; the first lines show the style, the order of day and month, and the unit."""
        heading = next(filter(None, map(_HEADING.match, lines)), None)
        self._unit = heading[2].lower() if heading else "s"
        self._zone, self._start_ns = options.zone, options.start_ns
        self._day, self._source = (options.day, "") if options.day else _day_of(Path(name))
        if options.pattern is not None:
            found = filter(None, map(options.pattern.search, lines))
            lines = [text for one in found if (text := one.groupdict().get("time"))]
        self.style = _style_of(lines, heading, alone=options.pattern is not None)
        """The style of the times in most lines; None without times."""
        self._day_first, self._ambiguous = _order(lines, self._day)
        self._lacks = set[str]()
        self._named: tuple[str | None, ...] = ()
        """The date, zone and year of the last clock."""
        self._date: date | None = None
        self._lacking = self._falls = 0
        self._last_ns: int | None = None

    def time_ns(self, found: re.Match[str] | None) -> int | None:
        """The time of a match of the style; the last one, if it is missing or not that of a row."""
        t_ns = None
        if found is not None:
            with suppress(ValueError, OverflowError):
                t_ns = self._time_of(found.groupdict().get)
        if found is None or t_ns is None or not 0 <= t_ns < END_NS:
            self._lacking += 1
            return self._last_ns
        if self._last_ns is not None and t_ns < self._last_ns:
            self._falls += 1
        self._last_ns = t_ns
        return t_ns

    def _time_of(self, get: Callable[[str], str | None]) -> int:
        """The time of the groups of a style."""
        if get("clock"):
            return self._clock_ns(get)
        if epoch := get("epoch"):
            return int(epoch.replace(".", "").ljust(19, "0")[:19])
        self._lacks.add("start")
        unit = _UNITS[get("unit") or self._unit]
        return int(Decimal(get("number") or 0) * unit) + (self._start_ns or 0)

    def _clock_ns(self, get: Callable[[str], str | None]) -> int:
        named = day, zone, year = get("date"), get("zone"), get("year")
        if named != self._named:
            self._date = _date(f"{day} {year or ''}", self._day, self._day_first) if day else None
            lacks = {"zone": not (zone or self._zone), "date": not day}
            lacks["year"] = not year and len(_WORDS.findall(day or "")) == 2
            self._lacks.update(what for what in lacks if lacks[what])
            self._named = named
        when = self._date or self._day
        half = get("early") or get("late") or ""
        t_ns = _moment_ns(when, get("clock") or "", half, zone, self._zone or UTC)
        t_ns += int(f"{get('fraction') or 0:0<9}")
        if not day and self._last_ns is not None and t_ns < self._last_ns - _DAY // 2:
            self._day += timedelta(days=1)
            t_ns += _DAY
        return t_ns

    def notes(self) -> Iterator[str]:
        """What the times lack, and where that comes from."""
        for lacking in ("date", "year") if self._source else ():
            if lacking in self._lacks:
                yield (
                    f"its times have no {lacking}; {self._source} gives {self._day},"
                    " --date 2026-01-31 says another"
                )
        if self._ambiguous:
            order = "day" if self._day_first else "month"
            yield (
                f"its dates, such as {self._ambiguous}, could be day or month first, and are read"
                f" {order} first; --date 2026-01-31 says the first date"
            )
        if "zone" in self._lacks:
            yield "its times name no zone, and are taken as UTC; --zone +08:00 says another"
        if "start" in self._lacks and self._start_ns is None:
            yield (
                f"its times count seconds from a start, and are shown as from {iso_time(0)[:10]};"
                " --start 2026-01-31T12:00:00Z says when it was"
            )
        if self._lacking:
            yield (
                f"{self._lacking:,} of its lines lack a time between 1970 and 2262;"
                " the one before is taken"
            )
        if self._falls:
            yield f"times that step back: {self._falls:,}; rows keep the later time"


def _style_of(
    lines: Sequence[str], heading: re.Match[str] | None, *, alone: bool
) -> re.Pattern[str] | None:
    """The style of the times in most lines; `alone` if each line is nothing but a time."""
    if heading is not None:
        before = len(re.findall("[,;\t]", heading[1]))
        return re.compile(rf'^(?:[^,;\t]*[,;\t]){{{before}}}\s*"?{_NUMBER}')
    seconds = _BARE_SECONDS if alone else _SECONDS
    styles = _CLOCK, _STAMP, seconds
    found = {style: [one for line in lines if (one := style.search(line))] for style in styles}
    values = [float(one["number"]) for one in found[seconds]]
    falls = sum(later < earlier for earlier, later in pairwise(values))
    if 50 * falls > len(values) or len(set(values)) < min(3, len(values)):
        del found[seconds]
    best = max(found, key=lambda style: len(found[style]))
    return best if _LEAST_SHARE * len(lines) <= len(found[best]) else None


@lru_cache(4096)
def _moment_ns(day: date, clock: str, half: str, zone: str | None, default: tzinfo) -> int:
    hour, minute, second = map(int, re.findall(r"\d\d?", clock))
    if half:
        hour = hour % 12 + 12 * (half in "pP下午")
    own = datetime.strptime(zone.replace("UTC", "Z"), "%z").tzinfo if zone else default
    moment = datetime.combine(day, time(hour, minute, min(second, 59), tzinfo=own))
    return (moment - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(seconds=1) * _SECOND


_WORDS: Final = re.compile(r"(\d+|[A-Za-z]{3})[a-z]*")
"""The numbers of a date, and the first letters of its month."""


def _date(text: str, near: date, day_first: bool) -> date:
    """The day of a date, without a year that of a near one; raises ValueError if there is none."""
    words = _WORDS.findall(text)
    words += [str(near.year)] if len(words) == 2 else []
    order = "%d %m %Y" if "." in text or day_first else "%m %d %Y"
    for form in ("%Y%m%d", "%Y %m %d", "%b %d %Y", "%d %b %Y", order, order.lower()):
        with suppress(ValueError):
            return datetime.strptime(" ".join(words), form).date()
    raise ValueError(text)


def _order(lines: Sequence[str], near: date) -> tuple[bool, str]:
    """Whether dates such as 2/8/2026 have the day first; and one of them if that is not certain."""
    dates = {one["date"] or "" for line in lines if (one := _CLOCK.search(line))}
    texts = sorted(text for text in dates if re.match(r"\d\d?[-/]\d\d?[-/]\d", text))
    pairs = [[int(one) for one in re.findall(r"\d+", text)] for text in texts]
    if not texts or any(second > 12 for _, second, _ in pairs):
        return False, ""
    if any(first > 12 for first, *_ in pairs):
        return True, ""
    by_month, by_day = (abs(_date(texts[-1], near, one) - near) for one in (False, True))
    return by_day < by_month, texts[-1] if by_day != by_month else ""


_IN_NAME: Final = re.compile(r"(?<!\d)(20\d\d)\D?([01]\d)\D?([0-3]\d)(?!\d)")


def _day_of(path: Path) -> tuple[date, str]:
    """The day in the name of a file, else that of its last modification; and where it is from."""
    for found in _IN_NAME.findall(path.name):
        with suppress(ValueError):
            return date(*map(int, found)), "the file's name"
    try:
        day = datetime.fromtimestamp(path.stat().st_mtime, UTC).date()
    except OSError:
        return datetime.now(UTC).date(), "the clock of this computer"
    return day, "the file's last modification"
