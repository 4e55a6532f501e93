"""Times in the lines of a log: one table of their forms, and the clock that they are read by.

A time is a date with a clock, a clock alone, or a number: since 1970, or since a start.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from functools import cache
from itertools import islice, pairwise
from pathlib import Path
from time import time_ns
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from fte_sniff.formats.log_form import LATEST_NS, NO_TIME

if TYPE_CHECKING:
    from fte_sniff.formats.log_form import Array, LogOptions

SECOND: Final = 10**9
_DAY_NS: Final = 86_400 * SECOND
_QUARTER_NS: Final = 900 * SECOND

_MONTHS: Final = "jan|feb|mar|apr|may|jun|jul|aug|sep|oct|nov|dec"
_NAMED: Final = rf"(?P<name>(?i:{_MONTHS}))[a-z]*"
_MONTH: Final = "1[0-2]|0?[1-9]"
_DAY: Final = r"3[01]|[12]\d|0?[1-9]"
_EITHER: Final = "day or month first"
DATES: Final = {
    "date":  # ISO 8601: Python, Go, Java, ROS, socat; tools in Chinese
        rf"(?P<y>\d{{4}})(?:[-/.]|年)(?P<mo>{_MONTH})(?:[-/.]|月)(?P<d>{_DAY})(?:日)?",
    "day first":  # tools in German and Russian
        r"(?P<d>\d{1,2})\.(?P<mo>\d{1,2})\.(?P<y>\d{4}|\d\d)",
    _EITHER:  # Docklight, Eltima, Windows tools in the order of the country
        r"(?P<a>\d{1,2})[-/](?P<b>\d{1,2})[-/](?P<y>\d{4}|\d\d)",
    "digits": r"(?P<y>20\d\d)(?P<mo>\d\d)(?P<d>\d\d)",  # embedded loggers, file names
    "day and name": rf"(?P<d>\d{{1,2}})[- ]{_NAMED}[- ](?P<y>\d{{4}})",  # git, Apache
    "name and day": rf"{_NAMED} +(?P<d>\d{{1,2}})(?:,? (?P<y>\d{{4}}))?",  # syslog, ts, Tera Term
    "month and day": r"(?P<mo>\d\d)[-/](?P<d>\d\d)",  # logcat, LLCOM
}  # fmt: skip
"""Regular expressions of the dates before a clock; an earlier one is preferred."""
_HALF: Final = "[AaPp][Mm]|上午|下午"
_MICROS: Final = r"(?:,(?P<us>\d{3})(?=\]))?"  # Zephyr
_ZONE: Final = r"(?P<zone> ?(?:Z|UTC)(?!\w)| ?(?P<sign>[+-])(?P<zh>\d\d):?(?P<zm>\d\d)(?!\d))?"
CLOCK: Final = (
    rf"(?:(?P<half>{_HALF}) *)?"
    r"(?P<h>2[0-4]|[01]?\d)(?::|时)(?P<mi>[0-5]\d)(?::|分)(?P<s>[0-5]\d|60)(?:秒)?"
    rf"(?:(?:\.|[:,](?=\d{{3}}(?!\d)|\d{{6}}[+-]))(?P<f>\d{{1,9}}){_MICROS})?"
    rf"(?![\d_]|:\w)(?: ?(?P<half2>{_HALF}))?(?: (?P<y2>20\d\d)(?!\d))?{_ZONE}"
)
"""A time of day in 12 or 24 hours, perhaps with the year and the zone after it."""
_WHOLE: Final = r"(?<![\w.+-])(?<!\d:)(?P<n>\d+)"
_FRACTION: Final = r"\.(?P<f>\d{1,9})\d*"
_NUMBER: Final = rf"{_WHOLE}(?:{_FRACTION})?(?![\w.])"
_BEGIN: Final = r"(?<![\w.])(?<!\b[0-9A-Fa-f]{2}:)(?<!\b\d:)(?<!::)"
_THEN: Final = r"(?:T|[,_ ] *)"
_SOCAT: Final = r" (?P<h>\d\d):(?P<mi>\d\d):(?P<s>\d\d)\.000(?P<f>\d{6})" + _MICROS + "(?=  length)"
_DAY_DIGITS: Final = r"(?P<y>20\d\d){0}(?P<mo>0[1-9]|1[0-2]){0}(?P<d>0[1-9]|[12]\d|3[01])"
_CLOCK_DIGITS: Final = r"(?P<h>[01]\d|2[0-3]){0}(?P<mi>[0-5]\d){0}(?P<s>[0-5]\d)"
_COMPACT: Final = (
    f"{_DAY_DIGITS}T?{_CLOCK_DIGITS}".format("")
    + rf"(?:[.,](?P<f>\d{{1,9}}){_MICROS})?{_ZONE}(?![\w.])"
)
_IN_NAME: Final = rf"(?<!\d){_DAY_DIGITS}(?:[-_ T.]+{_CLOCK_DIGITS})?(?!\d)".format("[-_.hm]?")
CLOCKS: Final = {
    "padded": _BEGIN + DATES["date"] + _SOCAT,  # socat 1.7.4.4: microseconds as nine digits
    **{name: f"{_BEGIN}{dates}{_THEN}{CLOCK}" for name, dates in DATES.items()},
    "compact": _BEGIN + _COMPACT,  # file names, PLCs
    "clock": _BEGIN + CLOCK,
}
"""Regular expressions of times of day; an earlier one is preferred."""
NUMBERS: Final = (
    *(  # `time`, candump; JavaScript; ROS, InfluxDB
        (_NUMBER.replace(r"\d+", rf"[12]\d{{{digits}}}"), "epoch", 10 ** (18 - digits))
        for digits in (9, 12, 15, 18)
    ),
    (_NUMBER, "since", 0),  # the heading of the column has the unit: DSView, Saleae
    (_NUMBER + r"(?= ms\b)", "since", 10**6),
    (_NUMBER + r"(?= us\b)", "since", 1000),
    (_NUMBER + r"(?= ns\b)", "since", 1),
    (r"\b[EWIDV] \(" + _NUMBER, "since", 10**6),  # ESP-IDF
    (rf"{_WHOLE}{_FRACTION}(?![\w.])", "since", SECOND),  # dmesg, tshark
)
"""Regular expressions of numbers, what they count from, and nanoseconds of one."""
_ANY: Final = re.sub(
    r"\?P<\w+>", "?:", f"{_BEGIN}(?:{_COMPACT}|(?:(?:{'|'.join(DATES.values())}){_THEN})?{CLOCK})"
)
OF_CLOCK: Final = frozenset({"h", "mi", "s", "f", "us", "n"})
"""Fields that may differ in lines of the same shape; their dates and zones are equal."""
_TIME_WORD: Final = r"(?i)time|stamp|start|\bts\b|时间"
_UNIT: Final = r"(?i)[\[(_ ]([nuµm])s(?:ec(?:onds)?)?(?:[\])]|\b)"
_SCALES: Final = {"m": 10**6, "u": 1000, "µ": 1000, "n": 1}
_LACKING: Final = {
    "since": "count seconds from a start, which is {:%Y-%m-%dT%H:%M:%SZ} by {}; --start"
    " 2026-01-31T12:00:00Z",
    "clock": "have no date: the date is {:%Y-%m-%d} by {}; --date 2026-01-31",
    "year-less": "have no date: the year is {:%Y} by {}; --date 2026-01-31",
}
"""By kind of time, what it lacks, and where that comes from."""

Fields = Mapping[str, tuple[int, int]]
"""By name, where a field of a time begins and ends in the line."""
Read = Callable[[int, int], Any]
"""Reads the number between two offsets of many lines at once."""
Count = Callable[[str, int, str, int], None]
"""Reports what lines do: the number of the first, an example, and how many there are."""


class Stamp(NamedTuple):
    """A time as it is written; the number may be a column of many lines."""

    ns: Any
    """Nanoseconds since 1970, midnight or a start, as the rule's `kind` says; or `NO_TIME`."""
    zone_s: int = NO_TIME
    """Seconds east of UTC; `NO_TIME` if none is written."""


