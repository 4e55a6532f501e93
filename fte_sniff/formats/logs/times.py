"""Times in the lines of a log: one table of their forms, and the clock that they are read by.

A time is a date with a clock, a clock alone, or a number: since 1970, or since a start.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, date, datetime
from functools import cache, lru_cache
from itertools import chain, islice, pairwise, product
from pathlib import Path
from time import time_ns
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from fte_sniff.formats.log_form import LATEST_NS, NO_TIME

if TYPE_CHECKING:
    from datetime import tzinfo

    from fte_sniff.formats.log_form import Array, LogOptions

SECOND: Final = 10**9
_DAY_NS: Final = 86_400 * SECOND
_QUARTER_NS: Final = 900 * SECOND

_MONTHS: Final = "jan|feb|mar|apr|may|jun|jul|aug|sep|oct|nov|dec"
_NAMED: Final = rf"(?=[ADFJMNOSadfjmnos])(?i:{_MONTHS})[a-z]*"
_YEAR: Final = r"(?:19|2[01])\d\d"
_DATES: Final = {
    "date": (
        rf"{_YEAR}(?:[-/.]|年)[01]?\d(?:[-/.]|月)[0-3]?\d(?:日)?",  # ISO 8601; tools in Chinese
        rf"\d{{1,2}}\.\d{{1,2}}\.(?:{_YEAR}|\d\d)",  # day first: tools in German and Russian
        rf"\d{{1,2}}[-/]\d{{1,2}}[-/](?:{_YEAR}|\d\d)",  # Docklight, Eltima, Windows
        r"20\d\d(?:0[1-9]|1[0-2])(?:0[1-9]|[12]\d|3[01])",  # embedded loggers, PLCs, file names
        rf"\d{{1,2}}[- ]{_NAMED}[- ]{_YEAR}",  # git, Apache
        rf"{_NAMED} +\d{{1,2}}(?:,? {_YEAR}|(?= +[\d:.]+ 20\d\d\b))",  # ctime, Tera Term
    ),
    "year-less": (
        rf"{_NAMED} +\d{{1,2}}",  # syslog, ts
        r"\d\d[-/]\d\d",  # logcat, LLCOM
    ),
}
_HALF: Final = "[AaPp][Mm]|上午|下午"
_CLOCK: Final = (  # the colons may be absent after a date of eight digits or a T
    rf"(?:(?P<half>{_HALF}) *)?"
    r"(?P<h>2[0-4]|[01]?\d)(?::|时|(?<=\d{10})|(?<=\dT\d\d))"
    r"(?P<mi>[0-5]\d)(?::|分|(?<=\d{12})|(?<=\dT\d{4}))(?P<s>[0-5]\d|60)(?:秒)?"
    r"(?:(?:\.(?:000(?=\d{6}  length))?|[:,](?=\d{3}(?!\d)|\d{6}[+-]))"  # socat 1.7.4.4 pads
    r"(?P<f>\d{1,9})(?:,(?P<us>\d{3})(?=\]))?)?"  # Zephyr writes milliseconds,microseconds
    rf"(?![\d_]|:\w)(?: ?(?P<half2>{_HALF}))?(?: (?P<y>20\d\d)(?!\d))?"
    r"(?P<zone> ?(?:Z|UTC)(?!\w)| ?(?P<sign>[+-])(?P<zh>\d\d):?(?P<zm>\d\d)(?!\d))?"
)
_BEGIN: Final = r"(?<![\w.])(?<!\b[0-9A-Fa-f]{2}:)(?<!\b\d:)(?<!::)"
_THEN: Final = r"(?:T|[,_ ] *|(?<=\d{8}))"
_WHOLE: Final = r"(?<![\w.+-])(?<!\d:)(?P<n>\d+)"
_FRACTION: Final = r"\.(?P<f>\d{1,9})\d*"
_NUMBER: Final = rf"{_WHOLE}(?:{_FRACTION})?(?![\w.])"
FORMS: Final[tuple[tuple[str, int, str], ...]] = (
    *(
        (kind, SECOND, f"{_BEGIN}(?P<date>{one}){_THEN}{_CLOCK}")
        for kind, dates in _DATES.items()
        for one in dates
    ),
    ("clock", SECOND, _BEGIN + _CLOCK),
    *(  # `time`, candump; JavaScript; ROS, InfluxDB
        ("epoch", 10 ** (18 - digits), _NUMBER.replace(r"\d+", rf"[12]\d{{{digits}}}"))
        for digits in (9, 12, 15, 18)
    ),
    ("since", 0, _NUMBER),  # the heading of the column has the unit: DSView, Saleae
    ("since", 10**6, _NUMBER + r"(?= ms\b)"),
    ("since", 1000, _NUMBER + r"(?= us\b)"),
    ("since", 1, _NUMBER + r"(?= ns\b)"),
    ("since", 10**6, r"\b[EWIDV] \(" + _NUMBER),  # ESP-IDF
    ("since", SECOND, rf"{_WHOLE}{_FRACTION}(?![\w.])"),  # dmesg, tshark
)
"""Kinds of times, nanoseconds of one, and regular expressions; an earlier one is preferred."""
_ALL_DATES: Final = "|".join(chain.from_iterable(_DATES.values()))
_ANY: Final = re.sub(r"\?P<\w+>", "?:", f"{_BEGIN}(?:(?:{_ALL_DATES}){_THEN})?{_CLOCK}")
_IN_NAME: Final = (
    r"(?<!\d)(20\d\d[-_.]?\d\d[-_.]?\d\d)(?:[-_ T.]+(\d\d[-_.hm]?\d\d[-_.hm]?\d\d))?(?!\d)"
)
_ZONED: Final = ("zone", "n")
OF_CLOCK: Final = frozenset({"h", "mi", "s", "f", "us", "n"})
"""Fields that may differ in lines of the same shape; their dates and zones are equal."""
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
    """Where the lines of a log have their times, and how they are read.

    Attributes:
        where: `before` or `after` the bytes, `above` them in a heading, or `none`.
        kind: `date`, `year-less`, `clock`, `epoch` or `since`; `unread` if numbers above may be
            times.
        scale: nanoseconds of one of the numbers.
        pattern: of the times, in the table of forms.
        column: which of the times in a line.
        is_local: whether the times are those of a zone that they do not name.
        resolution_ns: nanoseconds of the last digit.
        day_first: whether dates such as 5/3/2026 begin with the day.
        year: of dates without one.
        first_byte: whether the first byte of a line began then; else the last one had arrived.
    """

    where: str = "none"
    kind: str = "date"
    scale: int = SECOND
    pattern: str = _NUMBER
    column: int = 0
    is_local: bool = False
    resolution_ns: int = SECOND
    day_first: bool = False
    year: int = 1972
    first_byte: bool = False

    def find(self, text: bytes, start: int, stop: int) -> Fields | None:
        """Where the fields of the time are in a part of a line."""
        found = _compiled(self.pattern).finditer(text, start, stop)
        for one in islice(found, self.column, self.column + 1):
            fields = {name: one.span(name) for name, part in one.groupdict().items() if part}
            if fields.keys().isdisjoint(_ZONED) == self.is_local:
                return fields
        return None

    def stamp(self, text: bytes, fields: Fields, read: Read | None = None) -> Any:
        """The time of the fields of a line in nanoseconds, None if it is impossible.

        It counts from 1970, midnight or a start, as the `kind` says, in UTC if it has a zone. For
        many lines of the same shape, `read` reads their numbers, and it is a column.
        """
        part = {name: text[slice(*span)] for name, span in fields.items()}
        number: dict[str, Any] = {name: int(own) for name, own in part.items() if own.isdigit()}
        if read is not None:
            number |= {name: read(*fields[name]) for name in number.keys() & OF_CLOCK}
        for name, most in {"h": 24, "mi": 59, "s": 60, "n": LATEST_NS // self.scale}.items():
            own = number.get(name, 0)
            if (own if isinstance(own, int) else own.max()) > most:
                return None
        ns = number.get("f", 0) * self.scale // 10 ** len(part.get("f", b""))
        if "n" in number:
            return number["n"] * self.scale + ns
        hours = number["h"]
        if half := part.get("half") or part.get("half2"):
            hours = hours % 12 + 12 * (half.lower() in (b"pm", "下午".encode()))
        ns += ((hours * 60 + number["mi"]) * 60 + number["s"]) * SECOND + number.get("us", 0) * 1000
        if "date" in part:
            day = _day(part["date"].decode(), number.get("y", self.year), self.day_first)
            if day is None:
                return None
            ns += _midnight_ns(day)
        east_min = number.get("zh", 0) * 60 + number.get("zm", 0)
        return ns + 60 * SECOND * (east_min if part.get("sign") == b"-" else -east_min)

    def decide(self, texts: Iterable[bytes], near: date, *, given: bool) -> list[str]:
        """Decide the resolution, and the order of day and month; returns notes about them.

        Texts of the log are read until they show both; if none shows the order, it is that whose
        date is near the date that is `given`, or that of the file.
        """
        if self.kind == "unread":
            return ["numbers in the lines above the bytes may be times; they are not read"]
        form, fractions, dates = _compiled(self.pattern), {b""}, {b""}
        fields = [name for name in ("f", "us", "date") if name in form.groupindex]
        days = [list[date](), list[date]()]
        for text in texts if len(fields) > 1 else ():
            found = {one.group(*fields) for one in form.finditer(text)}
            fractions |= {(f or b"") + (us or b"") for f, us, *_ in found}
            dates |= {own for one in found for own in one[2:]}
            digits = max(len(fraction.rstrip(b"0")) for fraction in fractions)
            self.resolution_ns = SECOND // 10**digits
            days = [
                [day for one in dates if (day := _day(one.decode(), self.year, day_first))]
                for day_first in (False, True)
            ]
            certain = days[0] == days[1] or len(days[0]) != len(days[1])
            if certain and digits == max(map(len, fractions)):
                break
        plausible = [(len(own), -len({(one.year, one.month) for one in own})) for own in days]
        nearest = [-min((abs(one - near) for one in own), default=near - near) for own in days]
        self.day_first = (plausible[1], nearest[1]) >= (plausible[0], nearest[0])
        if given or days[0] == days[1] or plausible[0] != plausible[1]:
            return []
        return [
            f"its dates, such as {max(dates).decode()}, could be day or month first, and are read"
            f" {'day' if self.day_first else 'month'} first; --date 2026-01-31 says the first date"
        ]


def _midnight_ns(day: date) -> int:
    return (day - date(1970, 1, 1)).days * _DAY_NS


@lru_cache
def _day(text: str, year: int, day_first: bool) -> date | None:
    """The day of a date; None if there is none. The year is that of dates without one."""
    words = re.findall(rf"{_MONTHS}|\b\d{{4}}|\d\d?", text.lower())
    numeric = len(words) == 3 and words[0].isdigit()
    if numeric and len(words[0]) == 4:
        words = [*words[1:], words[0]]
    elif numeric and (day_first or "." in text or words[1].isalpha()):
        words[:2] = words[1::-1]
    with suppress(ValueError):
        month, day, own_year = (*words, year)[:3]
        number = 1 + _MONTHS.index(month) // 4 if month.isalpha() else int(month)
        return date(int(own_year) + 2000 * (int(own_year) < 100), number, int(day))
    return None


def time_rule(texts: Sequence[Text]) -> TimeRule:
    """Where lines have their times, by a sample of lines with bytes."""
    parts = {where: [text.part(where) for text in texts] for where in ("before", "after")}
    headings = list(dict.fromkeys(text.above for text in texts))
    parts["above"] = headings if len(headings) > 1 else []
    for form, where in [*product(FORMS, ("before", "after")), *product(FORMS, ("above",))]:
        rows = [[*_compiled(form[-1]).finditer(part)] for part in parts[where]]
        for column in range(max(map(len, rows), default=0)):
            found = [row[column] for row in rows if len(row) > column]
            rule = TimeRule(where, *form, column)
            if 2 * len(found) > len(rows) and _fits(rule, found, texts[0]):
                unread = where == "above" and rule.kind in ("epoch", "since")
                return TimeRule(kind="unread") if unread else rule
    return TimeRule()


def _fits(rule: TimeRule, found: Sequence[re.Match[bytes]], text: Text) -> bool:
    """Whether what is found are times: numbers rise, and their unit is known."""
    if "h" in found[0].groupdict():
        rule.is_local = 2 * sum(one["zone"] is None for one in found) >= len(found)
        return True
    times = [float(b"%b.%b" % (one["n"], one["f"] or b"0")) for one in found]
    falls = sum(later < earlier for earlier, later in pairwise(times))
    changes = rule.kind == "epoch" or len(times) < 3 or len(set(times)) > 2
    rule.scale = rule.scale or _unit(text, rule.where, found[0].start())
    rule.resolution_ns = max(1, rule.scale // 10 ** max(len(one["f"] or b"") for one in found))
    return rule.scale > 0 and falls <= len(times) // 50 and changes


def _unit(text: Text, where: str, start: int) -> int:
    """Nanoseconds of one, by the heading of the column of times that begins there; 0 without."""
    before = text.line[: text.stop + start] if where == "after" else text.part(where)[:start]
    cell = rf"(?im)^(?:[^,\n]*,){{{before.count(b',')}}}[^,\n]*(?:time|stamp|start|\bts\b|时间)"
    unit = rf"{cell}[^,\n]*[\[(_ ]([nuµm])s(?:ec|\b)"
    found = re.findall(unit, b"\n".join(text.headings).decode("utf-8", "replace"))
    return {"m": 10**6, "n": 1}.get(found[-1].lower(), 1000) if found else 0


class LogClock:
    """Turns the stamps of one log, in their order, into nanoseconds since 1970 UTC."""

    def __init__(self, rule: TimeRule, options: LogOptions, count: Count) -> None:
        self._rule, self._options, self._count = rule, options, count
        self._base_ns, self._last, self._last_ns = 0, NO_TIME, 0
        self.notes: list[str] = []
        """What the times lack, and where that comes from."""

    def settle(self, stamps: Sequence[int], name: str, written_ns: int | None) -> None:
        """Decide what the times count from.

        It is given by options, else by the name of the file, else by when it was written (None for
        a pipe) and the stamps of a sample, the first and the last of the log among them.
        """
        kind, options, self._last = self._rule.kind, self._options, stamps[0]
        if self._rule.is_local and options.zone is None:
            self.notes.append(
                "its times name no zone, and are taken as UTC; --zone +08:00 says another"
            )
        if kind not in _LACKING:
            return
        given, zone, modified = None, None, "the file's modification time"
        last = _DAY_NS * sum(b < a - _DAY_NS // 2 for a, b in pairwise(stamps))
        if kind == "since":
            given, zone, last = options.start_ns, options.zone or UTC, max(stamps)
            modified += " minus the last time"
        elif options.day:
            given = _midnight_ns(options.day)
        bases = {
            "": given,
            "the file's name": time_in_name(name, zone),
            modified: None if written_ns is None else written_ns - last,
            "the time of the first read": time_ns(),
        }
        source, base_ns = next((source, base) for source, base in bases.items() if base is not None)
        begin = datetime.fromtimestamp(base_ns // SECOND, UTC)
        self._rule.year = begin.year
        self._base_ns = {"since": base_ns, "clock": _midnight_ns(begin.date())}.get(kind, 0)
        if source:
            self.notes.append(f"its times {_LACKING[kind].format(begin, source)} sets another")

    def times(self, ns: Array, lines: Array) -> Array:
        """The times of consecutive lines, by their stamps; without one, that before."""
        import numpy as np

        missing = ns == NO_TIME
        if missing.any():
            alone = missing & (self._rule.where != "above")
            self._report("lack a time; that of the line before is taken", alone, lines)
            last = np.maximum.accumulate(np.arange(1, len(ns) + 1) * ~missing)
            ns = np.append(self._last, ns)[last]
        finer = ~missing & (ns % self._rule.resolution_ns != 0)
        self._report("show a finer time than the first lines", finer, lines)
        t_ns = ns + self._base_ns
        if self._rule.kind == "clock":
            t_ns += _DAY_NS * np.cumsum(np.append(self._last, ns[:-1]) - _DAY_NS // 2 > ns)
        self._last, self._base_ns = int(ns[-1]), int(t_ns[-1] - ns[-1])
        if self._rule.is_local and self._options.zone is not None:
            t_ns = _utc_ns(t_ns, self._options.zone)
        before = np.append(self._last_ns, t_ns[:-1])
        fall_s = f"{(before - t_ns)[(t_ns < before).argmax()] / SECOND:,.9g} s"
        self._report("step back in time", t_ns < before, lines, fall_s)
        self._last_ns = int(t_ns[-1])
        return np.maximum(t_ns, 0)

    def _report(self, what: str, which: Any, lines: Array, example: str = "") -> None:
        if which.any():
            self._count(what, int(lines[which.argmax()]), example, int(which.sum()))


def _utc_ns(local_ns: Array, zone: tzinfo) -> Array:
    """Local times in UTC; zones change at quarters of an hour."""
    import numpy as np

    quarters, each = np.unique(local_ns // _QUARTER_NS, return_inverse=True)
    local = (datetime.fromtimestamp(quarter * 900, UTC) for quarter in quarters.tolist())
    begins = np.array([one.replace(tzinfo=zone).timestamp() for one in local], np.int64)
    return begins[each] * SECOND + local_ns % _QUARTER_NS


def time_in_name(name: str, zone: tzinfo | None) -> int | None:
    """The time in a file name, or without a zone the date; nanoseconds since 1970, or None."""
    for day, clock in re.findall(_IN_NAME, Path(name).name):
        text = re.sub("[-_.hm]", "", f"{day}T{clock if zone and clock else '00'}")
        with suppress(ValueError):
            if clock or not zone:
                return (
                    int(datetime.fromisoformat(text).replace(tzinfo=zone or UTC).timestamp())
                    * SECOND
                )
    return None
