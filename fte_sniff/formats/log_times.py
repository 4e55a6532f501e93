r"""Times in the lines of a log, as nanoseconds since 1970.

    2026-01-31 14:03:22.123  31.01.2026 2:03:22 PM  Jan 31 14:03:22  14:03:22,123   a clock
    20260131140322.123  1769868202.123456  1769868202123                            digits
    [43.123456]  0.042909000  5953us                                                seconds

All times of a log have one of these styles, which its first lines decide. Seconds are times only
if they rise.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from datetime import UTC, date, datetime, time, timedelta, tzinfo
from decimal import Decimal
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

_SECOND: Final = 10**9
_DAY: Final = 86_400 * _SECOND
END_NS: Final = 2**63 - _DAY
"""Times of rows end in 2262."""

_MONTH: Final = r"(?i:jan|feb|mar|apr|may|jun|jul|aug|sep|oct|nov|dec)[a-z]*"
_DATE: Final = (
    r"\d{4}[-/.年]\d\d?[-/.月]\d\d?日?|\d\d?[-/.]\d\d?[-/.](?:\d{4}|\d\d)(?!\d)"
    rf"|{_MONTH} +\d\d?(?:,? \d{{4}})?|\d\d?[- ]{_MONTH}(?:[- ]\d{{4}})?|\d\d-\d\d(?= )"
)
_PARTS: Final = ("date", "early", "clock", "fraction", "late", "zone", "year")
_FRACTION: Final = r"(?P<fraction>\d{1,9})\d*"
_CLOCK: Final = re.compile(
    rf"(?<![\w.])(?<!\b[0-9A-Fa-f]{{2}}:)(?:(?P<date>{_DATE})(?:[T ,_;]| at ){{1,2}})?"
    r"(?:(?P<early>[AP]|上午|下午)M? ?)?"
    r"(?P<clock>(?:[01]?\d|2[0-3]):[0-5]\d:[0-6]\d)"
    rf"(?:(?:[.,]|:(?=\d{{3}}(?!\d))){_FRACTION})?"
    r"(?: ?(?P<late>[AaPp])\.?[Mm]\b\.?)?(?: ?(?P<zone>Z|UTC|[+-]\d\d:?\d\d)(?!\w))?"
    r"(?: (?P<year>20\d\d)(?!\w))?(?!\d|:[0-9A-Fa-f]{2}|\.\d)"
)
_DIGITS: Final = re.compile(
    rf"(?<![\w.+-])(?P<date>(?:19|20)\d{{6}})[T_ -]?(?P<clock>\d{{6}})(?:[.,]{_FRACTION})?(?![\w.])"
    r"(?P<early>)(?P<late>)(?P<zone>)(?P<year>)"
)
_EPOCH: Final = re.compile(r"(?<![\w.+-])(?P<epoch>1\d{9}\.\d+|1\d{12}(?:\d{3}){0,2})(?![\w.])")
_UNITS: Final = {"s": _SECOND, "ms": 10**6, "us": 1000, "µs": 1000, "ns": 1}
_UNIT: Final = "|".join(_UNITS)
_NUMBER: Final = r"(?P<number>\d{1,18}(?:\.\d{1,20})?)"
_SECONDS: Final = re.compile(
    rf"(?<![\w.-])(?=\d+\.\d{{3,20}}(?![\w.])|[\d.]+ ?(?:{_UNIT})(?!\w))"
    rf"{_NUMBER}(?: ?(?P<unit>{_UNIT})(?!\w))?"
)
"""With three decimals or a unit."""
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


class LogClock:
    """The times of a log, in the order of its lines."""

    def __init__(self, lines: Sequence[str], path: Path, options: LogOptions) -> None:
        """A clock; the first lines show the style, the order of day and month, and the unit."""
        heading = next(filter(None, map(_HEADING.match, lines)), None)
        self._options, self._unit = options, heading[2].lower() if heading else "s"
        day, source = (options.day, "") if options.day else _day_of(path)
        self._day, self._source = day, source and f"{source} gives {day}"
        seconds = _column(heading[1]) if heading else _SECONDS
        if options.pattern is not None:
            matches = filter(None, map(options.pattern.search, lines))
            lines, seconds = [one.groupdict().get("time") or "" for one in matches], _column("")
        self._first = _times_in(lines, seconds)
        self.style = self._first[0].re if self._first else None
        """The style of the times in most lines; None without times."""
        readers = {_CLOCK: self._clock_ns, _DIGITS: self._clock_ns, _EPOCH: self._epoch_ns}
        self._read = readers.get(self.style or seconds, self._seconds_ns)
        dates = {one["date"] or "" for one in self._first if self.style is _CLOCK}
        self._day_first, self._ambiguous = _order(dates, self._day)
        self._odd = 0
        self._last_ns: int | None = None

    def time_ns(self, found: re.Match[str] | None) -> int | None:
        """The time of a match of the style; the last one, if it is missing or not that of a row."""
        t_ns = None
        if found is not None:
            with suppress(ValueError, OverflowError):
                t_ns = self._read(found)
        if t_ns is None or not 0 <= t_ns < END_NS:
            self._odd += 1
            return self._last_ns
        self._odd += self._last_ns is not None and t_ns < self._last_ns
        self._last_ns = t_ns
        return t_ns

    def _clock_ns(self, found: re.Match[str]) -> int:
        day, early, clock, fraction, late, zone, year = found.group(*_PARTS)
        when = _date(f"{day} {year or ''}", self._day, self._day_first) if day else self._day
        t_ns = _moment_ns(when, clock, early or late or "", zone, self._options.zone or UTC)
        t_ns += int(fraction.ljust(9, "0")) if fraction else 0
        if not day and self._last_ns is not None and t_ns < self._last_ns - _DAY // 2:
            self._day += timedelta(days=1)
            t_ns += _DAY
        return t_ns

    def _epoch_ns(self, found: re.Match[str]) -> int:
        return int(found["epoch"].replace(".", "").ljust(19, "0")[:19])

    def _seconds_ns(self, found: re.Match[str]) -> int:
        unit = _UNITS[found.groupdict().get("unit") or self._unit]
        return int(Decimal(found["number"]) * unit) + (self._options.start_ns or 0)

    def notes(self) -> Iterator[str]:
        """What the times of the first lines lack, and odd ones; complete after reading."""
        clocks = [one.groupdict() for one in self._first if self._read == self._clock_ns]
        words = [_WORDS.findall(f"{one['date'] or ''} {one['year'] or ''}") for one in clocks]
        without = {0: "date", 2: "year"}.get(min(map(len, words), default=1))
        if self._source and without:
            yield f"its times have no {without}; {self._source}; --date 2026-01-31 sets it"
        if self._ambiguous:
            order = f"{'day' if self._day_first else 'month'} first; --date 2026-01-31 decides it"
            yield f"its dates, such as {self._ambiguous}, are read {order}"
        if clocks and self._options.zone is None and not all(one["zone"] for one in clocks):
            yield "its times name no zone, and are taken as UTC; --zone +08:00 sets it"
        if self._read == self._seconds_ns and self.style and self._options.start_ns is None:
            start = "are shown as from 1970-01-01; --start 2026-01-31T12:00:00Z sets it"
            yield f"its times count seconds from a start, and {start}"
        if self._odd:
            odd = "times that step back, are missing, or not between 1970 and 2262"
            yield f"{odd}: {self._odd:,}; rows keep the one before"


def _column(before: str) -> re.Pattern[str]:
    """The style of seconds in the column under a heading, by what is before that."""
    separators = len(re.findall("[,;\t]", before))
    return re.compile(rf'^(?:[^,;\t]*[,;\t]){{{separators}}}\s*"?{_NUMBER}')


def _times_in(lines: Sequence[str], seconds: re.Pattern[str]) -> list[re.Match[str]]:
    """The times of the style that is in most lines; nothing if these are few."""
    styles = _CLOCK, _DIGITS, _EPOCH, seconds
    found = {style: [*filter(None, map(style.search, lines))] for style in styles}
    values = [float(one["number"]) for one in found[seconds]]
    falls = sum(later < earlier for earlier, later in pairwise(values))
    if 50 * falls > len(values) or len(set(values)) < min(3, len(values)):
        del found[seconds]
    best = max(found.values(), key=len)
    return best if _LEAST_SHARE * len(lines) <= len(best) else []


@lru_cache(4096)
def _moment_ns(day: date, clock: str, half: str, zone: str | None, default: tzinfo) -> int:
    """The time of a second."""
    hour, minute, second = map(int, re.findall(r"\d\d?", clock))
    if half:
        hour = hour % 12 + 12 * (half in "pP下午")
    own = datetime.strptime(zone.replace("UTC", "Z"), "%z").tzinfo if zone else default
    moment = datetime.combine(day, time(hour, minute, min(second, 59), tzinfo=own))
    return (moment - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(seconds=1) * _SECOND


_WORDS: Final = re.compile(r"(\d+|[A-Za-z]{3})[a-z]*")
"""The numbers of a date, and the first letters of its month."""


@lru_cache(64)
def _date(text: str, near: date, day_first: bool) -> date:
    """The day of a date, without a year that of a near one; raises ValueError if there is none."""
    words = _WORDS.findall(text)
    words += [str(near.year)] if len(words) == 2 else []
    order = "%d %m %Y" if "." in text or day_first else "%m %d %Y"
    for form in ("%Y%m%d", "%Y %m %d", "%b %d %Y", "%d %b %Y", order, order.lower()):
        with suppress(ValueError):
            return datetime.strptime(" ".join(words), form).date()
    raise ValueError(text)


def _order(dates: Collection[str], near: date) -> tuple[bool, str]:
    """Whether dates such as 2/8/2026 have the day first; and one of them if that is not certain."""
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
    if path.exists():
        modified = datetime.fromtimestamp(path.stat().st_mtime, UTC)
        return modified.date(), "the file's last modification"
    return datetime.now(UTC).date(), "the clock of this computer"