class Text(NamedTuple):
    """A line of a sample with the offsets of its bytes, and the heading above it."""

    line: bytes
    start: int
    stop: int
    above: bytes
    headings: tuple[bytes, ...] = ()
    """Headings of tables above it."""

    def part(self, where: str) -> bytes:
        """The text `before` or `after` the bytes, or the line `above` them."""
        before, after = self.line[: self.start], self.line[self.stop :]
        return {"before": before, "after": after, "above": self.above}[where]

    def near(self, begin: int, end: int) -> Text:
        """The same with a part of the line."""
        line, start, stop = self.line[begin:end], self.start - begin, self.stop - begin
        return self._replace(line=line, start=start, stop=stop)


@cache
def _compiled(pattern: str) -> re.Pattern[bytes]:
    return re.compile(pattern.encode())


def masked(line: bytes) -> bytes:
    """The line with its first date or time hidden, which cannot be bytes."""
    return _compiled(_ANY).sub(lambda found: b"~" * len(found[0]), line, count=1)


@dataclass(slots=True)
class TimeRule:
    """Where the lines of a log have their times, and how they are read."""

    where: str = "none"
    """`before` or `after` the bytes, `above` them in a heading, or `none`."""
    pattern: str = _NUMBER
    """Of the times, in the tables of clocks and numbers."""
    kind: str = "date"
    """`date`, `year-less`, `clock`, `epoch` or `since`; `unread` if numbers above may be times."""
    column: int = 0
    """Which of the times in a line."""
    scale: int = SECOND
    """Nanoseconds of one of the numbers."""
    resolution_ns: int = SECOND
    day_first: bool = False
    """Whether dates such as 5/3/2026 begin with the day."""
    year: int = 1972
    """Of dates without one."""
    first_byte: bool = False
    """Whether the first byte of a line began then; else the last one had arrived."""

    def find(self, text: bytes, start: int, stop: int) -> Fields | None:
        """Where the fields of the time are in a part of a line."""
        found = _compiled(self.pattern).finditer(text, start, stop)
        one = next(islice(found, self.column, None), None)
        return one and {name: one.span(name) for name, part in one.groupdict().items() if part}

    def stamp(self, text: bytes, fields: Fields, read: Read | None = None) -> Stamp | None:
        """The time of the fields of a line, None if it is impossible.

        For many lines of the same shape, `read` reads their numbers.
        """
        part = {name: text[slice(*span)] for name, span in fields.items()}
        number: dict[str, Any] = {name: int(own) for name, own in part.items() if own.isdigit()}
        if read is not None:
            number |= {name: read(*fields[name]) for name in number.keys() & OF_CLOCK}
        most = {"h": 24, "mi": 59, "s": 60, "n": LATEST_NS // self.scale, "y": 2261}
        for name in number.keys() & most.keys():
            largest = number[name] if isinstance(number[name], int) else number[name].max()
            if largest > most[name]:
                return None
        ns = number.get("f", 0) * self.scale // 10 ** len(part.get("f", b""))
        if "n" in number:
            return Stamp(number["n"] * self.scale + ns)
        hours = number["h"]
        if half := part.get("half") or part.get("half2"):
            hours = hours % 12 + 12 * (half.lower() in (b"pm", "下午".encode()))
        ns += ((hours * 60 + number["mi"]) * 60 + number["s"]) * SECOND + number.get("us", 0) * 1000
        if "name" in part:
            number["mo"] = 1 + _MONTHS.index(part["name"].decode().lower()) // 4
        if "a" in part:
            number["d"], number["mo"] = (number[one] for one in ("ab" if self.day_first else "ba"))
        if "d" in number:
            year = number.get("y", number.get("y2", self.year))
            try:
                ns += _midnight_ns(_date(year, number["mo"], number["d"]))
            except ValueError:
                return None
        if "zone" not in part:
            return Stamp(ns)
        east_s = (number.get("zh", 0) * 60 + number.get("zm", 0)) * 60
        return Stamp(ns, -east_s if part.get("sign") == b"-" else east_s)

    def decide(self, texts: Iterable[bytes], near: date, *, given: bool) -> list[str]:
        """Decide the resolution, and the order of day and month; returns notes about them.

        Texts of the log are read until they show both; if none shows the order, it is that whose
        date is near the date that is `given`, or that of the file.
        """
        if self.kind == "unread":
            return ["numbers in the lines above the bytes may be times; they are not read"]
        fractions, dates = {b""}, set[tuple[int, ...]]()
        form, either = _compiled(self.pattern), self.pattern == CLOCKS[_EITHER]
        for text in texts if "h" in form.groupindex else ():
            found = [*form.finditer(text)]
            fractions |= {(one["f"] or b"") + (one["us"] or b"") for one in found}
            if either:
                dates |= {tuple(map(int, one.group("a", "b", "y"))) for one in found}
            digits = max(len(fraction.rstrip(b"0")) for fraction in fractions)
            self.resolution_ns = SECOND // 10**digits
            certain = not either or any(max(one[:2]) > 12 for one in dates)
            if certain and digits == max(map(len, fractions)):
                break
        month_first, day_first = (_plausible(dates, near, day_first=one) for one in (False, True))
        self.day_first = day_first >= month_first
        month, day, year = min(dates, default=(0, 0, 0))
        if given or month == day or month_first[:2] != day_first[:2]:
            return []
        return [
            f"its dates, such as {month}/{day}/{year}, could be day or month first, and are read"
            f" {'day' if self.day_first else 'month'} first; --date 2026-01-31 says the first date"
        ]


def _date(year: int, month: int, day: int) -> date:
    return date(year + 2000 if year < 100 else year, month, day)


def _midnight_ns(day: date) -> int:
    return (day - date(1970, 1, 1)).days * _DAY_NS


def _plausible(dates: Iterable[tuple[int, ...]], near: date, *, day_first: bool) -> list[int]:
    """How plausible an order of day and month is: by possible dates, few months, a near date."""
    days = list[date]()
    for first, second, year in dates:
        with suppress(ValueError):
            days.append(_date(year, *((second, first) if day_first else (first, second))))
    months = {(day.year, day.month) for day in days}
    return [len(days), -len(months), -min((abs(day - near).days for day in days), default=0)]


def time_rule(texts: Sequence[Text]) -> TimeRule:
    """Where lines have their times, by a sample of lines with bytes."""
    for rule_of in (_rule_of_clocks, _rule_of_numbers):
        for where in ("before", "after"):
            if rule := rule_of(where, [text.part(where) for text in texts], texts):
                return rule
    headings = list(dict.fromkeys(text.above for text in texts))
    if len(headings) > 1 and (rule := _rule_of_clocks("above", headings, texts)):
        return rule
    unread = len(headings) > 2 and _rule_of_numbers("above", headings, texts)
    return TimeRule(kind="unread" if unread else "date")


def _rule_of_clocks(where: str, parts: Sequence[bytes], _: Sequence[Text]) -> TimeRule | None:
    """The first form that more than half of the parts have."""
    for name, pattern in CLOCKS.items():
        found = [one.groupdict() for part in parts if (one := _compiled(pattern).search(part))]
        if len(found) > 0.5 * len(parts):
            has_year = any(one.get("y") or one.get("y2") for one in found)
            kind = "clock" if name == "clock" else "date" if has_year else "year-less"
            return TimeRule(where, pattern, kind)
    return None


def _rule_of_numbers(where: str, parts: Sequence[bytes], texts: Sequence[Text]) -> TimeRule | None:
    """The first form with a column of rising numbers in more than half of the parts."""
    for pattern, kind, unit in NUMBERS:
        rows = [[*_compiled(pattern).finditer(part)] for part in parts]
        for column in range(max(map(len, rows), default=0)):
            values = [row[column] for row in rows if len(row) > column]
            scale = unit or _unit(texts[0], where, values[0].start())
            times = [float(b"%b.%b" % (one["n"], one["f"] or b"0")) for one in values]
            falls = sum(later < earlier for earlier, later in pairwise(times))
            changes = kind == "epoch" or len(times) < 3 or len(set(times)) > 2
            if scale and falls <= len(times) // 50 and changes and len(times) > 0.5 * len(parts):
                places = max(len(one["f"] or b"") for one in values)
                return TimeRule(where, pattern, kind, column, scale, max(1, scale // 10**places))
    return None


def _unit(text: Text, where: str, start: int) -> int:
    """Nanoseconds of one, by the heading of the column of times that begins there; 0 without."""
    before = text.line[: text.stop + start] if where == "after" else text.part(where)[:start]
    cell = before.count(b",")
    for heading in reversed(text.headings):
        cells = heading.decode("utf-8", "replace").split(",")
        if len(cells) > cell and re.search(_TIME_WORD, cells[cell]):
            unit = re.search(_UNIT, cells[cell])
            return _SCALES[unit[1].lower()] if unit else 0
    return 0


class LogClock:
    """Turns the stamps of one log, in their order, into nanoseconds since 1970 UTC."""

    def __init__(self, rule: TimeRule, options: LogOptions, count: Count) -> None:
        self._rule, self._options, self._count = rule, options, count
        self._base_ns, self._last, self._last_ns = 0, Stamp(NO_TIME), 0
        self.notes: list[str] = []
        """What the times lack, and where that comes from."""

    def settle(self, stamps: Sequence[Stamp], name: str, written_ns: int | None) -> None:
        """Decide what the times count from.

        It is given by options, else by the name of the file, else by when it was written (None for
        a pipe) and the stamps of a sample, the first and the last of the log among them.
        """
        kind, day, self._last = self._rule.kind, self._options.day, stamps[0]
        if kind not in _LACKING:
            return
        given, named = day and _midnight_ns(day), time_in_name(name, clock=kind == "since")
        passed = _DAY_NS * sum(b.ns < a.ns - _DAY_NS // 2 for a, b in pairwise(stamps))
        if kind == "since":
            given = self._options.start_ns
            passed = 0 if written_ns is None else max(stamp.ns for stamp in stamps)
        other = "the time of the first read"
        if written_ns is not None:
            other = "the file's modification time" + " minus the last time" * (kind == "since")
        bases = {"": given, "the file's name": named, other: (written_ns or time_ns()) - passed}
        source, base_ns = next((source, base) for source, base in bases.items() if base is not None)
        if kind == "since" and source == "the file's name":
            base_ns -= _east_s(self._options, base_ns) * SECOND
        begin = datetime.fromtimestamp(base_ns // SECOND, UTC)
        self._rule.year = begin.year
        if kind != "year-less":
            self._base_ns = base_ns if kind == "since" else _midnight_ns(begin.date())
        if source:
            self.notes.append(f"its times {_LACKING[kind].format(begin, source)} sets another")

    def times(self, ns: Array, zones: Array, lines: Array) -> Array:
        """The times of consecutive lines, by their stamps; without one, that before."""
        import numpy as np

        missing = ns == NO_TIME
        if missing.any():
            alone = missing & (self._rule.where != "above")
            self._report("lack a time; that of the line before is taken", alone, lines)
            last = np.maximum.accumulate(np.arange(1, len(ns) + 1) * ~missing)
            ns, zones = (np.append(self._last[at], own)[last] for at, own in enumerate((ns, zones)))
        finer = ~missing & (ns % self._rule.resolution_ns != 0)
        self._report("show a finer time than the first lines", finer, lines)
        t_ns = ns + self._base_ns
        if self._rule.kind == "clock":
            t_ns += _DAY_NS * np.cumsum(np.append(self._last.ns, ns[:-1]) - _DAY_NS // 2 > ns)
        self._last, self._base_ns = Stamp(int(ns[-1]), int(zones[-1])), int(t_ns[-1] - ns[-1])
        if self._rule.kind not in ("since", "epoch"):
            t_ns -= self._east_s(t_ns, zones) * SECOND
        before = np.append(self._last_ns, t_ns[:-1])
        fall_s = f"{(before - t_ns)[(t_ns < before).argmax()] / SECOND:,.9g} s"
        self._report("step back in time", t_ns < before, lines, fall_s)
        self._last_ns = int(t_ns[-1])
        return np.maximum(t_ns, 0)

    def _east_s(self, local_ns: Array, zones: Array) -> Array:
        """Seconds east of UTC of local times; of those without a zone, that of the options."""
        import numpy as np

        if (zones != NO_TIME).all():
            return zones
        if self._options.zone is None:
            note = "its times name no zone, and are taken as UTC; --zone +08:00 says another"
            self.notes += [] if note in self.notes else [note]
        quarters = local_ns // _QUARTER_NS  # zones change at quarters of an hour
        starts = np.flatnonzero(np.diff(quarters, prepend=quarters[0] - 1))
        east = [_east_s(self._options, own * _QUARTER_NS) for own in quarters[starts].tolist()]
        sizes = np.diff(starts, append=len(quarters))
        return np.where(zones == NO_TIME, np.repeat(east, sizes), zones)

    def _report(self, what: str, which: Any, lines: Array, example: str = "") -> None:
        if which.any():
            self._count(what, int(lines[which.argmax()]), example, int(which.sum()))


def _east_s(options: LogOptions, local_ns: int) -> int:
    there = datetime.fromtimestamp(local_ns // SECOND, UTC).replace(tzinfo=options.zone)
    return int((there.utcoffset() or timedelta()).total_seconds())


def time_in_name(name: str, *, clock: bool) -> int | None:
    """The date in a file name, or with `clock` the time, nanoseconds since 1970; None without."""
    for found in re.finditer(_IN_NAME, Path(name).name):
        with suppress(ValueError):
            year, month, day, hour, minute, second = (int(text or 0) for text in found.groups())
            when = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
            if found["h"] or not clock:
                return int(when.timestamp()) * SECOND
    return None
