r"""Times in the lines of a log, as nanoseconds since 1970.

    2026-01-31 14:03:22.123  31.01.2026 2:03:22 PM  Jan 31 14:03:22  14:03:22,123   a clock
    20260131140322.123  1769868202.123456  1769868202123                            digits
    [43.123456]  0.042909000                                                        seconds

All times of a log have one of these three styles, which its first lines decide. Seconds are times
only if they rise.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from datetime import UTC, date, datetime, timedelta, timezone, tzinfo
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

from fte_sniff.protocol import DEFAULT_BAUD, iso_time

_SECOND: Final = 10**9
_DAY: Final = 86_400 * _SECOND
END_NS: Final = 2**63 - _DAY
"""Times of rows end in 2262."""
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_MONTHS: Final = tuple(re.findall("...", "janfebmaraprmayjunjulaugsepoctnovdec"))

_MONTH: Final = rf"(?i:{'|'.join(_MONTHS)})[a-z]*"
_DATE: Final = (
    r"\d{4}[-/.年]\d\d?[-/.月]\d\d?日?|\d\d?[-/.]\d\d?[-/.](?:\d{4}|\d\d)(?!\d)"
    rf"|{_MONTH} +\d\d?(?:,? \d{{4}})?|\d\d?[- ]{_MONTH}(?:[- ]\d{{4}})?|\d\d-\d\d(?= )"
)
CLOCK: Final = re.compile(
    rf"(?<![\w.])(?<!\b[0-9A-Fa-f]{{2}}:)(?:(?P<date>{_DATE})(?:[T ,_;]| at ){{1,2}})?"
    r"(?:(?P<early>[AP]|上午|下午)M? ?)?"
    r"(?P<clock>(?:[01]?\d|2[0-3]):[0-5]\d:[0-6]\d)"
    r"(?:(?:[.,]|:(?=\d{3}(?!\d)))(?P<fraction>\d{1,9})\d*)?"
    r"(?: ?(?P<late>[AaPp])\.?[Mm]\b\.?)?(?: ?(?P<zone>Z|UTC|[+-]\d\d:?\d\d)(?!\w))?"
    r"(?: (?P<year>20\d\d)(?!\w))?(?!\d|:[0-9A-Fa-f]{{2}}|\.\d)"
)
DIGITS: Final = re.compile(
    r"(?<![\w.+-])(?:(?P<stamp>(?:19|20)\d{6}[T_ -]?\d{6})(?:[.,](?P<part>\d{1,9})\d*)?"
    r"|(?P<epoch>1\d{9})\.(?P<fraction>\d{1,9})\d*|(?P<whole>1\d{12}(?:\d{3}){0,2}))"
    r"(?![\w.])"
)
_UNITS: Final = {"s": _SECOND, "ms": 10**6, "us": 1000, "µs": 1000, "ns": 1}
_UNIT: Final = "|".join(_UNITS)
_NUMBER: Final = r"(?P<number>\d{1,18})(?:\.(?P<fraction>\d{1,20}))?"
SECONDS: Final = re.compile(
    rf"(?<![\w.-])(?=\d+\.\d{{3,20}}(?![\w.])|[\d.]+ ?(?:{_UNIT})(?!\w))"
    rf"{_NUMBER}(?: ?(?P<unit>{_UNIT})(?!\w))?"
)
"""With three decimals or a unit."""
BARE_SECONDS: Final = re.compile(rf"^\W*{_NUMBER}\D*$")
"""A number that is nothing but a time."""
_HEADING: Final = re.compile(rf"(?i)^(.*)\btime\w* ?[\[(]({_UNIT})[\])]")
"""Of the column of times, with its unit."""
_LEAST_SHARE: Final = 0.1
"""Of the lines of a log with times."""


def style_of(lines: Sequence[str], *, alone: bool = False) -> re.Pattern[str] | None:
    """The style of the times in most lines of a log; None without times.

    `alone` if each line is nothing but a time.
    """
    heading = next(filter(None, map(_HEADING.match, lines)), None)
    if heading is not None:
        before = len(re.findall("[,;\t]", heading[1]))
        return re.compile(rf'^(?:[^,;\t]*[,;\t]){{{before}}}\s*"?{_NUMBER}')
    seconds = BARE_SECONDS if alone else SECONDS
    styles = CLOCK, DIGITS, seconds
    found = {style: [one for line in lines if (one := style.search(line))] for style in styles}
    values = [float(f"{one['number']}.{one['fraction'] or 0}") for one in found[seconds]]
    falls = sum(later < earlier for earlier, later in pairwise(values))
    if 50 * falls > len(values) or len(set(values)) < min(3, len(values)):
        del found[seconds]
    best = max(found, key=lambda style: len(found[style]))
    return best if _LEAST_SHARE * len(lines) <= len(found[best]) else None


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
        """A clock; the first lines show the order of day and month, and the unit of seconds."""
        heading = next(filter(None, map(_HEADING.match, lines)), None)
        self._unit = _UNITS[heading[2].lower()] if heading else _SECOND
        self._zone, self._start_ns = options.zone, options.start_ns
        self._day, self._source = (options.day, "") if options.day else _day_of(Path(name))
        self._day_first, self._ambiguous = _order(lines, self._day)
        self._kinds = set[str]()
        self._lacking = self._falls = 0
        self._last_ns: int | None = None
        self._fall = ""

    def time_ns(self, found: re.Match[str] | None) -> int | None:
        """The time of a match of a style; the last one, if it is missing or not a time of rows."""
        t_ns = None if found is None else self._time_of(found)
        if found is None or t_ns is None or not 0 <= t_ns < END_NS:
            self._lacking += 1
            return self._last_ns
        if self._last_ns is not None and t_ns < self._last_ns:
            self._falls += 1
            fall_s = (self._last_ns - t_ns) / _SECOND
            self._fall = self._fall or f"by {fall_s:,.9g} s to {found[0]}"
        self._last_ns = t_ns
        return t_ns

    def _time_of(self, found: re.Match[str]) -> int | None:
        groups = found.groupdict()
        try:
            return self._clock_ns(groups) if found.re is CLOCK else self._digits_ns(groups)
        except (ValueError, OverflowError):
            return None

    def _digits_ns(self, groups: dict[str, str | None]) -> int:
        if stamp := groups.get("stamp"):
            digits = re.sub(r"\D", "", stamp)
            moment = datetime.strptime(digits, "%Y%m%d%H%M%S").replace(tzinfo=self._zone or UTC)
            self._note_zone(None)
            return _since_1970(moment) + _fraction(groups["part"])
        if whole := groups.get("whole"):
            return int(whole.ljust(19, "0"))
        if epoch := groups.get("epoch"):
            return int(epoch) * _SECOND + _fraction(groups["fraction"])
        number, part = groups["number"] or "", groups["fraction"] or ""
        self._kinds.add("seconds")
        unit = _UNITS.get(groups.get("unit") or "", self._unit)
        ns = int(number) * unit + int(part[:9].ljust(9, "0")) * unit // _SECOND
        return ns + (self._start_ns or 0)

    def _clock_ns(self, groups: dict[str, str | None]) -> int:
        day, zone = groups["date"], groups["zone"]
        half = groups["early"] or groups["late"] or ""
        self._note_zone(zone)
        when = self._day if day is None else _date(day, groups["year"], self._day, self._day_first)
        t_ns = _clock_ns(when, groups["clock"] or "", half, zone, self._zone or UTC)
        t_ns += _fraction(groups["fraction"])
        if day is not None:
            if not re.search(r"\d{4}|\d[-/.]\d+[-/.]\d", day + (groups["year"] or "")):
                self._kinds.add("year")
            return t_ns
        self._kinds.add("date")
        if self._last_ns is not None and t_ns < self._last_ns - _DAY // 2:
            self._day += timedelta(days=1)
            t_ns += _DAY
        return t_ns

    def _note_zone(self, zone: str | None) -> None:
        if zone is None and self._zone is None:
            self._kinds.add("zone")

    def notes(self) -> Iterator[str]:
        """What the times lack, and where that comes from."""
        if self._source and not self._kinds.isdisjoint(("date", "year")):
            lacking = "date" if "date" in self._kinds else "year"
            found = self._day if lacking == "date" else self._day.year
            yield (
                f"its times have no {lacking}; {self._source} gives {found},"
                " --date 2026-01-31 says another"
            )
        if self._ambiguous:
            order = "day" if self._day_first else "month"
            yield (
                f"its dates, such as {self._ambiguous}, could be day or month first, and are read"
                f" {order} first; --date 2026-01-31 says the first date"
            )
        if "zone" in self._kinds:
            yield "its times name no zone, and are taken as UTC; --zone +08:00 says another"
        if "seconds" in self._kinds and self._start_ns is None:
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
            times = "once" if self._falls == 1 else f"{self._falls:,} times"
            yield f"its times step back {times}, first {self._fall}; rows keep the later time"


def _fraction(digits: str | None) -> int:
    return int((digits or "")[:9].ljust(9, "0"))


def _since_1970(moment: datetime) -> int:
    return (moment - _EPOCH) // timedelta(seconds=1) * _SECOND


@lru_cache(4096)
def _clock_ns(day: date, clock: str, half: str, zone: str | None, default: tzinfo) -> int:
    hour, minute, second = map(int, clock.split(":"))
    if half:
        hour = hour % 12 + 12 * (half in "pP下午")
    own = default
    if zone and zone[0] in "+-":
        offset = timedelta(hours=int(zone[1:3]), minutes=int(zone[-2:]))
        own = timezone(-offset if zone[0] == "-" else offset)
    elif zone:
        own = UTC
    moment = datetime(day.year, day.month, day.day, hour, minute, min(second, 59), tzinfo=own)
    return _since_1970(moment)


@lru_cache(1024)
def _date(text: str, year: str | None, near: date, day_first: bool) -> date:
    """The day of a date; raises ValueError if there is none."""
    numbers = [int(one) for one in re.findall(r"\d+", f"{text} {year or ''}")]
    if name := re.search("[a-z]{3}", text.lower()):
        month = _MONTHS.index(name[0]) + 1
        day, *years = numbers
        return date(years[0] if years else near.year, month, day)
    if len(numbers) == 2:
        return date(near.year, *numbers)
    if re.match(r"\d{4}", text):
        return date(*numbers)
    first, second, short = numbers
    day, month = (first, second) if "." in text or day_first else (second, first)
    return date(short + 2000 * (short < 100), month, day)


def _order(lines: Iterable[str], near: date) -> tuple[bool, str]:
    """Whether dates such as 2/8/2026 have the day first; and one of them if that is not certain."""
    dates = {one["date"] for line in lines if (one := CLOCK.search(line)) and one["date"]}
    texts = [text for text in dates if re.match(r"\d\d?[-/]\d\d?[-/]\d", text)]
    pairs = [[int(one) for one in re.findall(r"\d+", text)] for text in texts]
    if not texts or any(second > 12 for _, second, _ in pairs):
        return False, ""
    if any(first > 12 for first, *_ in pairs):
        return True, ""
    text = max(texts)
    month_first, day_first = (abs(_date(text, None, near, one) - near) for one in (False, True))
    return day_first < month_first, text if day_first != month_first else ""


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
