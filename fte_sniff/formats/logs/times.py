"""The table of time forms, and where the lines of a log have their times.

ISO            2026-01-31 12:00:05.123   2026-01-31T12:00:05Z   2026年1月31日 12时00分05秒
day or month   31/01/2026 12:00:05       1-31-26 12:00:05 PM    (which, the whole file decides)
month names    Jan 31 12:00:05           31 Jan 2026 12:00:05   Sat Jan 31 12:00:05.123 2026
without year   01-31 12:00:05.123        (logcat)
clock          12:00:05.123   12:00:05:123   12:00:05,123   上午 11:00:05   11:00:05 PM
numbers        epoch in s, ms, µs or ns; seconds since a start, in the unit of a heading
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from itertools import pairwise
from math import gcd
from typing import Any, Final, NamedTuple

SECOND: Final = 10**9
DAY_NS: Final = 86_400 * SECOND

_MONTHS: Final = [
    "jan",
    "feb",
    "mar",
    "apr",
    "may",
    "jun",
    "jul",
    "aug",
    "sep",
    "oct",
    "nov",
    "dec",
]
_MONTH: Final = rf"(?i:{'|'.join(_MONTHS)})[a-z]*"
_CLOCK: Final = (
    r"(?P<h>2[0-4]|[01]?\d)(?::|时)(?P<mi>[0-5]\d)(?::|分)(?P<s>[0-5]\d|60)(?:秒)?"
    r"(?:\.(?P<f>\d{1,9})(?:,(?P<f2>\d{3})(?=\]))?|:(?P<f3>\d{3})|,(?P<f4>\d{3})(?![\d,]))?"
    r"(?!(?!Z)\w|:\w)"
)
_HALF: Final = r"(?P<{}>[AaPp][Mm]|上午|下午)"
_DATE: Final = (
    r"(?P<y>\d{4})[-/.年](?P<mo>1[0-2]|0?[1-9])[-/.月](?P<d>3[01]|[12]\d|0?[1-9])(?:日)?"
    r"|(?P<a>\d{1,2})(?P<sep>[-/.])(?P<b>\d{1,2})(?P=sep)(?P<y1>\d{4}|\d{2})"
    r"|(?P<y2>20\d\d)(?P<mo2>\d\d)(?P<d2>\d\d)"
    rf"|(?P<d3>\d{{1,2}})[- ](?P<n3>{_MONTH})[- ](?P<y3>\d{{4}})"
    rf"|(?P<n4>{_MONTH}) +(?P<d4>\d{{1,2}})(?:,? (?P<y4>\d{{4}}))?"
    r"|(?P<mo5>\d\d)[-/](?P<d5>\d\d)"
)
STRONG: Final = re.compile(
    (
        rf"(?<![\w:.])(?:(?:{_DATE})(?:T|[,_ ] *))?(?:{_HALF.format('p')} *)?{_CLOCK}"
        rf"(?: ?{_HALF.format('p1')})?(?: (?P<y6>20\d\d)(?!\d))?"
        r"(?P<zone> ?(?:Z|UTC)(?!\w)| ?[+-]\d\d:?\d\d(?!\d))?"
    )
    .replace("[-/.年]", "(?:[-/.]|年)")
    .replace("[-/.月]", "(?:[-/.]|月)")
    .encode()
)
"""A date and time, or a time of day."""
NUMBER: Final = re.compile(rb"(?<![\w.+-])\d+(?:\.\d+)?(?![\w.])")
_UNIT: Final = re.compile(r"[\[(_ ](n|u|µ|m|)s(?:ec(?:onds)?)?(?:[\])]|\b)", re.IGNORECASE)
_SCALE: Final = {"": SECOND, "m": 10**6, "u": 1000, "µ": 1000, "n": 1}
_TIME_WORD: Final = re.compile(r"time|stamp|start|\bts\b|时间", re.IGNORECASE)
_EPOCHS: Final = {10: SECOND, 13: 10**6, 16: 1000, 19: 1}
"""By digits of a number since 1970, nanoseconds in one."""


def masked(line: bytes) -> bytes:
    """The line with its first date or time hidden, which cannot be bytes."""
    found = STRONG.search(line)
    if found is None:
        return line
    return line[: found.start()] + b"~" * (found.end() - found.start()) + line[found.end() :]


class Stamp(NamedTuple):
    """A time as it is written; the numbers may be columns of many lines."""

    ns: Any
    """Since midnight, 1970 or a start."""
    days: Any = None
    """Days from 1970; None without a date."""
    zone_s: int | None = None
    """Seconds east of UTC, if written."""
    kind: str = "clock"
    """`clock`, `date`, `year-less`, `epoch` or `since`."""


def days_of(year: Any, month: Any, day: Any) -> Any:
    """Days from 1970 of a date; the arguments may be columns. (Howard Hinnant's algorithm.)"""
    year = year - (month <= 2)
    of_year = (153 * ((month + 9) % 12) + 2) // 5 + day - 1
    era = year // 400
    of_era = year - era * 400
    return era * 146097 + of_era * 365 + of_era // 4 - of_era // 100 + of_year - 719468


Fields = Mapping[str, tuple[int, int]]
"""By name, where a field of a time begins and ends in the line."""
Read = Callable[[int, int], Any]
"""The number between two offsets of a line, or of many lines at once."""


def fields_of(found: re.Match[bytes]) -> Fields:
    """The fields of a time."""
    return {name: found.span(name) for name in found.groupdict() if found[name] is not None}


@dataclass(slots=True)
class TimeRule:
    """Where the lines of a log have their times, and how they are read."""

    where: str = "none"
    """`before` or `after` the bytes, `above` them in a heading, or `none`."""
    column: int = -1
    """For numbers, which one; -1 for dates and clocks."""
    scale: int = SECOND
    """Nanoseconds of one of the numbers."""
    kind: str = "clock"
    day_first: bool | None = None
    """Whether dates such as 5/3/2026 begin with the day; None if nothing shows it."""
    unordered: tuple[int, int, int] | None = None
    """The first such date: its numbers, the year last."""
    fraction_digits: int | None = None
    """Digits of a fraction, if they are not what they seem: socat writes µs with nine."""
    resolution_ns: int = 1
    first_byte: bool = False
    """Whether the first byte of a line began then; else the last one had arrived."""

    def settle_order(self, near: date, *, given: bool) -> str | None:
        """Decide the order of day and month by a date that is near; the note about it.

        The date is `given`, or the latest that is possible.
        """
        if self.unordered is None or self.day_first is not None:
            return None
        first, second, year = self.unordered
        if first == second:
            return None
        days = abs(date(year, second, first) - near), abs(date(year, first, second) - near)
        self.day_first = days[0] <= days[1]
        if given:
            return None
        order = "day first" if self.day_first else "month first"
        return (
            f"its dates, such as {first}/{second}/{year}, could be day or month first, and are"
            f" read {order}; --date 2026-01-31 says the first date"
        )

    def find(self, text: bytes, start: int, stop: int) -> tuple[int, int, Fields] | None:
        """Where the time is in a part of a line."""
        if self.column < 0:
            strong = STRONG.search(text, start, stop)
            return None if strong is None else (*strong.span(), fields_of(strong))
        numbers = list(NUMBER.finditer(text, start, stop))
        if not numbers or self.column >= len(numbers):
            return None
        begin, end = numbers[self.column].span()
        point = text.find(b".", begin, end)
        if point < 0:
            return begin, end, {"n": (begin, end)}
        return begin, end, {"n": (begin, point), "f": (point + 1, end)}

    def stamp(self, text: bytes, fields: Fields, read: Read) -> Stamp:
        """The time of those fields; `text` is the line, or one of many that differ in digits."""
        if "n" in fields:
            return self._of_number(fields, read)
        ns = ((read(*fields["h"]) * 60 + read(*fields["mi"])) * 60 + read(*fields["s"])) * SECOND
        half = next((text[slice(*fields[name])] for name in ("p", "p1") if name in fields), b"")
        if half:
            after_noon = half.upper() in (b"PM", "下午".encode())
            ns = ns % (DAY_NS // 2) + after_noon * (DAY_NS // 2)
        for name in ("f", "f3", "f4"):
            if name in fields:
                ns += self._fraction(*fields[name], read)
        if "f2" in fields:
            ns += read(*fields["f2"]) * 1000
        zone = text[slice(*fields["zone"])].strip() if "zone" in fields else b""
        return self._dated(text, fields, read, ns, _zone_s(zone.decode()))

    def _fraction(self, start: int, stop: int, read: Read) -> Any:
        digits = self.fraction_digits or stop - start
        return read(start, stop) * 10 ** (9 - digits)

    def _of_number(self, fields: Fields, read: Read) -> Stamp:
        ns = read(*fields["n"]) * self.scale
        if "f" in fields:
            start, stop = fields["f"]
            stop = min(stop, start + 9)
            ns += read(start, stop) * self.scale // 10 ** (stop - start)
        return Stamp(ns, kind=self.kind)

    def _dated(self, text: bytes, fields: Fields, read: Read, ns: Any, zone_s: int | None) -> Stamp:
        def number(*names: str) -> Any:
            return next((read(*fields[name]) for name in names if name in fields), None)

        year, month, day = (
            number("y", "y1", "y2", "y3", "y4", "y6"), number("mo", "mo2", "mo5"),
            number("d", "d2", "d3", "d4", "d5"),
        )  # fmt: skip
        if "a" in fields:
            first, second = number("a"), number("b")
            points = text[slice(*fields["sep"])] == b"."  # 31.01.2026 always begins with the day
            day_first = points or self.day_first
            day, month = (first, second) if day_first else (second, first)
            start, stop = fields["y1"]
            year = year + 2000 if stop - start == 2 else year
        for name in ("n3", "n4"):
            if name in fields:
                start = fields[name][0]
                month = _MONTHS.index(text[start : start + 3].decode().lower()) + 1
        if month is None:
            return Stamp(ns, zone_s=zone_s)
        if year is None:
            return Stamp(ns, days_of(1972, month, day), zone_s, "year-less")
        return Stamp(ns, days_of(year, month, day), zone_s, "date")


def _zone_s(text: str) -> int | None:
    if not text:
        return None
    if text in ("Z", "UTC"):
        return 0
    digits = text[1:].replace(":", "")
    east = int(digits[:2]) * 3600 + int(digits[2:]) * 60
    return -east if text[0] == "-" else east


class Text(NamedTuple):
    """A line of a sample with the offsets of its bytes, and the heading above it."""

    line: bytes
    start: int
    stop: int
    above: bytes
    headings: tuple[bytes, ...] = ()
    """Headings of tables above it."""


def time_rule(texts: Sequence[Text]) -> TimeRule:
    """Where lines have their times, by a sample of lines with bytes."""
    least = 0.5 * len(texts)
    for where in ("before", "after"):
        found = [STRONG.search(text.line, *_span(text, where)) for text in texts]
        if sum(one is not None for one in found) > least:
            return _strong_rule(where, [one for one in found if one is not None])
    for where in ("before", "after"):
        if rule := _number_rule(where, texts):
            return rule
    above = {id(text.above): STRONG.search(text.above) for text in texts}
    stamped = [one for one in above.values() if one is not None]
    if len(stamped) > 1 and len(stamped) > 0.5 * len(above):
        return _strong_rule("above", stamped)
    return TimeRule()


def _span(text: Text, where: str) -> tuple[int, int]:
    return (0, text.start) if where == "before" else (text.stop, len(text.line))


def _strong_rule(where: str, found: Sequence[re.Match[bytes]]) -> TimeRule:
    rule = TimeRule(where)
    pairs = [(int(one["a"]), int(one["b"])) for one in found if one["a"]]
    if pairs:
        first, second = (max(column) for column in zip(*pairs, strict=True))
        changes = [len(set(column)) for column in zip(*pairs, strict=True)]
        year = int(found[0]["y1"] or 0)
        rule.unordered = (*pairs[0], year + 2000 * (year < 100))
        if first > 12 or second > 12:
            rule.day_first = first > 12
        elif changes[0] != changes[1]:
            rule.day_first = changes[0] > changes[1]
    fractions = [one["f"] for one in found if one["f"]]
    if len(set(fractions)) > 1 and all(
        len(digits) == 9 and digits.startswith(b"000") for digits in fractions
    ):
        rule.fraction_digits = 6
    steps = 0
    for one in found:
        fields = fields_of(one)
        steps = gcd(steps, rule.stamp(one.string, fields, _reader(one.string)).ns)
    rule.resolution_ns = next(
        step
        for step in (SECOND, 10**8, 10**7, 10**6, 10**5, 10**4, 1000, 100, 10, 1)
        if steps % step == 0
    )
    return rule


def _reader(line: bytes) -> Read:
    return lambda start, stop: int(line[start:stop])


def _number_rule(where: str, texts: Sequence[Text]) -> TimeRule | None:
    rows = [
        [found[0] for found in NUMBER.finditer(text.line, *_span(text, where))] for text in texts
    ]
    for column in range(min(map(len, rows), default=0)):
        values = [row[column] for row in rows]
        rule = _rule_of_numbers(where, column, values, texts[0])
        if rule is not None:
            return rule
    return None


def _rule_of_numbers(where: str, column: int, values: list[bytes], text: Text) -> TimeRule | None:
    whole = {len(value.partition(b".")[0]) for value in values}
    fractions = all(b"." in value for value in values)
    digits = max(whole)
    found = list(NUMBER.finditer(text.line, *_span(text, where)))[column]
    scale = _unit_by_heading(text, found.start()) or _unit_beside(text.line, *found.span())
    kind = "since"
    if scale is None and len(whole) == 1 and digits in _EPOCHS and values[0][:1] in b"12":
        kind, scale = "epoch", _EPOCHS[digits]
    elif scale is None and fractions:
        scale = SECOND
    if scale is None:
        return None
    rule = TimeRule(where, column, scale, kind)
    stamps = []
    for value in values:
        fields = {"n": (0, value.find(b".")), "f": (value.find(b".") + 1, len(value))}
        if b"." not in value:
            fields = {"n": (0, len(value))}
        stamps.append(rule.stamp(value, fields, _reader(value)).ns)
    falls = sum(later < earlier for earlier, later in pairwise(stamps))
    if falls > len(stamps) // 50 or (kind == "since" and len(stamps) > 2 and len(set(stamps)) < 3):
        return None
    places = max(len(value.partition(b".")[2]) for value in values)
    rule.resolution_ns = max(1, scale // 10 ** min(places, 9))
    return rule


def _unit_by_heading(text: Text, start: int) -> int | None:
    """Nanoseconds of one, by the heading of the column at an offset."""
    cell = text.line.count(b",", 0, start)
    for heading in reversed(text.headings):
        cells = heading.decode("utf-8", "replace").split(",")
        if len(cells) > cell and _TIME_WORD.search(cells[cell]):
            unit = _UNIT.search(cells[cell])
            if unit:
                return _SCALE[unit[1].lower()]
            return None
    return None


def _unit_beside(line: bytes, start: int, stop: int) -> int | None:
    """Milliseconds of ESP-IDF's `I (1234) tag:`; a unit after the number."""
    if re.fullmatch(rb"[EWIDV] \(", line[max(0, start - 3) : start]):
        return 10**6
    unit = re.match(rb" ?(n|u|m|)s\b", line[stop : stop + 4])
    return _SCALE[unit[1].decode()] if unit else None
