"""Times in the lines of a log: one table of their forms, and the clock that they are read by.

A time is a date with a clock, a clock alone, or a number: since 1970, or since a start.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, date, datetime, timedelta
from functools import cache
from itertools import pairwise
from math import gcd
from pathlib import Path
from time import time_ns
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from fte_sniff.formats.logs.log_form import LATEST_NS, NO_TIME

if TYPE_CHECKING:
    from fte_sniff.formats.logs.log_form import Array
    from fte_sniff.formats.logs.reader import LogOptions

SECOND: Final = 10**9
DAY_NS: Final = 86_400 * SECOND

_MONTHS: Final = "jan|feb|mar|apr|may|jun|jul|aug|sep|oct|nov|dec"
_NAMED: Final = rf"(?P<name>(?i:{_MONTHS}))[a-z]*"
_MONTH: Final = "1[0-2]|0?[1-9]"
_DAY: Final = r"3[01]|[12]\d|0?[1-9]"
DATES: Final = {
    # ISO 8601: Python, Go, Java, ROS, socat; tools in Chinese
    "date": rf"(?P<y>\d{{4}})(?:[-/.]|年)(?P<mo>{_MONTH})(?:[-/.]|月)(?P<d>{_DAY})(?:日)?",
    # Docklight, Eltima, Windows tools in the order of the country
    "day or month first": r"(?P<a>\d{1,2})(?P<sep>[-/.])(?P<b>\d{1,2})[-/.](?P<y>\d{4}|\d\d)",
    # embedded loggers, file names
    "digits": r"(?P<y>20\d\d)(?P<mo>\d\d)(?P<d>\d\d)",
    # git, Apache
    "day and name": rf"(?P<d>\d{{1,2}})[- ]{_NAMED}[- ](?P<y>\d{{4}})",
    # syslog, ts, Tera Term
    "name and day": rf"{_NAMED} +(?P<d>\d{{1,2}})(?:,? (?P<y>\d{{4}}))?",
    # logcat, LLCOM
    "month and day": r"(?P<mo>\d\d)[-/](?P<d>\d\d)",
}  # fmt: skip
"""Regular expressions of the dates before a clock; an earlier one is preferred."""
_HALF: Final = "[AaPp][Mm]|上午|下午"
CLOCK: Final = (
    rf"(?:(?P<half>{_HALF}) *)?"
    r"(?P<h>2[0-4]|[01]?\d)(?::|时)(?P<mi>[0-5]\d)(?::|分)(?P<s>[0-5]\d|60)(?:秒)?"
    r"(?:(?:\.|[:,](?=\d{3}(?!\d)))(?P<f>\d{1,9})(?:,(?P<us>\d{3})(?=\]))?)?"
    rf"(?!(?!Z)\w|:\w)(?: ?(?P<half2>{_HALF}))?(?: (?P<y2>20\d\d)(?!\d))?"
    r"(?P<zone> ?(?:Z|UTC)(?!\w)| ?[+-]\d\d:?\d\d(?!\d))?"
)
"""A time of day in 12 or 24 hours, perhaps with the year and the zone after it."""
_NUMBER: Final = r"(?<![\w.+-])(?<!\d:)(?P<n>\d+)(?:\.(?P<f>\d{1,9})\d*)?(?![\w.])"
_BEGIN: Final = r"(?<![\w.])(?<!\b[0-9A-Fa-f]{2}:)(?<!\b\d:)(?<!::)"
_THEN: Final = r"(?:T|[,_ ] *)"
_COMPACT: Final = (
    r"(?P<y>20\d\d)(?P<mo>0[1-9]|1[0-2])(?P<d>0[1-9]|[12]\d|3[01])"
    r"(?P<h>[01]\d|2[0-3])(?P<mi>[0-5]\d)(?P<s>[0-5]\d)(?:[.,](?P<f>\d{1,9}))?(?![\w.])"
)
FORMS: Final = {
    **{name: f"{_BEGIN}{dates}{_THEN}{CLOCK}" for name, dates in DATES.items()},
    "compact": _BEGIN + _COMPACT,  # file names, PLCs
    "clock": _BEGIN + CLOCK,
    "number": _NUMBER,
}
"""Regular expressions of times; an earlier one is preferred."""
_EPOCHS: Final = {10: SECOND, 13: 10**6, 16: 1000, 19: 1}
"""By digits of a number since 1970, nanoseconds in one: `time`, candump, JavaScript, ROS."""
_SCALES: Final = {"": SECOND, "m": 10**6, "u": 1000, "µ": 1000, "n": 1}
_TIME_WORD: Final = r"(?i)time|stamp|start|\bts\b|时间"
_UNIT_IN_HEADING: Final = r"(?i)[\[(_ ]([nuµm])s(?:ec(?:onds)?)?(?:[\])]|\b)"
_LIMITS: Final = {"y": 2261, "h": 24, "mi": 59, "s": 60, "mo": 12, "d": 31, "n": 0}
_NAMED_DAY: Final = (
    r"(?<!\d)(20\d\d)[-_.]?(0[1-9]|1[0-2])[-_.]?(0[1-9]|[12]\d|3[01])"
    r"(?:[-_ T.]+([01]\d|2[0-3])[-_.h]?([0-5]\d)[-_.m]?([0-5]\d))?(?!\d)"
)

Fields = Mapping[str, tuple[int, int]]
"""By name, where a field of a time begins and ends in the line."""
Read = Callable[[int, int], Any]
"""Reads the number between two offsets of a line, or of many lines at once."""


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


@cache
def _form(name: str) -> re.Pattern[bytes]:
    """The expression of a form, or of `any` but a number."""
    if name != "any":
        return re.compile(FORMS[name].encode())
    dates = "|".join(DATES.values())
    any_form = f"{_BEGIN}(?:{_COMPACT}|(?:(?:{dates}){_THEN})?{CLOCK})"
    return re.compile(re.sub(r"\?P<\w+>", "?:", any_form).encode())


def masked(line: bytes) -> bytes:
    """The line with its first date or time hidden, which cannot be bytes."""
    found = _form("any").search(line)
    if found is None:
        return line
    return line[: found.start()] + b"~" * (found.end() - found.start()) + line[found.end() :]


def days_of(year: Any, month: Any, day: Any) -> Any:
    """Days from 1970 of a date; the arguments may be columns. (Howard Hinnant's algorithm.)"""
    year = year - (month <= 2)
    of_year = (153 * ((month + 9) % 12) + 2) // 5 + day - 1
    era = year // 400
    of_era = year - era * 400
    return era * 146097 + of_era * 365 + of_era // 4 - of_era // 100 + of_year - 719468


@dataclass(slots=True)
class TimeRule:
    """Where the lines of a log have their times, and how they are read."""

    where: str = "none"
    """`before` or `after` the bytes, `above` them in a heading, or `none`."""
    form: str = "number"
    """In the table of forms."""
    column: int = 0
    """Which of them; -1 for the last, where labels before it have numbers."""
    scale: int = SECOND
    """Nanoseconds of one of the numbers."""
    kind: str = "date"
    """`date`, `year-less`, `clock`, `epoch` or `since`; `unread` if numbers above may be times."""
    day_first: bool | None = None
    """Whether dates such as 5/3/2026 begin with the day."""
    year: int = 1972
    """Of dates without one."""
    padded: bool = False
    """Whether nine digits are microseconds: socat 1.7.4.4 writes so."""
    resolution_ns: int = SECOND
    first_byte: bool = False
    """Whether the first byte of a line began then; else the last one had arrived."""
    is_open: bool = False
    """Whether more lines could change the resolution, or the order of day and month."""
    _pairs: set[tuple[int, int, int]] = field(default_factory=set)

    def find(self, text: bytes, start: int = 0, stop: int | None = None) -> Fields | None:
        """Where the fields of the time are in a part of a line."""
        form, column, stop = _form(self.form), self.column, len(text) if stop is None else stop
        several = [form.search(text, start, stop)]
        if column:
            several = [*form.finditer(text, start, stop)]
        found = several[column] if -len(several) <= column < len(several) else None
        return found and {
            name: found.span(name) for name, part in found.groupdict().items() if part
        }

    def stamp(self, text: bytes, fields: Fields, read: Read | None = None) -> Stamp | None:
        """The time of the fields, None if it is impossible; `text` is one of the lines."""
        read = read or (lambda start, stop: int(text[start:stop]))
        part = {name: text[slice(*span)] for name, span in fields.items()}
        number: dict[str, Any] = {
            name: read(*fields[name]) for name in fields if part[name].isdigit()
        }
        if "a" in fields:  # 31.01.2026 always begins with the day
            order = "ab" if self.day_first or part["sep"] == b"." else "ba"
            number["d"], number["mo"] = (number[name] for name in order)
        for name in number.keys() & _LIMITS.keys():
            most = number[name] if isinstance(number[name], int) else number[name].max()
            if most > (LATEST_NS // self.scale if name == "n" else _LIMITS[name]):
                return None
        ns: Any = 0
        if "f" in fields:
            ns = number["f"] * self.scale // 10 ** (6 if self.padded else len(part["f"]))
        if "n" in fields:
            return Stamp(number["n"] * self.scale + ns)
        hours = number["h"]
        if half := part.get("half") or part.get("half2"):
            hours = hours % 12 + 12 * (half in (b"PM", b"pm", "下午".encode()))
        ns += ((hours * 60 + number["mi"]) * 60 + number["s"]) * SECOND + number.get("us", 0) * 1000
        if "d" in number:
            if "name" in part:
                number["mo"] = 1 + _MONTHS.index(part["name"].decode().lower()) // 4
            year = number.get("y", number.get("y2", self.year))
            year = year + 2000 if len(part.get("y", b"    ")) == 2 else year
            ns += days_of(year, number["mo"], number["d"]) * DAY_NS
        zone = part.get("zone", b"").decode().strip().replace(":", "")
        east = int(zone[1:3]) * 3600 + int(zone[3:]) * 60 if zone[:1] in ("+", "-") else 0
        return Stamp(ns, (-east if zone[0] == "-" else east) if zone else NO_TIME)

    def learn(self, text: bytes) -> None:
        """Decide the resolution, and the order of day and month, by all times in a text."""
        step, digits = self.resolution_ns, 0
        for found in _form(self.form).finditer(text):
            if fraction := found["f"]:
                digits = 6 if self.padded else max(digits, len(fraction))
                step = gcd(
                    step, int(fraction) * SECOND // 10 ** (6 if self.padded else len(fraction))
                )
            if "a" in found.re.groupindex:
                self._pairs.add((int(found["a"]), int(found["b"]), int(found["y"])))
        self.resolution_ns = 10 ** next(n for n in range(9, -1, -1) if step % 10**n == 0)
        first, second = ({pair[at] for pair in self._pairs} for at in (0, 1))
        certain = max(first, default=13) > 12 or max(second) > 12
        if certain or len(first) != len(second):
            self.day_first = max(first, default=0) > 12 or not (certain or len(first) < len(second))
        self.is_open = not certain or self.resolution_ns * 10**digits > SECOND

    def settle_order(self, near: date, *, given: bool) -> str | None:
        """Decide an order of day and month that no line shows; the note about it.

        The date that is near is `given`, or the latest that is possible.
        """
        if self.day_first is not None or not self._pairs:
            return None
        first, second, year = min(self._pairs)
        year += 2000 if year < 100 else 0
        days = abs(date(year, second, first) - near), abs(date(year, first, second) - near)
        self.day_first = days[0] <= days[1]
        order = "day first" if self.day_first else "month first"
        return (
            None
            if given or first == second
            else (
                f"its dates, such as {first}/{second}/{year}, could be day or month first, and are"
                f" read {order}; --date 2026-01-31 says the first date"
            )
        )


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
    for name in list(FORMS)[:-1]:
        found = [match for part in parts if (match := _form(name).search(part))]
        if len(found) > 0.5 * len(parts):
            years = (match.groupdict() for match in found)
            has_year = any(one.get("y") or one.get("y2") for one in years)
            kind = "clock" if name == "clock" else "date" if has_year else "year-less"
            fractions = {match["f"] or b"" for match in found}
            padded = len(fractions) > 1 and all(re.match(rb"000\d{6}", one) for one in fractions)
            rule = TimeRule(where, name, kind=kind, padded=padded)
            rule.learn(b"\n".join(parts))
            return rule
    return None


def _rule_of_numbers(where: str, parts: Sequence[bytes], texts: Sequence[Text]) -> TimeRule | None:
    rows = [[match[0] for match in _form("number").finditer(part)] for part in parts]
    least = min(map(len, rows), default=0)
    for column in (*range(least), *range(-1, -least - 1, -1)):
        values = [row[column] for row in rows]
        whole, places = zip(
            *(map(len, (value + b".").split(b".")[:2]) for value in values), strict=True
        )
        kind, scale = "since", _unit(texts[0], where, column)
        epoch = len(set(whole)) == 1 and values[0][:1] in b"12" and whole[0] in _EPOCHS
        if scale is None and epoch:
            kind, scale = "epoch", _EPOCHS[whole[0]]
        elif scale is None and min(places):
            scale = SECOND
        times = [float(value) for value in values]
        falls = sum(later < earlier for earlier, later in pairwise(times))
        changes = kind == "epoch" or len(times) < 3 or len(set(times)) > 2
        if scale is not None and falls <= len(times) // 50 and changes:
            resolution_ns = max(1, scale // 10 ** max(places))
            return TimeRule(where, "number", column, scale, kind, resolution_ns=resolution_ns)
    return None


def _unit(text: Text, where: str, column: int) -> int | None:
    """Nanoseconds of one, by the heading of the column, or by the text around the number."""
    start, line = text.stop * (where == "after"), text.above if where == "above" else text.line
    begin, end = [*_form("number").finditer(text.part(where))][column].span()
    cell = line.count(b",", 0, start + begin)
    for heading in reversed(text.headings):
        cells = heading.decode("utf-8", "replace").split(",")
        if len(cells) > cell and re.search(_TIME_WORD, cells[cell]):
            unit = re.search(_UNIT_IN_HEADING, cells[cell])
            return _SCALES[unit[1].lower()] if unit else None
    if re.search(rb"\b[EWIDV] \($", line[: start + begin]):  # ESP-IDF: I (1234) tag
        return 10**6
    beside = re.match(rb" ?([num])s\b", line[start + end :])
    return _SCALES[beside[1].decode()] if beside else None


class LogClock:
    """Turns the stamps of one log, in their order, into nanoseconds since 1970 UTC."""

    def __init__(self, rule: TimeRule, options: LogOptions) -> None:
        self._rule, self._options = rule, options
        self._base_ns, self._last, self._last_ns = 0, Stamp(NO_TIME), 0
        self._first: dict[str, str] = {}
        self._count = Counter[str]()

    def settle(self, stamps: Sequence[Stamp], name: str, written_ns: int | None) -> None:
        """Decide what the times count from.

        Args:
            stamps: those of a sample, the first and the last of the log among them.
            name: the file's; it may hold a date.
            written_ns: when the file was modified; None for a pipe, which is read now.
        """
        options, kind, (named, has_clock) = self._options, self._rule.kind, time_in_name(name)
        self._last = stamps[0]
        base_ns, source = written_ns or time_ns(), "the file's modification time"
        if written_ns is None:
            source = "the time of the first read"
        if kind == "since":
            if options.start_ns is not None:
                base_ns, source = options.start_ns, ""
            elif has_clock:
                base_ns, source = named - self._east_s(named) * SECOND, "the file's name"
            elif written_ns is not None:
                base_ns -= max(stamp.ns for stamp in stamps)
                source += " minus the last time"
            self._base_ns = base_ns
            what = f"count seconds from a start, which is {_iso(base_ns)} by {source}; --start"
            what += " 2026-01-31T12:00:00Z"
        elif kind in ("clock", "year-less"):
            midnights = sum(b.ns < a.ns - DAY_NS // 2 for a, b in pairwise(stamps))
            base_ns -= midnights * DAY_NS if kind == "clock" else 0
            if options.day is not None:
                base_ns, source = days_of(*options.day.timetuple()[:3]) * DAY_NS, ""
            elif named:
                base_ns, source = named, "the file's name"
            day = _iso(base_ns)[:10]
            self._rule.year = int(day[:4])
            self._base_ns = base_ns // DAY_NS * DAY_NS if kind == "clock" else 0
            what = f"date is {day}" if kind == "clock" else f"year is {day[:4]}"
            what = f"have no date: the {what} by {source}; --date 2026-01-31"
        if kind not in ("date", "epoch") and source:
            self._first[source] = f"its times {what} sets another"

    def times(self, ns: Array, zones: Array, lines: Array) -> Array:
        """The times of consecutive lines, by their stamps; without one, that before."""
        import numpy as np

        missing = ns == NO_TIME
        if missing.any():
            alone = missing & (self._rule.where != "above")
            self._note("none", alone, lines, "has no time; it gets the time of the line before it")
            last = np.maximum.accumulate(np.arange(1, len(ns) + 1) * ~missing)
            ns, zones = (np.append(self._last[at], own)[last] for at, own in enumerate((ns, zones)))
        wrong = ~missing & (ns % self._rule.resolution_ns != 0)
        self._note("finer", wrong, lines, "its time is finer than those of the first lines")
        t_ns = ns + self._base_ns
        if self._rule.kind == "clock":
            t_ns += DAY_NS * np.cumsum(np.append(self._last.ns, ns[:-1]) - DAY_NS // 2 > ns)
        self._last, self._base_ns = Stamp(int(ns[-1]), int(zones[-1])), int(t_ns[-1] - ns[-1])
        if self._rule.kind not in ("since", "epoch"):
            local = t_ns // (900 * SECOND)  # zones change at quarters of an hour
            quarters = local[:1] if self._options.zone is None else np.unique(local)
            for quarter in quarters.tolist() if (zones == NO_TIME).any() else ():
                here = (zones == NO_TIME) & ((local == quarter) | (self._options.zone is None))
                zones = np.where(here, self._east_s(quarter * 900 * SECOND), zones)
            t_ns -= zones * SECOND
        before = np.append(self._last_ns, t_ns[:-1])
        text = f"the time goes back by {(before - t_ns)[(t_ns < before).argmax()] / SECOND:,.9g} s"
        self._note("back", t_ns < before, lines, text)
        self._last_ns = int(t_ns[-1])
        return np.maximum(t_ns, 0)

    def _east_s(self, local_ns: int) -> int:
        """Seconds east of UTC of the zone that is given, at a local time."""
        if self._options.zone is None:
            note = "its times name no zone, and are taken as UTC; --zone +08:00 says another"
            self._first["zone"] = note
            return 0
        there = datetime(1970, 1, 1, tzinfo=self._options.zone)
        with suppress(OverflowError, ValueError):
            there += timedelta(seconds=local_ns // SECOND)
        return int((there.utcoffset() or timedelta()).total_seconds())

    def _note(self, problem: str, wrong: Any, lines: Array, text: str) -> None:
        if wrong.any():
            self._first.setdefault(problem, f"line {lines[wrong.argmax()]}: {text}")
            self._count[problem] += int(wrong.sum())

    @property
    def notes(self) -> list[str]:
        """How the times were read, one line each."""
        return [
            text
            + (f", and {self._count[problem] - 1:,} times more" if self._count[problem] > 1 else "")
            for problem, text in self._first.items()
        ]


def _iso(t_ns: int) -> str:
    return f"{datetime.fromtimestamp(t_ns // SECOND, UTC):%Y-%m-%dT%H:%M:%SZ}"


def time_in_name(name: str) -> tuple[int, bool]:
    """The time in a file name, nanoseconds since 1970 or 0, and whether it has a time of day."""
    for found in re.finditer(_NAMED_DAY, Path(name).name):
        with suppress(ValueError):
            year, month, day, hour, minute, second = (int(text or 0) for text in found.groups())
            when = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
            return int(when.timestamp()) * SECOND, found[4] is not None
    return 0, False
